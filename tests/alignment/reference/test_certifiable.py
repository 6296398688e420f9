"""Alignment from end to end: noise-free recovery, invariance, degenerate geometry, covariance."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.alignment.observability import Geometry
from certnav.alignment.problem import ClockModel, build_problem
from certnav.alignment.proofs.certificate import eigenvalue_ratio
from certnav.alignment.reference.certifiable import align_sdp
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.solver.constraints import ALL
from certnav.alignment.solver.refinement import rotation_angle
from certnav.alignment.status import AlignmentStatus


def paper_test(result):
    """Return whether the rank test of Song et al. on the solver's own H passes."""
    return eigenvalue_ratio(np.linalg.eigvalsh(result.minimum.dual.H)) < 1e-6


@pytest.mark.parametrize(
    ("motion", "satellites"), [("2d", 3), ("2d", 6), ("3d", 2), ("3d", 3), ("3d", 8)]
)
def test_noise_free_windows_are_recovered_and_certified(windows, motion, satellites):
    for window, problem in windows(25, satellites, motion):
        result = align_sdp(problem)
        assert result.status is AlignmentStatus.CERTIFIED
        assert result.minimum.gap < 1e-11
        assert np.degrees(rotation_angle(result.C_ew, window.C_ew)) < 1e-6
        assert result.nuisance[0] == pytest.approx(190.3, abs=1e-6)
        assert paper_test(result)


@pytest.mark.parametrize("families", [("columns",), ("columns", "rows")], ids=len)
def test_planar_motion_needs_handedness(windows, families):
    # Fig. 3 of Song et al.: 0 % without redundant constraints.
    for _, problem in windows(10, 5, "2d"):
        assert not paper_test(align_sdp(problem, families=families))


def test_one_satellite_is_unobservable(windows):
    for _, problem in windows(15, 1):
        result = align_sdp(problem)
        assert result.status is AlignmentStatus.UNOBSERVABLE
        assert not result.observability.lemma_1


def test_planar_motion_under_two_satellites_has_two_optima(windows):
    for window, problem in windows(25, 2, "2d", sigma=0.05):
        result = align_sdp(problem)
        assert result.observability.geometry is Geometry.MIRROR
        assert result.status is not AlignmentStatus.CERTIFIED
        mirrored = result.observability.mirrored(result.C_ew)
        # Both fit alike, and the truth is one of them.
        assert problem.cost(mirrored) - result.cost < 9.0
        errors = [rotation_angle(C, window.C_ew) for C in (result.C_ew, mirrored)]
        assert np.degrees(min(errors)) < 10.0


def test_exact_mirror_ends_at_one_of_the_two_and_says_so(windows):
    # Satellites that do not move: two optima to the last digit, and no way to prefer one.
    for window, _ in windows(10, 2, "2d"):
        rows = dataclasses.replace(window.rows, e_e=np.tile(window.rows.e_e[:2], (10, 1)))
        z = np.einsum("ki,ij,kj->k", rows.e_e, window.C_ew, rows.vel_w)
        result = align_sdp(build_problem(dataclasses.replace(rows, z=z)))
        assert result.status is AlignmentStatus.AMBIGUOUS
        assert result.minimum.status is AlignmentStatus.AMBIGUOUS
        assert result.minimum.certificate.corank == 2
        pair = (result.C_ew, result.observability.mirrored(result.C_ew))
        assert np.degrees(min(rotation_angle(C, window.C_ew) for C in pair)) < 1e-4


def test_straight_driving_is_unobservable(windows):
    for _, problem in windows(5, 6, "line"):
        assert align_sdp(problem).status is AlignmentStatus.UNOBSERVABLE


def test_free_clock_leaves_two_satellites_one_difference(rng):
    rows = simulate_window(rng, 2, sigma=0.05).rows
    assert align_sdp(build_problem(rows)).status is AlignmentStatus.CERTIFIED
    free = align_sdp(build_problem(rows, ClockModel("per-epoch")))
    assert free.status is AlignmentStatus.UNOBSERVABLE
    assert free.observability.rank_n == 1


