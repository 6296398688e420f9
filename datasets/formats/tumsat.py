"""Tsukishima drive (kakusang2020, Tokyo University of Marine Science and Technology): a car.

``GNSSTCData*.mat``: u-blox F9P, L1 at 5 Hz, one row per satellite: range rate (−λD), C/N0 and the
satellite's state, its clock and clock drift already taken out of the measurements.
``IMUData*.mat``: specific force [m/s²] and rates [rad/s] at 50 Hz; ``IMUData_CarSpeed.mat`` has
the same rows with the count of a wheel sensor. Text, gzipped or not: ``RTK*.csv`` has RTK
positions, ``GNSSvel*.csv`` Doppler velocities of five and more satellites, ``ubox*.csv`` the
receiver's own positions.

What the files do not say, measured on the drive against velocities that RTK-fixed positions and
Doppler agree on (changes over 1 s, delete-a-block jackknife):

time        IMU stamps are UTC: changes of speed lie 18.035 ± 0.005 s before GPS time against the
            velocities that RTK agrees with, 17.978 ± 0.006 s against those of the Doppler rows:
            18.00 ± 0.03 s. Cornering says 17.95 ± 0.10 s, turns 17.81 ± 0.18 s (a course leads
            the heading). 18 s is added; what may be left is an option (`imu_lag`).
axes        right-forward-up: forward force from y (gain 1.02 ± 0.03), rightward from x
            (0.93 ± 0.04), clockwise yaw from −z (0.986 ± 0.008).
gravity     9.59 m/s² at rest, 2 % low: a turn-on bias of 21 mg that stays in the data.
wheel       0.1965 ± 0.0001 m/s per count (0.1966 is applied), stamps late by
            0.642 ± 0.006 s, which is taken out. A count has no sign: reversing shows as forward.
satellites  positions are in the axes of *reception*: pseudoranges then fit RTK positions to
            1.2 m (median) and to 10 m otherwise. They are turned back to transmission. PRN 1, 2, 3
            and 7 lie above 39 000 km: these are QZSS. Rows of PRN 0 are zeros, padding.
bias        of the accelerometers, as a filter finds it with RTK in the first 900 s: moves 11 mm/s²
            in 20 s (RMS of the axes), in the preset for consumer IMUs by 2: 5 mg in run, not 1.
range rate  against the RTK velocity, median of the size: 0.020 m/s from 45 dB-Hz, 0.028 from 40,
            0.07 from 35, 0.11 from 30, 0.8 below; RMS 0.25 … 2.7 (reflections).

RTK, the receiver's own positions and the Doppler come from one antenna and one receiver. The lever
arm from the IMU (between the seats) to it (on the roof) is not documented.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...filters.earth import EARTH_RATE, SPEED_OF_LIGHT, C_en_of
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ...filters.sensors import imu_preset
from ..axes import axes_matrix
from ..gpstime import from_week_sow, gps_minus_utc
from ..observations import GnssFixes, GnssObservations
from ..physics import check_gravity, check_gyro, course_of
from ..sequence import Calibration, Sequence
from ..series import ImuData, Odometer, Reference
from ..text.columns import open_text, read_columns
from ..text.tables import LARGEST, cannot_open, increasing, sampling_note

_AXES = "RFU"
#: See above: speed of a count [m/s], and how late the counts are [s].
METRES_PER_SECOND_PER_COUNT = 0.1966
WHEEL_DELAY = 0.64
_GPS_L1 = SPEED_OF_LIGHT / 1575.42e6
#: Between the orbits of GPS (26 600 km) and the perigee of QZSS (39 000 km) [m].
_QZSS_RADIUS = 33e6
#: Stamps of one epoch differ by the receiver's clock, epochs by 0.2 s [s].
_SAME_EPOCH = 0.05
#: 1σ of a range rate at the drive's usual 43 dB-Hz, of which DOP makes that of a velocity [m/s]:
#: 0.06 m/s at 45 dB-Hz, 20 dB a decade, and a floor of 0.04, the defaults for Doppler elsewhere.
_RANGE_RATE_SIGMA = 0.085
_QUALITY = {1: "fixed", 2: "float"}
_IMU = dataclasses.replace(
    imu_preset("consumer"), name="consumer, 5 mg in run", accel_bias_instability_mg=5.0
)
#: Columns of the text files, from 1.
_RTK: dict[str, tuple[int, ...]] = {
    "time": (1,),
    "pos": (2, 3, 4),
    "quality": (5,),
    "satellites": (6,),
    "sd": (7, 8, 9, 10, 11, 12),
}
_VELOCITY: dict[str, tuple[int, ...]] = {"time": (1,), "vel": (6, 7, 8), "dop": (10, 11)}
_OWN: dict[str, tuple[int, ...]] = {"time": (1,), "pos": (2, 3, 4)}


def is_tumsat(folder: Path) -> bool:
    """Return whether the folder holds ``GNSSTCData*.mat`` and ``IMUData*.mat``."""
    return all(list(folder.glob(name)) for name in ("GNSSTCData*.mat", "IMUData*.mat"))


def read_tumsat(
    path: str | Path,
    *,
    rtk: str = "reference",
    preset: str = "",
    imu_lag: float = 0.0,
    wheel_delay: float = WHEEL_DELAY,
    fix_sigma_m: tuple[float, float] = (1.3, 2.6),
    lever_sigma_m: float = 1.0,
) -> Sequence:
    """Return the drive.

    Parameters
    ----------
    path : path
        Folder of the drive.
    rtk : {'reference', 'fixes'}
        What the RTK positions are. 'reference': the fixed ones judge, and the receiver's own
        positions are navigated with. 'fixes': they are navigated with, fixed and float; the
        reference is then not independent, and says so.
    preset : str
        Noise model of the IMU, which the set does not name; '': consumer, with the bias above.
    imu_lag : float
        How late the IMU's stamps are, beyond UTC [s]; they are moved back by it.
    wheel_delay : float
        How late the wheel counts are against the IMU's stamps [s].
    fix_sigma_m : tuple of float
        1σ per horizontal axis and of the height of the receiver's own positions, which carry
        none. Default: 1.5 m CEP of the F9P's data sheet without corrections, and twice that for
        the height.
    lever_sigma_m : float
        1σ per axis of the lever arm, which is not documented [m].

    Raises
    ------
    DataError
        Missing or unreadable files, or data that contradict physics.
    ConfigError
        Another `rtk`, or several recordings in one folder.
    """
    if rtk not in ("reference", "fixes"):
        raise ConfigError(f"rtk: expected 'reference' or 'fixes', found {rtk!r}")
    folder = Path(path)
    observations, week, notes = _observations(_only(folder, "GNSSTCData*.mat"))
    imu, imu_file = _imu(folder, week, imu_lag)
    odometer, wheel_note = _odometer(folder, week, wheel_delay)
    solved = _rtk(_only(folder, "RTK*.csv*"), week)
    reference = _reference(solved, _moved(solved), rtk)
    if rtk == "fixes":
        fixes = solved
    else:
        fixes = _own_positions(_only(folder, "ubox*.csv*"), week, fix_sigma_m)
        notes.append(
            f"fixes: the receiver's own positions, 1σ declared, {fix_sigma_m[0]:g} m horizontal "
            f"and {fix_sigma_m[1]:g} m vertical; data.rtk = 'fixes' navigates with RTK instead"
        )
    fixes = _with_velocities(fixes, _only(folder, "GNSSvel*.csv*"), week)
    course = course_of(reference.pos_e, reference.vel_e)
    return Sequence(
        name=folder.resolve().name,
        imu=imu,
        calibration=Calibration(
            imu=imu_preset(preset) if preset else _IMU,
            lever_antenna_b=np.zeros(3),
            lever_antenna_source="not documented; zero assumed",
            lever_antenna_sigma=lever_sigma_m,
        ),
        observations=observations,
        fixes=fixes,
        odometer=odometer,
        reference=reference,
        notes=(
            f"Tsukishima drive: IMU {_AXES} in m/s² and rad/s, stamps in UTC moved to GPS time"
            + (f" and back by {imu_lag:g} s" if imu_lag else ""),
            sampling_note(imu.time, "IMU"),
            *notes,
            f"{sampling_note(fixes.time, 'fixes')}, {int(fixes.has_velocity.sum())} with Doppler "
            "velocity",
            wheel_note,
            f"{sampling_note(reference.time, 'reference')}: {reference.source}",
            f"lever arm IMU→antenna not documented: zero, {lever_sigma_m:g} m 1σ per axis",
            check_gravity(imu.accel_b, file=imu_file, declared=f"m/s², {_AXES}"),
            check_gyro(imu, reference.time, course, file=imu_file, declared=f"rad/s, {_AXES}"),
        ),
    )


def _only(folder: Path, pattern: str, without: str = "\n") -> Path:
    """Return the one file of that pattern whose name does not hold `without`."""
    found = sorted(f for f in folder.glob(pattern) if without not in f.name)
    if not found:
        raise DataError(f"no {pattern} found", file=folder, remedy="copy the whole set")
    if len(found) > 1:
        names = ", ".join(f.name for f in found)
        raise ConfigError(f"{folder}: several recordings ({names}): keep one per folder")
    return found[0]


def _matrix(file: Path, name: str, width: int) -> FloatArray:
    """Return the matrix of that name in a MATLAB file (version 5)."""
    from scipy.io import loadmat

    try:
        held = loadmat(str(file), variable_names=[name])
    except OSError as error:
        raise cannot_open(file, error) from None
    except Exception as error:  # whatever damaged bytes lead the decoder into
        raise DataError(f"not readable as MATLAB 5: {error}".splitlines()[0], file=file) from None
    if name not in held:
        raise DataError(f"expected a matrix {name}, found none", file=file)
    table = held[name]
    if getattr(table, "ndim", 0) != 2 or table.shape[1] != width or table.dtype.kind not in "fiu":
        kind = f"{table.dtype} of shape {table.shape}" if hasattr(table, "dtype") else type(table)
        raise DataError(f"{name}: expected numbers in {width} columns, found {kind}", file=file)
    bad = ~(np.abs(table) <= LARGEST)
    if bad.any():
        row, column = (int(k) + 1 for k in np.argwhere(bad)[0])
        raise DataError(f"{name}: expected a finite number in column {column}", file=file, line=row)
    if len(table) < 2:
        raise DataError(f"{name}: expected at least 2 rows, found {len(table)}", file=file)
    return np.asarray(table, dtype=float)


def _observations(file: Path) -> tuple[GnssObservations, float, list[str]]:
    """Return the observations, the GPS week, and notes."""
    table = _matrix(file, "GNSSTCData", 16)
    padding = table[:, 3] == 0.0
    table = table[~padding]
    weeks = np.unique(table[:, 1])
    if weeks.size != 1:
        found = "no row" if not weeks.size else f"weeks {weeks[0]:g} … {weeks[-1]:g}"
        raise DataError(
            f"GNSSTCData: expected satellites of one GPS week, found {found}", file=file
        )
    _never_back(table[:, 2], "TOW", file)
    radius = np.linalg.norm(table[:, 5:8], axis=1)
    letter = np.where(radius > _QZSS_RADIUS, "J", "G")
    n, unknown = len(table), np.full(len(table), np.nan)
    travelled = table[:, 4] / SPEED_OF_LIGHT  # the receiver's clock stays within a millisecond
    observations = GnssObservations(
        time=from_week_sow(weeks[0], table[:, 2]),
        sat=np.array([f"{s}{int(p):02d}" for s, p in zip(letter, table[:, 3], strict=True)]),
        signal=np.full(n, "1C"),
        wavelength=np.full(n, _GPS_L1),
        pseudorange=table[:, 4],
        carrier=unknown,
        range_rate=table[:, 8],
        cn0=table[:, 14],
        loss_of_lock=np.zeros(n, dtype=np.int64),
        sat_pos_e=_at_transmission(table[:, 5:8], travelled),
        sat_vel_e=_at_transmission(table[:, 10:13], travelled),
        sat_clock=np.zeros(n),
        sat_clock_drift=np.zeros(n),
        elevation=np.radians(table[:, 13]),
        azimuth=unknown,
        rejected=np.full(n, ""),
    )
    return (
        observations,
        float(weeks[0]),
        [
            f"{sampling_note(np.unique(observations.time), 'GNSS observations')}; GPS and QZSS L1, "
            f"satellite clocks corrected; {int(padding.sum())} rows of PRN 0 are padding",
            "satellite positions turned from the axes of reception to those of transmission",
        ],
    )


def _at_transmission(vector: FloatArray, travelled: FloatArray) -> FloatArray:
    """Return vectors in ECEF at reception in ECEF at transmission, before the Earth turned."""
    s, c = np.sin(EARTH_RATE * travelled), np.cos(EARTH_RATE * travelled)
    x, y, z = vector.T
    return np.stack([c * x - s * y, c * y + s * x, z], axis=-1)


def _never_back(time: FloatArray, name: str, file: Path, strictly: bool = False) -> None:
    """Refuse rows of a matrix whose time goes back (or stands still)."""
    step = np.diff(time)
    bad = np.flatnonzero(step <= 0.0 if strictly else step < 0.0)
    if bad.size:
        k = int(bad[0]) + 1
        raise DataError(
            f"{name}: expected increasing time, found {time[k]:.3f} after {time[k - 1]:.3f}",
            file=file,
            line=k + 1,
            remedy="sort the rows",
        )


def _gps_time(week: float, utc_sow: FloatArray) -> FloatArray:
    """Return the GPS time of UTC seconds of the week."""
    time = from_week_sow(week, utc_sow)
    return time + gps_minus_utc(float(time[0]))


def _imu(folder: Path, week: float, lag: float) -> tuple[ImuData, Path]:
    file = _only(folder, "IMUData*.mat", without="CarSpeed")
    table = _matrix(file, "IMUData", 7)
    _never_back(table[:, 0], "time", file, strictly=True)
    C_bs = axes_matrix(_AXES)
    time = _gps_time(week, table[:, 0]) - lag
    return ImuData(time, table[:, 4:7] @ C_bs.T, table[:, 1:4] @ C_bs.T), file


def _odometer(folder: Path, week: float, delay: float) -> tuple[Odometer | None, str]:
    """Return the wheel's speed, at the time it was driven."""
    file = folder / "IMUData_CarSpeed.mat"
    if not file.is_file():
        return None, f"no {file.name}: no odometer"
    table = _matrix(file, "IMUCarSpeed", 10)
    _never_back(table[:, 0], "time", file, strictly=True)
    speed = METRES_PER_SECOND_PER_COUNT * table[:, 8]
    return Odometer(_gps_time(week, table[:, 0]) - delay, speed), (
        f"odometer: wheel counts of {METRES_PER_SECOND_PER_COUNT:g} m/s without sign, stamps moved "
        f"back by {delay:g} s"
    )


