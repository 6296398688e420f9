"""Spells without inertial data: gaps in the samples, and sensors that repeat themselves.

The mechanisation bridges a gap with the sample after it and believes a frozen sensor. What the
vehicle may have done meanwhile is added to the covariance: otherwise the filter comes out of a
turn with a wrong heading, sure of itself, and refuses the very positions that would correct it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...datasets.series import ImuData
from ...filters.ekf import ErrorStateFilter
from ...filters.error_model import ATT, VEL
from ...filters.rotation import FloatArray
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
#: Equal rows count as frozen from here on [s], and if so many, where GNSS sees motion [m/s].
_FROZEN, _EQUAL_ROWS, _MOVING = 0.2, 5, 0.5

Spell = tuple[float, float]


def is_gap(step: ArrayLike, interval: float) -> NDArray[np.bool_]:
    """Whether a step between IMU samples [s], or each of several, is a spell without data."""
    return np.asarray(step) > max(_SHORTEST, _INTERVALS * interval)


def blind_spells(imu: ImuData, events: Iterable[GnssEvent]) -> list[Spell]:
    """Return begin and end of every spell without inertial data, in order [s].

    Parameters
    ----------
    imu : ImuData
    events : iterable of GnssEvent
        Their velocities tell frozen sensors from a vehicle that stands on exact data.
    """
    step = np.diff(imu.time)
    gaps = np.flatnonzero(is_gap(step, imu.interval))
    spells = [(float(imu.time[k]), float(imu.time[k + 1])) for k in gaps]
    moving = [
        e.time
        for e in events
        if e.kind == "velocity" and not e.reason and np.linalg.norm(e.value_e) > _MOVING
    ]
    for values in (imu.gyro_b, imu.accel_b):
        spells += _frozen(imu.time, values, np.array(moving))
    return _merged(spells)


def _frozen(time: FloatArray, values: FloatArray, moving: FloatArray) -> list[Spell]:
    """Return the spells in which all three axes repeat themselves though GNSS sees motion."""
    same = np.concatenate([[0], (np.diff(values, axis=0) == 0.0).all(axis=1), [0]]).astype(int)
    edges = np.flatnonzero(np.diff(same))
    spells = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        begin, end = float(time[first]), float(time[last])
        if last - first < _EQUAL_ROWS or end - begin < _FROZEN:
            continue
        if np.any((moving > begin - 1.0) & (moving < end + 1.0)):
            spells.append((begin, end))
    return spells


def _merged(spells: list[Spell]) -> list[Spell]:
    out: list[Spell] = []
    for begin, end in sorted(spells):
        if out and begin <= out[-1][1]:
            out[-1] = (out[-1][0], max(end, out[-1][1]))
        else:
            out.append((begin, end))
    return out


def propagate(kalman: ErrorStateFilter, until: float, spells: Iterable[Spell]) -> None:
    """Propagate a filter to `until` [s]; in blind spells its covariance grows in steps.

    Parameters
    ----------
    kalman : ErrorStateFilter
    until : float
    spells : iterable of (float, float)
        In order of time.
    """
    for begin, end in spells:
        if end <= kalman.time:
            continue
        if begin >= until:
            break
        if begin > kalman.time:
            kalman.propagate(begin)
        while kalman.time < min(end, until):
            to = min(kalman.time + _STEP, end, until)
            _widen(kalman, min(1.0, end - begin), kalman.time - begin, to - begin)
            kalman.propagate(to)
    kalman.propagate(until)


def _widen(kalman: ErrorStateFilter, size: float, before: float, after: float) -> None:
    """Add what may have happened from `before` to `after` the spell's begin [s].

    A rate error that lasts makes σ grow with time: so the variances differ by the squares.
    """
    grown = size**2 * (after**2 - before**2)
    up_b = kalman.C_eb.T @ (kalman.pos_e / np.linalg.norm(kalman.pos_e))
    P = kalman.P.copy()
    room = max(0.0, _LOST**2 - float(up_b @ P[ATT, ATT] @ up_b))
    turn = min(TURN**2 * grown, room)
    P[ATT, ATT] += TILT**2 * grown * (np.eye(3) - np.outer(up_b, up_b))
    P[ATT, ATT] += turn * np.outer(up_b, up_b)
    P[VEL, VEL] += ACCELERATION**2 * grown * np.eye(3)
    kalman.reconsider(P)
