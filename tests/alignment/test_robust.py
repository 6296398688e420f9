"""Robust alignment: outliers found and named, and nothing passed that cannot be known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.alignment.priors import up_prior
from certnav.alignment.problem import ClockModel
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.result import Ask
from certnav.alignment.robust import RobustOptions, align_robust, robust_residuals
from certnav.alignment.row_selection import clock_gates
from certnav.alignment.rows import AlignmentRows
from certnav.alignment.solver.refinement import rotation_angle
from certnav.alignment.verdict import align
from certnav.filters.errors import AlignmentError, ConfigError


def window(seed: int, satellites: int = 6, motion: str = "3d", **options):
    return simulate_window(
        np.random.default_rng(seed), satellites, motion, **{"sigma": 0.1, "speed": 8.0} | options
    )


def contaminated(
    rows: AlignmentRows, share: float, kind: str, seed: int = 0
) -> tuple[AlignmentRows, np.ndarray]:
    rng = np.random.default_rng(seed)
    z, k = rows.z.copy(), round(share * len(rows))
    wrong = rng.choice(len(rows), k, replace=False)
    z[wrong] += {
        "random": rng.uniform(10.0, 50.0, k) * rng.choice([-1.0, 1.0], k),
        "moderate": rng.uniform(1.0, 8.0, k) * rng.choice([-1.0, 1.0], k),
        "clustered": 20.0 + 0.5 * rng.normal(size=k),
    }[kind]
    mask = np.zeros(len(rows), dtype=bool)
    mask[wrong] = True
    return replace(rows, z=z), mask


def test_without_outliers_it_is_the_plain_alignment():
    w = window(1)
    plain, robust = align(w.rows), align_robust(w.rows)
    assert robust.inliers.all() and robust.proof is None and robust.outliers.size == 0
    np.testing.assert_allclose(robust.result.C_ew, plain.C_ew, atol=1e-12)
    assert robust.passed and robust.result.cost == pytest.approx(plain.cost)


@pytest.mark.parametrize(
    ("kind", "share"),
    [("random", 0.3), ("random", 0.6), ("moderate", 0.4), ("clustered", 0.4)],
)
def test_finds_the_outliers_and_the_attitude(kind, share):
    for seed in range(4):
        w = window(seed, motion="3d" if seed % 2 else "2d", epochs=15)
        rows, wrong = contaminated(w.rows, share, kind, seed)
        found = align_robust(rows)
        oracle = align(rows.take(~wrong))
        assert rotation_angle(found.result.C_ew, w.C_ew) < max(
            np.radians(2.0), 3.0 * rotation_angle(oracle.C_ew, w.C_ew)
        )
        # Outliers of tens of metres per second are all named, and good rows almost all kept.
        if kind == "random":
            assert set(np.flatnonzero(wrong)) <= set(found.outliers)
        assert np.mean(found.inliers[~wrong]) > 0.95
        assert found.truncated_cost <= oracle.cost + 3.5**2 * wrong.sum() + 1e-6


def test_proved_result_passes_and_names_its_consensus():
    w = window(3, epochs=15)
    rows, _ = contaminated(w.rows, 0.3, "random", 3)
    found = align_robust(rows)
    assert found.passed
    assert found.proof is not None and found.proof.proved
    assert "proved: no rotation" in found.result.verdict(Ask.CONSENSUS).message


def test_a_majority_that_agrees_on_another_attitude_never_passes():
    """60 % of the rows come from another rotation: nobody could know which."""
    rng = np.random.default_rng(4)
    for seed in range(6):
        w = window(seed, epochs=12)
        C2 = Rotation.random(rng=rng).as_matrix()
        spoofed = rng.choice(len(w.rows), round(0.6 * len(w.rows)), replace=False)
        z = w.rows.z.copy()
        z[spoofed] += np.sum(w.rows.e_e * (w.rows.vel_w @ (C2 - w.C_ew).T), axis=1)[spoofed]
        found = align_robust(replace(w.rows, z=z))
        wrong = rotation_angle(found.result.C_ew, w.C_ew) > found.result.bound
        assert not (found.passed and wrong)


def test_a_clustered_majority_is_recognised_as_unprovable():
    """60 % around one wrong drift: the best consensus mixes both parties, and must not pass."""
    for seed in range(8):
        w = window(seed, motion="3d" if seed % 2 else "2d", epochs=10, speed=10.0)
        rows, _ = contaminated(w.rows, 0.6, "clustered", seed)
        found = align_robust(rows)
        assert not found.passed
        assert found.proof is not None
        if found.opposition is not None and found.proof.proved:
            assert "of those rejected may agree" in found.result.message


def test_clock_gate_keeps_every_row_that_some_rotation_explains():
    w = window(5, sigma=0.05)
    rows, wrong = contaminated(w.rows, 0.5, "random", 5)
    gates = list(clock_gates(rows, ClockModel(), 3.5))
    assert gates
    assert max(np.mean(gate[~wrong]) for gate in gates) == 1.0
    assert np.mean(gates[0][wrong]) < 0.5


def test_wandering_clock_is_not_taken_for_outliers():
    w = window(6, epochs=20, clock_walk=0.3)
    model = ClockModel("random-walk", 0.3)
    rows, wrong = contaminated(w.rows, 0.2, "random", 6)
    found = align_robust(rows, model)
    np.testing.assert_array_equal(found.inliers, ~wrong)
    assert rotation_angle(found.result.C_ew, w.C_ew) < found.result.bound
    assert found.result.verdict(Ask.CONSISTENT).passed


@pytest.mark.parametrize("satellites", [5, 8])
def test_a_clock_that_walks_beyond_the_noise_is_no_obstacle_to_the_proof(satellites):
    """In 30 s it wanders by ten times what supports a rotation; a drift for all proves nothing."""
    w = window(6, satellites, epochs=60, interval=0.5, clock_walk=0.3, sigma=0.03, speed=12.0)
    rows, _ = contaminated(w.rows, 0.15, "moderate", 6)
    found = align_robust(rows, ClockModel("random-walk", 0.3))
    assert np.ptp(w.clock_drift) > 10.0 * 2.0 * 0.03
    assert found.proof is not None and found.proof.proved
    assert found.passed and rotation_angle(found.result.C_ew, w.C_ew) < found.result.bound


def turned_satellites(w, count: int, angle: float) -> AlignmentRows:
    """Rows of which those of some satellites are those of another heading."""
    satellites = int(np.sum(w.rows.epoch == 0))
    turn = Rotation.from_rotvec(np.radians(angle) * w.up_e).as_matrix()
    vel_e = w.rows.vel_w @ w.C_ew.T
    wrong = np.arange(len(w.rows)) % satellites < count
    return replace(
        w.rows, z=w.rows.z + wrong * np.sum(w.rows.e_e * (vel_e @ (turn.T - np.eye(3))), axis=1)
    )


def test_two_of_ten_satellites_that_conspire_are_outvoted_and_four_stop_the_window():
    """Two agree on something whatever it is; four may be the truth, and then six are wrong."""
    clock = ClockModel("random-walk", 0.1)
    for seed in range(3):
        w = window(seed, 10, epochs=15, clock_walk=0.1, speed=10.0)
        two = align_robust(turned_satellites(w, 2, 70.0), clock)
        assert two.passed and rotation_angle(two.result.C_ew, w.C_ew) < two.result.bound
        for count in (4, 6):
            assert not align_robust(turned_satellites(w, count, 70.0), clock).passed


@pytest.mark.parametrize("kind", ["linear", "per-epoch"])
def test_other_clocks(kind):
    w = window(7, epochs=15, clock_rate=0.1)
    rows, wrong = contaminated(w.rows, 0.2, "random", 7)
    found = align_robust(rows, ClockModel(kind))
    assert set(np.flatnonzero(wrong)) <= set(found.outliers)
    assert rotation_angle(found.result.C_ew, w.C_ew) < np.radians(5.0)
    assert (found.proof is None) == (kind == "linear")


@pytest.mark.parametrize(("share", "passed"), [(0.1, True), (0.3, False)])
def test_without_a_proof_most_rows_have_to_agree(share, passed):
    """A linear clock admits none: then eight rows of ten, or nobody knows."""
    w = window(7, epochs=15, clock_rate=0.1)
    rows, _ = contaminated(w.rows, share, "random", 7)
    found = align_robust(rows, ClockModel("linear"))
    verdict = found.result.verdict(Ask.CONSENSUS)
    assert found.proof is None and verdict.passed == passed
    assert verdict.value == pytest.approx(1.0 - share, abs=0.05) and verdict.limit == 0.8
    assert ("admit no proof" in verdict.message) == (not passed)
    assert found.passed == passed


def test_unknown_start_velocity_as_a_nuisance():
    w = window(8, epochs=20, speed=15.0)
    offset = np.array([3.0, -2.0, 1.0])
    rows, wrong = contaminated(w.rows, 0.2, "random", 8)
    rows = replace(rows, z=rows.z + rows.e_e @ offset)
    found = align_robust(rows, nuisance=rows.e_e)
    np.testing.assert_array_equal(found.inliers, ~wrong)
    assert rotation_angle(found.result.C_ew, w.C_ew) < found.result.bound
    np.testing.assert_allclose(found.result.nuisance[1:], offset, atol=1.0)


def test_priors_are_believed():
    w = window(9, satellites=2, motion="2d", epochs=20)
    east = np.cross([0.0, 0.0, 1.0], w.up_e)
    east /= np.linalg.norm(east)
    C_en = np.column_stack([np.cross(w.up_e, east), east, -w.up_e])
    rows, wrong = contaminated(w.rows, 0.15, "random", 9)
    prior = up_prior(w.C_ew.T @ w.up_e, C_en, np.radians(0.5))
    found = align_robust(rows, priors=[prior])
    assert set(np.flatnonzero(wrong)) <= set(found.outliers)
    assert rotation_angle(found.result.C_ew, w.C_ew) < np.radians(5.0)


def test_backends_agree():
    w = window(10)
    rows, _ = contaminated(w.rows, 0.4, "random", 10)
    one, other = (align_robust(rows, backend=name) for name in ("numba", "numpy"))
    np.testing.assert_array_equal(one.inliers, other.inliers)
    assert rotation_angle(one.result.C_ew, other.result.C_ew) < 1e-8


def test_refusals():
    w = window(11)
    with pytest.raises(AlignmentError, match="3 rows"):
        align_robust(w.rows.take(slice(0, 3)))
    with pytest.raises(ConfigError, match="support > 0"):
        RobustOptions(cutoff=0.0)


def test_correlated_rows_count_as_fewer():
    """Every row ten times over, declared as such, says what the rows say once."""
    w = window(6, epochs=12)
    rows, _ = contaminated(w.rows, 0.2, "random", 6)
    again = rows.take(np.repeat(np.arange(len(rows)), 10))
    once, often = align_robust(rows), align_robust(again, correlated=10.0)
    assert rotation_angle(once.result.C_ew, often.result.C_ew) < 1e-9
    np.testing.assert_array_equal(np.repeat(once.inliers, 10), often.inliers)
    np.testing.assert_allclose(often.result.cost, once.result.cost, rtol=1e-9)
    assert often.result.dof == pytest.approx(once.result.dof, abs=1)
    assert often.result.bound == pytest.approx(once.result.bound, rel=0.02)
    believed = align_robust(again)
    assert believed.result.bound < 0.5 * often.result.bound


def test_residuals_are_those_of_all_rows():
    w = window(7, sigma=0.05)
    rows, wrong = contaminated(w.rows, 0.3, "random", 7)
    C_ew, residuals = robust_residuals(rows)
    assert rotation_angle(C_ew, w.C_ew) < np.radians(1.0)
    assert np.all(np.abs(residuals[wrong]) > 5.0)
    assert np.sqrt(np.mean(residuals[~wrong] ** 2)) == pytest.approx(0.05, rel=0.3)
