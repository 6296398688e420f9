"""Verdicts: which one fails, and that none passes what it should not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from certnav.alignment.problem import AlignmentProblem, ClockModel, build_problem
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.result import Ask
from certnav.alignment.solver.refinement import rotation_angle
from certnav.alignment.verdict import VerdictLimits, align, judge
from certnav.filters.errors import AlignmentError, ConfigError


def window(seed: int, satellites: int, motion: str, **options):
    return simulate_window(
        np.random.default_rng(seed), satellites, motion, **{"sigma": 0.05, "epochs": 20} | options
    )


def failed(result) -> set[Ask]:
    return {verdict.name for verdict in result.failed}


def test_a_good_window_passes_all_and_is_within_its_bound():
    for seed in range(8):
        w = window(seed, 5, "3d")
        result = align(w.rows)
        assert result.passed and not result.failed
        assert rotation_angle(result.C_ew, w.C_ew) < result.bound < np.radians(5.0)
        assert result.nuisance[0] == pytest.approx(190.3, abs=0.5)
        assert result.message.startswith("aligned: attitude within")
        assert result.require() is result


def test_straight_driving_is_not_unique_and_needs_a_turn():
    result = align(window(1, 5, "line").rows)
    assert {Ask.UNIQUE, Ask.BOUNDED} <= failed(result)
    assert result.verdict(Ask.OPTIMAL).passed
    assert "needs a turn" in result.message
    with pytest.raises(AlignmentError, match="needs a turn"):
        result.require()


def test_mirror_of_planar_motion_under_two_satellites():
    """Certified, unique in exact arithmetic, and wrong every other time."""
    result = align(window(2, 2, "2d", epochs=10).rows)
    assert {Ask.UNIQUE, Ask.UNAMBIGUOUS, Ask.BOUNDED} <= failed(result)
    assert "third satellite" in result.verdict(Ask.UNIQUE).message
    mirror = result.observability.mirrored(result.C_ew)
    assert rotation_angle(mirror, result.rivals.C[0]) < np.radians(3.0)


def test_one_satellite_is_not_enough():
    assert not align(window(3, 1, "3d").rows).passed


def test_wrong_clock_model_is_certified_but_not_consistent():
    w = window(4, 4, "3d", clock_rate=0.1)
    wrong = align(w.rows)
    assert wrong.verdict(Ask.OPTIMAL).passed and wrong.minimum.gap < 1e-9
    assert failed(wrong) >= {Ask.CONSISTENT}
    assert wrong.verdict(Ask.CONSISTENT).value > 3.0
    assert "clock" in wrong.message
    assert align(w.rows, ClockModel("linear")).passed


def test_noise_widens_the_bound_until_it_fails_alone():
    result = align(window(5, 4, "3d", sigma=1.0).rows)
    assert failed(result) == {Ask.BOUNDED}
    assert f"{np.degrees(result.bound):.0f}°" in result.message
    wider = VerdictLimits(bound=np.radians(60.0))
    assert align(window(5, 4, "3d", sigma=1.0).rows, limits=wider).passed


def test_without_redundancy_nothing_is_consistent():
    problem = build_problem(window(6, 5, "3d").rows)
    result = judge(replace(problem, dof=2))
    assert failed(result) == {Ask.CONSISTENT}
    assert "2 redundant rows" in result.message


def test_gap_is_reported_as_not_optimal():
    """A cost that is no sum of squares: Choi and Lam's quartic."""
    from certnav.alignment.solver.quartic import Z

    G = np.diag([1.0, 0, 0, 0, 0, 0, 0, 0.5, 0.5, 0.5])
    for a, b in ((1, 9), (2, 8), (3, 7)):
        G[a, b] = G[b, a] = -1.0 / 3.0
    Q = 1e4 * (Z @ G @ Z.T / 16.0 + 0.1 * np.eye(10))
    factor = np.linalg.cholesky(Q).T
    result = judge(AlignmentProblem(Q, factor, 10_000, 1.0, np.zeros((1, 10))))
    assert Ask.OPTIMAL in failed(result)
    assert "not proved" in result.message


def test_covariance_grows_with_misfit_and_matches_the_errors():
    """NEES of the right-hand error has mean 3."""
    rng = np.random.default_rng(7)
    nees = []
    for _ in range(150):
        w = simulate_window(rng, 5, "3d", epochs=15, sigma=0.1)
        result = align(w.rows)
        D = result.C_ew.T @ w.C_ew
        theta = 0.5 * np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
        nees.append(theta @ np.linalg.solve(result.cov_w, theta))
    assert 2.4 < np.mean(nees) < 3.5
    w = window(8, 5, "3d", clock_rate=0.1)
    result = align(w.rows)
    ratio = result.cov_w / result.minimum.covariance()
    np.testing.assert_allclose(ratio, result.cost / result.dof, rtol=1e-6)


def test_no_passed_result_is_wrong():
    rng = np.random.default_rng(9)
    passed = 0
    for k in range(300):
        sigma = float(10.0 ** rng.uniform(-2, 0))
        w = simulate_window(
            rng, int(rng.integers(1, 9)), "2d" if k % 2 else "3d", epochs=15, sigma=sigma,
            clock_walk=float(rng.choice([0.0, 0.1])),
        )  # fmt: skip
        result = align(w.rows, ClockModel("random-walk", 0.1))
        if result.passed:
            passed += 1
            assert rotation_angle(result.C_ew, w.C_ew) < 1.2 * result.bound
            assert result.bound <= np.radians(10.0)
    assert passed > 50


def test_backends_judge_alike():
    for seed, satellites, motion in ((1, 4, "3d"), (2, 2, "2d"), (3, 3, "2d")):
        problem = build_problem(window(seed, satellites, motion).rows)
        one, other = judge(problem, backend="numba"), judge(problem, backend="numpy")
        assert failed(one) == failed(other)


def test_limits_are_checked():
    with pytest.raises(ConfigError, match="probability"):
        VerdictLimits(probability=1.0)
    with pytest.raises(ConfigError, match="bound"):
        VerdictLimits(bound=4.0)
