"""Precise products: orbits, clocks and antennas take the place of the broadcast ones."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load, with_precise
from certnav.datasets.rtklib import (
    precise_observations,
    read_observations,
    relative_positions,
    satellite_states,
    single_point,
)
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.filters.earth import SPEED_OF_LIGHT
from certnav.filters.errors import ConfigError, DataError
from oracles.products import write_antex, write_clk, write_sp3


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("precise") / "drive"
    made = SimulationConfig(
        "drive", 1, 30.0, density="open", imu_rate=10.0, base_distance_m=3000.0
    )  # fmt: skip
    simulate_folder(made, folder)
    return folder, load(folder)


@pytest.fixture(scope="module")
def states(drive):
    """Where the broadcast has the satellites, moved and with clocks that are off and run faster."""
    navigation = drive[1].navigation
    begin = drive[1].observations.time[0]

    def of(shift_m=0.0, faster=0.0, late_m=None):
        def at(names, time):
            found = satellite_states(navigation, names, np.full(len(names), time))
            along = found.vel_e / np.linalg.norm(found.vel_e, axis=1)[:, None]
            # Products leave the periodic relativistic part of the clock to their user.
            moving = found.vel_e + np.cross([0.0, 0.0, 7.2921151467e-5], found.pos_e)
            relativity = -2.0 * np.sum(found.pos_e * moving, axis=1) / SPEED_OF_LIGHT**2
            clock = found.clock / SPEED_OF_LIGHT - relativity + faster * (time - begin)
            clock += np.array([(late_m or {}).get(name, 0.0) for name in names]) / SPEED_OF_LIGHT
            return found.pos_e + shift_m * along, clock

        return at

    return of


def files(drive, states, folder, names=None, **options):
    observations = drive[1].observations
    names = names or sorted(set(map(str, observations.sat)))
    begin = np.floor(observations.time[0] / 900.0) * 900.0
    sp3 = begin + 900.0 * np.arange(-6, 8)
    clk = begin + 30.0 * np.arange(62)
    return [
        write_sp3(folder / "day.sp3", names, sp3, states(**options)),
        write_clk(folder / "day.clk", names, clk, states(**options)),
    ]


def test_products_made_of_the_broadcast_give_the_broadcast(drive, states, tmp_path):
    """RTKLIB's interpolation over eleven quarter hours: centimetres, tenths of a millimetre/s."""
    observations = drive[1].observations
    found, note = precise_observations(observations, files(drive, states, tmp_path))
    known = np.isfinite(observations.sat_pos_e).all(1)
    assert known.sum() > 100
    np.testing.assert_allclose(found.sat_pos_e[known], observations.sat_pos_e[known], atol=0.3)
    np.testing.assert_allclose(found.sat_vel_e[known], observations.sat_vel_e[known], atol=1e-3)
    np.testing.assert_allclose(found.sat_clock[known], observations.sat_clock[known], atol=0.1)
    np.testing.assert_allclose(
        found.sat_clock_drift[known], observations.sat_clock_drift[known], atol=2e-3
    )
    assert note.endswith(f"in {len(observations)} of {len(observations)} rows, else broadcast")
    np.testing.assert_array_equal(found.rejected, observations.rejected)


def test_orbits_and_clocks_are_the_products_own(drive, states, tmp_path):
    observations = drive[1].observations
    made = files(drive, states, tmp_path, shift_m=50.0, faster=1e-10)
    found, _ = precise_observations(observations, made)
    known = np.isfinite(observations.sat_pos_e).all(1)
    moved = np.linalg.norm((found.sat_pos_e - observations.sat_pos_e)[known], axis=1)
    np.testing.assert_allclose(moved, 50.0, atol=0.3)
    faster = (found.sat_clock_drift - observations.sat_clock_drift)[known]
    np.testing.assert_allclose(faster, 1e-10 * SPEED_OF_LIGHT, atol=2e-3)


def positions(sequence):
    return single_point(sequence.observations, sequence.navigation, raim=False)


