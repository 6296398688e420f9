"""How many intervals one point can hit, by weight, of many sets at once; a kernel."""

from __future__ import annotations

import numpy as np

from ...filters.compiled.jit import njit

#: Up to so many numbers insertion sorts faster than the library.
_FEW = 24


@njit(cache=True)
def stabbed(low, high, member, first, weight, out):
    """Add the most that one point per group hits of each set of closed intervals.

    Parameters
    ----------
    low, high : ndarray, shape (n, k)
        Ends of the intervals, low ≤ high.
    member : ndarray of int, shape (k,)
        Intervals by group.
    first : ndarray of int, shape (groups + 1,)
        Where each group begins in `member`.
    weight : ndarray, shape (k,)
    out : ndarray, shape (n,)
    """
    most = 0
    for g in range(first.size - 1):
        most = max(most, first[g + 1] - first[g])
    starts, ends = np.empty(most), np.empty(most)
    by_start, by_end = np.empty(most, np.int64), np.empty(most, np.int64)
    for n in range(low.shape[0]):
        for g in range(first.size - 1):
            size = first[g + 1] - first[g]
            for i in range(size):
                k = member[first[g] + i]
                starts[i], ends[i] = low[n, k], high[n, k]
            _ordered(starts, by_start, size)
            _ordered(ends, by_end, size)
            best, now, over = 0.0, 0.0, 0
            for i in range(size):
                here = by_start[i]
                now += weight[member[first[g] + here]]
                while ends[by_end[over]] < starts[here]:
                    now -= weight[member[first[g] + by_end[over]]]
                    over += 1
                best = max(best, now)
            out[n] += best


@njit(cache=True)
def _ordered(values, order, size):
    """Write the indices that sort the first `size` values."""
    if size > _FEW:
        order[:size] = np.argsort(values[:size])
        return
    for i in range(size):
        j = i
        while j > 0 and values[order[j - 1]] > values[i]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = i
