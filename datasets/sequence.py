"""The type every reader ends in: one unit system, one set of axes, one time scale.

SI and radians; body axes forward-right-down (b); ECEF (e) for positions and velocities; GPS
time in seconds since the GPS epoch. A `Sequence` that exists is consistent in shape, order
and finiteness; what it cannot know (units that were declared wrongly) `datasets.physics`
tests against gravity and motion. Its parts are in `datasets.series` and `datasets.observations`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..filters.errors import DataError
from ..filters.rotation import FloatArray
from ..filters.sensors import ImuSpec
from .fields import checked, freeze, rows_of
from .observations import GnssFixes, GnssObservations
from .series import ImuData, Odometer, Reference


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
        How well it is known, 1σ per axis [m]; 0: exactly, else a run estimates it.
    C_bv : array_like, shape (3, 3)
        Vehicle mounting: ``C_bv @ x_v == x_b``, vehicle axes forward-right-down.
    mounting_source : str
        Where mounting and `lever_vehicle_b` come from; '' when they are not known: both are then
        only where an estimate of them begins.
    lever_vehicle_b : array_like, shape (3,)
        From the IMU to the point the wheels constrain (middle of the rear axle), body axes [m].
    mounting_sigma : float
        How well pitch and yaw of `C_bv` are known where `mounting_source` says whence, 1σ [rad];
        0: exactly.
    lever_vehicle_sigma : float
        The same of `lever_vehicle_b`, per axis [m].
    delay_sigma : float
        How well the time stamps of GNSS and IMU are known against each other, 1σ [s]; 0: exactly,
        else a run estimates by how much GNSS is later than stamped.

    Examples
    --------
    >>> from certnav.datasets import Calibration
    >>> from certnav.filters import imu_preset
    >>> imu = imu_preset("adis16470")
    >>> calibration = Calibration(imu, [-0.65, -0.05, -0.15], "tape measure", 0.02)
    >>> calibration.C_bv.diagonal(), calibration.mounting_source  # not known: where estimates begin
    (array([1., 1., 1.]), '')
    """

    imu: ImuSpec
    lever_antenna_b: FloatArray
    lever_antenna_source: str
    lever_antenna_sigma: float = 0.0
    C_bv: FloatArray = field(default_factory=lambda: np.eye(3))
    lever_vehicle_b: FloatArray = field(default_factory=lambda: np.zeros(3))
    mounting_source: str = ""
    mounting_sigma: float = 0.0
    lever_vehicle_sigma: float = 0.0
    delay_sigma: float = 0.0

    def __post_init__(self) -> None:
        C_bv = checked("calibration", "C_bv", self.C_bv, (3, 3))
        if abs(np.linalg.det(C_bv) - 1.0) > 1e-6 or not np.allclose(
            C_bv @ C_bv.T, np.eye(3), atol=1e-6
        ):
            raise DataError("calibration.C_bv: expected a rotation matrix (orthonormal, det +1)")
        lever = checked("calibration", "lever_antenna_b", self.lever_antenna_b, (3,))
        if np.linalg.norm(lever) > 20.0:
            raise DataError(
                f"calibration.lever_antenna_b: expected metres on a road vehicle, found {lever}"
            )
        freeze(
            self,
            C_bv=C_bv,
            lever_antenna_b=lever,
            lever_vehicle_b=checked("calibration", "lever_vehicle_b", self.lever_vehicle_b, (3,)),
        )

    def __repr__(self) -> str:
        lever = ", ".join(f"{value:g}" for value in self.lever_antenna_b)
        mounting = self.mounting_source or "not known"
        return f"Calibration({self.imu.name}, antenna at ({lever}) m, mounting {mounting})"


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
    logs : tuple of str
        What was found in receivers' own logs, a line each.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> sequence = simulate(SimulationConfig(duration=10.0, density="open")).sequence()
    >>> sequence.imu
    ImuData(1001 samples, 100 Hz, 10.0 s)
    >>> round(sequence.span[1] - sequence.span[0]), sequence.time_scale  # [s]
    (10, 'gps')
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
    logs: tuple[str, ...] = ()

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

    def __repr__(self) -> str:
        names = ("imu", "observations", "fixes", "odometer", "reference", "calibration")
        parts = [repr(part) for name in names if (part := getattr(self, name)) is not None]
        return "\n  ".join([f"Sequence({self.name!r}, {self.time_scale} time", *parts]) + ")"

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
                parts[part] = rows_of(record, rows) if rows.sum() >= 2 else None
        return dataclasses.replace(self, **parts)  # type: ignore[arg-type]

    def _spans(self) -> Iterator[tuple[str, FloatArray]]:
        if self.imu is not None:
            yield "IMU", self.imu.time
        for part in ("observations", "fixes", "odometer", "reference"):
            record = getattr(self, part)
            if record is not None and record.time.size:
                yield part, record.time
