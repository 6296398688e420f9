"""Constellations held against each other: drifts of their own, noise, and real receivers."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from certnav.datasets.loading import load
from certnav.datasets.rtklib import read_observations
from certnav.filters.earth import lla_to_ecef
from certnav.velocity.constellations import compare_constellations
from certnav.velocity.least_squares import doppler_velocities
from certnav.velocity.range_rate import DopplerRows, doppler_rows, with_elevation

#: By constellation: satellites an epoch.
MANY = {"G": 8, "E": 6, "R": 5}


def drive(offsets=(), noises=(), epochs=60, seed=1):
    """Return rows of a moving receiver and their epochs; offsets [m/s] and noises by letter."""
    rng = np.random.default_rng(seed)
    names = [f"{letter}{k:02d}" for letter, n in MANY.items() for k in range(n)]
    letters = np.array([n[0] for n in names])
    sat, e_e, z, epoch = [], [], [], []
    for k in range(epochs):
        e = rng.normal(size=(len(names), 3))
        e[:, 2] = np.abs(e[:, 2])
        e /= np.linalg.norm(e, axis=1)[:, None]
        noise = 0.05 * rng.normal(size=len(names))
        for letter, factor in dict(noises).items():
            noise[letters == letter] *= factor
        value = e @ rng.normal(size=3) * 10.0 - 25.0 + noise
        for letter, offset in dict(offsets).items():
            value[letters == letter] -= offset
        sat += names
        e_e.append(e)
        z.append(value)
        epoch += [k] * len(names)
    n = len(sat)
    rows = DopplerRows(
        np.arange(n), np.array(sat), np.vstack(e_e), np.concatenate(z), np.full(n, 0.05)
    )
    return rows, np.array(epoch)


def by_letter(found):
    return {c.letter: c for c in found}


def test_one_receiver_has_one_drift_and_another_is_found():
    sound = by_letter(compare_constellations(*drive()))
    assert sorted(sound) == ["E", "R"]
    for c in sound.values():
        assert not c.disagrees and abs(c.offset) < 5.0 * c.offset_sigma and c.noise < 1.15
    found = by_letter(compare_constellations(*drive(offsets={"R": 0.4})))
    assert found["R"].disagrees and not found["E"].disagrees
    assert abs(found["R"].offset - 0.4) < 4.0 * found["R"].offset_sigma < 0.05


def test_an_offset_below_the_noise_does_no_harm():
    assert not by_letter(compare_constellations(*drive(offsets={"E": 0.015})))["E"].disagrees


def test_noise_is_that_of_the_constellation():
    found = by_letter(compare_constellations(*drive(noises={"R": 3.0})))
    assert found["R"].noise == pytest.approx(3.0, rel=0.15)
    assert found["E"].noise < 1.2 and not found["R"].disagrees


def test_little_says_nothing():
    assert compare_constellations(*drive(epochs=10)) == []
    rows, epoch = drive()
    alone = rows.take(np.char.startswith(rows.sat, "G"))
    assert compare_constellations(alone, epoch[: len(alone)]) == []


def rms_by_system(observations, pos_e, velocity_at):
    """Return 3-D RMS of least-squares velocities [m/s] of each constellation, and of all."""
    seen = with_elevation(observations, pos_e)
    seen = seen.mark(seen.elevation < np.radians(10.0), "low")
    letters = seen.sat.astype("U1")
    out = {}
    for system in ("GREJC", *np.unique(letters)):
        other = seen.mark(~np.isin(letters, list(system)), "other")
        found = [v for v in doppler_velocities(other, pos_e) if v.ok]
        if found:
            error = np.array([v.vel_e - velocity_at(v.time) for v in found])
            out[str(system)] = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
    rows = doppler_rows(seen, pos_e)
    epoch = np.cumsum(np.diff(seen.time[rows.row], prepend=-np.inf) > 0) - 1
    return out, compare_constellations(rows, epoch)


def at_rest(time):
    return np.zeros(3)


def test_five_constellations_of_a_receiver_at_rest(data_dir, tmp_path):
    """GLONASS by its channels, QZSS and all: together better than any alone, with one drift."""
    folder = data_dir / "nagoya-rtk-static"
    text = gzip.decompress((folder / "rover.obs.gz").read_bytes()).decode()
    head, *epochs = text.split("\n> ")
    (tmp_path / "rover.obs").write_text("\n> ".join([head, *epochs[:60]]) + "\n")
    observations = read_observations(tmp_path / "rover.obs", [folder / "base.nav"])
    assert set(observations.sat.astype("U1")) == set("GREJC")
    lat, lon, height = (float(v) for v in (folder / "rover_position.txt").read_text().split())
    place = lla_to_ecef(np.radians(lat), np.radians(lon), height)
    rms, compared = rms_by_system(observations, place, at_rest)
    assert set(rms) >= {"GREJC", "G", "R", "E", "C"} and max(rms.values()) < 0.06
    assert rms["GREJC"] < 0.015 and rms["GREJC"] == min(rms.values())
    assert compared and not any(c.disagrees for c in compared)


def test_a_base_with_qzss(data_dir):
    folder = data_dir / "fuji-rtk"
    observations = read_observations(folder / "3034265G.21O", [folder / "SEPT2650.21P"])
    place = np.array([-3959400.631, 3385704.533, 3667523.111])
    first = observations.take(observations.time < observations.time[0] + 60.0)
    rms, compared = rms_by_system(first, place, at_rest)
    assert set(rms) == {"GREJC", "G", "E", "J"} and rms["GREJC"] == min(rms.values()) < 0.03
    assert {c.letter for c in compared} <= set("GEJ") and not any(c.disagrees for c in compared)


def test_gps_and_galileo_of_a_simulator_in_motion(data_dir):
    sequence = load(data_dir / "instinct" / "spirent_dynamic")
    truth, o = sequence.reference, sequence.observations
    place = np.column_stack([np.interp(o.time, truth.time, c) for c in truth.pos_e.T])

    def velocity(time):
        return np.array([np.interp(time, truth.time, c) for c in truth.vel_e.T])

    rms, compared = rms_by_system(o, place, velocity)
    assert max(rms.values()) < 0.01
    assert [c.letter for c in compared] == ["E"] and abs(compared[0].offset) < 2e-3
    assert not compared[0].disagrees
