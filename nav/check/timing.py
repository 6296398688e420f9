"""The IMU's clock against the motion GNSS sees, whatever the axes are (`nav.check.lag`).

Time is taken out before axes are judged: so one fault makes one finding. The course leads the
heading (`nav.check.motion`), which is a limit of the gyro as a clock and not a fault. Accelerometer
and gyro may have delays of their own: what was measured from which is kept apart, and the gyro is
held against the course at the lag its own turns show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...datasets.gpstime import gps_minus_utc
from ...datasets.sequence import Sequence
from ...filters.rotation import FloatArray
from ...velocity.tracks import Track
from .findings import Finding
from .lag import Lag, find_lag
from .motion import COURSE_SPEED, Inertial, increments

#: Offsets below are neither told from filter delays inside receivers nor worth a doubt [s].
LAG_TOLERANCE = 0.04
#: From here on a difference is measured and not chance, in its σ.
SIGNIFICANT = 3.0
#: From here on a position is metres off: not navigable [s].
LAG_FATAL = 0.5
#: Distance between antenna and rear axle, and what remains unknown of a lever arm [m].
_AXLE, _LEVER = 2.0, 0.3
#: A gyro's own lag is used where it is known so well: what is left of it is well below the
#: seconds over which a turn is compared [s].
_SURE = 0.1
_ACCELEROMETER, _GYRO = ("speed", "cornering"), ("turn rate",)


@dataclass(frozen=True)
class Offset:
    """A time offset from all motions that show it.

    Attributes
    ----------
    lag, sigma : float
        Positive: the IMU's stamps are late [s].
    evidence : tuple of (str, Lag)
    """

    lag: float
    sigma: float
    evidence: tuple[tuple[str, Lag], ...]

    @property
    def significant(self) -> bool:
        """Whether the offset is beyond its uncertainty and what receivers do to time."""
        return abs(self.lag) > LAG_TOLERANCE + SIGNIFICANT * self.sigma

    @property
    def of_gyro(self) -> float | None:
        """The lag of turns against the course [s], with what the course leads; None if unsure."""
        turns = self._of(_GYRO)
        return turns[0][1].lag if turns and turns[0][1].sigma < _SURE else None

    @property
    def words(self) -> str:
        """What was measured from which sensor, without what is systematic in it."""
        parts = []
        for sensor, motions in (("accelerometer", _ACCELEROMETER), ("gyro", _GYRO)):
            found = [
                f"{what} {lag.lag:+.2f} ± {lag.sigma:.2f} s" for what, lag in self._of(motions)
            ]
            if found:
                parts.append(f"{sensor}: {', '.join(found)}")
        return "; ".join(parts)

    @property
    def numbers(self) -> dict[str, float]:
        """Everything for programs."""
        out = {"offset_s": self.lag, "offset_sigma_s": self.sigma}
        for what, lag in self.evidence:
            key = what.replace(" ", "_")
            out |= {f"{key}_lag_s": lag.lag, f"{key}_lag_sigma_s": lag.sigma}
        return out

    def _of(self, motions: tuple[str, ...]) -> list[tuple[str, Lag]]:
        return [item for item in self.evidence if item[0] in motions]


def time_offset(
    imu: Inertial,
    track: Track,
    distance: float,
    heading: FloatArray | None = None,
    expected: tuple[float, ...] = (),
) -> Offset | None:
    """Return by how much the IMU's stamps are late against a track, or None if nothing tells.

    Parameters
    ----------
    imu : Inertial
    track : Track
    distance : float
        From the IMU to the point the track is of [m]: its acceleration leads or lags cornering.
    heading : ndarray, shape (n,), optional
        Heading of the body at the track's times [rad]; the course otherwise.
    expected : tuple of float
        As of `expected_lags`.
    """
    moves = increments(track, heading)
    if moves is None:
        return None
    speed = moves.turning_speed if np.isfinite(moves.turning_speed) else COURSE_SPEED
    horizontal = imu.velocity[:, :2]
    found = []
    for what, integral, y, systematic in (
        ("speed", horizontal, moves.along, 0.01),
        ("cornering", horizontal, moves.across, (distance + _LEVER) / speed),
        ("turn rate", imu.angle, moves.turn, 0.01 if heading is not None else _AXLE / speed),
    ):
        lag = find_lag(imu.time, integral, moves.start, moves.end, y[:, None], expected=expected)
        if lag is not None and lag.conclusive:
            found.append((what, lag, float(np.hypot(lag.sigma, systematic))))
    if not found:
        return None
    # A far lag is taken from the motion that shows it best; those that contradict it are left out.
    best = max(found, key=lambda f: f[1].explained)
    near = [f for f in found if abs(f[1].lag - best[1].lag) < 1.0]
    weight = np.array([1.0 / f[2] ** 2 for f in near])
    mean = float(weight @ [f[1].lag for f in near] / weight.sum())
    return Offset(mean, float(weight.sum() ** -0.5), tuple((f[0], f[1]) for f in near))


def offset_findings(
    offset: Offset | None, other: str, expected: tuple[float, ...] = ()
) -> list[Finding]:
    """Return what the IMU's time offset against `other` ('GNSS') means."""
    subject = f"time, IMU and {other}"
    if offset is None:
        return [
            Finding(
                "note", subject, "an offset cannot be told: too little acceleration and turning"
            )
        ]
    size, late = abs(offset.lag), "late" if offset.lag > 0 else "early"
    evidence, numbers = offset.words, offset.numbers
    if not offset.significant:
        if size > SIGNIFICANT * offset.sigma:
            found = f"the IMU's stamps are {size:.3f} ± {offset.sigma:.3f} s {late} ({evidence})"
            return [Finding("note", subject, found, numbers=numbers)]
        found = f"agree to {offset.lag:+.3f} ± {offset.sigma:.3f} s ({evidence})"
        return [Finding("note", subject, found, numbers=numbers)]
    found = f"the IMU's stamps are {size:.2f} ± {offset.sigma:.2f} s {late} ({evidence})"
    change = ("subtract", "from") if offset.lag > 0 else ("add", "to")
    remedy = f"{change[0]} {size:.2f} s {change[1]} the IMU's time"
    if size < LAG_FATAL:
        found += f"; at 20 m/s that is {20.0 * size:.0f} m along the road"
        return [Finding("doubtful", subject, found, remedy, numbers)]
    leap = leap_second_words(offset.lag, expected)
    remedy = leap_remedy(offset.lag, expected, remedy, "the IMU")
    return [Finding("fatal", subject, found + leap, remedy, numbers)]


def expected_lags(sequence: Sequence) -> tuple[float, ...]:
    """Return the lags that a mistaken time scale makes: GPS − UTC at that date, once and twice.

    None without a date.
    """
    if sequence.time_scale != "gps":
        return ()
    leap = gps_minus_utc(sequence.span[0])
    return (leap, 2.0 * leap) if leap > 0.0 else ()


def leap_second_words(lag: float, expected: tuple[float, ...]) -> str:
    """Return what a lag that equals GPS − UTC at that date (`expected_lags`) suggests, or ''."""
    for leap, words in zip(expected, ("", " applied twice"), strict=False):
        if abs(abs(lag) - leap) < 0.3:
            return f", the {expected[0]:.0f} leap seconds between UTC and GPS time{words}"
    return ""


def leap_remedy(lag: float, expected: tuple[float, ...], otherwise: str, name: str) -> str:
    """Return how to declare a leap-second slip of the stamps called `name`, or `otherwise`.

    UTC is behind GPS time: stamps in UTC that are taken for GPS time are early.
    """
    if not leap_second_words(lag, expected):
        return otherwise
    which = f"{name} is in UTC" if lag < 0 else "the GNSS is in UTC"
    return f"declare the time scale: it looks as if {which} while the other is in GPS time"
