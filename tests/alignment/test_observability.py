"""Ranks and lemmas on geometries whose answer is known, and the mirror identity itself."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.alignment.observability import Geometry, observability
from certnav.alignment.problem import ClockModel, build_problem
from certnav.alignment.rows import AlignmentRows


def problem_of(e_e, vel_w, C_ew, clock=None, sigma=0.05):
    """Every velocity with every line of sight, noise-free."""
    epochs, sats = len(vel_w), len(e_e)
    e, v = np.tile(e_e, (epochs, 1)), np.repeat(vel_w, sats, axis=0)
    e = e / np.linalg.norm(e, axis=1, keepdims=True)
    epoch = np.repeat(np.arange(epochs), sats)
    z = np.einsum("ki,ij,kj->k", e, C_ew, v) - 12.0
    rows = AlignmentRows(e, v, z, np.full(len(z), sigma), epoch, epoch.astype(float))
    return build_problem(rows, clock)


COURSE = 2 * np.pi * np.arange(12) / 12
CIRCLE = 3.0 * np.column_stack([np.cos(COURSE), np.sin(COURSE), 0 * COURSE])
HILLS = CIRCLE + np.column_stack([0 * COURSE, 0 * COURSE, np.sin(2 * COURSE)])
LINE = np.linspace(1.0, 5.0, 12)[:, None] * np.array([1.0, 0.0, 0.0])
SATS = np.array([[0.1, 0.3, 0.9], [-0.7, 0.2, 0.6], [0.5, -0.6, 0.6], [0.2, 0.8, 0.4]])


@pytest.mark.parametrize(
    ("vel_w", "sats", "ranks", "geometry"),
    [
        (HILLS, 4, (3, 3, 9), Geometry.LINEAR),
        (HILLS, 3, (3, 3, 9), Geometry.LINEAR),
        (HILLS, 2, (3, 2, 6), Geometry.LINEAR),
        (CIRCLE, 3, (2, 3, 6), Geometry.LINEAR),
        (CIRCLE, 2, (2, 2, 4), Geometry.MIRROR),
        (HILLS, 1, (3, 1, 3), Geometry.UNOBSERVABLE),
        (LINE, 4, (1, 3, 3), Geometry.UNOBSERVABLE),
    ],
)
def test_ranks_and_verdict(rotations, vel_w, sats, ranks, geometry):
    seen = observability(problem_of(SATS[:sats], vel_w, rotations[0]).Q)
    assert (seen.rank_v, seen.rank_n, seen.rank_m) == ranks
    assert seen.geometry is geometry
    assert seen.lemma_1 is (geometry is not Geometry.UNOBSERVABLE)
    assert seen.lemma_2 is (geometry is Geometry.LINEAR)


def test_coplanar_lines_of_sight_count_two(rotations):
    sats = np.array([[0.0, 0.3, 0.9], [0.0, -0.7, 0.6], [0.0, 0.9, 0.4]])
    seen = observability(problem_of(sats, CIRCLE, rotations[0]).Q)
    assert seen.geometry is Geometry.MIRROR
    np.testing.assert_allclose(np.abs(seen.axes_n[:, 2]), [1.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(np.abs(seen.axes_v[:, 2]), [0.0, 0.0, 1.0], atol=1e-9)


def test_mirror_is_another_rotation_of_exactly_the_same_cost(rotations):
    problem = problem_of(SATS[:2], CIRCLE, rotations[0])
    seen = observability(problem.Q)
    for C in rotations:
        other = seen.mirrored(C)
        assert np.linalg.det(other) == pytest.approx(1.0)
        np.testing.assert_allclose(other.T @ other, np.eye(3), atol=1e-12)
        assert problem.cost(other) == pytest.approx(problem.cost(C), rel=1e-9, abs=1e-9)
        np.testing.assert_allclose(seen.mirrored(other), C, atol=1e-12)
    assert np.abs(seen.mirrored(rotations[0]) - rotations[0]).max() > 0.1


def test_few_rows_leave_only_orthogonality_to_decide(rotations):
    # Seven rows of full-rank velocities and lines of sight: rank M < 9, yet isolated solutions.
    rng = np.random.default_rng(2)
    e = rng.normal(size=(7, 3))
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    v = rng.normal(size=(7, 3))
    z = np.einsum("ki,ij,kj->k", e, rotations[0], v)
    rows = AlignmentRows(e, v, z, np.full(7, 0.01), np.zeros(7, int), np.zeros(7))
    seen = observability(build_problem(rows).Q)
    assert (seen.rank_v, seen.rank_n, seen.rank_m) == (3, 3, 6)
    assert seen.geometry is Geometry.GENERIC
    assert not seen.lemma_2


def test_per_epoch_clock_takes_a_dimension_from_the_lines_of_sight(rotations):
    for sats, rank in ((2, 1), (3, 2), (4, 3)):
        problem = problem_of(SATS[:sats], HILLS, rotations[0], ClockModel("per-epoch"))
        assert observability(problem.Q).rank_n == rank


def test_strength_is_what_a_change_of_sign_costs_at_most(rotations):
    problem = problem_of(SATS, HILLS, rotations[0])
    seen = observability(problem.Q)
    for strength, k in zip(seen.strength_v, seen.axes_v.T, strict=True):
        reflected = rotations[0] @ (np.eye(3) - 2.0 * np.outer(k, k))
        assert problem.cost(reflected) <= 4.0 * strength * (1.0 + 1e-9)
        assert problem.cost(reflected) > 0.1 * strength


def test_a_slope_below_the_noise_is_no_third_dimension(rotations):
    gentle = CIRCLE + 0.01 * (HILLS - CIRCLE)  # 1 cm/s up and down
    assert observability(problem_of(SATS, gentle, rotations[0], sigma=0.05).Q).rank_v == 2
    assert observability(problem_of(SATS, gentle, rotations[0], sigma=0.001).Q).rank_v == 3


def test_noise_of_the_local_velocity_is_no_third_dimension(windows):
    for window, _ in windows(20, 6, "2d", sigma=0.02):
        noise = np.random.default_rng(4).normal(size=(10, 3))[window.rows.epoch] * 0.1
        noisy = dataclasses.replace(window.rows, vel_w=window.rows.vel_w + noise)
        problem = build_problem(noisy)
        naive = observability(problem.Q)
        assert (naive.rank_v, naive.rank_m) == (3, 9)
        seen = observability(problem.Q, vel_sigma=0.1, information=problem.information)
        assert (seen.rank_v, seen.rank_n, seen.rank_m) == (2, 3, 6)
        # Three times the χ² that noise is expected to add, on top of what is noticed without.
        noise = 3.0 * 0.1**2 * problem.information
        assert seen.threshold_v == pytest.approx(naive.threshold_v + noise)
        assert seen.threshold_n == naive.threshold_n == naive.threshold_v


def test_simulated_windows_have_the_expected_geometry(windows):
    expected = {
        ("3d", 1): Geometry.UNOBSERVABLE,
        ("2d", 2): Geometry.MIRROR,
        ("3d", 2): Geometry.LINEAR,
        ("line", 6): Geometry.UNOBSERVABLE,
    }
    for (motion, satellites), geometry in expected.items():
        for _, problem in windows(20, satellites, motion):
            assert observability(problem.Q).geometry is geometry
