"""Constraints against random rotations, and against matrices that are none."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.alignment.solver.constraints import (
    ALL,
    COLUMNS,
    HANDEDNESS,
    ROWS,
    constraint_matrices,
    lift,
    unlift,
)
from certnav.filters.errors import ConfigError


def values(forms, C):
    x = lift(C)
    return np.einsum("...i,kij,...j->...k", x, forms, x)


def test_lift_stacks_columns_and_unlift_inverts_it(rotations):
    x = lift(rotations)
    np.testing.assert_array_equal(x[:, 3:6], rotations[:, :, 1])
    np.testing.assert_array_equal(x[:, 9], 1.0)
    np.testing.assert_allclose(unlift(-2.5 * x), rotations, rtol=0, atol=1e-15)


def test_all_forms_are_symmetric_and_vanish_on_rotations(rotations):
    for forms in (COLUMNS, ROWS, HANDEDNESS):
        np.testing.assert_array_equal(forms, np.swapaxes(forms, 1, 2))
        assert np.abs(values(forms, rotations)).max() < 1e-14


def test_forms_are_the_equations_they_are_named_after(rng):
    C = rng.normal(size=(3, 3))
    upper = np.triu_indices(3)
    np.testing.assert_allclose(values(COLUMNS, C), (C.T @ C - np.eye(3))[upper], atol=1e-13)
    np.testing.assert_allclose(values(ROWS, C), (C @ C.T - np.eye(3))[upper], atol=1e-13)
    a, b, c = C.T
    crossed = [np.cross(a, b) - c, np.cross(b, c) - a, np.cross(c, a) - b]
    np.testing.assert_allclose(values(HANDEDNESS, C), np.concatenate(crossed), atol=1e-13)


def test_only_handedness_refuses_reflections(rotations):
    mirrored = rotations @ np.diag([1.0, 1.0, -1.0])
    assert np.abs(values(COLUMNS, mirrored)).max() < 1e-14
    assert np.abs(values(ROWS, mirrored)).max() < 1e-14
    assert np.abs(values(HANDEDNESS, mirrored)).max(axis=1).min() > 0.5


@pytest.mark.parametrize(
    ("families", "count"),
    [(("columns",), 6), (("columns", "rows"), 11), (("columns", "handedness"), 15), (ALL, 20)],
)
def test_each_set_is_linearly_independent(families, count):
    forms = constraint_matrices(families)
    assert forms.shape == (count, 10, 10)
    assert np.linalg.matrix_rank(forms.reshape(count, 100)) == count


def test_together_they_span_every_form_that_vanishes_on_rotations(rotations):
    # 55 quadratic forms in x, 35 quartic forms in the quaternion: 20 vanish.
    x = lift(rotations)
    i, j = np.triu_indices(10)
    assert np.linalg.matrix_rank(x[:, i] * x[:, j]) == 55 - len(constraint_matrices(ALL))


def test_unknown_family_names_the_nearest():
    with pytest.raises(ConfigError, match="did you mean 'handedness'"):
        constraint_matrices(("columns", "handednes"))


def test_handedness_alone_is_refused():
    with pytest.raises(ConfigError, match="expected 'columns' or 'rows'"):
        constraint_matrices(("handedness",))
