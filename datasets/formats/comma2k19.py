"""comma2k19 segments: phone IMU, u-blox raw GNSS, CAN speed and a camera pose in one minute.

Arrays in numpy's format without extension. IMU: rad/s and m/s², forward-right-down, stamped in
boot seconds at 104 Hz; of the two gyros ``gyro`` is taken, which is ``gyro_uncalibrated`` minus
Android's bias (constant over a segment, up to 0.07 rad/s, and left in the other). Raw GNSS: range
rate in m/s, positive when receding. The live fixes: degrees, UTC in milliseconds, ellipsoidal
height. The pose is that of the camera, as a quaternion (w, x, y, z) whose matrix has the
camera's forward, right and down axes in ECEF as columns.

Boot time becomes GPS time through the raw GNSS, whose ``t`` is its time of week plus a constant.
``frame_gps_times − frame_times`` is constant too, but 0.126 s larger: it makes the first
*frame* coincide with the first GNSS epoch. Doppler velocities, live speeds and live positions all
fit the pose with the first and miss it by 0.12–0.14 s with the second (2 m at 17 m/s).
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from tokenize import TokenError

import numpy as np
from numpy.typing import NDArray

from ...filters.earth import SPEED_OF_LIGHT, C_en_at, C_en_of, lla_to_ecef
from ...filters.errors import DataError
from ...filters.rotation import FloatArray, rpy_from_matrix
from ...filters.sensors import imu_preset
from .. import gpstime
from ..observations import GnssFixes, GnssObservations
from ..physics import check_gravity, check_gyro, course_of
from ..sequence import Calibration, Sequence
from ..series import ImuData, Odometer, Reference
from ..text.tables import check_head, sampling_note
from .receiver_logs import in_order

_IMU, _GNSS, _POSE = "processed_log/IMU", "processed_log/GNSS", "global_pose"
_SATELLITES = "derived/gps_ublox_with_satpv.csv"
#: What `numpy.load` says of a damaged file.
_NO_ARRAY = (
    *(ValueError, TypeError, OSError, EOFError, SyntaxError, OverflowError, MemoryError),
    *(RecursionError, TokenError, zipfile.BadZipFile),
)
_GPS_L1 = SPEED_OF_LIGHT / 1575.42e6
_SATELLITE_COLUMNS = (
    *("sat_x_m", "sat_y_m", "sat_z_m", "sat_vx_mps", "sat_vy_mps", "sat_vz_mps"),
    *("sat_clk_m", "sat_clkdrift_mps"),
)


def is_comma2k19(folder: Path) -> bool:
    """Return whether the folder holds ``processed_log/IMU`` and ``global_pose``."""
    return (folder / _IMU).is_dir() and (folder / _POSE).is_dir()


def read_comma2k19(
    path: str | Path,
    *,
    fix_sigma_m: tuple[float, float] = (2.1, 4.2),
    lever_sigma_m: float = 1.0,
) -> Sequence:
    """Return one segment.

    Parameters
    ----------
    path : path
        Folder of the segment.
    fix_sigma_m : tuple of float
        1σ per horizontal axis and of the height of the live fixes, which carry none. Default:
        2.5 m CEP of the u-blox M8 data sheet, and twice that for the height.
    lever_sigma_m : float
        1σ per axis of the lever arm, which is not documented.

    Raises
    ------
    DataError
        Missing or unreadable arrays, or data that contradict physics.
    """
    folder = Path(path)
    offset, notes = _boot_to_gps(folder)
    gyro = _array(folder, f"{_IMU}/gyro/value", 3)
    imu = ImuData(
        time=_like(folder, f"{_IMU}/gyro/t", gyro[:, 0]) + offset,
        gyro_b=gyro,
        accel_b=_accelerometer(folder),
    )
    notes.append(sampling_note(imu.time, "IMU"))
    reference = _reference(folder, offset)
    course = course_of(reference.pos_e, reference.vel_e)
    file = folder / _IMU
    notes += [
        check_gravity(imu.accel_b, file=file, declared="m/s², FRD"),
        check_gyro(imu, reference.time, course, file=file, declared="rad/s, FRD"),
        "gyro with Android's bias removed (constant over the segment)",
        "reference of the camera, whose attitude may differ from the IMU's by a constant below 1°",
        f"lever arms to antenna and camera not documented: zero, {lever_sigma_m:g} m 1σ per axis",
        "the phone's mounting in the car is not documented and not applied: calibrate before "
        "using vehicle constraints",
    ]
    observations, note = _observations(folder)
    fixes = _fixes(folder, fix_sigma_m)
    if fixes is not None:
        notes.append(
            f"{sampling_note(fixes.time, 'live fixes')}; heights taken as ellipsoidal; covariance "
            f"declared, {fix_sigma_m[0]:g} m horizontal and {fix_sigma_m[1]:g} m vertical; their "
            "speed and bearing left out (no vertical component)"
        )
    return Sequence(
        name=folder.resolve().name,
        imu=imu,
        calibration=Calibration(
            imu=imu_preset("consumer"),
            lever_antenna_b=np.zeros(3),
            lever_antenna_source="unknown: not documented, zero assumed",
            lever_antenna_sigma=lever_sigma_m,
        ),
        observations=observations,
        fixes=fixes,
        odometer=_odometer(folder, offset),
        reference=reference,
        notes=(*notes, note),
    )


def _array(folder: Path, name: str, width: int = 0) -> FloatArray:
    """Return an array of finite or missing numbers; `width` columns, or one dimension."""
    file = folder / name
    try:
        value = np.load(file, allow_pickle=False)
    except FileNotFoundError:
        raise DataError("array not found", file=file, remedy="check the folder") from None
    except _NO_ARRAY as error:
        raise DataError(f"not a numpy array: {error}".splitlines()[0], file=file) from None
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
        found = getattr(value, "dtype", "an archive")
        raise DataError(f"expected an array of real numbers, found {found}", file=file)
    shape = f"(n, {width})" if width else "(n,)"
    if value.ndim != 1 + bool(width) or (width and value.shape[1] != width):
        raise DataError(f"expected shape {shape}, found {value.shape}", file=file)
    return value.astype(float)


def _like(folder: Path, name: str, other: FloatArray) -> FloatArray:
    """Return a one-dimensional array that has to be as long as another one, and not empty."""
    value = _array(folder, name)
    if value.shape != other.shape or not value.size:
        raise DataError(
            f"expected {other.size} stamps, as many as it has values, found {value.size}",
            file=folder / name,
            remedy="the array is cut short or of another segment: copy it again",
        )
    return value


def _accelerometer(folder: Path) -> FloatArray:
    """Return the accelerometer at the gyro's times: both come from one chip with one stamp."""
    gyro = _array(folder, f"{_IMU}/gyro/t")
    value = _array(folder, f"{_IMU}/accelerometer/value", 3)
    time = _like(folder, f"{_IMU}/accelerometer/t", value[:, 0])
    if time.shape == gyro.shape and np.abs(time - gyro).max() < 1e-3:
        return value
    if not (np.diff(time) > 0.0).all():
        raise DataError("expected increasing times", file=folder / _IMU / "accelerometer/t")
    return np.column_stack([np.interp(gyro, time, value[:, k]) for k in range(3)])


