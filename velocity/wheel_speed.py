"""How late an odometer's stamps are, and its scale, against speeds that GNSS knows.

Wheel pulses are counted over an interval, filtered and sent over a bus: half a second late is
usual, and a car that brakes has changed its speed by 2 m/s by then. Over a range of delays

    v(t) ≈ a s(t + d),

with the scale a of least squares at each; the best d leaves the least. Delete-a-block jackknife
gives the σ of both, which then holds whatever makes parts of a drive disagree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..filters.rotation import FloatArray

#: Delays looked at [s]; a bus is no later than that.
SEARCH = 2.0
_STEP, _HALF = 0.05, 5
#: Slower, a wheel sensor counts single pulses [m/s].
_SLOWEST = 1.0
#: Parts of the drive, fewest speeds, and the change of speed that tells a delay (RMS) [m/s].
_BLOCKS, _FEWEST, _CHANGING = 12, 60, 0.5
#: Speeds further off than so many MADs are reflections, or slip.
_OUTLIER = 5.0
#: An odometer leaves less of the speed's variance than that.
_UNEXPLAINED = 0.2
#: A delay known to this is known [s].
_KNOWN = 0.1


class WheelSpeed(NamedTuple):
    """An odometer against GNSS.

    Attributes
    ----------
    delay, delay_sigma : float
        How late its stamps are [s].
    scale, scale_sigma : float
        Speed over what it says.
    """

    delay: float
    delay_sigma: float
    scale: float
    scale_sigma: float


def wheel_speed(
    time: ArrayLike, speed: ArrayLike, known_time: ArrayLike, known_speed: ArrayLike
) -> WheelSpeed | None:
    """Return delay and scale of an odometer; None where the drive does not tell.

    Parameters
    ----------
    time, speed : array_like, shape (n,)
        Its stamps and what they say [s], in any unit of speed, with or without sign.
    known_time, known_speed : array_like, shape (m,)
        Speeds as GNSS has them [s], [m/s].
    """
    stamp, says = np.asarray(time, dtype=float), np.abs(np.asarray(speed, dtype=float))
    t, v = np.asarray(known_time, dtype=float), np.asarray(known_speed, dtype=float)
    inside = (t > stamp[0] + SEARCH) & (t < stamp[-1] - SEARCH) & (v > _SLOWEST)
    t, v = t[inside], v[inside]
    if t.size < _FEWEST or np.std(v) < _CHANGING:
        return None
    delays = np.arange(-SEARCH, SEARCH + 0.5 * _STEP, _STEP)
    s = np.array([np.interp(t + d, stamp, says) for d in delays])
    if not np.any(s > 0.0):
        return None
    keep = np.ones(t.size, dtype=bool)
    for _ in range(2):  # what is far off at the best delay is no speed of the wheels
        left = _left(s[:, keep], v[keep])
        best = int(np.argmin(left))
        a = float(s[best, keep] @ v[keep] / (s[best, keep] @ s[best, keep]))
        off = np.abs(v - a * s[best])
        keep = off <= _OUTLIER * max(1.4826 * float(np.median(off)), 0.02)
    block = np.minimum((np.arange(t.size) * _BLOCKS) // t.size, _BLOCKS - 1)
    found = [_fitted(delays, s[:, keep], v[keep])]
    for k in range(_BLOCKS):
        rest = keep & (block != k)
        found.append(_fitted(delays, s[:, rest], v[rest]))
    if any(f is None for f in found):
        return None
    (delay, scale), *parts = (f for f in found if f is not None)
    spread = np.array(parts) - np.mean(parts, axis=0)
    sigma = np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum(spread**2, axis=0))
    white = _white(delays, s[:, keep], v[keep])
    if white is None:
        return None
    out = WheelSpeed(delay, max(float(sigma[0]), white, 1e-3), scale, max(float(sigma[1]), 1e-5))
    return out if out.delay_sigma < _KNOWN else None


def _white(delays: FloatArray, s: FloatArray, v: FloatArray) -> float | None:
    """Return the delay's σ if errors were white: a jackknife of few parts is smaller at times.

    None where the odometer does not explain the speed.
    """
    left = _left(s, v)
    k = int(np.argmin(left))
    if left[k] > _UNEXPLAINED * float(np.sum((v - v.mean()) ** 2)):
        return None
    scale = float(s[k] @ v / (s[k] @ s[k]))
    slope = scale * (s[k + 1] - s[k - 1]) / (delays[k + 1] - delays[k - 1])
    return float(np.sqrt(left[k] / v.size / max(float(slope @ slope), 1e-12)))


def _left(s: FloatArray, v: FloatArray) -> FloatArray:
    """Return what least squares leaves of v at each delay [m²/s²]."""
    square = np.maximum(np.sum(s * s, axis=1), 1e-12)
    return np.maximum(v @ v - (s @ v) ** 2 / square, 0.0)


def _fitted(delays: FloatArray, s: FloatArray, v: FloatArray) -> tuple[float, float] | None:
    """Return delay and scale, between the steps; None where the least is at the end.

    A parabola over a quarter of a second: counts that stay for a tenth make steps in it.
    """
    left = _left(s, v)
    k = int(np.argmin(left))
    if not _HALF <= k < delays.size - _HALF:
        return None
    near = slice(k - _HALF, k + _HALF + 1)
    curve, slope, _ = np.polyfit(delays[near] - delays[k], left[near], 2)
    if curve <= 0.0:
        return None
    delay = float(delays[k] - 0.5 * slope / curve)
    return delay, float(s[k] @ v / (s[k] @ s[k]))
