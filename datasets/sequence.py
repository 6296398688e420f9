"""The types every reader ends in: one unit system, one set of axes, one time scale.

SI and radians; body axes forward-right-down (b); ECEF (e) for positions and velocities; GPS
time in seconds since the GPS epoch. A `Sequence` that exists is consistent in shape, order
and finiteness; what it cannot know (units that were declared wrongly) `datasets.physics`
tests against gravity and motion.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..filters.errors import DataError
from ..filters.rotation import FloatArray
from ..filters.sensors import ImuSpec

StrArray = NDArray[np.str_]

#: Beyond any quantity in SI units here; squares and cubes of it are finite.
_LARGEST = 1e40
#: Without inertial data for longer than this [s] it is no longer one drive.
_LONGEST_GAP = 3600.0


def _array(owner: str, name: str, value: object, shape: tuple[int, ...], finite: bool = True):
    """Return `value` as a read-only float array of `shape` (−1: any), or refuse it by name."""
    array = np.ascontiguousarray(value, dtype=float)
    if array.ndim != len(shape) or any(
        s not in (-1, a) for s, a in zip(shape, array.shape, strict=True)
    ):
        wanted = tuple("n" if s == -1 else s for s in shape)
        raise DataError(f"{owner}.{name}: expected shape {wanted}, found {array.shape}")
    if finite and not np.isfinite(array).all():
        index = int(np.argwhere(~np.isfinite(array))[0, 0])
        raise DataError(f"{owner}.{name}: not finite at index {index}")
    huge = np.abs(array) > _LARGEST  # also where missing values may be NaN
    if huge.any():
        at = tuple(np.argwhere(huge)[0])
        raise DataError(f"{owner}.{name}: {array[at]:.3g} at index {at[0]}: no such quantity")
    array.flags.writeable = False
    return array


def _ordered(owner: str, time: FloatArray, strictly: bool = True) -> None:
    """Refuse times that do not increase (strictly), naming the first bad index."""
    step = np.diff(time)
    bad = np.flatnonzero(step <= 0 if strictly else step < 0)
    if bad.size:
        k = int(bad[0]) + 1
        raise DataError(
            f"{owner}.time: goes backwards or repeats at index {k} "
            f"({time[k - 1]:.6f} s, then {time[k]:.6f} s)"
        )


def _freeze(record: object, **arrays: object) -> None:
    for name, value in arrays.items():
        object.__setattr__(record, name, value)


def _rows(record, rows: NDArray[np.bool_]):
    """Return a copy of `record` with the masked rows of every per-epoch array."""
    n = record.time.size
    values = {f.name: getattr(record, f.name) for f in dataclasses.fields(record)}
    per_epoch = {
        name: value[rows]
        for name, value in values.items()
        if isinstance(value, np.ndarray)
        and value.ndim
        and value.shape[0] == n
        and name != "lever_b"
    }
    return dataclasses.replace(record, **per_epoch)


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

    A sensor that samples instantaneously is turned into means by its reader.
    """

    time: FloatArray
    gyro_b: FloatArray
    accel_b: FloatArray

    def __post_init__(self) -> None:
        time = _array("imu", "time", self.time, (-1,))
        if time.size < 2:
            raise DataError(f"imu: expected at least 2 samples, found {time.size}")
        n = time.size
        _ordered("imu", time)
        gap = int(np.argmax(np.diff(time)))
        if time[gap + 1] - time[gap] > _LONGEST_GAP:
            raise DataError(
                f"imu.time: nothing for {time[gap + 1] - time[gap]:.6g} s after index {gap} "
                f"({time[gap]:.3f} s)",
                remedy="repair the time stamp, or make two recordings of it",
            )
        _freeze(
            self,
            time=time,
            gyro_b=_array("imu", "gyro_b", self.gyro_b, (n, 3)),
            accel_b=_array("imu", "accel_b", self.accel_b, (n, 3)),
        )

    def __len__(self) -> int:
        return self.time.size

    @property
    def interval(self) -> float:
        """Median sample interval [s]."""
        return float(np.median(np.diff(self.time)))

    def between(self, start: float, end: float) -> ImuData:
        """Return the samples with ``start <= time <= end``."""
        k = slice(*np.searchsorted(self.time, [start, np.nextafter(end, np.inf)]))
        return ImuData(self.time[k], self.gyro_b[k], self.accel_b[k])


