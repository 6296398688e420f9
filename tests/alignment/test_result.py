"""The one result: verdicts by name, a status that the geometry has its say in, one short line."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from certnav.alignment import (
    AlignmentStatus,
    Ask,
    ClockModel,
    Geometry,
    Verdict,
    align,
    align_robust,
    given_attitude,
    judge,
    planar_track,
    up_prior,
)
from certnav.alignment.observability import observability
from certnav.alignment.proofs import check, exact_proof, prove_consensus
from certnav.alignment.reference import align_sdp, gauss_newton, simulate_window
from certnav.filters.earth import lla_to_ecef
from certnav.filters.errors import AlignmentError

FIVE = (Ask.OPTIMAL, Ask.UNIQUE, Ask.UNAMBIGUOUS, Ask.CONSISTENT, Ask.BOUNDED)


def window(seed=1, satellites=5, motion="3d", **options):
    rng = np.random.default_rng(seed)
    return simulate_window(rng, satellites, motion, **{"sigma": 0.1, "epochs": 15} | options)


def test_verdicts_are_asked_for_by_name():
    result = align(window().rows)
    assert result.asked == FIVE
    for name in FIVE:
        assert result.verdict(name).name is name
    with pytest.raises(KeyError, match="'consensus' was not asked; asked were optimal, unique"):
        result.verdict(Ask.CONSENSUS)


def test_one_verdict_that_fails_is_enough():
    result = align(window().rows)
    assert result.passed and result.require() is result
    for name in Ask:
        doubted = result.asked_further(Verdict(name, False, 1.0, 0.0, "does not add up"))
        assert not doubted.passed and [v.name for v in doubted.failed] == [name]
        assert doubted.asked == (*FIVE, name)
        with pytest.raises(AlignmentError, match="not aligned: does not add up"):
            doubted.require()
    assert result.asked_further(Verdict(Ask.RIVALS, True, 0.0, 1.0, "none")).passed


@pytest.mark.parametrize(
    ("proved", "geometry", "together"),
    [
        ("CERTIFIED", "LINEAR", "CERTIFIED"),
        ("CERTIFIED", "GENERIC", "CERTIFIED"),
        ("CERTIFIED", "MIRROR", "AMBIGUOUS"),
        ("CERTIFIED", "UNOBSERVABLE", "UNOBSERVABLE"),
        ("AMBIGUOUS", "LINEAR", "AMBIGUOUS"),
        ("AMBIGUOUS", "UNOBSERVABLE", "UNOBSERVABLE"),
        ("NOT_TIGHT", "MIRROR", "NOT_TIGHT"),
        ("NUMERICAL", "MIRROR", "NUMERICAL"),
        ("NOT_TIGHT", "UNOBSERVABLE", "UNOBSERVABLE"),
    ],
)
def test_status_is_the_weaker_of_proof_and_geometry(proved, geometry, together):
    assert AlignmentStatus[proved].seen_in(Geometry[geometry]) is AlignmentStatus[together]


def test_only_two_statuses_are_optimal():
    assert [s for s in AlignmentStatus if s.optimal] == [
        AlignmentStatus.CERTIFIED,
        AlignmentStatus.AMBIGUOUS,
    ]


@pytest.mark.parametrize(
    ("satellites", "motion", "status"),
    [
        (5, "3d", AlignmentStatus.CERTIFIED),
        (2, "2d", AlignmentStatus.AMBIGUOUS),
        (5, "line", AlignmentStatus.UNOBSERVABLE),
        (1, "3d", AlignmentStatus.UNOBSERVABLE),
    ],
)
def test_both_solvers_say_the_same_of_a_window(satellites, motion, status):
    """The relaxation asks two of the five questions, and answers them alike."""
    for seed in range(5):
        fast = align(window(seed, satellites, motion).rows)
        sdp = align_sdp(fast.problem)
        assert fast.status is sdp.status is status
        assert sdp.asked == (Ask.OPTIMAL, Ask.UNIQUE)
        assert sdp.passed == (status is AlignmentStatus.CERTIFIED)
        assert sdp.message.startswith("aligned: " if sdp.passed else "not aligned: ")
        for name in sdp.asked:
            assert sdp.verdict(name).passed == fast.verdict(name).passed
        assert sdp.cost == pytest.approx(fast.cost, rel=1e-6, abs=1e-9)
        assert sdp.rivals.C.shape == (0, 3, 3) and sdp.rivals.cost.shape == (0,)
        assert sdp.bound == np.pi and sdp.dof == fast.dof


def test_a_relaxation_that_is_not_tight_is_not_optimal(choi_lam):
    problem = replace(align(window().rows).problem, Q=choi_lam + np.eye(10))
    problem = replace(problem, factor=np.linalg.cholesky(problem.Q).T)
    result = align_sdp(problem)
    assert not result.verdict(Ask.OPTIMAL).passed
    assert result.status is AlignmentStatus.NOT_TIGHT


def test_margins_of_both_solvers_hold_for_every_rotation(rotations):
    for seed in range(5):
        problem = align(window(seed, 3).rows).problem
        for found in (judge(problem).minimum, align_sdp(problem).minimum):
            angle = np.arccos((np.trace(found.C.T @ rotations, axis1=1, axis2=2) - 1.0) / 2.0)
            rise = found.best_margin * (1.0 - np.cos(0.5 * angle) ** 4)
            costs = np.array([problem.cost(C) for C in rotations])
            assert found.best_margin > 0.0
            assert np.all(costs - found.cost >= rise - 1e-9 * found.scale)


def test_multipliers_of_both_solvers_prove_exactly():
    result = align(window().rows)
    for minimum in (result.minimum, align_sdp(result.problem).minimum):
        proof = exact_proof(result.problem.Q, minimum)
        assert proof is not None and check(proof).proved


def test_inflation_counts_misfit_and_never_helps():
    result = align(window().rows)
    assert replace(result, cost=3.0 * result.dof).inflation == 3.0
    assert replace(result, cost=0.2 * result.dof).inflation == 1.0
    assert replace(result, cost=50.0, dof=0).inflation == 1.0


def test_sigma_is_that_of_the_axis_known_least():
    result = replace(align(window().rows), cov_w=np.diag([1.0, 9.0, 4.0]))
    assert result.sigma == 3.0
    assert replace(result, cov_w=np.full((3, 3), np.nan)).sigma == np.inf
    assert replace(result, cov_w=np.diag([1.0, np.inf, 4.0])).sigma == np.inf


def parts(value, seen):
    """A dataclass of the package and all those in it."""
    if is_dataclass(value) and type(value).__module__.startswith("certnav.alignment"):
        seen[type(value).__name__] = value
        for field in fields(value):
            parts(getattr(value, field.name), seen)
    return seen


def test_nothing_prints_pages():
    """A line each, of what decides, however many rows there are."""
    w = window(epochs=300)
    rows = replace(w.rows, z=w.rows.z + 20.0 * (np.arange(len(w.rows)) % 10 == 0))
    robust, sdp = align_robust(rows), align_sdp(align(w.rows).problem)
    time = np.arange(100.0)
    shown = {}
    for value in (
        w, align(w.rows), robust, sdp, robust.proof, gauss_newton(sdp.problem),
        observability(sdp.problem.Q), up_prior([0.0, 0.0, 1.0], np.eye(3), 0.1),
        exact_proof(sdp.problem.Q, sdp.minimum, "here"),
        prove_consensus(w.rows, w.C_ew, 1e9, max_cells=10),
        planar_track(time, time, 0.0 * time, 3.0, 50.0),
        given_attitude(0.0, lla_to_ecef(0.1, 0.2, 0.0), np.zeros(3), 0.01, 0.1),
    ):  # fmt: skip
        parts(value, shown)
    assert len(shown) > 15
    for name, value in shown.items():
        assert len(repr(value)) < 300 and "\n" not in repr(value), name


def test_a_result_is_known_by_its_line():
    good = repr(align(window().rows))
    assert good.startswith("<AlignmentResult passed: CERTIFIED, 1σ 0.")
    assert "°, bound " in good and "at 71 dof>" in good
    bad = repr(align(window(2, 2, "2d").rows, ClockModel("random-walk", 0.01)))
    assert "not unique, unambiguous, bounded: AMBIGUOUS" in bad and "no bound" in bad
