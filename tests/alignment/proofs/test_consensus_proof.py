"""Branch and bound: its bounds hold for every rotation sampled, and it proves what it says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.alignment.priors import up_prior
from certnav.alignment.proofs.consensus_proof import consensus, prove_consensus, row_weights
from certnav.alignment.proofs.stabbing import reached, stabbed
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.rows import AlignmentRows
from certnav.alignment.solver.refinement import rotation_angle
from certnav.filters.errors import ConfigError
from certnav.filters.rotation import matrix_from_rotvec


def window(seed: int, satellites: int = 6, motion: str = "3d", **options):
    return simulate_window(
        np.random.default_rng(seed), satellites, motion, **{"sigma": 0.05, "speed": 10.0} | options
    )


def brute_force_count(rows: AlignmentRows, C: np.ndarray, cutoff: float) -> int:
    """Inliers at every clock drift that puts one row at the edge of its interval."""
    drift = np.sum(rows.e_e * (rows.vel_w @ C.T), axis=1) - rows.z
    half = cutoff * rows.sigma
    return max(int(np.sum(np.abs(drift - t) <= half + 1e-12)) for t in drift - half)


def with_outliers(rows: AlignmentRows, share: float, seed: int) -> AlignmentRows:
    rng = np.random.default_rng(seed)
    z, k = rows.z.copy(), round(share * len(rows))
    wrong = rng.choice(len(rows), k, replace=False)
    z[wrong] += rng.uniform(5.0, 40.0, k) * rng.choice([-1.0, 1.0], k)
    return replace(rows, z=z)


def test_consensus_is_the_largest_set_any_clock_allows():
    rows = with_outliers(window(1).rows, 0.4, 1)
    for C in Rotation.random(30, rng=np.random.default_rng(2)).as_matrix():
        assert consensus(rows, C, 3.5, per_epoch=False) == brute_force_count(rows, C, 3.5)
        by_epoch = sum(brute_force_count(rows.take(rows.epoch == k), C, 3.5) for k in range(10))
        assert consensus(rows, C, 3.5, per_epoch=True) == by_epoch


def test_all_rows_agree_with_the_truth():
    w = window(2, sigma=0.0)
    assert consensus(w.rows, w.C_ew, 3.5, per_epoch=False) == len(w.rows)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_proves_the_truth_among_random_outliers(share):
    w = window(3)
    rows = with_outliers(w.rows, share, 4)
    count = consensus(rows, w.C_ew, 3.5, per_epoch=False)
    proof = prove_consensus(rows, w.C_ew, count, radius=np.radians(15.0))
    assert proof.proved and proof.rival is None
    # Nothing sampled outside contradicts it.
    R = Rotation.random(3000, rng=np.random.default_rng(5)).as_matrix()
    counts = [consensus(rows, C, 3.5, per_epoch=False) for C in R]
    assert (
        max(c for c, a in zip(counts, rotation_angle(w.C_ew, R), strict=True) if a > 0.26) < count
    )


def test_cell_bounds_hold_inside_every_cell():
    """What the proof rests on: the turn between Exp(a) and Exp(b) is at most |a − b|."""
    rng = np.random.default_rng(6)
    a = rng.uniform(-np.pi, np.pi, (20000, 3))
    b = a + rng.uniform(-1.0, 1.0, a.shape) * 10.0 ** rng.uniform(-3, 0, (len(a), 1))
    turn = rotation_angle(matrix_from_rotvec(a), matrix_from_rotvec(b))
    assert np.all(turn <= np.linalg.norm(a - b, axis=1) + 1e-9)


def test_a_wrong_rotation_is_refuted_with_a_rival():
    w = window(7)
    wrong = matrix_from_rotvec([0.0, 1.0, 0.5]) @ w.C_ew
    proof = prove_consensus(w.rows, wrong, 40)
    assert not proof.proved
    assert proof.rival is not None
    assert consensus(w.rows, proof.rival, 3.5, per_epoch=False) >= 40
    assert rotation_angle(proof.rival, wrong) > proof.radius


def test_the_planar_mirror_is_a_rival():
    w = window(8, satellites=2, motion="2d")
    proof = prove_consensus(w.rows, w.C_ew, len(w.rows) - 1, radius=np.radians(3.0))
    assert not proof.proved


def test_slack_makes_the_proof_harder_and_a_free_clock_harder_still():
    w = window(9, epochs=8)
    rows = with_outliers(w.rows, 0.2, 9)
    count = consensus(rows, w.C_ew, 3.5, per_epoch=False)
    strict = prove_consensus(rows, w.C_ew, count)
    loose = prove_consensus(rows, w.C_ew, count, slack=0.3)
    assert strict.proved and strict.cells < loose.cells
    each = prove_consensus(rows, w.C_ew, count, per_epoch=True)
    assert strict.cells < each.cells


def test_gives_up_at_the_limit_and_says_so():
    w = window(10)
    proof = prove_consensus(w.rows, w.C_ew, len(w.rows) // 2, max_cells=100)
    assert not proof.proved and proof.rival is None and proof.cells > 100


def test_refuses_senseless_questions():
    w = window(11)
    with pytest.raises(ConfigError, match="required"):
        prove_consensus(w.rows, w.C_ew, 0)
    for radius in (0.0, np.pi):
        with pytest.raises(ConfigError, match="radius"):
            prove_consensus(w.rows, w.C_ew, 5, radius=radius)


def test_a_row_weighs_as_much_as_it_excludes():
    """The share of random directions in which a row is an outlier, by drawing directions."""
    w = window(12, sigma=0.5)
    rows = replace(w.rows, sigma=np.linspace(0.1, 4.0, len(w.rows)))
    R = Rotation.random(4000, rng=np.random.default_rng(1)).as_matrix()
    off = np.einsum("ki,nij,kj->nk", rows.e_e, R, rows.vel_w)
    outlier = np.mean(np.abs(off) > 2.0 * rows.sigma, axis=0)
    np.testing.assert_allclose(row_weights(rows, 2.0), outlier, atol=0.04)
    assert row_weights(rows, 2.0)[-1] == pytest.approx(max(0.0, 1.0 - 8.0 / 10.0), abs=1e-6)


def test_equal_weights_are_a_count():
    w = window(13)
    rows = with_outliers(w.rows, 0.3, 13)
    weight = np.full(len(rows), 0.3)
    for C in (w.C_ew, *Rotation.random(5, rng=np.random.default_rng(3)).as_matrix()):
        count = consensus(rows, C, 3.5, per_epoch=False)
        weighted = consensus(rows, C, 3.5, per_epoch=False, weight=weight)
        assert weighted == pytest.approx(0.3 * count)
    count = consensus(rows, w.C_ew, 3.5, per_epoch=False)
    plain = prove_consensus(rows, w.C_ew, count)
    same = prove_consensus(rows, w.C_ew, 0.3 * count, weight=weight)
    assert plain.proved and same.proved and plain.cells == same.cells


def test_a_vertical_excludes_the_mirror_and_only_what_it_contradicts():
    """Level motion under two satellites: mirrored about the plane of the lines of sight."""
    w = window(8, satellites=2, motion="2d")
    required = 0.9 * len(w.rows)
    free = prove_consensus(w.rows, w.C_ew, required, radius=np.radians(15.0))
    assert not free.proved and free.rival is not None
    up_e = w.up_e
    east = np.cross([0.0, 0.0, 1.0], up_e) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], up_e))
    C_en = np.column_stack([np.cross(up_e, east), east, -up_e])
    level = up_prior(w.C_ew.T @ up_e, C_en, np.radians(2.0))
    held = prove_consensus(
        w.rows, w.C_ew, required, radius=np.radians(15.0), priors=[level], max_cells=200_000
    )
    assert held.proved or rotation_angle(held.rival @ w.C_ew.T @ up_e, up_e) < 0.2
    # One that says nothing excludes nothing.
    loose = prove_consensus(
        w.rows, w.C_ew, required, radius=np.radians(15.0),
        priors=[up_prior(w.C_ew.T @ up_e, C_en, 10.0)],
    )  # fmt: skip
    assert not loose.proved


@pytest.mark.parametrize("size", [1, 7, 24, 25, 200])
def test_what_is_decided_without_sorting_is_what_sorting_says(size):
    """Groups below and above what is sorted, ties and reaches that take in everything."""
    rng = np.random.default_rng(size)
    member = rng.permutation(3 * size)
    first = np.array([0, size, 2 * size, 3 * size])
    weight, speed, half = rng.uniform(0.1, 1.0, (3, 3 * size))
    z = np.round(rng.normal(size=3 * size), 1)
    cosine = np.round(rng.uniform(-1.0, 1.0, (200, 3 * size)), 2)
    for reach in (0.02, 0.4, 1.5, 3.0):
        angle = np.arccos(cosine)
        low = speed * np.cos(np.minimum(angle + reach, np.pi)) - z - half
        high = speed * np.cos(np.maximum(angle - reach, 0.0)) - z + half
        most = np.zeros(len(cosine))
        stabbed(low, high, member, first, weight, most)
        for least in np.quantile(most, [0.0, 0.1, 0.5, 0.9, 1.0]) * (1.0 + 1e-9):
            out = np.zeros(len(cosine), dtype=bool)
            reached(
                speed, cosine, np.cos(reach), np.sin(reach), z, half, member, first, weight,
                least, out,
            )  # fmt: skip
            assert np.array_equal(out, most >= least)
            assert not out.all() or least <= most.min()
