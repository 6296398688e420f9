"""The relaxation against rotations (weak duality), against cvxpy, and its moment matrix."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.alignment.problem import build_problem
from certnav.alignment.reference.sdp import DualSolution, rotations_from_moments, solve_dual
from certnav.alignment.reference.sdp_cvxpy import solve_dual_cvxpy
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.solver.constraints import ALL, lagrangian, lift
from certnav.alignment.solver.refinement import cost, newton, rotation_angle
from certnav.filters.errors import ConfigError


def random_cost(rng):
    A = rng.normal(size=(10, 10))
    return A + A.T


@pytest.mark.parametrize("families", [("columns",), ("columns", "rows"), ALL], ids=len)
def test_dual_is_below_every_rotation(rng, rotations, families):
    for _ in range(5):
        Q = random_cost(rng)
        dual = solve_dual(Q, families)
        assert dual.dual_cost <= min(cost(Q, C) for C in rotations) + 1e-7


def test_more_constraints_never_loosen_the_bound(rng):
    for _ in range(5):
        Q = random_cost(rng)
        bounds = [
            solve_dual(Q, f).dual_cost for f in (("columns",), ("columns", "rows"), ALL)
        ]  # fmt: skip
        assert bounds[0] <= bounds[1] + 1e-7
        assert bounds[1] <= bounds[2] + 1e-7


def test_lagrangian_form_is_the_cost_above_gamma_on_rotations(rng, rotations):
    Q, multipliers = random_cost(rng), rng.normal(size=20)
    H = lagrangian(Q, 0.7, multipliers, ALL)
    for C in rotations[:10]:
        assert lift(C) @ H @ lift(C) == pytest.approx(cost(Q, C) - 0.7, abs=1e-12)


def test_solution_satisfies_strong_duality_and_complementarity(windows):
    for _, problem in windows(10, 3, sigma=0.1):
        dual, scale = solve_dual(problem.Q), np.trace(problem.Q)
        assert abs(dual.primal_cost - dual.dual_cost) < 1e-10 * scale
        H = lagrangian(problem.Q, dual.dual_cost, dual.multipliers, dual.families)
        # Most windows end 'AlmostSolved', with residuals of 1e-10 to 3e-9 of the trace: which, is
        # for rounding to say, and other versions of numpy round otherwise.
        np.testing.assert_allclose(dual.H, H, atol=1e-8 * scale)
        assert np.linalg.eigvalsh(dual.H)[0] > -1e-15 * scale
        assert np.linalg.norm(dual.H @ dual.Z) < 1e-6 * scale
        assert dual.Z[9, 9] == pytest.approx(1.0, abs=1e-9)


def test_moment_matrix_is_the_optimum_where_the_relaxation_is_tight(windows):
    for window, problem in windows(20, 4):
        dual = solve_dual(problem.Q)
        x = lift(window.C_ew)
        np.testing.assert_allclose(dual.Z, np.outer(x, x), atol=1e-5)
        *near, other = rotations_from_moments(dual.Z)
        assert np.linalg.det(other) == pytest.approx(1.0)
        for C in near:
            assert np.linalg.det(C) == pytest.approx(1.0)
            assert np.degrees(rotation_angle(C, window.C_ew)) < 1e-3


def test_two_optima_are_both_recovered_from_their_mean(rotations):
    for C1, C2 in zip(rotations[:20], rotations[20:40], strict=True):
        x, y = lift(C1), lift(C2)
        _, *found, _ = rotations_from_moments(0.5 * (np.outer(x, x) + np.outer(y, y)))
        distance = [[rotation_angle(C, other) for other in (C1, C2)] for C in found]
        assert min(np.trace(distance), np.trace(distance[::-1])) < 1e-6


def test_two_optima_half_a_turn_apart_are_recovered_from_any_mixture(rotations):
    for C1 in rotations[:20]:
        C2 = C1 @ np.diag([-1.0, 1.0, -1.0])
        x, y = lift(C1), lift(C2)
        first, *_, last = rotations_from_moments(0.8 * np.outer(x, x) + 0.2 * np.outer(y, y))
        assert rotation_angle(first, C1) < 1e-6 and rotation_angle(last, C2) < 1e-6


def test_scaling_the_problem_scales_the_solution(windows):
    ((_, problem),) = windows(1, 4, sigma=0.1)
    one, other = solve_dual(problem.Q), solve_dual(1e-6 * problem.Q)
    assert other.dual_cost == pytest.approx(1e-6 * one.dual_cost, rel=1e-9)
    # The multipliers are a face of the cone, of which the solver returns the middle.
    np.testing.assert_allclose(1e6 * other.multipliers, one.multipliers, rtol=0.01, atol=1.0)
    np.testing.assert_allclose(other.Z, one.Z, atol=1e-6)


def test_refined_cost_meets_the_bound(windows):
    for _, problem in windows(20, 3, sigma=0.2):
        dual: DualSolution = solve_dual(problem.Q)
        found = newton(problem.Q, rotations_from_moments(dual.Z)[0], factor=problem.factor)
        assert abs(found.cost - dual.dual_cost) < 1e-10 * np.trace(problem.Q)


def test_unknown_family_is_refused():
    with pytest.raises(ConfigError, match="unknown key 'row'"):
        solve_dual(np.eye(10), ("columns", "row"))


def compare_with_cvxpy(runs):
    rng = np.random.default_rng(7)
    worst = 0.0
    for k in range(runs):
        if k % 4 == 3:
            Q = random_cost(rng)
        else:
            # Without noise and geometry γ = 0 is approached on an unbounded face: 1e-8 at best.
            satellites = int(rng.integers(1, 9))
            sigma = (0.0 if satellites > 2 else 0.1, 0.05, 0.5)[k % 3]
            window = simulate_window(rng, satellites, ("2d", "3d")[k % 2], sigma=sigma)
            Q = build_problem(window.rows).Q
        ours, theirs = solve_dual(Q), solve_dual_cvxpy(Q)
        worst = max(worst, abs(ours.dual_cost - theirs) / np.abs(np.linalg.eigvalsh(Q)).sum())
    return worst


def test_cvxpy_agrees():
    pytest.importorskip("cvxpy")
    assert compare_with_cvxpy(20) < 1e-8


@pytest.mark.slow
def test_cvxpy_agrees_over_200_problems():
    pytest.importorskip("cvxpy")
    assert compare_with_cvxpy(200) < 1e-8
