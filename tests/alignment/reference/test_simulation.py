"""Simulated windows against the model they are meant to follow."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.alignment.reference.simulation import ORBIT_RADIUS, simulate_window
from certnav.filters.errors import ConfigError


def test_rows_are_the_model_exactly(rng):
    window = simulate_window(rng, 4, clock_rate=0.3, clock_walk=0.1)
    rows = window.rows
    z = np.einsum("ki,ij,kj->k", rows.e_e, window.C_ew, rows.vel_w) - window.clock_drift[rows.epoch]
    np.testing.assert_allclose(rows.z, z, rtol=0, atol=1e-11)


@pytest.mark.parametrize(("motion", "dimensions"), [("2d", 2), ("3d", 3), ("line", 1)])
def test_motion_has_its_dimensions_and_uniform_speed(rng, motion, dimensions):
    rows = simulate_window(rng, 2, motion).rows
    np.testing.assert_allclose(np.linalg.norm(rows.vel_w, axis=1), 3.0)
    assert np.linalg.matrix_rank(rows.vel_w, tol=1e-9) == dimensions


def test_level_motion_is_level_and_satellites_are_above_the_mask(rng):
    for _ in range(20):
        window = simulate_window(rng, 5, "2d")
        rows = window.rows
        up_w = window.C_ew.T @ window.up_e
        assert np.abs(rows.vel_w @ up_w).max() < 1e-12
        first = rows.epoch == 0
        assert np.degrees(np.arcsin(rows.e_e[first] @ window.up_e)).min() > 10.0 - 1e-3


def test_satellites_move_as_kepler_says(rng):
    # Seen from the ground 4 km/s at 20,000–26,000 km: 0.1–0.2 mrad a second.
    rows = simulate_window(rng, 3, epochs=2).rows
    turn = np.linalg.norm(rows.e_e[3:] - rows.e_e[:3], axis=1)
    speed = np.sqrt(3.986004418e14 / ORBIT_RADIUS)
    assert np.all(turn < speed / (ORBIT_RADIUS - 6.4e6))
    assert np.all(turn > 1e-5)


def test_noise_has_the_stated_sigma():
    quiet = simulate_window(np.random.default_rng(8), 8, epochs=400)
    noisy = simulate_window(np.random.default_rng(8), 8, epochs=400, sigma=0.2)
    noise = noisy.rows.z - quiet.rows.z
    assert noise.std() == pytest.approx(0.2, rel=0.05)
    assert np.all(noisy.rows.sigma == 0.2)


def test_clock_walks_with_the_square_root_of_time(rng):
    drawn = [simulate_window(rng, 1, interval=0.25, clock_walk=0.4).clock_drift for _ in range(300)]
    steps = np.diff(drawn, axis=1)
    assert steps.std() == pytest.approx(0.4 * 0.5, rel=0.05)
    np.testing.assert_array_equal(np.array(drawn)[:, 0], 190.3)


def test_same_seed_same_window():
    one, two = (simulate_window(np.random.default_rng(3), 3) for _ in range(2))
    np.testing.assert_array_equal(one.rows.z, two.rows.z)
    np.testing.assert_array_equal(one.C_ew, two.C_ew)


def test_unknown_motion_is_refused(rng):
    with pytest.raises(ConfigError, match="unknown key '3D'"):
        simulate_window(rng, 2, "3D")
