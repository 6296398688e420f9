"""Priors: rows that vanish at the truth, and what they make observable."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.alignment.observability import observability
from certnav.alignment.priors import heading_prior, up_prior, with_priors
from certnav.alignment.problem import build_problem
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.result import Ask
from certnav.alignment.solver.constraints import lift
from certnav.alignment.solver.fast_solver import fast_minimum
from certnav.alignment.solver.refinement import rotation_angle
from certnav.alignment.verdict import align
from certnav.filters.errors import ConfigError, DataError
from certnav.filters.rotation import matrix_from_rotvec

SIGMA = np.radians(0.5)


def frame(up_e: np.ndarray) -> np.ndarray:
    """NED axes with the given vertical."""
    east = np.cross([0.0, 0.0, 1.0], up_e)
    east /= np.linalg.norm(east)
    return np.column_stack([np.cross(up_e, east), east, -up_e])


def window(seed: int, satellites: int, motion: str = "2d", **options):
    w = simulate_window(
        np.random.default_rng(seed), satellites, motion, **{"sigma": 0.05} | options
    )
    return w, frame(w.up_e), w.C_ew.T @ w.up_e


def test_rows_are_the_normalised_error_of_the_direction():
    w, C_en, up_w = window(1, 2)
    prior = up_prior(3.0 * up_w, C_en, SIGMA)
    np.testing.assert_allclose(prior.rows @ lift(w.C_ew), 0.0, atol=1e-10)
    tilt = matrix_from_rotvec(SIGMA * C_en[:, 0]) @ w.C_ew  # 1σ about north
    assert np.linalg.norm(prior.rows @ lift(tilt)) == pytest.approx(1.0, rel=1e-3)


def test_heading_rows_see_heading_only_and_tell_forwards_from_backwards():
    w, C_en, _ = window(2, 2)
    forward_w = w.rows.vel_w[0]
    forward_n = C_en.T @ w.C_ew @ forward_w
    heading = np.arctan2(forward_n[1], forward_n[0])
    prior = heading_prior(forward_w, heading, C_en, SIGMA)
    # The circle is level at its middle; over 30 m the vertical turns by 5e-6 rad.
    np.testing.assert_allclose(prior.rows @ lift(w.C_ew), 0.0, atol=1e-4)

    def turned(axis, angle):
        return prior.rows @ lift(matrix_from_rotvec(angle * axis) @ w.C_ew)

    assert abs(turned(C_en[:, 2], SIGMA)[0]) == pytest.approx(1.0, rel=1e-3)
    level = np.cos(heading) * C_en[:, 0] + np.sin(heading) * C_en[:, 1]
    across = np.cross(C_en[:, 2], level)
    assert np.linalg.norm(turned(level, 0.1)) < 1e-3  # roll
    assert np.linalg.norm(turned(across, 0.05)) < 0.05  # pitch
    assert np.linalg.norm(turned(C_en[:, 2], np.pi)) > 15.0  # backwards


def test_up_prior_removes_the_planar_mirror():
    for seed in range(6):
        w, C_en, up_w = window(seed, 2, epochs=20)
        assert not align(w.rows).passed
        result = align(w.rows, priors=[up_prior(up_w, C_en, SIGMA)])
        assert result.verdict(Ask.UNAMBIGUOUS).passed and result.verdict(Ask.UNIQUE).passed
        assert rotation_angle(result.C_ew, w.C_ew) < result.bound


def test_one_satellite_with_a_vertical_gives_the_heading():
    passed, errors = 0, []
    for seed in range(20):
        w, C_en, up_w = window(seed, 1, epochs=60)
        result = align(w.rows, priors=[up_prior(up_w, C_en, SIGMA)])
        if result.passed:
            passed += 1
            errors.append(rotation_angle(result.C_ew, w.C_ew))
            assert errors[-1] < result.bound
    assert passed >= 5
    assert np.median(errors) < np.radians(2.0)


def test_a_wrong_prior_is_not_consistent():
    w, C_en, up_w = window(3, 5, "3d")
    wrong = matrix_from_rotvec([0.3, 0.0, 0.0]) @ up_w
    result = align(w.rows, priors=[up_prior(wrong, C_en, SIGMA)])
    assert not result.verdict(Ask.CONSISTENT).passed


def test_a_heading_decides_between_mirrors():
    decided = 0
    for seed in range(20):
        w, C_en, _ = window(seed, 2)
        v = w.rows.vel_w[0]
        course_n = C_en.T @ w.C_ew @ v
        prior = heading_prior(v, np.arctan2(course_n[1], course_n[0]), C_en, np.radians(2.0))
        problem = build_problem(w.rows)
        mirror = observability(problem.Q).mirrored(w.C_ew)
        if np.linalg.norm(prior.rows @ lift(mirror)) > 8.0:
            decided += 1
            found = fast_minimum(with_priors(problem, [prior]).Q)
            assert rotation_angle(found.C, w.C_ew) < rotation_angle(found.C, mirror)
    assert decided >= 5


def test_priors_add_to_cost_and_degrees_of_freedom():
    w, C_en, up_w = window(5, 4, "3d")
    problem = build_problem(w.rows)
    priors = [up_prior(up_w, C_en, SIGMA), heading_prior([1.0, 0.0, 0.0], 0.3, C_en, 0.1)]
    joint = with_priors(problem, priors)
    assert joint.dof == problem.dof + 3
    C = matrix_from_rotvec([0.1, 0.2, 0.3])
    extra = sum(np.sum((p.rows @ lift(C)) ** 2) for p in priors)
    assert joint.cost(C) == pytest.approx(problem.cost(C) + extra)
    np.testing.assert_allclose(joint.nuisance_at(C), problem.nuisance_at(C))
    assert with_priors(problem, []) is problem


def test_refusals():
    C_en = np.eye(3)
    with pytest.raises(DataError, match="up_w: expected a direction"):
        up_prior([0.0, 0.0, 0.0], C_en, 0.1)
    with pytest.raises(ConfigError, match="σ > 0"):
        up_prior([0.0, 0.0, 1.0], C_en, 0.0)
    with pytest.raises(ConfigError, match="heading prior"):
        heading_prior([1.0, 0.0, 0.0], 0.0, C_en, -1.0)
