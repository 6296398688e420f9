"""Derivatives on SO(3) against finite differences; Newton's method against known minima."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.alignment.solver.constraints import lift
from certnav.alignment.solver.refinement import (
    cost,
    gradient,
    hessian,
    newton,
    rotation_angle,
    tangent_basis,
)
from certnav.filters.rotation import matrix_from_rotvec


@pytest.fixture
def symmetric(rng):
    A = rng.normal(size=(10, 10))
    return A + A.T


def test_tangent_basis_against_finite_differences(rotations):
    h = 1e-6
    for C in rotations[:5]:
        J = tangent_basis(C)
        for k, axis in enumerate(np.eye(3)):
            ahead, behind = (lift(C @ matrix_from_rotvec(s * h * axis))[:9] for s in (1, -1))
            np.testing.assert_allclose(J[:, k], (ahead - behind) / (2 * h), atol=1e-9)


def test_gradient_against_finite_differences(symmetric, rotations):
    h = 1e-5
    for C in rotations[:5]:
        ahead, behind = (
            [cost(symmetric, C @ matrix_from_rotvec(s * h * axis)) for axis in np.eye(3)]
            for s in (1, -1)
        )
        numeric = (np.array(ahead) - behind) / (2 * h)
        np.testing.assert_allclose(gradient(symmetric, C), numeric, atol=1e-7)


def test_hessian_against_second_differences(symmetric, rotations):
    h = 1e-3

    def f(C, theta):
        return cost(symmetric, C @ matrix_from_rotvec(theta))

    for C in rotations[:5]:
        H = hessian(symmetric, C)
        np.testing.assert_allclose(H, H.T, rtol=0, atol=1e-13)
        for direction in np.vstack([np.eye(3), [[1, 1, 0], [0, 1, 1], [1, 0, 1]]]):
            numeric = (f(C, h * direction) - 2 * f(C, 0 * direction) + f(C, -h * direction)) / h**2
            assert direction @ H @ direction == pytest.approx(numeric, abs=1e-4)


def test_rotation_angle_keeps_small_angles_and_reaches_half_a_turn(rotations):
    axis = np.array([0.6, 0.0, 0.8])
    for angle in (0.0, 1e-12, 1e-7, 0.3, 3.0, np.pi - 1e-7, np.pi):
        turned = rotations[0] @ matrix_from_rotvec(angle * axis)
        assert rotation_angle(rotations[0], turned) == pytest.approx(angle, rel=1e-4, abs=1e-15)
    batch = rotation_angle(rotations, rotations[0])
    expected = (
        Rotation.from_matrix(rotations[0]).inv() * Rotation.from_matrix(rotations)
    ).magnitude()
    np.testing.assert_allclose(batch, expected, atol=1e-7)


def test_newton_ends_at_stationary_minima_from_anywhere(symmetric, rotations):
    for start in rotations[:30]:
        found = newton(symmetric, start)
        assert found.converged
        assert np.linalg.norm(found.gradient) < 1e-11
        assert np.linalg.eigvalsh(found.hessian)[0] > 0.0
        assert found.cost <= cost(symmetric, start)
        assert found.cost == pytest.approx(cost(symmetric, found.C), abs=1e-12)


def test_newton_leaves_saddles_and_maxima():
    # f = −tr(AᵀC) + const, A = diag(3, 2, 1): stationary at the half turns, least at identity.
    Q = np.zeros((10, 10))
    Q[9, [0, 4, 8]] = Q[[0, 4, 8], 9] = [-1.5, -1.0, -0.5]
    for signs in ((1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        start = np.diag(signs).astype(float)
        np.testing.assert_allclose(gradient(Q, start), 0.0, atol=1e-15)
        found = newton(Q, start)
        assert found.converged
        np.testing.assert_allclose(found.C, np.eye(3), atol=1e-9)
        assert found.cost == pytest.approx(-6.0)


def test_newton_converges_quadratically_to_the_noise_free_truth(windows):
    for window, problem in windows(20, 3):
        start = window.C_ew @ matrix_from_rotvec(np.radians([1.0, -2.0, 1.5]))
        found = newton(problem.Q, start, factor=problem.factor)
        assert found.steps <= 8
        assert np.degrees(rotation_angle(found.C, window.C_ew)) < 1e-9


def test_newton_stays_put_where_the_cost_is_flat():
    # Only the first column of C costs anything: turns about it are free.
    Q = np.zeros((10, 10))
    Q[:3, :3] = np.eye(3)
    Q[:3, 9] = Q[9, :3] = [-1.0, 0.0, 0.0]
    Q[9, 9] = 1.0
    start = matrix_from_rotvec([0.4, 0.2, -0.1])
    found = newton(Q, start)
    assert found.converged
    assert found.cost == pytest.approx(0.0, abs=1e-14)
    np.testing.assert_allclose(found.C[:, 0], [1.0, 0.0, 0.0], atol=1e-7)
    assert rotation_angle(found.C, start) < 0.5
