"""What GNSS could do along a run."""

from __future__ import annotations

import numpy as np

from ...filters.rotation import FloatArray
from ..evaluation.interpolation import usable_at
from ..results.directory import Result


def gnss_state(result: Result) -> np.ndarray:
    """Return what GNSS could do at each solution epoch: 0 position, 1 velocity only, 2 nothing.

    From the usable satellites (≥ 4, 2–3, < 2) where there are observations; for a set of fixes,
    2 means that no position was accepted for 3 s or 3 usual intervals.
    """
    time = result.solution.trajectory.time
    usable = usable_at(result.solution.epochs, time)
    if (usable >= 0).all():
        return np.where(usable >= 4, 0, np.where(usable >= 2, 1, 2))
    accepted = position_times(result)
    limit = max(3.0, 3.0 * float(np.median(np.diff(accepted)))) if len(accepted) > 1 else 3.0
    return np.where(age_of_position(result) <= limit, 0, 2)


def state_names(result: Result) -> tuple[str, str, str]:
    """Return the names of the three states of `gnss_state`."""
    if (result.solution.epochs.usable >= 0).any():
        return ("≥ 4 satellites usable", "2–3 usable", "fewer than 2 usable")
    return ("position fixes accepted", "", "no position accepted")


def position_times(result: Result) -> FloatArray:
    """Return the GPS times of the positions that the filter accepted [s]."""
    updates = result.solution.updates
    return np.array([u.time for u in updates if u.accepted and u.kind == "position"])


def age_of_position(result: Result) -> FloatArray:
    """Return how long ago a position was accepted, at each solution epoch [s]; ∞ before one."""
    time, fixes = result.solution.trajectory.time, position_times(result)
    last = np.searchsorted(fixes, time + 1e-6, side="right") - 1
    age: FloatArray = time - np.r_[-np.inf, fixes][last + 1]
    return age
