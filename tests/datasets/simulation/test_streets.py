"""The drive keeps to streets, limits and the non-holonomic constraint."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.simulation.streets import RouteConfig, drive, smoothstep, smoothstep_integral
from certnav.datasets.simulation.trajectory import Trajectory

START = 1287800000.0


@pytest.fixture(scope="module")
def config():
    return RouteConfig(duration=600.0)


@pytest.fixture(scope="module")
def route(config):
    return drive(config, np.random.default_rng(5))


@pytest.fixture(scope="module")
def trajectory(route):
    return Trajectory(START, route.time, route.pos_t, route.rpy, (0.53, 2.0, 30.0))


def test_smoothstep_is_flat_to_third_order_and_its_integral_is_its_integral():
    h = 1e-3
    assert smoothstep(h) < 36 * h**4 and 1.0 - smoothstep(1.0 - h) < 36 * h**4
    x = np.linspace(0.0, 1.0, 2001)
    trapezoid = np.concatenate(
        [[0], np.cumsum(np.diff(x) * 0.5 * (smoothstep(x)[1:] + smoothstep(x)[:-1]))]
    )
    np.testing.assert_allclose(smoothstep_integral(x), trapezoid, atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_vehicle_moves_where_it_points(config, seed):
    route = drive(config, np.random.default_rng(seed))
    trajectory = Trajectory(START, route.time, route.pos_t, route.rpy, (0.53, 2.0, 30.0))
    time = START + np.arange(0.0, 600.0, 0.013)  # between the nodes, too
    k = trajectory.kinematics(time)
    vel_v = np.einsum("nji,nj->ni", k.C_eb, k.vel_e)
    assert np.abs(vel_v[:, 1:]).max() < 1e-5
    assert vel_v[:, 0].min() > -1e-5 and vel_v[:, 0].max() < 15.1


def test_straights_lie_on_streets_and_corners_are_where_streets_cross(route):
    index = route.block_at(route.time)
    quarter = route.rpy[:, 2] / (np.pi / 2)
    straight = np.abs(quarter - np.round(quarter)) < 1e-12
    checked = 0
    for k, block in enumerate(route.blocks):
        on = (index == k) & straight
        across = 1 - block.key[2]
        np.testing.assert_allclose(route.pos_t[on, across], block.corner_t[across], atol=1e-6)
        assert 80.0 <= block.length <= 250.0
        checked += on.sum()
    assert checked > 0.6 * route.time.size
    turns = np.abs(np.diff([b.heading for b in route.blocks]))
    assert set(np.round(np.degrees(turns))) == {0.0, 90.0}


def test_limits_of_accelerations_grade_and_speed_in_turns(trajectory, route):
    time = START + np.arange(0.0, 600.0, 0.02)
    k = trajectory.kinematics(time)
    accel_v = np.einsum("nji,nj->ni", k.C_eb, k.accel_e)
    assert np.abs(accel_v[:, :2]).max() < 3.6
    assert 0.01 < np.abs(np.tan(route.rpy[:, 1])).max() <= 0.06
    turning = np.abs(k.omega_eb_b[:, 2]) > np.radians(10.0)
    speed = np.linalg.norm(k.vel_e[turning], axis=1)
    assert speed.min() > 3.9 and speed.max() < 6.6
    # leans outwards: in a right turn (f_y > 0) the left side goes down
    lateral = accel_v[turning, 1]
    roll = np.interp(time[turning] - START, route.time, route.rpy[:, 0])
    assert np.corrcoef(lateral, roll)[0, 1] < -0.999


def test_stops_are_as_long_as_configured(config, route):
    speed = np.gradient(route.arc_length, route.time)
    standing = np.diff(np.concatenate([[0], (speed < 1e-3).astype(int), [0]]))
    length = (np.flatnonzero(standing < 0) - np.flatnonzero(standing > 0)) * np.diff(route.time)[0]
    assert length[0] >= config.static_start + 1.0
    assert length[1:-1].size >= 3
    # smoothsteps creep below 1 mm/s for up to a second at either end
    assert length[1:-1].min() >= 5.0 and length[1:-1].max() < 33.0
    assert route.time[0] <= 0.0 and route.time[-1] >= config.duration


def test_moving_start_is_at_cruising_speed():
    route = drive(RouteConfig(duration=120.0, moving_start=True), np.random.default_rng(1))
    speed = np.gradient(route.arc_length, route.time)
    assert np.all((speed[:60] > 8.0) & (speed[:60] < 15.0))


def test_without_lights_and_corners_it_drives_straight_on():
    config = RouteConfig(duration=120.0, stop_probability=0.0, turn_probability=0.0)
    route = drive(config, np.random.default_rng(1))
    assert np.ptp(route.rpy[:, 2]) == 0.0
    assert np.diff(route.arc_length)[-100:].min() > 14.0 * np.diff(route.time)[0]


def test_seed_decides(config, route):
    again = drive(config, np.random.default_rng(5))
    other = drive(config, np.random.default_rng(6))
    assert np.array_equal(again.pos_t, route.pos_t)
    assert not np.allclose(other.pos_t, route.pos_t)
