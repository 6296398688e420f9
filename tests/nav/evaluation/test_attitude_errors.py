"""Errors of attitude: as angles, as a vector, and with a constant misalignment removed."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.filters.rotation import (
    matrix_from_rotvec,
    matrix_from_rpy,
    rpy_from_matrix,
    wrap_angle,
)
from certnav.nav.evaluation.accuracy import (
    attitude_vector_from_rpy,
    remove_misalignment,
    rpy_covariance,
    rpy_from_attitude_vector,
    standard_deviation,
)


def test_misalignment_leaves_the_varying_error():
    rng = np.random.default_rng(3)
    ref = np.stack([*rng.normal(0, 0.05, (2, 4000)), rng.uniform(-np.pi, np.pi, 4000)], -1)
    M = matrix_from_rpy([0.02, -0.03, 1.2])
    jitter = matrix_from_rotvec(rng.normal(0, 0.01, (4000, 3)))
    error, found = remove_misalignment(matrix_from_rpy(ref) @ jitter @ M, ref)
    np.testing.assert_allclose(found, [0.02, -0.03, 1.2], atol=3 * 0.01 / np.sqrt(4000))
    np.testing.assert_allclose(error.std(axis=0), 0.01, rtol=0.05)


def test_rpy_covariance_against_finite_differences():
    rpy = np.array([[0.2, -0.6, 2.5]])
    C_nb, numeric = matrix_from_rpy(rpy[0]), np.empty((3, 3))
    for axis in range(3):
        ends = [
            rpy_from_matrix(matrix_from_rotvec(h * np.eye(3)[axis]) @ C_nb) for h in (-1e-6, 1e-6)
        ]
        numeric[:, axis] = wrap_angle(ends[1] - ends[0]) / 2e-6
    A = np.random.default_rng(0).normal(size=(3, 3))
    P = (A @ A.T)[None]
    np.testing.assert_allclose(rpy_covariance(P, rpy)[0], numeric @ P[0] @ numeric.T, rtol=1e-7)
    np.testing.assert_allclose(np.linalg.inv(numeric), attitude_vector_from_rpy(rpy)[0], atol=1e-8)


def test_a_heading_alone_is_averaged_around_the_circle():
    """179° and −179° differ by two degrees, not by 358."""
    heading = np.radians([10.0, 100.0, 200.0, 300.0])
    error = np.radians([179.0, -179.0, 179.5, -179.5])
    C_nb = matrix_from_rpy(np.stack([np.zeros(4), np.zeros(4), heading + error], -1))
    ref = np.stack([np.full(4, np.nan), np.full(4, np.nan), heading], -1)
    ref[3] = np.nan
    left, found = remove_misalignment(C_nb, ref)
    assert np.degrees(abs(found[2])) == pytest.approx(179.833, abs=1e-2)
    assert np.isnan(found[:2]).all() and np.isnan(left[:, :2]).all() and np.isnan(left[3, 2])
    np.testing.assert_allclose(np.degrees(left[:3, 2]), [-0.8333, 1.1667, -0.3333], atol=0.01)
    unknown = np.full((4, 3), np.nan)
    left, found = remove_misalignment(C_nb, unknown)
    assert np.isnan(left).all() and np.isnan(found).all()


def test_misalignment_is_that_of_the_epochs_that_are_known():
    ref = np.zeros((10, 3))
    ref[:, 2] = np.linspace(0.0, 2.0, 10)
    M = matrix_from_rpy([0.02, -0.03, 0.5])
    C_nb = matrix_from_rpy(ref) @ M
    ref[4, 0] = np.nan
    error, found = remove_misalignment(C_nb, ref)
    np.testing.assert_allclose(found, [0.02, -0.03, 0.5], atol=1e-12)
    assert np.isnan(error[4, 0])
    np.testing.assert_allclose(np.delete(error, 4, 0), 0.0, atol=1e-12)


def test_both_ways_between_the_attitude_vector_and_the_angles():
    rpy = np.array([[0.3, -0.4, 2.0], [-0.1, 1.2, -3.0]])
    there, back = attitude_vector_from_rpy(rpy), rpy_from_attitude_vector(rpy)
    assert there.shape == back.shape == (2, 3, 3)
    np.testing.assert_allclose(there @ back, np.tile(np.eye(3), (2, 1, 1)), atol=1e-14)


def test_a_variance_that_rounding_made_negative_is_none():
    cov = np.stack([np.diag([4.0, 9.0, -1e-20]), np.diag([1.0, 0.0, 16.0])])
    np.testing.assert_array_equal(standard_deviation(cov), [[2.0, 3.0, 0.0], [1.0, 0.0, 4.0]])
