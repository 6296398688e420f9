"""Spells without inertial data: gaps in the samples, and axes that measure nothing.

The mechanisation bridges a gap with the sample after it and believes a frozen or clipped axis.
What the vehicle may have done meanwhile is added to the covariance: otherwise the filter comes out
of a turn with a wrong heading, sure of itself, and refuses the very positions that would correct
it. Each axis is blind for itself: a gyro's costs attitude about it, an accelerometer's velocity
along it.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...datasets.imu_faults import SENSORS, UNITS, Stretch, blind_stretches
from ...datasets.series import ImuData
from ...filters.ekf import ErrorStateFilter
from ...filters.error_model import ATT, VEL
from ..notes import Note, clock
from .events import GnssEvent

#: What a car may do unseen, 1σ: turn about the vertical and tilt [rad/s], accelerate [m/s²]. In a
#: spell shorter than a second it cannot have changed that much: proportionally less.
TURN, TILT, ACCELERATION = 0.3, 0.05, 2.0
#: No attitude is less known than this [rad].
_LOST = 1.0
#: Steps in which the covariance grows [s].
_STEP = 0.5
#: A gap is longer than this [s] and than so many intervals; shorter ones change nothing.
_SHORTEST, _INTERVALS = 0.05, 3.0
#: Speed that is motion [m/s], and how long after a velocity it still says so [s].
_MOVING, _FRESH = 0.5, 1.0

Blindness = tuple[float, float]


class Spell(NamedTuple):
    """A time in which the same axes are blind.

    Attributes
    ----------
    begin, end : float
        [s].
    axes : tuple of six, (float, float) or None
        Gyro x, y, z, accelerometer x, y, z: begin and end of the blindness of each, which may be
        longer than the spell; None where it measures.
    """

    begin: float
    end: float
    axes: tuple[Blindness | None, ...]


def gap(begin: float, end: float) -> Spell:
    """Return the spell in which nothing is measured."""
    return Spell(begin, end, ((begin, end),) * 6)


def is_gap(step: ArrayLike, interval: float) -> NDArray[np.bool_]:
    """Whether a step between IMU samples [s], or each of several, is a spell without data."""
    return np.asarray(step) > max(_SHORTEST, _INTERVALS * interval)


def blind_axes(imu: ImuData, events: Iterable[GnssEvent]) -> list[Stretch]:
    """Return where axes are frozen or clipped (`datasets.imu_faults`).

    Parameters
    ----------
    imu : ImuData
    events : iterable of GnssEvent
        Their velocities tell frozen sensors from a vehicle that stands on exact data.
    """
    known = [e for e in events if e.kind == "velocity" and not e.reason]
    if not known:
        return blind_stretches(imu, np.zeros(len(imu), dtype=bool))
    time = np.array([e.time for e in known])
    fast = np.array([bool(np.linalg.norm(e.value_e) > _MOVING) for e in known])
    after = np.clip(np.searchsorted(time, imu.time), 0, time.size - 1)
    before = np.maximum(after - 1, 0)
    since, until = np.abs(imu.time - time[before]), np.abs(time[after] - imu.time)
    # Where GNSS says nothing for a while, the nearer of its neighbours decides.
    moving = np.where(since < until, fast[before], fast[after])
    moving |= (fast[before] & (since < _FRESH)) | (fast[after] & (until < _FRESH))
    return blind_stretches(imu, moving)


def blind_spells(imu: ImuData, blind: Iterable[Stretch]) -> list[Spell]:
    """Return every spell without inertial data, or with less, in order and apart from each other.

    Parameters
    ----------
    imu : ImuData
        For its gaps.
    blind : iterable of Stretch
        As of `blind_axes`.
    """
    gaps = np.flatnonzero(is_gap(np.diff(imu.time), imu.interval))
    missing = [(float(imu.time[k]), float(imu.time[k + 1])) for k in gaps]
    axes: list[list[Blindness]] = [list(missing) for _ in range(6)]
    for stretch in blind:
        axes[3 * stretch.sensor + stretch.axis].append((stretch.begin, stretch.end))
    axes = [_merged(some) for some in axes]
    edges = np.unique([edge for some in axes for span in some for edge in span])
    out = []
    for begin, end in pairwise(float(edge) for edge in edges):
        there = tuple(_covering(some, begin, end) for some in axes)
        if any(there):
            out.append(Spell(begin, end, there))
    return out


def _merged(spans: list[Blindness]) -> list[Blindness]:
    out: list[Blindness] = []
    for begin, end in sorted(spans):
        if out and begin <= out[-1][1]:
            out[-1] = (out[-1][0], max(end, out[-1][1]))
        else:
            out.append((begin, end))
    return out


def _covering(spans: list[Blindness], begin: float, end: float) -> Blindness | None:
    k = bisect_right(spans, (begin, np.inf)) - 1
    return spans[k] if k >= 0 and end <= spans[k][1] else None


def blind_notes(spells: Iterable[Spell], blind: Iterable[Stretch]) -> tuple[Note, ...]:
    """Name the gaps, and the axes that are blind, with the longest stretch of each."""
    out = []
    # Six axes that are blind for the same time: nothing was measured, or nothing new.
    missing = [s for s in spells if None not in s.axes and len(set(s.axes)) == 1]
    if missing:
        longest = max(missing, key=lambda s: s.end - s.begin)
        text = (
            f"IMU: no data, or frozen, in {len(missing)} spells, the longest "
            f"{longest.end - longest.begin:.2f} s from {clock(longest.begin)}; the covariance is "
            "widened by what a car may do meanwhile"
        )
        out.append(Note("note", text))
    by_axis: dict[tuple[int, int, str], list[Stretch]] = {}
    whole = {s.axes[0] for s in missing}
    for stretch in blind:
        if (stretch.begin, stretch.end) not in whole:
            key = (stretch.sensor, stretch.axis, stretch.why)
            by_axis.setdefault(key, []).append(stretch)
    for (sensor, axis, why), some in by_axis.items():
        longest_one = max(some, key=lambda s: s.end - s.begin)
        along = "attitude about it" if sensor == 0 else "velocity along it"
        total = sum(s.end - s.begin for s in some)
        at = " and ".join(f"{v:+.3g}" for v in sorted({s.value for s in some}))
        what = f"clipped at {at} {UNITS[sensor]}" if why == "clipped" else "frozen"
        text = (
            f"IMU: {SENSORS[sensor]} {'xyz'[axis]} {what} for {total:.1f} s in {len(some)} "
            f"stretches, the longest {longest_one.end - longest_one.begin:.2f} s from "
            f"{clock(longest_one.begin)}: blind there, the covariance is widened ({along})"
        )
        out.append(Note("doubtful", text))
    return tuple(out)


def propagate(kalman: ErrorStateFilter, until: float, spells: Iterable[Spell]) -> None:
    """Propagate a filter to `until` [s]; in blind spells its covariance grows in steps.

    Parameters
    ----------
    kalman : ErrorStateFilter
    until : float
    spells : iterable of Spell
        In order of time.
    """
    for spell in spells:
        if spell.end <= kalman.time:
            continue
        if spell.begin >= until:
            break
        if spell.begin > kalman.time:
            kalman.propagate(spell.begin)
        while kalman.time < min(spell.end, until):
            to = min(kalman.time + _STEP, spell.end, until)
            _widen(kalman, spell.axes, to)
            kalman.propagate(to)
    kalman.propagate(until)


def _widen(kalman: ErrorStateFilter, axes: tuple[Blindness | None, ...], to: float) -> None:
    """Add what may happen unseen until `to` [s].

    A rate error that lasts makes σ grow with time since the axis is blind: so the variances differ
    by the squares.
    """
    grown = np.zeros(6)
    for k, blind in enumerate(axes):
        if blind is not None:
            begin, end = blind
            size = min(1.0, end - begin)
            grown[k] = size**2 * ((to - begin) ** 2 - (kalman.time - begin) ** 2)
    up_b = kalman.C_eb.T @ (kalman.pos_e / np.linalg.norm(kalman.pos_e))
    P = kalman.P.copy()
    turned, pushed = np.sqrt(grown[:3]), grown[3:]
    if turned.any():
        room = max(0.0, _LOST**2 - float(up_b @ P[ATT, ATT] @ up_b))
        turn = min(TURN**2, room / float(grown[:3].max()))
        rates = TILT**2 * (np.eye(3) - np.outer(up_b, up_b)) + turn * np.outer(up_b, up_b)
        P[ATT, ATT] += turned[:, None] * rates * turned
    P[VEL, VEL] += ACCELERATION**2 * (kalman.C_eb * pushed) @ kalman.C_eb.T
    kalman.reconsider(P)
