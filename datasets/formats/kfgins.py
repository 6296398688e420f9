"""KF-GINS text files (i2Nav, Wuhan University): IMU, GNSS, and results or ground truth.

Facts: README of i2Nav-WHU/KF-GINS, section 2.2. White-space columns, no header, GPS seconds of
week. IMU: *increments* in rad and m/s, forward-right-down. GNSS: latitude and longitude in deg,
ellipsoidal height, deviations north, east, down; with six more columns velocity north, east, down
and its deviations. Result and truth: week (may be 0), seconds of week, position of the IMU,
velocity north-east-down, roll, pitch, yaw in deg. The file of options (``*.yaml``) beside them
holds the lever arm (forward, right, down) and the noise of the IMU.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ...filters.earth import C_en_at, lla_to_ecef
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ...filters.sensors import ImuSpec
from ...filters.sensors import imu_preset as _preset
from ..displacement import check_velocity
from ..gpstime import SECONDS_PER_WEEK, from_week_sow
from ..observations import GnssFixes
from ..physics import check_gravity, check_gyro, course_of
from ..sequence import Calibration, Sequence
from ..series import ImuData, Reference
from ..text.imu import rates_from_increments
from ..text.tables import (
    Table,
    increasing,
    read_lines,
    read_table,
    sampling_note,
    starts_with_number,
)

_IMU = ("sow", "dtheta x", "dtheta y", "dtheta z", "dv x", "dv y", "dv z")
_GNSS = ("sow", "lat", "lon", "height", "std n", "std e", "std d")
_GNSS_VELOCITY = ("vn", "ve", "vd", "std vn", "std ve", "std vd")
_NAV = ("week", "sow", "lat", "lon", "height", "vn", "ve", "vd", "roll", "pitch", "yaw")
_NUMBERS = r"\[?\s*([^\]#\n]+?)\s*\]?\s*(?:#.*)?$"
_MGAL_PER_MG = 980.665


@dataclass(frozen=True, eq=False)
class NavTable:
    """A result or ground truth: position of the IMU, its velocity and attitude.

    Attributes
    ----------
    time : ndarray, shape (n,)
        GPS time [s].
    pos_e, vel_e : ndarray, shape (n, 3)
        [m], [m/s].
    rpy : ndarray, shape (n, 3)
        Roll, pitch, heading [rad].
    week : int
        Of the first row; 0 where the file has none and none was given.
    """

    time: FloatArray
    pos_e: FloatArray
    vel_e: FloatArray
    rpy: FloatArray
    week: int


def kind_of(path: Path) -> str:
    """Return 'imu', 'gnss', 'nav' or '' from the first rows of a file."""
    try:
        with path.open(encoding="utf-8", errors="strict") as stream:
            rows = [line.split() for line in (stream.readline() for _ in range(20)) if line.strip()]
    except (OSError, UnicodeDecodeError):
        return ""
    rows = [row for row in rows if row and starts_with_number(row[0])]
    if len(rows) < 2 or any(len(row) != len(rows[0]) for row in rows):
        return ""
    if not all(starts_with_number(token) for row in rows for token in row):
        return ""
    value = np.array(rows, dtype=float)
    width = value.shape[1]
    if width == len(_NAV) and _is_week_and_sow(value[:, 0], value[:, 1]):
        return "nav" if _is_place(value[:, 2:5]) else ""
    if not _is_week_and_sow(np.zeros(1), value[:, 0]):
        return ""
    interval = float(np.median(np.diff(value[:, 0])))
    deviations = bool((value[:, 4:7] > 0.0).all())
    if width in (7, 13) and interval > 0.0 and _is_place(value[:, 1:4]) and deviations:
        return "gnss"
    # Increments over the longest interval an IMU is of use with.
    small = width == 7 and 0.0 < interval < 0.25 and np.abs(value[:, 1:]).max() < 2.0
    return "imu" if small else ""


def _is_week_and_sow(week: FloatArray, sow: FloatArray) -> bool:
    whole = bool((week == np.round(week)).all() and (week >= 0).all() and (week < 9999).all())
    return whole and bool((sow >= 0.0).all() and (sow <= SECONDS_PER_WEEK + 86400.0).all())


def _is_place(lla: FloatArray) -> bool:
    inside = (np.abs(lla[:, 0]) <= 90.0) & (np.abs(lla[:, 1]) <= 180.0)
    near = np.ptp(lla[:, 0]) < 0.1 and np.abs(lla[:, :2]).max() > 0.5
    return bool(inside.all() and near and (np.abs(lla[:, 2]) < 1e4).all())


def is_kfgins(folder: Path) -> bool:
    """Return whether the folder holds IMU increments and GNSS positions in KF-GINS's columns."""
    kinds = {kind_of(file) for file in _texts(folder)}
    return {"imu", "gnss"} <= kinds


