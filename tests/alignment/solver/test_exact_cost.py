"""Costs in integers: against floats where these are good, and where they are not, by refusal."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.alignment.problem import build_problem
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.solver.constraints import lift
from certnav.alignment.solver.exact_cost import (
    ExactCost,
    integer_quaternion,
    lifted,
    proves,
    rotation_of,
)
from certnav.alignment.solver.fast_solver import fast_minimum
from certnav.alignment.solver.refinement import cost, gradient, rotation_angle
from certnav.filters.rotation import matrix_from_rotvec


@pytest.fixture(scope="module")
def problem():
    return build_problem(simulate_window(np.random.default_rng(3), 5, "3d", sigma=0.1).rows)


def test_a_rotation_is_that_of_its_quaternion(rng):
    for C in Rotation.random(20, rng=rng).as_matrix():
        q = integer_quaternion(C)
        np.testing.assert_allclose(rotation_of(q), C, atol=1e-15)
        x = lifted(q)
        np.testing.assert_allclose([int(v) / int(x[9]) for v in x], lift(C), atol=1e-15)
        assert sum(int(v) ** 2 for v in x) == 4 * int(x[9]) ** 2  # |x|² = 4, exactly


def test_cost_and_slope_are_those_of_floats(problem, rng):
    for exact in (ExactCost.of(problem.Q), ExactCost.of(problem.Q, problem.factor)):
        for C in Rotation.random(10, rng=rng).as_matrix():
            q = integer_quaternion(C)
            assert float(exact.value(q)) == pytest.approx(cost(problem.Q, C), rel=1e-12)
            np.testing.assert_allclose(exact.slope(q), gradient(problem.Q, C), rtol=1e-9, atol=1e-7)


def test_a_matrix_is_taken_as_it_is():
    Q = np.diag([0.0] * 9 + [1.0])
    Q[0, 0], Q[0, 1], Q[1, 0] = 1e-300, 0.1, 0.1
    exact = ExactCost.of(Q)
    q = np.array([1, 2, 3, 4], dtype=object)
    x = [Fraction(int(v), 30) for v in lifted(q)]
    expected = Fraction(1e-300) * x[0] ** 2 + 2 * Fraction(0.1) * x[0] * x[1] + 1
    assert exact.value(q) == expected


def test_newton_ends_where_floats_cannot_go(problem):
    found = fast_minimum(problem.Q)
    exact = ExactCost.of(problem.Q, problem.factor)
    off = integer_quaternion(found.C @ matrix_from_rotvec([1e-4, -2e-4, 1e-4]))
    q = exact.refined(off)
    assert np.linalg.norm(exact.slope(q)) < 1e-25 * found.scale
    assert rotation_angle(rotation_of(q), found.C) < 1e-12


def test_a_proof_is_of_the_margin_that_there_is_and_of_no_more(problem):
    found = fast_minimum(problem.Q)
    exact = ExactCost.of(problem.Q)
    q = exact.refined(integer_quaternion(found.C))
    t = found.uniqueness
    assert proves(exact, q, found.gram, 0.9 * t, 1e-20 * found.scale)
    assert not proves(exact, q, found.gram, 1.2 * t, 1e-20 * found.scale)
    # Away from the minimum the same needs room: κ²/t, some 1e-17 of tr Q here.
    near = integer_quaternion(found.C @ matrix_from_rotvec([1e-9, 0.0, 0.0]))
    assert not proves(exact, near, found.gram, 0.5 * t, 1e-22 * found.scale)
    assert proves(exact, near, found.gram, 0.5 * t, 1e-14 * found.scale)
    other = integer_quaternion(found.C @ matrix_from_rotvec([0.3, 0.0, 0.0]))
    assert not proves(exact, other, found.gram, 0.5 * t, 1e-6 * found.scale)