def _text(file: Path, columns: dict[str, tuple[int, ...]]) -> dict[str, FloatArray]:
    """Return columns of a text file whose times increase."""
    found = read_columns(open_text(file), columns)
    increasing(found.table, found.numbers["time"][:, 0], "seconds of week")
    return dict(found.numbers)


def _rtk(file: Path, week: float) -> GnssFixes:
    """Return the RTK positions; deviations are RTKLIB's, those between axes signed roots."""
    found = _text(file, _RTK)
    square = found["sd"] * np.abs(found["sd"])
    cov = square[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]]  # of sdx sdy sdz sdxy sdyz sdzx
    none = np.linalg.eigvalsh(cov)[:, 0] < 0.0
    quality = found["quality"][:, 0].astype(int)
    n = len(quality)
    return GnssFixes(
        time=from_week_sow(week, found["time"][:, 0]),
        pos_e=found["pos"],
        pos_cov_e=cov,
        vel_e=np.full((n, 3), np.nan),
        vel_cov_e=np.full((n, 3, 3), np.nan),
        satellites=found["satellites"][:, 0].astype(np.int64),
        quality=np.array([_QUALITY.get(k, "single") for k in quality]),
        rejected=np.where(none, "its covariance is none (negative)", ""),
    )


def _own_positions(file: Path, week: float, sigma: tuple[float, float]) -> GnssFixes:
    found = _text(file, _OWN)
    n, C_en = len(found["pos"]), C_en_of(found["pos"])
    variance = np.array([sigma[0], sigma[0], sigma[1]]) ** 2
    return GnssFixes(
        time=from_week_sow(week, found["time"][:, 0]),
        pos_e=found["pos"],
        pos_cov_e=np.einsum("nij,j,nkj->nik", C_en, variance, C_en),
        vel_e=np.full((n, 3), np.nan),
        vel_cov_e=np.full((n, 3, 3), np.nan),
        satellites=np.full(n, -1),
        quality=np.full(n, "receiver"),
    )