def test_positions_by_products_of_the_broadcast_are_the_broadcasts(drive, states, tmp_path):
    """Orbits to centimetres and clocks to 0.1 ns: weights alone differ, and residuals are small."""
    with_them = with_precise(drive[1], files(drive, states, tmp_path))
    expected, found = positions(drive[1]), positions(with_them)
    assert len(found.fixes) == len(expected.fixes) == 31
    apart = np.linalg.norm(found.fixes.pos_e - expected.fixes.pos_e, axis=1)
    assert apart.max() < 1.5 and np.median(apart) < 0.6
    back = with_precise(drive[1], files(drive, states, tmp_path))  # and exactly so again
    np.testing.assert_array_equal(positions(back).fixes.pos_e, found.fixes.pos_e)


def test_an_error_of_a_products_clock_is_in_the_positions_by_its_gain(drive, states, tmp_path):
    """30 m late on one satellite moves each position by what that range is worth, no more."""
    one = str(drive[1].observations.sat[0])
    sound = positions(with_precise(drive[1], files(drive, states, tmp_path)))
    wrong = with_precise(drive[1], files(drive, states, tmp_path, late_m={one: 30.0}))
    found = positions(wrong)
    for k, satellites in enumerate(sound.satellites):
        moved = found.fixes.pos_e[k] - sound.fixes.pos_e[k]
        gain = sound.ranges[k].gain[:, satellites.index(one)]
        assert np.linalg.norm(30.0 * gain) > 1.0
        np.testing.assert_allclose(moved, 30.0 * gain, atol=0.05)


def test_antennas_are_in_front_of_the_centre_of_mass(drive, states, tmp_path):
    """2 m towards the Earth, in the states and in the ranges; the note says of how many."""
    made = files(drive, states, tmp_path)
    names = sorted(set(map(str, drive[1].observations.sat)))
    plain = with_precise(drive[1], made)
    assert "of centres of mass: no ANTEX" in plain.notes[-1]
    antex = write_antex(tmp_path / "igs.atx", names, 2.0)
    found = with_precise(drive[1], [*made, antex])
    assert f"antennas of {len(names)} satellites" in found.notes[-1]
    moved = found.observations.sat_pos_e - plain.observations.sat_pos_e
    down = -plain.observations.sat_pos_e
    down /= np.linalg.norm(down, axis=1)[:, None]
    np.testing.assert_allclose(np.sum(moved * down, axis=1), 2.0, atol=1e-3)
    # Ranges are shorter by 2 m times the cosine seen from the satellite: the clock's, nearly.
    clock = positions(found).clock - positions(plain).clock
    np.testing.assert_allclose(clock, 2.0, atol=0.1)


def test_relative_positions_do_without(drive, states, tmp_path):
    moved = files(drive, states, tmp_path, shift_m=100.0)
    navigation = [*drive[1].navigation, *moved]
    found, plain = (
        relative_positions(drive[1].rover_file, drive[1].base, n)
        for n in (navigation, drive[1].navigation)
    )
    np.testing.assert_array_equal(found.fixes.pos_e, plain.fixes.pos_e)
    with pytest.raises(DataError, match="without broadcast ephemerides"):
        read_observations(drive[1].rover_file, moved)


def test_what_the_products_do_not_have_stays_broadcast(drive, states, tmp_path):
    observations = drive[1].observations
    one = str(observations.sat[np.isfinite(observations.sat_pos_e).all(1)][0])
    made = files(drive, states, tmp_path)
    nothing = f"P{one}" + f"{0.0:14.6f}" * 3 + f"{999999.999999:14.6f}"
    lines = made[0].read_text().splitlines()
    lines = [nothing if line.startswith(f"P{one}") else line for line in lines]
    made[0].write_text("\n".join(lines) + "\n")
    found, note = precise_observations(observations, made)
    assert note.endswith(f"rows, else broadcast; none of {one}")
    rows = observations.sat == one
    np.testing.assert_array_equal(found.sat_pos_e[rows], observations.sat_pos_e[rows])
    assert (found.sat_pos_e != observations.sat_pos_e)[~rows].any()


