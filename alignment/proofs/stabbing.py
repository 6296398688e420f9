"""How many intervals one point can hit, by weight, of many sets at once; a kernel."""

from __future__ import annotations

import numpy as np

from ...filters.compiled.jit import njit

#: Up to so many numbers insertion sorts faster than the library, and than bins are counted.
_FEW = 24
#: Bins that a larger group is looked at in, before it is sorted.
_BINS = 128


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
    most = _largest(first)
    starts, ends = np.empty(most), np.empty(most)
    by_start, by_end = np.empty(most, np.int64), np.empty(most, np.int64)
    for n in range(low.shape[0]):
        for g in range(first.size - 1):
            group = member[first[g] : first[g + 1]]
            out[n] += _most(low[n], high[n], group, weight, starts, ends, by_start, by_end)


@njit(cache=True)
def reached(speed, cosine, c, s, z, half, member, first, weight, least, out):
    """Say of each set of intervals whether one point per group hits `least` of their weight.

    As `stabbed`, for the intervals |v| cos(φ ± reach) − z ± half, φ the angle of a cosine. Most
    sets are decided without sorting: what touches a bin of the drift bounds what a point in it
    hits from above, and what its middle hits from below.

    Parameters
    ----------
    speed, z, half, weight : ndarray, shape (k,)
    cosine : ndarray, shape (n, k)
    c, s : float
        Cosine and sine of the reach, which is less than π.
    member, first : ndarray of int
        As for `stabbed`.
    least : float
    out : ndarray of bool, shape (n,)
    """
    most, rows = _largest(first), speed.size
    starts, ends = np.empty(most), np.empty(most)
    by_start, by_end = np.empty(most, np.int64), np.empty(most, np.int64)
    low, high, touched = np.empty(rows), np.empty(rows), np.empty(_BINS + 1)
    inside = np.arange(most)  # rows in the order of the groups: each is a stretch of them
    share = weight[member]
    for n in range(cosine.shape[0]):
        for i in range(rows):
            k = member[i]
            here = cosine[n, k]
            across = np.sqrt(1.0 - here * here) * s
            low[i] = speed[k] * (-1.0 if here < -c else here * c - across) - z[k] - half[k]
            high[i] = speed[k] * (1.0 if here > c else here * c + across) - z[k] + half[k]
        above, below = 0.0, 0.0
        for g in range(first.size - 1):
            those = slice(first[g], first[g + 1])
            a, b, w = low[those], high[those], share[those]
            if a.size <= _FEW:
                hit = _most_of_few(a, b, w)
                above += hit
                below += hit
            else:
                upper, middle = _fullest(a, b, w, touched)
                above += upper
                below += _hit(a, b, w, middle)
        if below >= least or above < least:
            out[n] = below >= least
            continue
        exact = 0.0
        for g in range(first.size - 1):
            those = slice(first[g], first[g + 1])
            a, b, w = low[those], high[those], share[those]
            exact += _most(a, b, inside[: a.size], w, starts, ends, by_start, by_end)
        out[n] = exact >= least


@njit(cache=True, fastmath={"reassoc", "nsz", "contract"})
def _hit(low, high, weight, point):
    """Return the weight of the intervals that a point hits."""
    total = 0.0
    for i in range(low.size):
        total += weight[i] if low[i] <= point and point <= high[i] else 0.0
    return total


@njit(cache=True)
def _most_of_few(low, high, weight):
    """Return the most that one point hits, which is at a beginning: nothing to sort."""
    best = 0.0
    for i in range(low.size):
        best = max(best, _hit(low, high, weight, low[i]))
    return best


@njit(cache=True)
def _largest(first):
    """Return the size of the largest group."""
    most = 0
    for g in range(first.size - 1):
        most = max(most, first[g + 1] - first[g])
    return most


@njit(cache=True)
def _fullest(low, high, weight, touched):
    """Return the most weight that touches one bin, and the middle of that bin."""
    begin, end = low.min(), high.max()
    per = _BINS / max(end - begin, 1e-300) * (1.0 - 1e-12)
    touched[:] = 0.0
    for i in range(low.size):
        touched[int((low[i] - begin) * per)] += weight[i]
        touched[int((high[i] - begin) * per) + 1] -= weight[i]
    best, now, where = 0.0, 0.0, 0
    for b in range(_BINS):
        now += touched[b]
        if now > best:
            best, where = now, b
    # Sums in another order differ by their rounding.
    return best * (1.0 + 1e-12), begin + (where + 0.5) / per


@njit(cache=True)
def _most(low, high, group, weight, starts, ends, by_start, by_end):
    """Return the most that one point hits of a group's intervals; the rest is room to work."""
    for i in range(group.size):
        starts[i], ends[i] = low[group[i]], high[group[i]]
    _ordered(starts, by_start, group.size)
    _ordered(ends, by_end, group.size)
    best, now, over = 0.0, 0.0, 0
    for i in range(group.size):
        here = by_start[i]
        now += weight[group[here]]
        while ends[by_end[over]] < starts[here]:
            now -= weight[group[by_end[over]]]
            over += 1
        best = max(best, now)
    return best


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
