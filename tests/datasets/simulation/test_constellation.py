"""Broadcast orbits against RTKLIB, continuity over records, visibility."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets import gpstime, rtklib
from certnav.datasets.simulation.constellation import GM_GPS, draw_constellation, write_navigation
from certnav.datasets.text.rinex import check_navigation
from certnav.filters.earth import EARTH_RATE, C_en_of, lla_to_ecef

TIME = gpstime.from_calendar(2020, 10, 27, 2, 10)


@pytest.fixture(scope="module")
def ephemerides():
    return draw_constellation(TIME, np.random.default_rng(7))


def test_rtklib_finds_the_same_orbits_and_clocks_in_the_file(ephemerides, tmp_path):
    file = tmp_path / "nav.rnx"
    write_navigation(file, ephemerides, TIME, TIME + 6 * 3600)
    check_navigation(file)
    # across three records: RTKLIB takes the nearest, the simulator always the same
    time = TIME + np.linspace(0.0, 6 * 3600.0, 25)
    pos_e, clock = ephemerides.state((time - ephemerides.toe)[:, None] + 0 * ephemerides.e)
    for j, sat in enumerate(ephemerides.sat):
        states = rtklib.satellite_states([file], [sat], time)
        assert states.healthy.all()
        np.testing.assert_allclose(states.pos_e, pos_e[:, j], atol=1.5e-3)  # 0.24 µs · 3.9 km/s
        np.testing.assert_allclose(states.clock / 299792458.0, clock[:, j], atol=1e-15)


def test_records_before_and_after_a_week_describe_one_orbit(ephemerides):
    saturday = gpstime.from_week_sow(2129, 604800.0 - 7200.0)
    before = ephemerides.shifted(saturday)
    after = before.shifted(saturday + 3 * 7200.0)
    assert gpstime.to_week_sow(after.toe)[0] == 2130
    x = np.linspace(0.0, 3 * 7200.0, 7)[:, None] + 0 * ephemerides.e
    for one, two in zip(before.state(x), after.state(x - 3 * 7200.0), strict=True):
        np.testing.assert_allclose(one, two, atol=1e-3, rtol=0.0)


def test_orbits_obey_newton(ephemerides):
    """Inertial acceleration is GM/r² towards the Earth, but for what stands for the J2 field."""
    h = 1.0
    samples = []
    for d in (-h, 0.0, h):
        pos_e, _ = ephemerides.state(np.full(len(ephemerides.sat), 100.0 + d))
        angle = EARTH_RATE * d
        c, s = np.cos(angle), np.sin(angle)
        x, y, z = pos_e.T
        samples.append(np.stack([c * x - s * y, s * x + c * y, z], axis=-1))
    accel = (samples[0] - 2 * samples[1] + samples[2]) / h**2
    r = np.linalg.norm(samples[1], axis=1, keepdims=True)
    np.testing.assert_allclose(accel, -GM_GPS * samples[1] / r**3, atol=1e-4)  # of 0.56 m/s²
    assert np.all(np.abs(r - 26.56e6) < 0.6e6)


@pytest.mark.parametrize("seed", range(5))
def test_eight_to_thirteen_satellites_in_the_open(seed):
    site = lla_to_ecef(np.radians(30.53), np.radians(114.36), 30.0)
    down_e = C_en_of(site)[:, 2]
    ephemerides = draw_constellation(TIME, np.random.default_rng(seed))
    x = np.arange(0.0, 86400.0, 300.0)[:, None] + 0 * ephemerides.e
    sight = ephemerides.state(x)[0] - site
    up = -(sight @ down_e) / np.linalg.norm(sight, axis=-1)
    count = (up > np.sin(np.radians(5.0))).sum(1)
    assert count.min() >= 7 and count.max() <= 13
    assert np.mean((count >= 8) & (count <= 12)) > 0.99
    assert len(ephemerides.sat) == 31