def test_what_lies_beyond_the_products_stays_broadcast_and_is_said(drive, states, tmp_path):
    """Rows three hours later, when files end after two."""
    observations = drive[1].observations
    late = observations.time > observations.time[0] + 15.0
    longer = dataclasses.replace(observations, time=observations.time + 10800.0 * late)
    found, note = precise_observations(longer, files(drive, states, tmp_path))
    np.testing.assert_array_equal(found.sat_pos_e[late], observations.sat_pos_e[late])
    assert (found.sat_pos_e != observations.sat_pos_e)[~late].all()
    names = ", ".join(sorted(set(map(str, observations.sat))))
    assert f"in {(~late).sum()} of {late.size} rows, else broadcast; not always of {names}" in note


def test_every_reader_takes_them_and_says_so(drive, states, tmp_path):
    made = files(drive, states, tmp_path)
    loaded = load(drive[0], precise=[str(f) for f in made])
    assert "satellites from precise ephemerides (day.sp3, day.clk; " in loaded.notes[-1]
    assert (loaded.observations.sat_pos_e != drive[1].observations.sat_pos_e).any()
    assert loaded.navigation == (*drive[1].navigation, *made)
    among = load(drive[0], navigation=tuple(str(f) for f in loaded.navigation))
    np.testing.assert_array_equal(among.observations.sat_pos_e, loaded.observations.sat_pos_e)
    assert among.notes[-1] == loaded.notes[-1]
    with pytest.raises(ConfigError, match=r"data\.precise: expected names of files"):
        load(drive[0], precise=3)


def test_what_is_no_product_is_refused_by_name(drive, states, tmp_path):
    observations = drive[1].observations
    sp3, clk = files(drive, states, tmp_path)
    with pytest.raises(DataError, match="no orbits: clocks alone"):
        precise_observations(observations, [clk])
    with pytest.raises(DataError, match="no such file"):
        precise_observations(observations, [tmp_path / "other.sp3"])
    with pytest.raises(DataError, match=r":1: expected SP3 orbits, RINEX clocks or ant"):
        precise_observations(observations, [drive[1].navigation[0]])
    text = sp3.read_text()
    broken = tmp_path / "broken.sp3"
    broken.write_text(text[:3000].replace("PG", "xG") + text[3000:])
    with pytest.raises(
        DataError, match=r"broken\.sp3:\d+: expected \d+ satellites in the epoch before"
    ):
        precise_observations(observations, [broken])
    at = text.index("PG") + 10
    broken.write_text(text[:at] + "x" + text[at + 1 :])
    with pytest.raises(
        DataError, match=r"broken\.sp3:\d+: expected a satellite, its coordinates and"
    ):
        precise_observations(observations, [broken])
    head, *epochs = text.split("\n*  ")
    broken.write_text("\n*  ".join([head, *epochs[:5]]) + "\n")
    with pytest.raises(DataError, match="at least 11 epochs of orbits, found 5"):
        precise_observations(observations, [broken])
    text = clk.read_text()
    broken = tmp_path / "broken.clk"
    broken.write_text(text.replace("  2   ", "  2 x ", 1))
    with pytest.raises(DataError, match=r"broken\.clk:4: expected a satellite, its epoch"):
        precise_observations(observations, [sp3, broken])
    antex = write_antex(tmp_path / "igs.atx", ["G01"], 2.0)
    text = antex.read_text()
    for damage, said in (
        (lambda t: t[:-90], r"igs\.atx:\d+: expected END OF ANTENNA"),
        (lambda t: t.replace("2000.00", "2000 00", 1), r"igs\.atx:\d+: expected offsets north"),
        (lambda t: t.replace("G01   ", "      "), "no antenna of a satellite found"),
    ):
        antex.write_text(damage(text))
        with pytest.raises(DataError, match=said):
            precise_observations(observations, [sp3, antex])
    later = dataclasses.replace(observations, time=observations.time + 86400.0)
    with pytest.raises(DataError, match="of none of the satellites at the time"):
        precise_observations(later, [sp3, clk])
    far = dataclasses.replace(observations, time=observations.time + 1800.0)
    with pytest.raises(DataError, match="m from the broadcast ones"):
        precise_observations(far, [sp3, clk])
