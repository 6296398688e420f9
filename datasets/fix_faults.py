"""Fixes that are none: rows without a fix, and fixes that a receiver repeats while it is moved.

What loggers write until there is a fix (latitude and longitude zero, no satellites, no or an absurd
accuracy) and what receivers write when they have lost it (the last one, again and again) looks like
any other row. Nothing is removed: such rows carry the reason in `GnssFixes.rejected`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..filters.earth import HIGHEST_RADIUS, LOWEST_RADIUS
from ..filters.rotation import FloatArray
from .observations import GnssFixes

HELD = "repeats the fix before, though the vehicle moved"
COPIED = "repeats the fix before: the log is printed faster than the receiver reports"
#: Nobody drives so far from the median of a recording [m].
_FAR = 1_000_000.0
#: Accuracies that nobody has: below, it is a field left empty; above, no fix [m].
_EMPTY, _ABSURD = 1e-9, 1000.0
#: Negative variance in some direction, as a share of the largest, that rounded digits can make.
_ROUNDED = 2e-4
#: Coordinates this close are the same number, written and read [m].
SAME = 1e-6
#: Displacement that proves motion, beside four times its own σ [m]: a receiver that holds its
#: position at rest lets go within less.
_MOVED, _SIGMAS = 1.0, 4.0
#: Strongest braking [m/s²]: what was faster before cannot have stopped.
_BRAKING = 12.0
#: Strongest setting off [m/s²].
_SETTING_OFF = 4.0
#: Runs of repeated rows, and their share among the rows in motion, that are a way of printing.
_MANY, _PRINTED = 10, 0.4
#: Names for a quality that is no fix.
_NO_FIX = ("none", "no fix", "nofix", "invalid", "0")


def screened(fixes: GnssFixes) -> GnssFixes:
    """Return the fixes with those marked that are none; what is marked already stays so."""
    rejected = fixes.rejected.astype("U96")
    for rows, reason in _empty(fixes):
        rejected = np.where(rows & (rejected == ""), reason, rejected)
    good = np.flatnonzero(rejected == "")
    for rows, reason in _repeated(fixes, good):
        rejected[rows] = reason
    return dataclasses.replace(fixes, rejected=rejected)


def stretches(fixes: GnssFixes) -> list[tuple[str, int, float, float]]:
    """Return reason, rows, first and last time [s] of each stretch of rejected rows.

    A stretch is what one reason rejects without a usable fix in between; rows that are merely
    printed again are one stretch altogether.
    """
    bad = np.flatnonzero(fixes.rejected != "")
    out: list[tuple[str, int, float, float]] = []
    last: dict[str, int] = {}
    where: dict[str, int] = {}
    usable = np.cumsum(fixes.rejected == "")
    for k in bad:
        reason, time = str(fixes.rejected[k]), float(fixes.time[k])
        on = reason in last and (reason == COPIED or usable[k] == usable[last[reason]])
        if on:
            text, count, first, _ = out[where[reason]]
            out[where[reason]] = (text, count + 1, first, time)
        else:
            where[reason] = len(out)
            out.append((reason, 1, time, time))
        last[reason] = int(k)
    return out


def _empty(fixes: GnssFixes) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Yield rows that hold no fix, and why."""
    quality = np.char.lower(fixes.quality)
    yield np.isin(quality, _NO_FIX), "no fix: the receiver says so"
    yield fixes.satellites == 0, "no fix: zero satellites"
    radius = np.linalg.norm(fixes.pos_e, axis=1)
    null = (np.hypot(fixes.pos_e[:, 1], fixes.pos_e[:, 2]) < 1.0) | (radius < 1.0)
    yield null, "no fix: latitude and longitude 0"
    off = (radius < LOWEST_RADIUS) | (radius > HIGHEST_RADIUS)
    yield off, "no fix: not on the Earth"
    sigma = np.sqrt(np.clip(np.diagonal(fixes.pos_cov_e, axis1=1, axis2=2), 0.0, None)).max(axis=1)
    yield sigma < _EMPTY, "stated accuracy 0: unknown"
    yield sigma > _ABSURD, f"no fix: stated accuracy beyond {_ABSURD:.0f} m"
    for what, cov in (("position", fixes.pos_cov_e), ("velocity", fixes.vel_cov_e)):
        yield _indefinite(cov), f"covariance of the {what} is none: correlations beyond 1"
    on_earth = ~(null | off)
    if on_earth.any():
        middle = np.median(fixes.pos_e[on_earth], axis=0)
        far = on_earth & (np.linalg.norm(fixes.pos_e - middle, axis=1) > _FAR)
        yield far, f"no fix: beyond {_FAR / 1000.0:.0f} km from the others"