@dataclass(frozen=True, eq=False)
class GnssObservations:
    """GNSS observations: one row per satellite signal and epoch, ordered by time.

    Nothing is ever removed: a row that must not be used carries the reason in `rejected`
    ('' = usable). Missing values are NaN.

    Parameters
    ----------
    time : array_like, shape (n,)
        Reception time by the receiver's clock, as a GPS time [s].
    sat : array_like of str, shape (n,)
        RINEX satellite identifier, constellation letter and number: 'G05'.
    signal : array_like of str, shape (n,)
        RINEX 3 band and attribute: '1C'.
    wavelength : array_like, shape (n,)
        Carrier wavelength [m].
    pseudorange : array_like, shape (n,)
        [m].
    carrier : array_like, shape (n,)
        Carrier phase [cycles].
    range_rate : array_like, shape (n,)
        −λD [m/s]: positive when receding, satellite and receiver clock drift still in it.
    cn0 : array_like, shape (n,)
        Carrier-to-noise density [dB-Hz].
    loss_of_lock : array_like of int, shape (n,)
        RINEX loss-of-lock indicator bits, 0 when unknown.
    sat_pos_e, sat_vel_e : array_like, shape (n, 3)
        Satellite position [m] and velocity [m/s] at transmission, in the ECEF axes *of the
        transmission instant*; rotating them to reception is the range-rate model's job.
    sat_clock, sat_clock_drift : array_like, shape (n,)
        c·δt^s [m] (relativity included, group delay not) and its rate [m/s].
    elevation, azimuth : array_like, shape (n,)
        Seen from the receiver [rad], azimuth clockwise from north; NaN until a position is known.
    rejected : array_like of str, shape (n,)
        Why the row is not used; '' when it is.
    label : array_like of str, shape (n,), optional
        What a data set says of the path: 'los', 'nlos', or '' where it says nothing. Nothing in
        the pipeline uses it; it is there to judge by.
    """

    time: FloatArray
    sat: StrArray
    signal: StrArray
    wavelength: FloatArray
    pseudorange: FloatArray
    carrier: FloatArray
    range_rate: FloatArray
    cn0: FloatArray
    loss_of_lock: NDArray[np.int64]
    sat_pos_e: FloatArray
    sat_vel_e: FloatArray
    sat_clock: FloatArray
    sat_clock_drift: FloatArray
    elevation: FloatArray
    azimuth: FloatArray
    rejected: StrArray
    label: StrArray = field(default_factory=lambda: np.empty(0, dtype="U4"))

    def __post_init__(self) -> None:
        time = _array("observations", "time", self.time, (-1,))
        n = time.size
        _ordered("observations", time, strictly=False)
        if np.size(self.label) == 0:
            _freeze(self, label=np.full(n, "", dtype="U4"))
        for name in ("sat", "signal", "rejected", "label", "loss_of_lock"):
            value = np.asarray(getattr(self, name))
            if value.shape != (n,):
                raise DataError(f"observations.{name}: expected shape ({n},), found {value.shape}")
            if name == "loss_of_lock":
                value = value.astype(np.int64)
            elif value.dtype.kind != "U":
                value = value.astype(str)
            _freeze(self, **{name: value})
        _freeze(
            self, time=time, wavelength=_array("observations", "wavelength", self.wavelength, (n,))
        )
        for name in ("pseudorange", "carrier", "range_rate", "cn0", "sat_clock"):
            _freeze(self, **{name: _array("observations", name, getattr(self, name), (n,), False)})
        for name in ("sat_clock_drift", "elevation", "azimuth"):
            _freeze(self, **{name: _array("observations", name, getattr(self, name), (n,), False)})
        for name in ("sat_pos_e", "sat_vel_e"):
            _freeze(
                self, **{name: _array("observations", name, getattr(self, name), (n, 3), False)}
            )

    def __len__(self) -> int:
        return self.time.size

    @property
    def usable(self) -> NDArray[np.bool_]:
        """True for rows that nothing has rejected, shape (n,)."""
        return np.asarray(self.rejected == "")

    @property
    def has_range_rate(self) -> NDArray[np.bool_]:
        """True for usable rows whose range rate and satellite state are known, shape (n,)."""
        state = np.isfinite(self.sat_vel_e).all(1) & np.isfinite(self.sat_clock_drift)
        return np.asarray(self.usable & np.isfinite(self.range_rate) & state)

    def epochs(self) -> Iterator[tuple[float, slice]]:
        """Yield the time of each epoch and the slice of its rows."""
        if not len(self):
            return
        starts = np.flatnonzero(np.diff(self.time, prepend=-np.inf) > 0)
        for start, stop in zip(starts, [*starts[1:], len(self)], strict=True):
            yield float(self.time[start]), slice(int(start), int(stop))

    def take(self, rows: slice | NDArray) -> GnssObservations:
        """Return the given rows (a slice, a mask or indices)."""
        return GnssObservations(
            **{f.name: getattr(self, f.name)[rows] for f in dataclasses.fields(self)}
        )

    def with_columns(self, **columns: object) -> GnssObservations:
        """Return a copy with the named columns replaced."""
        return dataclasses.replace(self, **columns)  # type: ignore[arg-type]

    def mark(self, rows: NDArray[np.bool_], reason: str) -> GnssObservations:
        """Return a copy in which the still usable rows of the mask are rejected for `reason`."""
        rejected = np.where(rows & self.usable, reason, self.rejected)
        return self.with_columns(rejected=rejected)