def _boot_to_gps(folder: Path) -> tuple[float, list[str]]:
    """Return GPS time minus boot time [s], checked for constancy."""
    week_tow = _array(folder, f"{_POSE}/frame_gps_times", 2)
    by_frame = gpstime.from_week_sow(week_tow[:, 0], week_tow[:, 1])
    by_frame = by_frame - _like(folder, f"{_POSE}/frame_times", by_frame)
    frame = _constant(by_frame, folder / _POSE / "frame_gps_times")
    if not (folder / _GNSS / "raw_gnss_ublox").is_dir():
        return frame, ["boot to GPS time from the frames' stamps (no raw GNSS to check them)"]
    raw = _array(folder, f"{_GNSS}/raw_gnss_ublox/value", 10)
    by_raw = gpstime.from_week_sow(raw[:, 1], raw[:, 2])
    by_raw = by_raw - _like(folder, f"{_GNSS}/raw_gnss_ublox/t", by_raw)
    offset = _constant(by_raw, folder / _GNSS / "raw_gnss_ublox/t")
    return offset, [
        f"boot to GPS time from the raw GNSS; the frames' own GPS stamps are {frame - offset:.3f} "
        "s later and not used"
    ]


def _constant(difference: FloatArray, file: Path) -> float:
    spread = float(np.ptp(difference))
    if not spread < 2e-3:
        raise DataError(
            f"GPS time minus boot time: expected a constant, varies by {spread:.3f} s",
            file=file,
            remedy="the segment's clocks cannot be related",
        )
    return float(np.median(difference))


