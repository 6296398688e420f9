"""Fewer points to draw, without losing extremes: what a page can show of a long recording."""

from __future__ import annotations

import numpy as np

from ...filters.rotation import FloatArray


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
