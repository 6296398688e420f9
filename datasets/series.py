"""Series over time that go with GNSS: the IMU's samples, the odometer's, the reference's epochs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..filters.errors import DataError
from ..filters.rotation import FloatArray
from .fields import checked, freeze, ordered, span

#: Without inertial data for longer than this [s] it is no longer one drive.
_LONGEST_GAP = 3600.0


@dataclass(frozen=True, eq=False)
class ImuData:
    """Inertial samples in body axes (forward, right, down).

    Parameters
    ----------
    time : array_like, shape (n,)
        End of each sample's interval, GPS time [s], strictly increasing.
    gyro_b : array_like, shape (n, 3)
        Angular rate ω_ib^b [rad/s], the mean over ``(time[k-1], time[k]]``.
    accel_b : array_like, shape (n, 3)
        Specific force f_ib^b [m/s²] (≈ (0, 0, −9.8) level at rest), mean over the same interval.

    Notes
    -----
    A sensor that samples instantaneously is turned into means by its reader.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.datasets import ImuData
    >>> time, still = 0.01 * np.arange(1, 101), np.zeros((100, 3))
    >>> ImuData(time, still, still + [0.0, 0.0, -9.8])  # level, at rest
    ImuData(100 samples, 100 Hz, 1.0 s)
    >>> ImuData(time, still, [0.0, 0.0, -9.8])
    Traceback (most recent call last):
        ...
    certnav.filters.errors.DataError: imu.accel_b: expected shape (100, 3), found (3,)
    """

    time: FloatArray
    gyro_b: FloatArray
    accel_b: FloatArray

    def __post_init__(self) -> None:
        time = checked("imu", "time", self.time, (-1,))
        if time.size < 2:
            raise DataError(f"imu: expected at least 2 samples, found {time.size}")
        n = time.size
        ordered("imu", time)
        gap = int(np.argmax(np.diff(time)))
        if time[gap + 1] - time[gap] > _LONGEST_GAP:
            raise DataError(
                f"imu.time: nothing for {time[gap + 1] - time[gap]:.6g} s after index {gap} "
                f"({time[gap]:.3f} s)",
                remedy="repair the time stamp, or make two recordings of it",
            )
        freeze(
            self,
            time=time,
            gyro_b=checked("imu", "gyro_b", self.gyro_b, (n, 3)),
            accel_b=checked("imu", "accel_b", self.accel_b, (n, 3)),
        )

    def __len__(self) -> int:
        return self.time.size

    def __repr__(self) -> str:
        return f"ImuData({len(self)} samples, {span(self.time)})"

    @cached_property
    def interval(self) -> float:
        """Median sample interval [s]."""
        return float(np.median(np.diff(self.time)))

    def between(self, start: float, end: float) -> ImuData:
        """Return the samples with ``start <= time <= end``."""
        k = slice(*np.searchsorted(self.time, [start, np.nextafter(end, np.inf)]))
        return ImuData(self.time[k], self.gyro_b[k], self.accel_b[k])


@dataclass(frozen=True, eq=False)
class Odometer:
    """Speed along the vehicle's forward axis, and yaw rate where the source has it.

    Parameters
    ----------
    time : array_like, shape (n,)
        GPS time [s], strictly increasing.
    speed : array_like, shape (n,)
        Signed forward speed [m/s].
    yaw_rate : array_like, shape (n,), optional
        About the vehicle's down axis [rad/s].

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.datasets import Odometer
    >>> odometer = Odometer(0.1 * np.arange(100), np.full(100, 8.3))
    >>> odometer
    Odometer(100 samples, 10 Hz, 9.9 s)
    """

    time: FloatArray
    speed: FloatArray
    yaw_rate: FloatArray | None = None

    def __post_init__(self) -> None:
        time = checked("odometer", "time", self.time, (-1,))
        ordered("odometer", time)
        freeze(self, time=time, speed=checked("odometer", "speed", self.speed, (time.size,)))
        if self.yaw_rate is not None:
            freeze(self, yaw_rate=checked("odometer", "yaw_rate", self.yaw_rate, (time.size,)))

    def __len__(self) -> int:
        return self.time.size

    def __repr__(self) -> str:
        yaw = "" if self.yaw_rate is None else ", with yaw rate"
        return f"Odometer({len(self)} samples, {span(self.time)}{yaw})"


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference trajectory of one point of the vehicle.

    Parameters
    ----------
    time : array_like, shape (n,)
        GPS time [s], strictly increasing.
    pos_e, vel_e : array_like, shape (n, 3)
        ECEF [m], [m/s], of the reference point; velocity may be NaN.
    rpy : array_like, shape (n, 3)
        Roll, pitch, heading [rad] with respect to NED; NaN where unknown.
    lever_b : array_like, shape (3,)
        From the IMU to the reference point, body axes [m].
    point : str
        What the point is: 'imu', 'antenna', 'camera' …
    attitude_frame : {'b', 'v'}
        Whether `rpy` is the attitude of the IMU's body axes or of the vehicle's.
    source : str
        What made it; says so if it is not independent of the GNSS that is navigated with.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.datasets import Reference
    >>> from certnav.filters import lla_to_ecef
    >>> time, pos_e = np.arange(3.0), np.tile(lla_to_ecef(0.5, 2.0, 30.0), (3, 1))
    >>> unknown = np.full((3, 3), np.nan)
    >>> reference = Reference(time, pos_e, unknown, unknown, np.zeros(3), "imu", "surveyed point")
    >>> reference
    Reference(3 epochs, 1 Hz, 2.0 s, position of the imu, no attitude: surveyed point)
    """

    time: FloatArray
    pos_e: FloatArray
    vel_e: FloatArray
    rpy: FloatArray
    lever_b: FloatArray
    point: str
    source: str
    attitude_frame: str = "b"

    def __post_init__(self) -> None:
        time = checked("reference", "time", self.time, (-1,))
        n = time.size
        if n < 2:
            raise DataError(f"reference: expected at least 2 epochs, found {n}")
        ordered("reference", time)
        if self.attitude_frame not in ("b", "v"):
            raise DataError(
                f"reference.attitude_frame: expected 'b' or 'v', found {self.attitude_frame!r}"
            )
        freeze(
            self,
            time=time,
            pos_e=checked("reference", "pos_e", self.pos_e, (n, 3)),
            vel_e=checked("reference", "vel_e", self.vel_e, (n, 3), False),
            rpy=checked("reference", "rpy", self.rpy, (n, 3), False),
            lever_b=checked("reference", "lever_b", self.lever_b, (3,)),
        )

    def __len__(self) -> int:
        return self.time.size

    def __repr__(self) -> str:
        whose = {"b": "the IMU", "v": "the vehicle"}[self.attitude_frame]
        attitude = f"attitude of {whose}" if np.isfinite(self.rpy).any() else "no attitude"
        return (
            f"Reference({len(self)} epochs, {span(self.time)}, position of the {self.point}, "
            f"{attitude}: {self.source})"
        )