def _reference(folder: Path, offset: float) -> Reference:
    pos_e = _array(folder, f"{_POSE}/frame_positions", 3)
    quaternion = _array(folder, f"{_POSE}/frame_orientations", 4)
    if len(quaternion) != len(pos_e) or not (np.linalg.norm(quaternion, axis=1) > 0.5).all():
        raise DataError(
            f"expected {len(pos_e)} unit quaternions, as many as there are positions",
            file=folder / _POSE / "frame_orientations",
        )
    velocity = _array(folder, f"{_POSE}/frame_velocities", 3)
    if len(velocity) != len(pos_e):
        raise DataError(
            f"expected {len(pos_e)} velocities, as many as there are positions, found "
            f"{len(velocity)}",
            file=folder / _POSE / "frame_velocities",
            remedy="the array is cut short or of another segment: copy it again",
        )
    from scipy.spatial.transform import Rotation

    C_ec = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    C_nc = np.swapaxes(C_en_of(pos_e), 1, 2) @ C_ec
    return Reference(
        time=_like(folder, f"{_POSE}/frame_times", pos_e[:, 0]) + offset,
        pos_e=pos_e,
        vel_e=velocity,
        rpy=rpy_from_matrix(C_nc),
        lever_b=np.zeros(3),
        point="camera",
        source="comma2k19's INS/GNSS/vision optimiser: NOT independent of the GNSS",
        attitude_frame="b",
    )


def _observations(folder: Path) -> tuple[GnssObservations | None, str]:
    """Return all raw u-blox rows; satellite states where the derived table has them (GPS)."""
    if not (folder / _GNSS / "raw_gnss_ublox").is_dir():
        return None, "no raw GNSS"
    raw = _array(folder, f"{_GNSS}/raw_gnss_ublox/value", 10)
    if not np.isfinite(raw[:, :3]).all():
        raise DataError(
            "satellite, week and time: expected finite numbers",
            file=folder / _GNSS / "raw_gnss_ublox/value",
        )
    raw = raw[np.lexsort((raw[:, 0], raw[:, 1] * gpstime.SECONDS_PER_WEEK + raw[:, 2]))]
    other = len(raw)
    raw = raw[_is_gps_or_glonass(raw[:, 0])]
    other -= len(raw)
    prn = raw[:, 0].astype(int)
    gps = prn <= 32
    channel = np.where(np.isfinite(raw[:, 3]), raw[:, 3], 0.0)
    state = _satellite_states(folder / _SATELLITES, raw)
    known = np.isfinite(state).all(axis=1)
    nothing = np.full(len(raw), np.nan)
    observations = GnssObservations(
        time=gpstime.from_week_sow(raw[:, 1], raw[:, 2]),
        sat=_satellite_names(prn),
        signal=np.full(len(raw), "1C"),
        wavelength=np.where(gps, _GPS_L1, SPEED_OF_LIGHT / (1602e6 + 562.5e3 * channel)),
        pseudorange=raw[:, 4],
        carrier=raw[:, 9],
        range_rate=raw[:, 6],
        cn0=raw[:, 8],
        loss_of_lock=np.zeros(len(raw), dtype=int),
        sat_pos_e=state[:, :3],
        sat_vel_e=state[:, 3:6],
        sat_clock=state[:, 6],
        sat_clock_drift=state[:, 7],
        elevation=nothing,
        azimuth=nothing,
        rejected=np.where(known, "", "no ephemeris"),
    )
    more = f" ({other} of other satellites left out)" if other else ""
    return observations, (
        f"raw GNSS: {int(gps.sum())} GPS and {int((~gps).sum())} GLONASS rows{more}, satellite "
        f"states for {int(known.sum())} (orbits from broadcasts four days older: fit for Doppler, "
        "not for positioning, so no navigation file is offered)"
    )


