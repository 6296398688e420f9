"""What speaks against a window's solution: each verdict against its closed form."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from certnav.alignment import Ask, align
from certnav.alignment.in_motion import doubts
from certnav.alignment.in_motion.unknowns import InertialOptions
from certnav.alignment.reference import simulate_window
from certnav.alignment.solver import LocalMinima, region_threshold
from certnav.filters.errors import AlignmentError
from certnav.filters.rotation import matrix_from_rotvec

OPTIONS = InertialOptions()


@pytest.mark.parametrize(("rejected", "passed"), [(0, True), (10, True), (11, False)])
def test_consensus_needs_nine_rows_of_ten(rejected, passed):
    verdict = doubts.consensus(np.arange(100) >= rejected, OPTIONS)
    assert verdict.name is Ask.CONSENSUS and verdict.passed == passed
    assert (verdict.value, verdict.limit) == (1.0 - rejected / 100, 0.9)
    kept = f"{100 - rejected} of 100 rows agree"
    assert verdict.message == (kept if passed else f"at most {kept}, 90 % are needed")


def test_rows_at_rest_do_not_outvote_those_in_motion():
    """146 of 156 agree, of 24 in motion 14: what a window in a canyon passed with, 22° wrong."""
    inliers, moves = np.ones(156, dtype=bool), np.arange(156) >= 132
    inliers[-10:] = False
    assert doubts.consensus(inliers, OPTIONS).passed
    verdict = doubts.consensus(inliers, OPTIONS, moves)
    assert not verdict.passed and verdict.value == pytest.approx(14 / 24)
    assert verdict.message.startswith("at most 14 of 24 rows in motion agree, 90 % are needed")
    # Too few in motion for a share of them to mean anything.
    assert doubts.consensus(inliers, OPTIONS, np.arange(156) >= 147).passed


def test_motion_is_what_satellites_see_and_neither_clock_nor_the_earth(noise_free):
    doppler, drive = noise_free.doppler, noise_free.simulation
    reference = drive.reference
    speed = np.linalg.norm(
        [np.interp(doppler.time, reference.time, v) for v in reference.vel_e.T], axis=0
    )
    moves = doubts.in_motion(doppler)
    fast = (speed > 3.0)[doppler.epoch]
    assert fast.any() and moves[fast].all()
    still = replace(doppler, z=doppler.z - np.sum(doppler.e_e * _velocity(doppler, drive), axis=1))
    assert not doubts.in_motion(still).any()


def _velocity(doppler, drive):
    """Velocity over the Earth at each row, ECEF."""
    lever_b = drive.calibration.lever_antenna_b
    ends = [drive.trajectory.pos_e(doppler.time + d, lever_b) for d in (-0.01, 0.01)]
    return ((ends[1] - ends[0]) / 0.02)[doppler.epoch]


@pytest.fixture(scope="module")
def result():
    return align(simulate_window(np.random.default_rng(3), 5, sigma=0.1, epochs=15).rows)


def rivals_of(monkeypatch, result, excesses, settled):
    """The verdict on rivals of these excess costs, which settle at (angle, excess) each."""
    solved = SimpleNamespace(window=SimpleNamespace(biases=np.zeros(6)))
    asked = []

    def settle(window, biases, options, near, inliers):
        asked.append(round(float(near[0, 0])))
        angle, excess = settled[asked[-1]]
        turned = result.C_ew @ matrix_from_rotvec([angle, 0.0, 0.0])
        return SimpleNamespace(C_ew=turned, cost=result.cost + excess)

    monkeypatch.setattr(doubts, "settle", settle)
    # Which rival it is stands in its first element.
    C = np.array([k * np.eye(3) for k in range(len(excesses))]).reshape(-1, 3, 3)
    found = SimpleNamespace(
        rivals=LocalMinima(C, result.cost + np.array(excesses)), cost=result.cost,
        C_ew=result.C_ew, inflation=2.0,
    )  # fmt: skip
    verdict = doubts.rivals(None, solved, found, np.ones(3, dtype=bool), OPTIONS)
    assert verdict.name is Ask.RIVALS
    return verdict, asked


def test_rivals_are_followed_to_their_own_biases(monkeypatch, result):
    limit = 2.0 * OPTIONS.limits.ambiguity
    verdict, asked = rivals_of(monkeypatch, result, [50.0, 80.0], [(1.0, 40.0), (1.0, limit - 1)])
    assert asked == [0, 1]
    assert not verdict.passed and verdict.value == pytest.approx(40.0)
    assert verdict.limit == pytest.approx(limit)
    assert f"+40 (limit {limit:.0f}): needs a turn" in verdict.message
    verdict, _ = rivals_of(monkeypatch, result, [50.0, 80.0], [(1.0, limit + 1), (1.0, 1e3)])
    assert verdict.passed and verdict.value == pytest.approx(limit + 1)
    assert "limit" not in verdict.message


def test_rivals_that_end_at_the_optimum_or_are_far_above_are_none(monkeypatch, result):
    limit = 2.0 * OPTIONS.limits.ambiguity
    verdict, asked = rivals_of(
        monkeypatch, result, [50.0, 101.0 * limit], [(0.009, 0.0), (1.0, 0.0)]
    )
    assert asked == [0]
    assert verdict.passed and verdict.value == np.inf
    assert verdict.message == "no rival with biases of its own"
    verdict, asked = rivals_of(monkeypatch, result, [99.0 * limit], [(0.011, 0.0)])
    assert asked == [0] and not verdict.passed


def test_a_dozen_minima_are_not_followed(monkeypatch, result):
    """Nor needed: so many are those of a window that does not bound the attitude."""
    assert rivals_of(monkeypatch, result, [50.0] * 9, [(1.0, 0.0)] * 9)[1] == []
    assert len(rivals_of(monkeypatch, result, [50.0] * 8, [(1.0, 0.0)] * 8)[1]) == 8


def separation_of(monkeypatch, moves, wider, cov):
    """The verdict where leaving out satellite k turns by moves[k] and widens to wider[k]."""
    sats = np.repeat(np.array(["G01", "G02", "G03"]), 4)
    inliers = np.ones(12, dtype=bool)
    inliers[0] = False
    C_ew = matrix_from_rotvec([0.3, -0.2, 1.0])

    def settle(window, biases, options, near, others):
        (k,) = (k for k, sat in enumerate(np.unique(sats)) if not others[sats == sat].any())
        assert near is C_ew and not others[0] and others.sum() == (8 if k == 0 else 7)
        if moves[k] is None:
            raise AlignmentError("too few")
        return SimpleNamespace(
            C_ew=matrix_from_rotvec(moves[k]) @ C_ew,
            estimate=lambda result: (None, wider[k]),
        )

    monkeypatch.setattr(doubts, "settle", settle)
    stretch = SimpleNamespace(rows=SimpleNamespace(sat=sats))
    solved = SimpleNamespace(
        window=SimpleNamespace(stretch=stretch, biases=np.zeros(6)), C_ew=C_ew,
        estimate=lambda result: (None, cov),
    )  # fmt: skip
    verdict = doubts.separation(None, solved, None, inliers, OPTIONS)
    assert verdict.name is Ask.SEPARATION
    return verdict


def test_separation_is_the_move_in_units_of_what_the_satellite_added(monkeypatch):
    rng = np.random.default_rng(5)
    root = 1e-3 * rng.normal(size=(3, 3))
    added = root @ root.T + 1e-7 * np.eye(3)
    cov, wider = np.eye(12) * 1e-6, np.eye(12)
    wider[:3, :3] = cov[:3, :3] + added
    move = np.linalg.cholesky(added) @ np.array([1.0, -2.0, 1.5])  # χ² 7.25
    still = np.zeros(3)
    verdict = separation_of(monkeypatch, [0.5 * move, move, still], [wider] * 3, cov)
    assert verdict.passed and verdict.value == pytest.approx(7.25, rel=1e-3)
    assert verdict.limit == pytest.approx(region_threshold(0.9999))
    assert verdict.message == "without G02 the attitude moves by χ² 7.25"
    verdict = separation_of(monkeypatch, [still, still, 2.0 * move], [wider] * 3, cov)
    assert not verdict.passed and verdict.value == pytest.approx(29.0, rel=1e-3)
    assert "without G03" in verdict.message and "(limit 21)" in verdict.message


def test_a_satellite_that_adds_nothing_may_not_move_the_attitude(monkeypatch):
    """Differences below a hundredth of σ² are rounding: that much is allowed, not nothing."""
    cov = np.eye(12) * 4e-6
    still, move = np.zeros(3), np.array([0.0, 3e-4, 0.0])
    verdict = separation_of(monkeypatch, [still, move, still], [cov] * 3, cov)
    assert verdict.value == pytest.approx(move @ move / 4e-8, rel=1e-6) and verdict.passed
    assert not separation_of(monkeypatch, [still, 10.0 * move, still], [cov] * 3, cov).passed


def test_a_satellite_without_which_nothing_is_left_carries_the_attitude(monkeypatch):
    cov = np.eye(12) * 1e-6
    verdict = separation_of(monkeypatch, [np.zeros(3), None, np.zeros(3)], [cov] * 3, cov)
    assert not verdict.passed and verdict.value == np.inf
    assert verdict.message == "nothing is left without G02"


def contradicted(scores, sat, epoch, epochs=80):
    """The answer for residuals in σ after the fit."""
    rows = SimpleNamespace(sat=sat, epoch=epoch, time=np.arange(float(epochs)))
    window = SimpleNamespace(stretch=SimpleNamespace(rows=rows))
    return doubts.contradicted(SimpleNamespace(window=window, scores=lambda: scores))


def test_sound_rows_contradict_as_rarely_as_the_probability_says():
    rng, found = np.random.default_rng(8), 0
    epoch, sat = np.repeat(np.arange(80), 3), np.tile(["G01", "G02", "G03"], 80)
    for _ in range(1000):
        found += contradicted(np.abs(rng.normal(size=240)), sat, epoch)
    # Eleven parts of 0.1 % each.
    assert 2 <= found <= 25


@pytest.mark.parametrize("where", ["satellite", "end"])
def test_a_few_rows_that_contradict_are_not_hidden_by_many_that_cannot(where):
    """The window as a whole has less χ² than it may have."""
    rng = np.random.default_rng(9)
    epoch, sat = np.repeat(np.arange(80), 3), np.tile(["G01", "G02", "G03"], 80)
    bad = (sat == "G02") & (epoch >= 65) if where == "satellite" else epoch >= 75
    scores = np.abs(rng.normal(size=240)) * np.where(bad, 4.0, 0.3)
    assert np.mean(scores**2) < 1.2  # the limit for 240 is 1.3
    assert contradicted(scores, sat, epoch)
    # Rows that were rejected or cannot be judged have no score, and no say.
    assert not contradicted(np.where(bad, 0.0, scores), sat, epoch)