def _texts(folder: Path) -> list[Path]:
    endings = (".txt", ".nav", ".pos", ".imu", ".gnss")
    return sorted(f for f in folder.iterdir() if f.is_file() and f.suffix.lower() in endings)


def read_kfgins(
    path: str | Path,
    *,
    lever: ArrayLike | None = None,
    imu_preset: str | None = None,
    week: int | None = None,
) -> Sequence:
    """Return a recording in KF-GINS's files.

    Parameters
    ----------
    path : path
        Folder with IMU and GNSS text, and perhaps ground truth and the file of options.
    lever : array_like, shape (3,), optional
        From the IMU to the antenna, forward-right-down [m]; default: ``antlever`` of the file of
        options. Required where there is none.
    imu_preset : str, optional
        Noise model; default: ``imunoise`` of the file of options. Required where there is none.
    week : int, optional
        GPS week of the first row; default: that of the truth. Without either the time is
        relative, which no satellite is needed to notice.

    Raises
    ------
    DataError
        Missing or unreadable files, or data that contradict physics.
    ConfigError
        What has to be declared and is not, or several files of one kind.
    """
    folder = Path(path)
    files = _files(folder)
    options = _options(folder)
    if lever is None and options is not None:
        lever = _option(options, "antlever", 3)
    if lever is None:
        raise ConfigError(
            f"{folder}: lever arm IMU→antenna not given — add: --set data.lever=[0.1,-0.3,-0.2] "
            "(forward, right, down in metres), or antlever in the KF-GINS *.yaml"
        )
    lever_b = np.asarray(lever, dtype=float)
    if lever_b.shape != (3,) or not np.isfinite(lever_b).all():
        raise ConfigError(f"lever: expected (forward, right, down) in metres, found {lever!r}")
    spec = _spec(folder, options, imu_preset)
    truth = read_nav(files["nav"], week=week or 0) if "nav" in files else None
    found_week = week if week is not None else truth.week if truth is not None else 0
    imu, fixes = read_imu(files["imu"], week=found_week), read_gnss(files["gnss"], week=found_week)
    reference = None
    if truth is not None:
        reference = Reference(
            time=truth.time, pos_e=truth.pos_e, vel_e=truth.vel_e, rpy=truth.rpy,
            lever_b=np.zeros(3), point="imu",
            source=f"{files['nav'].name}: KF-GINS ground truth or result of the IMU",
        )  # fmt: skip
    notes = [
        sampling_note(imu.time, f"IMU {files['imu'].name}"),
        sampling_note(fixes.time, f"GNSS {files['gnss'].name}"),
        "KF-GINS: increments turned into rates, forward-right-down; mounting in the vehicle not "
        "documented, taken as aligned",
        check_gravity(imu.accel_b, file=files["imu"], declared="increments m/s, FRD"),
    ]
    moved = next((r for r in (reference, fixes) if r is not None and _moves(r)), None)
    if moved is not None:
        course = course_of(moved.pos_e, moved.vel_e)
        notes.append(
            check_gyro(imu, moved.time, course, file=files["imu"], declared="increments rad, FRD")
        )
    return Sequence(
        name=folder.resolve().name,
        imu=imu,
        calibration=Calibration(
            imu=spec,
            lever_antenna_b=lever_b,
            lever_antenna_source="antlever of the KF-GINS options"
            if options is not None
            else "declared in the call",
        ),
        fixes=fixes,
        reference=reference,
        time_scale="gps" if found_week else "relative",
        notes=tuple(notes),
    )


