"""Measurement Jacobians against central differences of the nonlinear prediction."""

import dataclasses

import numpy as np
import pytest

from filters import measurements
from filters.rotation import matrix_from_rotvec

LEVER = np.array([-0.65, -0.05, -0.15])
OMEGA = np.array([0.02, -0.05, 0.35])


def moved(state, x):
    """The state as it would be if the error vector x were added to it."""
    return dataclasses.replace(
        state,
        pos_e=state.pos_e + x[0:3],
        vel_e=state.vel_e + x[3:6],
        C_eb=state.C_eb @ matrix_from_rotvec(x[6:9]),
    )


def predict(kind, state, x):
    new = moved(state, x)
    if kind == "position":
        return measurements.antenna_position(new, LEVER)
    return measurements.antenna_velocity(new, OMEGA - x[9:12], LEVER)


@pytest.mark.parametrize("kind", ["position", "velocity"])
def test_jacobian_against_central_differences(moving_state, kind):
    measured = np.array([1.0, 2.0, 3.0])
    if kind == "position":
        m = measurements.position(moving_state, 15, measured, np.eye(3), LEVER)
    else:
        m = measurements.velocity(moving_state, 15, measured, np.eye(3), LEVER, OMEGA)
    steps = np.repeat([10.0, 1.0, 1e-3, 1e-3, 1.0], 3)
    numeric = np.column_stack(
        [
            (predict(kind, moving_state, s * e) - predict(kind, moving_state, -s * e)) / (2 * s)
            for s, e in zip(steps, np.eye(15), strict=True)
        ]
    )
    np.testing.assert_allclose(m.H, numeric, atol=2e-7)
    np.testing.assert_allclose(m.z, measured - predict(kind, moving_state, np.zeros(15)))


def test_lever_arm_velocity_on_a_circle(moving_state):
    """A point ahead of the IMU moves sideways at r·ω when the vehicle turns."""
    state = dataclasses.replace(moving_state, vel_e=np.zeros(3))
    vel = measurements.antenna_velocity(state, [0, 0, 0.5], [2.0, 0, 0])
    earth_rate_share = 2.0 * 7.3e-5
    np.testing.assert_allclose(state.C_eb.T @ vel, [0, 1.0, 0], atol=earth_rate_share)