def _indefinite(cov: FloatArray) -> NDArray[np.bool_]:
    """Tell which covariances some direction has a negative variance in, beyond rounded digits."""
    finite = np.asarray(np.isfinite(cov).all(axis=(1, 2)))
    values = np.linalg.eigvalsh(np.where(finite[:, None, None], cov, 0.0))
    return np.asarray(finite & (values[:, 0] < -_ROUNDED * values[:, -1]))


def _repeated(fixes: GnssFixes, good: NDArray[np.int64]) -> Iterator[tuple[NDArray, str]]:
    """Yield rows that repeat the position before while the vehicle moved, and why."""
    if good.size < 2:
        return
    pos_e, time = fixes.pos_e[good], fixes.time[good]
    same = np.abs(np.diff(pos_e, axis=0)).max(axis=1) < SAME
    if not same.any():
        return
    starts, ends = _runs(same)
    moving = _all_moves(fixes, good, starts, ends, 0.0)
    # Printed faster than reported: every fix of a moving vehicle comes several times.
    counts = ends - starts
    fresh = np.flatnonzero(~same) + 1
    apart = np.linalg.norm(np.diff(pos_e[np.concatenate([[0], fresh])], axis=0), axis=1)
    in_motion = int((apart > SAME).sum()) + int(counts[moving].sum())
    short = counts <= 2 * np.median(counts[moving]) if moving.any() else moving
    copied = moving.sum() >= _MANY and counts[moving & short].sum() >= _PRINTED * in_motion
    if copied:
        after = np.minimum(ends + 1, time.size - 1)
        reported = float(np.median((time[after] - time[starts])[moving]))
        moving = _all_moves(fixes, good, starts, ends, reported)
    for a, b, moved, brief in zip(starts, ends, moving, short, strict=True):
        if copied and brief:
            yield good[a + 1 : b + 1], COPIED
        elif moved:
            yield good[a + 1 : b + 1], HELD


def _all_moves(
    fixes: GnssFixes,
    good: NDArray[np.int64],
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    interval: float,
) -> NDArray[np.bool_]:
    """Return in which runs of repeated fixes the vehicle moved; see `_moves`."""
    runs = zip(starts, ends, strict=True)
    return np.array([_moves(fixes, good, a, b, interval) for a, b in runs], dtype=bool)


def _runs(same: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return first and last index of the rows of each run of equal neighbours."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]])))
    return edges[::2], edges[1::2]


def _moves(
    fixes: GnssFixes, good: NDArray[np.int64], first: int, last: int, interval: float
) -> bool:
    """Tell whether the vehicle moved while the fix of row `first` was repeated up to row `last`.

    Between two fixes of the receiver lie `interval` [s], if that is more than between rows.
    """
    i = good[first]
    lasted = float(fixes.time[good[last]] - fixes.time[i])
    if last + 1 < good.size:
        j = good[last + 1]
        moved = float(np.linalg.norm(fixes.pos_e[j] - fixes.pos_e[i]))
        # After the last repeated row it may have set off.
        since = max(float(fixes.time[j] - fixes.time[good[last]]), interval)
        way = 0.5 * _SETTING_OFF * since**2
        if fixes.has_velocity[j]:
            way = max(way, float(np.linalg.norm(fixes.vel_e[j])) * since)
        cov = fixes.pos_cov_e[i] + fixes.pos_cov_e[j]
        if moved > max(least_motion(cov), 1.2 * way):
            return True
    if not fixes.has_velocity[i]:
        return False
    speed = float(np.linalg.norm(fixes.vel_e[i]))
    slowest = speed - _SIGMAS * _sigma(fixes.vel_cov_e[i])
    # The way that even the strongest braking would have left behind.
    braked = min(lasted, max(slowest, 0.0) / _BRAKING)
    way = slowest * braked - 0.5 * _BRAKING * braked**2
    return way > least_motion(fixes.pos_cov_e[i])


def least_motion(cov_e: FloatArray) -> float:
    """Return the displacement that proves motion where a position has that covariance [m]."""
    return max(_MOVED, _SIGMAS * _sigma(cov_e))


def _sigma(cov: FloatArray) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(cov)[-1]))