def _with_velocities(fixes: GnssFixes, file: Path, week: float) -> GnssFixes:
    """Return the fixes with the Doppler velocity of the same epoch, where there is one."""
    found = _text(file, _VELOCITY)
    vel_e = found["vel"]
    at, same = _same_epoch(fixes.time, from_week_sow(week, found["time"][:, 0]))
    C_en = C_en_of(fixes.pos_e)
    variance = (_RANGE_RATE_SIGMA * found["dop"][at][:, [0, 0, 1]]) ** 2  # horizontal, vertical
    cov = np.einsum("nij,nj,nkj->nik", C_en, variance, C_en)
    return dataclasses.replace(
        fixes,
        vel_e=np.where(same[:, None], vel_e[at], np.nan),
        vel_cov_e=np.where(same[:, None, None], cov, np.nan),
    )


def _same_epoch(time: FloatArray, of: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the index in `of` that is next to each time, and whether it is the same epoch."""
    after = np.clip(np.searchsorted(of, time), 1, of.size - 1)
    at = np.where(time - of[after - 1] < of[after] - time, after - 1, after)
    return at, np.abs(of[at] - time) < _SAME_EPOCH


def _moved(solved: GnssFixes) -> FloatArray:
    """Return velocities of RTK epochs from their neighbours; NaN unless all three are fixed."""
    vel_e = np.full_like(solved.pos_e, np.nan)
    fixed, time = solved.quality == "fixed", solved.time
    span = time[2:] - time[:-2]
    whole = fixed[2:] & fixed[1:-1] & fixed[:-2] & (span < 2.5 * np.median(np.diff(time)))
    step = (solved.pos_e[2:] - solved.pos_e[:-2]) / span[:, None]
    vel_e[1:-1][whole] = step[whole]
    return vel_e


def _reference(solved: GnssFixes, vel_e: FloatArray, rtk: str) -> Reference:
    """Return the fixed epochs: velocities of their own displacements, not the Doppler's."""
    fixed = solved.quality == "fixed"
    if fixed.sum() < 2:
        raise DataError("RTK: expected at least 2 fixed epochs, found none")
    source = (
        "the RTK-fixed epochs navigated with: NOT independent of them"
        if rtk == "fixes"
        else "RTK-fixed epochs of the same receiver and antenna; independent of the Doppler, not "
        "of the receiver's own positions"
    )
    return Reference(
        time=solved.time[fixed],
        pos_e=solved.pos_e[fixed],
        vel_e=vel_e[fixed],
        rpy=np.full((int(fixed.sum()), 3), np.nan),
        lever_b=np.zeros(3),
        point="antenna",
        source=source,
    )
