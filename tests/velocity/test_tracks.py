"""Velocities of every source of a recording agree with the motion they were made from."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import C_en_of
from certnav.velocity.tracks import differenced, thinned, tracks


@pytest.fixture(scope="module")
def drive():
    return simulate(SimulationConfig(seed=4, duration=120.0, density="open"))


def truth_n(simulation, track):
    vel_e = simulation.trajectory.vel_e(track.time, simulation.calibration.lever_antenna_b)
    return np.einsum("nji,nj->ni", C_en_of(track.pos_e), vel_e)


def apart(track, vel_n):
    return np.linalg.norm(track.vel_n - vel_n, axis=1)


def test_doppler_is_the_best_there_is(drive):
    found = tracks(drive.sequence())
    assert found.gnss is found.doppler and found.doppler.precise
    error = apart(found.doppler, truth_n(drive, found.doppler))
    assert np.median(error) < 0.15 and error.max() < 2.0
    antenna_e = drive.trajectory.pos_e(found.coarse.time, drive.calibration.lever_antenna_b)
    assert np.median(np.linalg.norm(found.coarse.pos_e - antenna_e, axis=1)) < 60.0
    assert np.isnan(found.coarse.vel_n).all()


@pytest.mark.parametrize("metres", [300.0, 8e3, 3e4])
def test_one_range_wrong_by_kilometres_does_not_move_coarse_positions(drive, metres):
    """Whichever satellite: an orbit 100 km off lengthens its ranges by up to 24 km."""
    sound = drive.sequence().observations
    near = tracks(drive.sequence()).coarse
    for satellite in np.unique(sound.sat)[:6]:
        wrong = sound.pseudorange + metres * (sound.sat == satellite)
        observations = sound.with_columns(pseudorange=wrong)
        found = tracks(dataclasses.replace(drive.sequence(), observations=observations))
        off = found.coarse.pos_e - near.pos_e
        assert len(found.coarse) == len(near)
        assert np.median(np.linalg.norm(off, axis=1)) < 60.0
        assert found.doppler is not None


def test_without_doppler_what_is_carried_and_without_that_what_is_differenced(drive):
    lever = drive.calibration.lever_antenna_b
    time = np.arange(1.0, 119.0) + drive.config.start_time
    rng = np.random.default_rng(1)
    fixes = fixes_from_truth(drive.trajectory, time, lever, 0.5, 0.05, rng)
    sequence = dataclasses.replace(drive.sequence(fixes), observations=None)
    carried = tracks(sequence)
    assert carried.gnss.name == "GNSS velocity" and carried.doppler is None
    assert np.median(apart(carried.gnss, truth_n(drive, carried.gnss))) < 0.15
    blank = dataclasses.replace(fixes, vel_e=np.full_like(fixes.vel_e, np.nan))
    moved = tracks(dataclasses.replace(sequence, fixes=blank)).gnss
    assert moved.name.startswith("differenced")
    assert np.median(apart(moved, truth_n(drive, moved))) < 3.0


def test_differences_over_a_hole_are_no_velocity(drive):
    reference = drive.reference
    keep = (reference.time < reference.time[0] + 20.0) | (reference.time > reference.time[0] + 40.0)
    track = differenced("reference", reference.time[keep], reference.pos_e[keep])
    assert np.isnan(track.vel_n).any(axis=1).sum() == 1
    assert not np.isfinite(track.course(1e9)).any()


def test_thinning_keeps_whole_epochs(drive):
    observations = drive.observations
    few = thinned(observations, 20)
    times = np.unique(few.time)
    assert 15 <= times.size <= 20
    for time in times:
        assert (few.time == time).sum() == (observations.time == time).sum()
