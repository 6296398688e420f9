"""A position that is wrong, and known to be: what passes keeps its bound."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.alignment.problem import ClockModel
from certnav.alignment.reference.earth_windows import earth_window
from certnav.alignment.robust import align_robust
from certnav.alignment.rows import AlignmentRows
from certnav.alignment.solver.refinement import rotation_angle
from certnav.alignment.verdict import align
from certnav.velocity.range_rate import DopplerRows

CLOCK = ClockModel("random-walk", 0.1)


def rows_of(window, off_e, sigma):
    """Rows of a window made so far from where it is [m], and said to be so by 1σ per axis."""
    signals = window.signals
    sight = signals.at(window.pos_e + off_e + window.track.moved_at(signals.time) @ window.C_ew.T)
    number = np.arange(len(signals))
    doppler = DopplerRows(
        number, number.astype(str), sight.e_e, sight.z, signals.sigma, sight.by_pos
    )
    vel_w = window.track.velocity_at(signals.time)
    return AlignmentRows.paired(doppler, signals.time, vel_w, position_sigma=sigma)


@pytest.mark.parametrize("distance", [300.0, 1e3, 1e4])
def test_windows_keep_their_bound_wherever_they_are_thought_to_be(distance):
    """Each window twice: with the position's σ none is beyond its bound, as if exact many are."""
    rng = np.random.default_rng(round(distance))
    passed, wrong, believed_wrong = 0, 0, 0
    for k in range(24):
        window = earth_window(rng, (4, 6, 8)[k % 3], 30.0)
        direction = rng.normal(size=3)
        off_e = distance * direction / np.linalg.norm(direction)
        for sigma in (0.0, distance / np.sqrt(3.0)):
            result = align(rows_of(window, off_e, sigma), CLOCK)
            beyond = rotation_angle(result.C_ew, window.C_ew) > result.bound
            if sigma:
                passed += result.passed
                wrong += result.passed and beyond
            else:
                believed_wrong += beyond or not result.passed
    assert wrong == 0
    assert passed >= 20
    assert distance < 1e3 or believed_wrong >= 6


def test_rows_may_be_wrong_as_well():
    """A tenth of them gross, 100 m off: the search and its proof know of the position's error."""
    rng = np.random.default_rng(8)
    window = earth_window(rng, 8, 30.0, clock_walk=0.02)
    rows = rows_of(window, np.array([60.0, -50.0, 60.0]), 60.0)
    gross = rng.random(len(rows)) < 0.1
    rows.z[gross] += rng.uniform(3.0, 9.0, gross.sum())
    found = align_robust(rows, ClockModel("random-walk", 0.02))
    assert found.passed, found.result.message
    assert rotation_angle(found.result.C_ew, window.C_ew) < found.result.bound
    assert not found.inliers[gross].any()
    assert found.inliers[~gross].mean() > 0.98