def test_solution_turns_with_the_frames(rng, rotations):
    rows = simulate_window(rng, 3, sigma=0.1).rows
    result = align_sdp(build_problem(rows))
    A, B = rotations[:2]  # e' = A e, w' = B w
    turned = dataclasses.replace(rows, e_e=rows.e_e @ A.T, vel_w=rows.vel_w @ B.T)
    other = align_sdp(build_problem(turned))
    np.testing.assert_allclose(other.C_ew, A @ result.C_ew @ B.T, atol=1e-10)
    assert other.cost == pytest.approx(result.cost, rel=1e-9)
    np.testing.assert_allclose(
        other.observability.strength_m, result.observability.strength_m, rtol=1e-8, atol=1e-8
    )


def test_solution_does_not_depend_on_order_or_clock(rng):
    rows = simulate_window(rng, 4, sigma=0.1).rows
    result = align_sdp(build_problem(rows))
    shuffled = rows.take(rng.permutation(len(rows)))
    late = dataclasses.replace(shuffled, z=shuffled.z - 5e4)
    other = align_sdp(build_problem(late))
    assert rotation_angle(other.C_ew, result.C_ew) < 1e-9
    assert other.nuisance[0] - result.nuisance[0] == pytest.approx(5e4, abs=1e-6)


def test_no_rotation_fits_better_under_noise(windows):
    samples = Rotation.random(2000, rng=np.random.default_rng(3)).as_matrix()
    for window, problem in windows(10, 4, sigma=0.3):
        result = align_sdp(problem)
        assert result.status is AlignmentStatus.CERTIFIED
        assert result.cost <= problem.cost(window.C_ew)
        assert result.cost <= min(problem.cost(C) for C in samples)


def test_wrong_clock_model_is_certified_but_misfits(rng):
    # A certificate is about the cost, not about the model: χ² per degree of freedom tells.
    rows = simulate_window(rng, 4, sigma=0.1, epochs=30, clock_rate=0.5).rows
    wrong = align_sdp(build_problem(rows))
    right = align_sdp(build_problem(rows, ClockModel("linear")))
    assert wrong.status is AlignmentStatus.CERTIFIED
    assert wrong.cost / wrong.dof > 10.0
    assert right.cost / right.dof < 2.0


@pytest.mark.parametrize(("motion", "satellites"), [("3d", 3), ("2d", 6)])
def test_covariance_is_consistent(windows, motion, satellites):
    squared = []
    for window, problem in windows(150, satellites, motion, sigma=0.03):
        result = align_sdp(problem)
        theta = Rotation.from_matrix(result.C_ew.T @ window.C_ew).as_rotvec()
        squared.append(theta @ np.linalg.solve(result.cov_w, theta))
    # NEES: χ² with three degrees of freedom; 4σ of the mean of 150.
    assert np.mean(squared) == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / 150))


def test_random_walk_model_beats_both_extremes(rng):
    errors = {"constant": [], "per-epoch": [], "random-walk": []}
    for _ in range(40):
        window = simulate_window(rng, 3, sigma=0.1, epochs=30, clock_walk=0.2)
        for kind, found in errors.items():
            model = ClockModel(kind, 0.2 if kind == "random-walk" else None)
            C_ew = align_sdp(build_problem(window.rows, model)).C_ew
            found.append(np.degrees(rotation_angle(C_ew, window.C_ew)))
    median = {kind: np.median(found) for kind, found in errors.items()}
    assert median["random-walk"] < min(median["constant"], median["per-epoch"])


def test_dropping_all_redundancy_keeps_the_rotation_when_motion_is_rich(windows):
    for window, problem in windows(5, 6):
        result = align_sdp(problem, families=("columns", "handedness"))
        assert set(result.minimum.certificate.families) < set(ALL)
        assert np.degrees(rotation_angle(result.C_ew, window.C_ew)) < 1e-6