def _is_gps_or_glonass(number: FloatArray) -> NDArray[np.bool_]:
    """Return which NMEA numbers are 1…32 or 65…96; others are SBAS, or GLONASS not yet named."""
    return ((number >= 1) & (number <= 32)) | ((number >= 65) & (number <= 96))


def _satellite_names(prn: NDArray[np.int64]) -> NDArray[np.str_]:
    """Return 'G05' for 1…32 and 'R08' for 65…96 (NMEA numbers)."""
    return np.array([f"G{k:02d}" if k <= 32 else f"R{k - 64:02d}" for k in prn], dtype="<U3")


def _satellite_states(file: Path, raw: FloatArray) -> FloatArray:
    """Return satellite position, velocity, clock and drift of each raw row; NaN where unknown."""
    state = np.full((len(raw), 8), np.nan)
    if not file.is_file():
        return state
    import pandas as pd

    check_head(file)
    columns = ["tow_rx_s", "prn", *_SATELLITE_COLUMNS]
    try:
        table = pd.read_csv(file, usecols=columns, dtype=float)
    except (ValueError, OSError) as error:  # a missing column too
        raise DataError(f"not readable as numbers: {error}".splitlines()[0], file=file) from None
    good = np.isfinite(table.to_numpy()).all(axis=1) & (np.abs(table["tow_rx_s"]) < 1e6)
    good &= table["prn"].between(1, 999)
    if not good.all():
        k = int(np.argmin(good.to_numpy()))
        raise DataError("expected finite numbers in all columns", file=file, line=k + 2)
    if not len(table):
        return state

    def key(prn: FloatArray, tow: FloatArray) -> NDArray[np.int64]:
        return np.round(tow * 1e3).astype(np.int64) * 100 + prn.astype(np.int64)

    order = np.argsort(known := key(table["prn"].to_numpy(), table["tow_rx_s"].to_numpy()))
    wanted = key(raw[:, 0], raw[:, 2])
    at = order[np.minimum(np.searchsorted(known, wanted, sorter=order), len(known) - 1)]
    match = known[at] == wanted
    state[match] = table[list(_SATELLITE_COLUMNS)].to_numpy()[at[match]]
    return state


def _fixes(folder: Path, sigma: tuple[float, float]) -> GnssFixes | None:
    if not (folder / _GNSS / "live_gnss_ublox").is_dir():
        return None
    live = _array(folder, f"{_GNSS}/live_gnss_ublox/value", 6)
    live = live[in_order(live[:, 3])]  # a fix may stand there twice
    lat, lon = np.radians(live[:, :2]).T
    C_en = C_en_at(lat, lon)
    variance = np.array([sigma[0], sigma[0], sigma[1]]) ** 2
    n = len(live)
    return GnssFixes(
        time=gpstime.from_unix(live[:, 3] * 1e-3),
        pos_e=lla_to_ecef(lat, lon, live[:, 4]),
        pos_cov_e=np.einsum("nij,j,nkj->nik", C_en, variance, C_en),
        vel_e=np.full((n, 3), np.nan),
        vel_cov_e=np.full((n, 3, 3), np.nan),
        satellites=np.full(n, -1),
        quality=np.full(n, "receiver"),
    )


def _odometer(folder: Path, offset: float) -> Odometer | None:
    if not (folder / "processed_log/CAN/speed").is_dir():
        return None
    speed = _array(folder, "processed_log/CAN/speed/value", 1)[:, 0]
    time = _like(folder, "processed_log/CAN/speed/t", speed)
    kept = in_order(time)  # messages of one burst share a stamp
    return Odometer(time=time[kept] + offset, speed=speed[kept])
