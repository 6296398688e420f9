"""A heading against the velocities, for any error of it: nothing is linearised."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.alignment.velocity_matching import heading_offset
from certnav.filters.rotation import wrap_angle


def turn(angle):
    """Return Rz of each angle, shape (n, 3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    out = np.zeros((*np.shape(angle), 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1] = c, -s, s, c
    out[..., 2, 2] = 1.0
    return out


def driven(offset, gyro_bias=0.0, accel_b=(0.0, 0.0), level_n=(0.0, 0.0), straight=False):
    """Return what `heading_offset` takes, without noise, of a car that sets off and turns.

    What is felt is integrated with a heading that is `offset` [rad] too small at the end.
    """
    fine = np.linspace(0.0, 30.0, 30001)
    speed = 12.0 if straight else np.minimum(4.0 + fine, 12.0)
    heading = 0.4 + (0.0 if straight else np.clip(0.2 * (fine - 12.0), 0.0, 1.6)) + 0.0 * fine
    vel_n = np.column_stack([speed * np.cos(heading), speed * np.sin(heading)])
    accel_n = np.gradient(vel_n, fine, axis=0) + np.asarray(level_n)
    wrong = heading - offset - gyro_bias * (fine - fine[-1])
    body = np.einsum("kji,kj->ki", turn(heading)[:, :2, :2], accel_n) + np.asarray(accel_b)
    felt = np.einsum("kij,kj->ki", turn(wrong)[:, :2, :2], body)
    step = fine[1]
    felt_n = np.vstack([np.zeros(2), np.cumsum(0.5 * (felt[1:] + felt[:-1]), axis=0) * step])
    at = np.arange(0, fine.size, 1000)
    return fine[at], vel_n[at], np.full(at.size, 0.05), felt_n[at], turn(wrong[at])


@pytest.mark.parametrize("offset_deg", [-170.0, -90.0, -30.0, 0.0, 5.0, 60.0, 180.0])
def test_any_offset_is_found(offset_deg):
    found = heading_offset(*driven(np.radians(offset_deg)))
    assert found is not None and found.tells and not found.contradicts
    # The weak prior of level, accelerometers and gyro takes no part where they are zero.
    assert abs(np.degrees(wrap_angle(found.offset - np.radians(offset_deg)))) < 0.2


@pytest.mark.parametrize("error", [
    {"accel_b": (0.3, -0.2)}, {"level_n": (0.5, -0.4)}, {"gyro_bias": np.radians(0.2)},
])  # fmt: skip
def test_what_sensors_and_level_leave_is_no_heading(error):
    found = heading_offset(*driven(np.radians(60.0), **error))
    assert found is not None and found.tells and not found.contradicts
    assert abs(found.offset - np.radians(60.0)) < min(np.radians(6.0), 2.0 * found.sigma)


def test_its_sigma_is_that_of_its_errors():
    time, vel_n, sigma, felt_n, C_nb = driven(np.radians(40.0))
    rng, squares = np.random.default_rng(1), []
    for _ in range(200):
        walk = np.cumsum(rng.normal(0.0, np.sqrt(0.025), (time.size, 2)), axis=0)
        noise = rng.normal(0.0, 0.15, (time.size, 2))
        found = heading_offset(time, vel_n + noise + walk - walk[0], sigma, felt_n, C_nb)
        assert found is not None and found.tells and not found.contradicts
        squares.append(((found.offset - np.radians(40.0)) / found.sigma) ** 2)
    # Chance has 1 ± 0.1; its priors leave room for more than there was.
    assert 0.4 < np.mean(squares) < 1.3


def test_reflections_do_not_turn_it():
    time, vel_n, sigma, felt_n, C_nb = driven(np.radians(40.0))
    wild = vel_n.copy()
    wild[[6, 17, 24]] += [[8.0, -5.0], [-6.0, 9.0], [4.0, 12.0]]
    found = heading_offset(time, wild, sigma, felt_n, C_nb)
    assert not found.tells or abs(found.offset - np.radians(40.0)) < 3.0 * found.sigma


def test_a_straight_road_at_constant_speed_says_nothing():
    time, vel_n, sigma, felt_n, C_nb = driven(np.radians(90.0), straight=True)
    rng = np.random.default_rng(2)
    found = heading_offset(time, vel_n + rng.normal(0, 0.1, vel_n.shape), sigma, felt_n, C_nb)
    assert not found.tells and not found.contradicts


def test_accelerations_of_another_size_are_no_heading():
    time, vel_n, sigma, felt_n, C_nb = driven(0.0)
    found = heading_offset(time, vel_n, sigma, 2.0 * felt_n, C_nb)
    assert not found.tells and found.contradicts and abs(found.scale - 0.5) < 0.02


def test_few_velocities_say_nothing():
    assert heading_offset(*(x[-9:] for x in driven(0.0))) is None
