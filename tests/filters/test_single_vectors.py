"""Functions of one position or one vector, as the filter calls them, against those of many."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.filters.earth import C_en_at, C_en_of, gravity_e, lla_to_ecef
from certnav.filters.rotation import crossed, matrix_from_rotvec


def test_axes_and_gravity_of_one_position_are_those_of_many():
    rng = np.random.default_rng(8)
    lat = np.r_[0.0, 0.5 * np.pi, -0.5 * np.pi, rng.uniform(-0.5 * np.pi, 0.5 * np.pi, 200)]
    lon, height = rng.uniform(-np.pi, np.pi, lat.size), rng.uniform(-7e3, 2e4, lat.size)
    pos_e = lla_to_ecef(lat, lon, height)
    one = np.array([C_en_of(p) for p in pos_e])
    far_from_axis = np.abs(lat) < 1.57  # at the poles any direction is north
    exact = C_en_at(lat, lon)[far_from_axis]
    np.testing.assert_allclose(one[far_from_axis], exact, rtol=0, atol=2e-15)
    np.testing.assert_allclose(one, C_en_of(pos_e), rtol=0, atol=2e-15)
    gravity = np.array([gravity_e(p) for p in pos_e])
    np.testing.assert_allclose(gravity, gravity_e(pos_e), rtol=0, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.99e-4, 1.01e-4, 1.0, 3.1, 7.0])
def test_one_vector_turns_as_many_do(angle):
    vectors = np.random.default_rng(3).standard_normal((20, 3))
    vectors *= angle / np.linalg.norm(vectors, axis=1)[:, None]
    one = np.array([matrix_from_rotvec(v) for v in vectors])
    np.testing.assert_allclose(one, matrix_from_rotvec(vectors), rtol=0, atol=2e-15)
    np.testing.assert_allclose(
        [crossed(a, b) for a, b in zip(vectors, vectors[::-1], strict=True)],
        np.cross(vectors, vectors[::-1]), rtol=0, atol=1e-14,
    )  # fmt: skip


def test_a_rotation_that_is_not_finite_is_no_matrix():
    assert np.isnan(matrix_from_rotvec([np.inf, 0.0, 0.0])).all()