def _moves(record: GnssFixes | Reference) -> bool:
    return bool(np.isfinite(record.vel_e).any())


def _files(folder: Path) -> dict[str, Path]:
    found: dict[str, list[Path]] = {}
    for file in _texts(folder):
        kind = kind_of(file)
        if kind:
            found.setdefault(kind, []).append(file)
    if "nav" in found:  # truth beats results
        truth = [f for f in found["nav"] if "truth" in f.name.lower()]
        found["nav"] = truth or found["nav"]
    for kind, files in found.items():
        if len(files) > 1:
            names = ", ".join(f.name for f in files)
            raise ConfigError(f"{folder}: several {kind} files ({names}): keep one per folder")
    for kind in ("imu", "gnss"):
        if kind not in found:
            raise DataError(
                f"no {kind} text in KF-GINS's columns found",
                file=folder,
                remedy="IMU: sow, increments in rad, m/s; rates and others go by sequence.toml",
            )
    return {kind: files[0] for kind, files in found.items()}


def read_imu(path: str | Path, *, week: int) -> ImuData:
    """Return an IMU text file: increments turned into mean rates over each interval."""
    table = read_table(path, _IMU, exact=False)
    time = _time(table, 0, week)
    return ImuData(
        time,
        rates_from_increments(time, table.values[:, 1:4]),
        rates_from_increments(time, table.values[:, 4:7]),
    )


def read_gnss(path: str | Path, *, week: int) -> GnssFixes:
    """Return a GNSS text file of 7 columns, or 13 with velocity.

    Raises
    ------
    DataError
        Another number of columns, deviations that are not positive, or a velocity that the
        positions contradict.
    """
    path = Path(path)
    rows = [line.split() for line in read_lines(path) if line.strip()]
    wide = bool(rows) and len(rows[-1]) == len(_GNSS) + len(_GNSS_VELOCITY)
    table = read_table(path, (*_GNSS, *_GNSS_VELOCITY) if wide else _GNSS)
    time, value = _time(table, 0, week), table.values
    std = value[:, [4, 5, 6, 10, 11, 12]] if wide else value[:, 4:7]
    if not (std > 0.0).all():
        k = int(np.argmin((std > 0.0).all(axis=1)))
        raise DataError(
            f"standard deviations: expected > 0, found {std[k]}",
            file=path,
            line=int(table.line[k]),
            remedy="columns are sow lat lon height std_n std_e std_d [vn ve vd and their std]",
        )
    lat, lon = np.radians(value[:, 1:3]).T
    C_en, pos_e = C_en_at(lat, lon), lla_to_ecef(lat, lon, value[:, 3])
    n = time.size
    vel_e, vel_cov_e = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    if wide:
        vel_e = np.einsum("nij,nj->ni", C_en, value[:, 7:10])
        vel_cov_e = np.einsum("nij,nj,nkj->nik", C_en, std[:, 3:] ** 2, C_en)
        sigma = np.hypot(*std[:, :2].T)
        check_velocity(time, pos_e, vel_e, sigma, file=path, declared="north-east-down")
    return GnssFixes(
        time=time,
        pos_e=pos_e,
        pos_cov_e=np.einsum("nij,nj,nkj->nik", C_en, std[:, :3] ** 2, C_en),
        vel_e=vel_e,
        vel_cov_e=vel_cov_e,
        satellites=np.full(n, -1),
        quality=np.full(n, "kf-gins"),
    )


