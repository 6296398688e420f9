"""What a log of inertial samples lacks: axes frozen at one value or clipped, samples polled twice.

A sensor has three axes and each its own range and its own register: two that are clipped are not
believed because the third still moves. Equal values in a row are no fault by themselves. Exact data
repeat at rest, a log may be printed faster than the sensor reports, and where one step of the
converter is as large as the noise, values stay the same for long; so a run has to be longer than
chance makes it in that axis.

A logger that polls a sensor out of step reads some samples twice and misses others. What vibrates
then does not average out: in place of a missed sample another one counts twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..filters.rotation import FloatArray
from .series import ImuData

SENSORS = ("gyro", "accelerometer")
UNITS = ("rad/s", "m/s²")
#: Equal rows are frozen from here on [s], and if so many.
_FROZEN, _EQUAL_ROWS = 0.2, 5
#: Runs as long as chance makes once in so many recordings are none.
_CHANCE = 1e-3
#: Below so many steps of the converter in a usual change, equal values are its resolution.
_COARSE = 3.0
#: The neighbourhood of a run: so many rows on either side.
_AROUND = 100
#: A value is a limit if so many rows have it, so many times as many as the values just inside …
_HITS, _PILED = 10, 3.0
#: … and it is so far from the usual: gyro [rad/s], accelerometer [m/s²].
_FAR = (0.1, 0.8)
#: A clipped signal dips below the limit for so long [s]; shorter clipping changes nothing [s].
_DIP, _CLIPPED = 0.1, 0.05


#: Polled twice is one row in so many at least, and in so many at most: what repeats every other row
#: is printed faster than measured, and misses nothing.
_TWICE = (1e-3, 0.25)


@dataclass(frozen=True)
class Polled:
    """Samples read twice, and the noise of those that were missed.

    Attributes
    ----------
    share : float
        Of rows that repeat the one before in all axes.
    gyro_density, accel_density : float
        What they add to the white noise of an axis, in the mean of the three [rad/s/√Hz],
        [m/s²/√Hz].
    """

    share: float
    gyro_density: float
    accel_density: float


def polled(imu: ImuData) -> Polled | None:
    """Return the noise of samples polled twice; None where next to none is.

    A sample x of an interval T that counts twice adds (x − x̄)T to the integral, x̄ the mean around
    it, one that is missed takes as much away; in the long run there are as many of these. With r of
    either in a second their sum grows like white noise of density √(2r) T σ. σ² is half the mean
    square of the steps to the rows before and behind, which is all that is known of x − x̄ there.

    Parameters
    ----------
    imu : ImuData
    """
    x = np.hstack([imu.gyro_b, imu.accel_b])
    if len(x) < _EQUAL_ROWS:
        return None
    step = np.diff(x, axis=0)
    same = (step == 0.0).all(axis=1)
    alone = np.flatnonzero(same[1:-1] & ~same[:-2] & ~same[2:]) + 1
    share = alone.size / len(same)
    if not _TWICE[0] <= share <= _TWICE[1]:
        return None
    around = 0.25 * (step[alone - 1] ** 2 + step[alone + 1] ** 2)
    rate = 2.0 * share * imu.interval * around.mean(axis=0)
    gyro, accel = np.sqrt(rate[:3].mean()), np.sqrt(rate[3:].mean())
    return Polled(share, float(gyro), float(accel))


@dataclass(frozen=True)
class Stretch:
    """One axis without information.

    Attributes
    ----------
    sensor : {0, 1}
        Index into `SENSORS`.
    axis : {0, 1, 2}
    why : {'frozen', 'clipped'}
    first, last : int
        Rows.
    begin, end : float
        Their times [s].
    value : float
        What the axis shows meanwhile.
    """

    sensor: int
    axis: int
    why: str
    first: int
    last: int
    begin: float
    end: float
    value: float

    @property
    def name(self) -> str:
        """Sensor and axis."""
        return f"{SENSORS[self.sensor]} {'xyz'[self.axis]}"


def blind_stretches(imu: ImuData, moving: NDArray[np.bool_]) -> list[Stretch]:
    """Return where each axis measures nothing.

    Parameters
    ----------
    imu : ImuData
    moving : ndarray of bool, shape (n,)
        Whether the vehicle may move; at rest values may repeat.

    Returns
    -------
    list of Stretch
        By sensor, axis and time.
    """
    out = []
    for sensor, values in enumerate((imu.gyro_b, imu.accel_b)):
        for axis, column in enumerate(values.T):
            limits = _limits(column, _FAR[sensor])
            found = [("clipped", *run) for run in _clipped(imu, column, limits)]
            found += [
                ("frozen", first, last)
                for first, last in _frozen(imu, column, moving)
                if column[first] not in limits
            ]
            out += [
                Stretch(
                    sensor, axis, why, a, b, float(imu.time[a]), float(imu.time[b]),
                    float(column[a]),
                )
                for why, a, b in sorted(found, key=lambda f: f[1])
            ]  # fmt: skip
    return out


def _frozen(
    imu: ImuData, column: FloatArray, moving: NDArray[np.bool_]
) -> Iterator[tuple[int, int]]:
    """Yield first and last row of each run of equal values that chance does not explain."""
    change = np.abs(np.diff(column))
    same = change == 0.0
    if not same.any():
        return
    step = float(np.percentile(change[~same], 1)) if not same.all() else 0.0
    for first, last in _runs(same):
        lasted = imu.time[last + 1] - imu.time[first]
        if last + 1 - first < _EQUAL_ROWS or lasted < _FROZEN:
            continue
        if moving[first : last + 2].any() and not _by_chance(change, first, last, step):
            yield first, last + 1


def _by_chance(change: FloatArray, first: int, last: int, step: float) -> bool:
    """Tell whether the changes around a run of none make one as long likely.

    `step` is one step of the converter. Noise differs from place to place: it is that of the
    neighbourhood that counts.
    """
    around = np.concatenate(
        [change[max(0, first - _AROUND) : first], change[last + 1 : last + 1 + _AROUND]]
    )
    size = around[around > 0.0]
    if not size.size:
        return around.size > 0  # the neighbours of this run are long runs themselves
    if float(np.median(size)) < _COARSE * step:
        return True
    # Of a slower sensor that is printed faster, a change is followed by so many repeats each time.
    likely = 1.0 - size.size / around.size
    if likely == 0.0:
        return False
    return (last + 1 - first) * np.log(likely) > np.log(_CHANCE / change.size)


def _limits(column: FloatArray, far: float) -> tuple[float, ...]:
    """Return the extreme values at which a column piles up."""
    ends = (float(column.min()), float(column.max()))
    # A value is printed once at least: of most columns that is all there is to look at.
    often = {limit: hits for limit in ends if (hits := int((column == limit).sum())) >= _HITS}
    size = np.abs(np.diff(column)) if often else np.zeros(0)
    size = size[size > 0.0]
    if not size.size:
        return ()
    # At least the next step of the converter: the outermost value of a sound axis is the rarest.
    inside = max(0.5 * float(np.median(size)), 1.5 * float(np.percentile(size, 1)))
    centre = float(np.median(column))
    # Of a slower sensor that is printed faster, every value has so many rows.
    printed = float(np.median(np.diff(np.flatnonzero(np.diff(column, prepend=np.nan) != 0.0))))
    out = []
    for limit, hits in often.items():
        apart = np.abs(column - limit)
        near = int(((apart > 0.0) & (apart <= inside)).sum())
        if hits >= _HITS * printed and hits > _PILED * near and abs(limit - centre) > far:
            out.append(limit)
    return tuple(out)


def _clipped(
    imu: ImuData, column: FloatArray, limits: tuple[float, ...]
) -> Iterator[tuple[int, int]]:
    """Yield first and last row of each stretch at a limit, short dips below it included."""
    for limit in limits:
        at = np.flatnonzero(column == limit)
        edge = np.flatnonzero(np.diff(imu.time[at]) > _DIP)
        firsts, lasts = at[np.concatenate([[0], edge + 1])], at[np.concatenate([edge, [-1]])]
        for first, last in zip(firsts, lasts, strict=True):
            if imu.time[last] - imu.time[first] >= _CLIPPED:
                yield int(first), int(last)


def _runs(same: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Yield first and last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], same.astype(int), [0]])))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        yield int(first), int(end - 1)
