"""What GNSS could do along a run, and thinning of what is drawn of it."""

from __future__ import annotations

import numpy as np

from ...filters.rotation import FloatArray
from ..evaluation.accuracy import usable_at
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


def runs(t: FloatArray, mask: np.ndarray, end: float) -> list[tuple[float, float]]:
    """Return (start, width) where `mask` holds; runs closer than a pixel are joined."""
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    starts, stops = t[edges[:-1] == 1], np.append(t, end)[np.flatnonzero(edges == -1)]
    if not starts.size:
        return []
    apart = starts[1:] - stops[:-1] > (end - t[0]) / 1500.0
    starts, stops = starts[np.r_[True, apart]], stops[np.r_[apart, True]]
    return [(float(a), float(b - a)) for a, b in zip(starts, stops, strict=True)]


def thin(values: FloatArray, bins: int = 800) -> np.ndarray:
    """Return indices that keep the least and greatest of `values` in each of `bins` stretches."""
    if values.size <= 2 * bins:
        return np.arange(values.size)
    width = -(-values.size // bins)
    padded = np.full(width * -(-values.size // width), np.nan)
    padded[: values.size] = values
    rows = padded.reshape(-1, width)
    unknown = np.isnan(rows)
    first = np.arange(len(rows)) * width
    low = first + np.where(unknown, np.inf, rows).argmin(axis=1)
    high = first + np.where(unknown, -np.inf, rows).argmax(axis=1)
    return np.unique(np.concatenate([low, high, [0, values.size - 1]]))


def pieces(
    t: FloatArray, y: FloatArray, wrap: float | None = None, bins: int = 800
) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices to draw of a line, and which of them to break before.

    Broken at holes in time and, with `wrap`, where an angle jumps by half of it.
    """
    step = np.diff(t, prepend=t[0])
    hole = step > max(1.5, 5.0 * float(np.median(step)))
    if wrap:
        hole |= np.abs(np.diff(y, prepend=y[0])) > wrap / 2
    keep = np.union1d(thin(y, bins), np.flatnonzero(hole | np.roll(hole, -1)))
    keep = keep if keep.size < 10 * bins else thin(y, bins)
    return keep, np.flatnonzero(np.diff(np.cumsum(hole)[keep])) + 1
