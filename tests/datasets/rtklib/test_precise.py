"""Precise ephemerides: orbits and clocks of products take the place of the broadcast ones."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load
from certnav.datasets.rtklib import precise_observations, satellite_states
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.filters.earth import SPEED_OF_LIGHT
from certnav.filters.errors import ConfigError, DataError
from oracles.products import write_clk, write_sp3


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("precise") / "drive"
    simulate_folder(SimulationConfig("drive", 1, 30.0, density="open", imu_rate=10.0), folder)
    return folder, load(folder)


@pytest.fixture(scope="module")
def states(drive):
    """Where the broadcast has the satellites, moved and with clocks that run faster."""
    navigation = drive[1].navigation
    begin = drive[1].observations.time[0]

    def of(shift_m=0.0, faster=0.0):
        def at(names, time):
            found = satellite_states(navigation, names, np.full(len(names), time))
            along = found.vel_e / np.linalg.norm(found.vel_e, axis=1)[:, None]
            # Products leave the periodic relativistic part of the clock to their user.
            moving = found.vel_e + np.cross([0.0, 0.0, 7.2921151467e-5], found.pos_e)
            relativity = -2.0 * np.sum(found.pos_e * moving, axis=1) / SPEED_OF_LIGHT**2
            clock = found.clock / SPEED_OF_LIGHT - relativity + faster * (time - begin)
            return found.pos_e + shift_m * along, clock

        return at

    return of


def files(drive, states, folder, **options):
    observations = drive[1].observations
    names = sorted(set(map(str, observations.sat)))
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
    assert note.endswith("else broadcast")
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


def test_what_the_products_do_not_have_stays_broadcast(drive, states, tmp_path):
    observations = drive[1].observations
    one = str(observations.sat[np.isfinite(observations.sat_pos_e).all(1)][0])
    made = files(drive, states, tmp_path)
    nothing = f"P{one}" + f"{0.0:14.6f}" * 3 + f"{999999.999999:14.6f}"
    lines = made[0].read_text().splitlines()
    lines = [nothing if line.startswith(f"P{one}") else line for line in lines]
    made[0].write_text("\n".join(lines) + "\n")
    found, _ = precise_observations(observations, made)
    rows = observations.sat == one
    np.testing.assert_array_equal(found.sat_pos_e[rows], observations.sat_pos_e[rows])
    assert (found.sat_pos_e != observations.sat_pos_e)[~rows].any()


def test_every_reader_takes_them_and_says_so(drive, states, tmp_path):
    made = files(drive, states, tmp_path)
    loaded = load(drive[0], precise=[str(f) for f in made])
    assert "satellites from precise ephemerides (day.sp3, day.clk)" in loaded.notes[-1]
    assert (loaded.observations.sat_pos_e != drive[1].observations.sat_pos_e).any()
    assert loaded.navigation == drive[1].navigation
    with pytest.raises(ConfigError, match=r"data\.precise: expected names of files"):
        load(drive[0], precise=3)


def test_what_is_no_product_is_refused_by_name(drive, states, tmp_path):
    observations = drive[1].observations
    sp3, clk = files(drive, states, tmp_path)
    with pytest.raises(DataError, match="no orbits: clocks alone"):
        precise_observations(observations, [clk])
    with pytest.raises(DataError, match="no such file"):
        precise_observations(observations, [tmp_path / "other.sp3"])
    with pytest.raises(DataError, match="expected SP3 orbits or RINEX clocks"):
        precise_observations(observations, [drive[1].navigation[0]])
    text = sp3.read_text()
    broken = tmp_path / "broken.sp3"
    broken.write_text(text[:3000].replace("PG", "xG") + text[3000:])
    with pytest.raises(DataError, match=r"broken\.sp3:\d+: expected \d+ satellites"):
        precise_observations(observations, [broken])
    at = text.index("PG") + 10
    broken.write_text(text[:at] + "x" + text[at + 1 :])
    with pytest.raises(DataError, match=r"broken\.sp3:\d+: expected X, Y, Z and clock"):
        precise_observations(observations, [broken])
    head, *epochs = text.split("\n*  ")
    broken.write_text("\n*  ".join([head, *epochs[:5]]) + "\n")
    with pytest.raises(DataError, match="expected 11 epochs or more, found 5"):
        precise_observations(observations, [broken])
    later = dataclasses.replace(observations, time=observations.time + 86400.0)
    with pytest.raises(DataError, match="of none of the satellites at the time"):
        precise_observations(later, [sp3, clk])
    far = dataclasses.replace(observations, time=observations.time + 1800.0)
    with pytest.raises(DataError, match="m from the broadcast ones"):
        precise_observations(far, [sp3, clk])