def read_nav(path: str | Path, *, week: int = 0) -> NavTable:
    """Return a result or ground truth.

    Parameters
    ----------
    path : path
    week : int
        GPS week of the first row, for files whose week column is 0.

    Raises
    ------
    DataError
        A week that contradicts the one given, or a velocity that the positions contradict.
    """
    path = Path(path)
    table = read_table(path, _NAV)
    value = table.values
    printed = int(value[0, 0])
    if week and printed and week != printed:
        raise DataError(
            f"GPS week: expected {week} as declared, found {printed}", file=path, line=1
        )
    time = _time(table, 1, week or printed)
    lat, lon = np.radians(value[:, 2:4]).T
    pos_e = lla_to_ecef(lat, lon, value[:, 4])
    vel_e = np.einsum("nij,nj->ni", C_en_at(lat, lon), value[:, 5:8])
    check_velocity(time, pos_e, vel_e, file=path, declared="north-east-down")
    return NavTable(time, pos_e, vel_e, np.radians(value[:, 8:11]), week or printed)


def _time(table: Table, column: int, week: int) -> FloatArray:
    sow = table.values[:, column]
    bad = ~((sow >= 0.0) & (sow <= SECONDS_PER_WEEK + 86400.0))
    if bad.any():
        k = int(np.argmax(bad))
        raise DataError(
            f"sow: expected GPS seconds of week, found {sow[k]:.3f}",
            file=table.file,
            line=int(table.line[k]),
        )
    rollover = np.diff(sow, prepend=sow[0]) < -SECONDS_PER_WEEK / 2
    time = from_week_sow(week + np.cumsum(rollover), sow)
    increasing(table, time, "sow")
    return time


def _options(folder: Path) -> Path | None:
    found = sorted(f for f in folder.iterdir() if f.suffix.lower() in (".yaml", ".yml"))
    found = [f for f in found if f.is_file()]
    with_lever = [f for f in found if "antlever" in f.read_text(encoding="utf-8", errors="replace")]
    if len(with_lever) > 1:
        names = ", ".join(f.name for f in with_lever)
        raise ConfigError(f"{folder}: several KF-GINS options ({names}): keep one")
    return with_lever[0] if with_lever else None


def _option(file: Path, key: str, count: int) -> FloatArray | None:
    """Return the numbers of ``key: [a, b, c]``; None where the file does not have it."""
    text = file.read_text(encoding="utf-8", errors="replace")
    found = re.search(rf"^\s*{key}\s*:\s*{_NUMBERS}", text, re.MULTILINE)
    if not found:
        return None
    tokens = [token.strip() for token in found[1].split(",")]
    if len(tokens) != count or not all(starts_with_number(t) for t in tokens):
        line = text[: found.start(1)].count("\n") + 1
        raise DataError(
            f"{key}: expected {count} numbers, found '{found[1]}'", file=file, line=line
        )
    return np.array(tokens, dtype=float)


def _spec(folder: Path, options: Path | None, preset: str | None) -> ImuSpec:
    if preset is not None:
        return _preset(preset)
    keys = ("arw", "vrw", "gbstd", "abstd", "gsstd", "asstd")
    found = {} if options is None else {key: _option(options, key, 3) for key in keys}
    correlation = None if options is None else _option(options, "corrtime", 1)
    arw, vrw, gyro, accel = (found.get(key) for key in keys[:4])
    if arw is None or vrw is None or gyro is None or accel is None:
        raise ConfigError(
            f"{folder}: noise of the IMU not given — add: --set data.imu_preset=adis16470, or "
            "imunoise in the KF-GINS *.yaml"
        )
    gyro_scale, accel_scale = found["gsstd"], found["asstd"]
    return ImuSpec(
        name="kf-gins",
        source=f"imunoise of {options.name if options else ''} (largest axis; turn-on as in run)",
        gyro_arw_deg_sqrth=float(arw.max()),
        gyro_bias_instability_degph=float(gyro.max()),
        gyro_bias_turn_on_degph=float(gyro.max()),
        accel_vrw_mps_sqrth=float(vrw.max()),
        accel_bias_instability_mg=float(accel.max()) / _MGAL_PER_MG,
        accel_bias_turn_on_mg=float(accel.max()) / _MGAL_PER_MG,
        bias_correlation_time_s=3600.0 * (1.0 if correlation is None else float(correlation[0])),
        gyro_scale_ppm=0.0 if gyro_scale is None else float(gyro_scale.max()),
        accel_scale_ppm=0.0 if accel_scale is None else float(accel_scale.max()),
    )
