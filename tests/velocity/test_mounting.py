"""Mounting angles that the simulator tilted the IMU by."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import DataError
from certnav.filters.rotation import matrix_from_rpy
from certnav.velocity.mounting import calibrate_mounting, sequence_mounting


@pytest.fixture(scope="module")
def tilted():
    config = SimulationConfig(duration=200.0, seed=5, mounting_rpy_deg=(2.0, -3.0, 5.0))
    return simulate(config)


def test_simulated_tilt_is_found_within_its_sigma(tilted):
    found = sequence_mounting(tilted.sequence())
    forward_b = tilted.trajectory.C_bv[:, 0]
    pitch, yaw = -np.arcsin(forward_b[2]), np.arctan2(forward_b[1], forward_b[0])
    assert found.pitch == pytest.approx(pitch, abs=np.radians(0.05))
    assert found.yaw == pytest.approx(yaw, abs=np.radians(0.05))
    assert 0.0 < found.sigma_pitch < np.radians(0.05)
    np.testing.assert_allclose(found.C_bv[:, 0], forward_b, atol=1e-3)


def straight(rng, n=600, seconds=60.0, reverse=0.0, noise=0.0):
    time = np.linspace(0.0, seconds, n)
    C_bv = matrix_from_rpy(np.radians([0.0, 2.0, -4.0]))
    C_eb = matrix_from_rpy(rng.uniform(-1, 1, (n, 3)))
    speed = np.where(rng.random(n) < reverse, -10.0, 10.0)
    vel_b = speed[:, None] * C_bv[:, 0] + noise * rng.standard_normal((n, 3))
    return time, np.einsum("nij,nj->ni", C_eb, vel_b), C_eb, np.zeros((n, 3))


def test_exact_and_reversing_data_give_exact_angles():
    rng = np.random.default_rng(1)
    for reverse in (0.0, 0.3):
        found = calibrate_mounting(*straight(rng, reverse=reverse))
        assert found.pitch == pytest.approx(np.radians(2.0), abs=1e-12)
        assert found.yaw == pytest.approx(np.radians(-4.0), abs=1e-12)


def test_sigma_is_the_spread_of_repeated_calibrations():
    rng = np.random.default_rng(2)
    found = [calibrate_mounting(*straight(rng, noise=0.1)) for _ in range(150)]
    spread = np.std([f.yaw for f in found])
    assert np.mean([f.sigma_yaw for f in found]) == pytest.approx(spread, rel=0.3)


def test_an_imu_mounted_backwards():
    rng = np.random.default_rng(3)
    time, vel_e, C_eb, omega = straight(rng)
    half_turn = matrix_from_rpy([0.0, 0.0, np.pi])
    found = calibrate_mounting(time, vel_e, C_eb @ half_turn, omega)
    assert abs(found.yaw) == pytest.approx(np.pi - np.radians(4.0), abs=1e-9)


def test_too_little_straight_driving_is_refused():
    rng = np.random.default_rng(4)
    time, vel_e, C_eb, omega = straight(rng)
    omega[100:, 2] = 0.2
    with pytest.raises(
        DataError, match="expected 20 s of straight driving above 5 m/s, found 10 s"
    ):
        calibrate_mounting(time, vel_e, C_eb, omega)
    with pytest.raises(DataError, match="found 0 s"):
        calibrate_mounting(time, 0.1 * vel_e, C_eb, np.zeros_like(omega))