@dataclass(frozen=True, eq=False)
class GnssFixes:
    """Antenna positions, and velocities where the source has them, with covariance.

    Parameters
    ----------
    time : array_like, shape (n,)
        GPS time [s], strictly increasing.
    pos_e, vel_e : array_like, shape (n, 3)
        ECEF [m], [m/s]; velocity rows are NaN where there is none.
    pos_cov_e, vel_cov_e : array_like, shape (n, 3, 3)
        Covariances in ECEF axes [m²], [m²/s²]; NaN together with a missing velocity.
    satellites : array_like of int, shape (n,)
        Satellites used, −1 when the source does not say.
    quality : array_like of str, shape (n,)
        'fixed', 'float', 'dgps', 'single', 'receiver' …
    """

    time: FloatArray
    pos_e: FloatArray
    pos_cov_e: FloatArray
    vel_e: FloatArray
    vel_cov_e: FloatArray
    satellites: NDArray[np.int64]
    quality: StrArray

    def __post_init__(self) -> None:
        time = _array("fixes", "time", self.time, (-1,))
        n = time.size
        _ordered("fixes", time)
        _freeze(
            self,
            time=time,
            pos_e=_array("fixes", "pos_e", self.pos_e, (n, 3)),
            pos_cov_e=_array("fixes", "pos_cov_e", self.pos_cov_e, (n, 3, 3)),
            vel_e=_array("fixes", "vel_e", self.vel_e, (n, 3), False),
            vel_cov_e=_array("fixes", "vel_cov_e", self.vel_cov_e, (n, 3, 3), False),
            satellites=np.asarray(self.satellites, dtype=np.int64),
            quality=np.asarray(self.quality).astype(str),
        )

    def __len__(self) -> int:
        return self.time.size

    @property
    def has_velocity(self) -> NDArray[np.bool_]:
        """True where a velocity with covariance is given, shape (n,)."""
        both = np.isfinite(self.vel_e).all(1) & np.isfinite(self.vel_cov_e).all((1, 2))
        return np.asarray(both)

    def take(self, rows: slice | NDArray) -> GnssFixes:
        """Return the given rows (a slice, a mask or indices)."""
        return GnssFixes(**{f.name: getattr(self, f.name)[rows] for f in dataclasses.fields(self)})


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
    """

    time: FloatArray
    speed: FloatArray
    yaw_rate: FloatArray | None = None

    def __post_init__(self) -> None:
        time = _array("odometer", "time", self.time, (-1,))
        _ordered("odometer", time)
        _freeze(self, time=time, speed=_array("odometer", "speed", self.speed, (time.size,)))
        if self.yaw_rate is not None:
            _freeze(self, yaw_rate=_array("odometer", "yaw_rate", self.yaw_rate, (time.size,)))


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
        time = _array("reference", "time", self.time, (-1,))
        n = time.size
        if n < 2:
            raise DataError(f"reference: expected at least 2 epochs, found {n}")
        _ordered("reference", time)
        if self.attitude_frame not in ("b", "v"):
            raise DataError(
                f"reference.attitude_frame: expected 'b' or 'v', found {self.attitude_frame!r}"
            )
        _freeze(
            self,
            time=time,
            pos_e=_array("reference", "pos_e", self.pos_e, (n, 3)),
            vel_e=_array("reference", "vel_e", self.vel_e, (n, 3), False),
            rpy=_array("reference", "rpy", self.rpy, (n, 3), False),
            lever_b=_array("reference", "lever_b", self.lever_b, (3,)),
        )

    def __len__(self) -> int:
        return self.time.size


@dataclass(frozen=True, eq=False)
class Calibration:
    """Where things are on the vehicle, and what the IMU is.

    Parameters
    ----------
    imu : ImuSpec
        Sensor noise model.
    lever_antenna_b : array_like, shape (3,)
        From the IMU to the GNSS antenna's phase centre, body axes [m].
    lever_antenna_source : str
        Where that value comes from.
    lever_antenna_sigma : float
        How well it is known, 1σ per axis [m]; enters the fix covariance.
    C_bv : array_like, shape (3, 3)
        Vehicle mounting: ``C_bv @ x_v == x_b``, vehicle axes forward-right-down.
    mounting_source : str
        Where mounting and `lever_vehicle_b` come from; '' when they are not known, which keeps
        vehicle constraints off.
    lever_vehicle_b : array_like, shape (3,)
        From the IMU to the point the wheels constrain (middle of the rear axle), body axes [m].
    """

    imu: ImuSpec
    lever_antenna_b: FloatArray
    lever_antenna_source: str
    lever_antenna_sigma: float = 0.0
    C_bv: FloatArray = field(default_factory=lambda: np.eye(3))
    lever_vehicle_b: FloatArray = field(default_factory=lambda: np.zeros(3))
    mounting_source: str = ""

    def __post_init__(self) -> None:
        C_bv = _array("calibration", "C_bv", self.C_bv, (3, 3))
        if abs(np.linalg.det(C_bv) - 1.0) > 1e-6 or not np.allclose(
            C_bv @ C_bv.T, np.eye(3), atol=1e-6
        ):
            raise DataError("calibration.C_bv: expected a rotation matrix (orthonormal, det +1)")
        lever = _array("calibration", "lever_antenna_b", self.lever_antenna_b, (3,))
        if np.linalg.norm(lever) > 20.0:
            raise DataError(
                f"calibration.lever_antenna_b: expected metres on a road vehicle, found {lever}"
            )
        _freeze(
            self,
            C_bv=C_bv,
            lever_antenna_b=lever,
            lever_vehicle_b=_array("calibration", "lever_vehicle_b", self.lever_vehicle_b, (3,)),
        )


@dataclass(frozen=True, eq=False)
class Sequence:
    """One drive, converted: what every reader returns and the pipeline takes.

    Parameters
    ----------
    name : str
        Short name, used for result folders.
    imu : ImuData or None
        None in a set without inertial sensors; such a set can be aligned, not navigated.
    calibration : Calibration
    observations : GnssObservations, optional
        Raw GNSS, with satellite states.
    navigation : tuple of Path
        Broadcast ephemeris files that belong to `observations`; empty when single-point
        positioning is not possible.
    rover_file, base : Path, tuple of Path
        RINEX file behind `observations`, and those of a base station, for relative positioning;
        None and empty where there are none.
    fixes : GnssFixes, optional
        Positions the set carries.
    odometer : Odometer, optional
    reference : Reference, optional
    time_scale : {'gps', 'relative'}
        'relative' when the files hold no date; everything but satellite work is then possible.
    notes : tuple of str
        What the reader converted, assumed on whose word, or left out; printed in the report.
    """

    name: str
    imu: ImuData | None
    calibration: Calibration
    observations: GnssObservations | None = None
    navigation: tuple[Path, ...] = ()
    fixes: GnssFixes | None = None
    odometer: Odometer | None = None
    reference: Reference | None = None
    time_scale: str = "gps"
    notes: tuple[str, ...] = ()
    rover_file: Path | None = None
    base: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        if self.observations is None and self.fixes is None:
            raise DataError(
                f"{self.name}: neither GNSS observations nor positions — nothing to fuse"
            )
        spans = list(self._spans())
        first, anchor = spans[0]
        for part, times in spans[1:]:
            if times[-1] < anchor[0] or times[0] > anchor[-1]:
                raise DataError(
                    f"{self.name}: no time overlap: {first} {anchor[0]:.1f}…{anchor[-1]:.1f} s, "
                    f"{part} {times[0]:.1f}…{times[-1]:.1f} s",
                    remedy="check GPS week, time scale and leap seconds",
                )

    @property
    def inertial(self) -> ImuData:
        """The IMU data of a set that has to have them.

        Raises
        ------
        DataError
            If there are none.
        """
        if self.imu is None:
            raise DataError(
                f"{self.name}: no IMU data",
                remedy="certnav run needs an IMU; without one, certnav align works",
            )
        return self.imu

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the IMU data, or of the first part there is [s]."""
        _, time = next(self._spans())
        return float(time[0]), float(time[-1])

    def between(self, start: float, end: float) -> Sequence:
        """Return the part with ``start <= time <= end`` [s].

        Raises
        ------
        DataError
            If nothing to navigate with is left.
        """
        if not start < end:
            raise DataError(f"{self.name}: start {start} s is not before end {end} s")
        parts: dict[str, object] = {}
        if self.imu is not None:
            inside = (self.imu.time >= start) & (self.imu.time <= end)
            if inside.sum() < 2:
                raise DataError(
                    f"{self.name}: no IMU data between {start:.1f} and {end:.1f} s",
                    remedy="the data span {:.1f}…{:.1f} s".format(*self.span),
                )
            parts["imu"] = self.imu.between(start, end)
        for part in ("observations", "fixes", "odometer", "reference"):
            record = getattr(self, part)
            if record is not None:
                rows = (record.time >= start) & (record.time <= end)
                parts[part] = _rows(record, rows) if rows.sum() >= 2 else None
        return dataclasses.replace(self, **parts)  # type: ignore[arg-type]

    def _spans(self) -> Iterator[tuple[str, FloatArray]]:
        if self.imu is not None:
            yield "IMU", self.imu.time
        for part in ("observations", "fixes", "odometer", "reference"):
            record = getattr(self, part)
            if record is not None and record.time.size:
                yield part, record.time
