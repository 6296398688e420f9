"""smartLoc (TU Chemnitz): a car in Berlin and Frankfurt, raw GNSS with line-of-sight labels.

``RXM-RAWX.csv`` (semicolons): a u-blox M8T, one row per satellite and epoch: pseudorange, carrier,
Doppler [Hz, positive when approaching], C/N0, and whether the path was line of sight (0), not (1)
or unknown (#); GLONASS with its frequency slot (channel + 7). Each row repeats the NovAtel SPAN
truth. ``MY_DATASET.csv`` (commas): odometer speed and yaw rate, each with its own seconds of week,
and the truth, which repeats between its own epochs. ``NAV-POSLLH.csv``: the receiver's positions.
There is no IMU.

Conventions, tested on the data: the truth's heading is mathematical (rad, 0 = east,
counter-clockwise) and its yaw rate and the odometer's are positive to the left; heading is turned
to north and clockwise, yaw rate to the down axis. The truth's heading lies 1.2° to the left of the
course of its positions, and its printed speed is 1.4 % above their differences: the velocity of
the reference is that of the positions.

Satellite states come from broadcast ephemerides, or from a table
``derived_gps_doppler_merged.csv`` beside the files, which has GPS only, no clock and no clock
drift (a few mm/s, taken as zero). Its positions are in the axes of the transmission instant.
"""

from __future__ import annotations

from collections.abc import Sequence as Many
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...filters.earth import SPEED_OF_LIGHT, C_en_at, lla_to_ecef
from ...filters.errors import DataError
from ...filters.rotation import FloatArray, wrap_angle
from ...filters.sensors import ImuSpec
from ..fields import StrArray
from ..gpstime import SECONDS_PER_WEEK, from_week_sow
from ..observations import GnssFixes, GnssObservations
from ..physics import gyro_unit_ratio, refuse
from ..sequence import Calibration, Sequence
from ..series import Odometer, Reference
from ..text.columns import Columns, open_text, read_columns
from ..text.tables import increasing, sampling_note

RAW, DRIVE, FIXES = "RXM-RAWX.csv", "MY_DATASET.csv", "NAV-POSLLH.csv"
_SATELLITES = "derived_gps_doppler_merged.csv"
_L1 = SPEED_OF_LIGHT / 1575.42e6
_SYSTEMS = {"gps": "G", "glonass": "R", "galileo": "E", "beidou": "C", "qzss": "J", "sbas": "S"}
_LABELS = {"0": "los", "1": "nlos", "#": ""}
# Columns of RXM-RAWX.csv by number: their headers are sentences.
_TRUTH = {"week": (1,), "sow": (2,), "place": (5, 3, 7), "heading": (9,)}
_MEASURED = {
    "week": (18,),
    "tow": (17,),
    "pseudorange": (22,),
    "carrier": (23,),
    "doppler": (24,),
    "number": (26,),
    "slot": (27,),
    "cn0": (29,),
}
_DRIVE = {
    "week": (1,),
    "sow": (2,),
    "place": (7, 6, 8),
    "heading": (9,),
    "speed_sow": (11,),
    "speed": (12,),
    "yaw_sow": (13,),
    "yaw_rate": (14,),
}
_FIX = {"week": (1,), "itow": (17,), "place": (19, 18, 20), "accuracy": (22, 23)}
_STATE = {
    "tow": ("tow_s",),
    "prn": ("prn",),
    "pos": ("sat_x_m", "sat_y_m", "sat_z_m"),
    "vel": ("sat_vx_mps", "sat_vy_mps", "sat_vz_mps"),
}
#: A set without inertial sensors: no information from them.
_NO_IMU = ImuSpec("none", "the set has no IMU", *[np.inf] * 6)


def is_smartloc(folder: Path) -> bool:
    """Return whether the folder holds ``RXM-RAWX.csv``."""
    return (folder / RAW).is_file()


def read_smartloc(
    path: str | Path,
    *,
    navigation: Many[str | Path] = (),
    lever_sigma_m: float = 1.0,
) -> Sequence:
    """Return one recording.

    Parameters
    ----------
    path : path
        Folder with ``RXM-RAWX.csv``; odometer and the long truth come from ``MY_DATASET.csv``.
    navigation : sequence of path
        Broadcast ephemerides of the day; default: the table of satellite states in the folder.
    lever_sigma_m : float
        1σ per axis of the lever arms, which are not documented [m].

    Raises
    ------
    DataError
        Missing or unreadable files, or an odometer that contradicts the truth.
    """
    folder = Path(path)
    raw = _read(folder / RAW, {**_TRUTH, **{f"m_{k}": v for k, v in _MEASURED.items()}})
    truth = _Truth.of(raw, "place", "heading")
    odometer = None
    notes = ["smartLoc: no IMU; odometer and yaw rate"]
    if (folder / DRIVE).is_file():
        drive = _read(folder / DRIVE, _DRIVE, text={})
        truth = _Truth.of(drive, "place", "heading")
        odometer = _odometer(drive)
        notes += [
            sampling_note(odometer.time, "odometer"),
            _check_yaw_rate(odometer, truth, folder / DRIVE),
        ]
    else:
        notes.append(f"no {DRIVE}: no odometer")
    if isinstance(navigation, str | Path):
        navigation = [navigation]
    observations, more = _observations(folder, raw, tuple(Path(n) for n in navigation))
    reference = _reference(truth)
    fixes = _fixes(folder)
    return Sequence(
        name=folder.resolve().name,
        imu=None,
        calibration=Calibration(
            imu=_NO_IMU,
            lever_antenna_b=np.zeros(3),
            lever_antenna_source="not documented: zero assumed",
            lever_antenna_sigma=lever_sigma_m,
        ),
        observations=observations,
        navigation=tuple(Path(n) for n in navigation),
        fixes=fixes,
        odometer=odometer,
        reference=reference,
        notes=(
            *notes,
            *more,
            sampling_note(reference.time, "reference") + "; point and lever arm not documented, "
            "no roll and pitch; velocity from differenced positions",
        ),
    )


def _read(
    file: Path, numbers: dict[str, tuple[int, ...]], text: dict[str, tuple[int, ...]] | None = None
) -> Columns:
    source = open_text(file)
    width = max(k for columns in numbers.values() for k in columns)
    if source.width < width:
        raise DataError(f"expected {width} columns or more, found {source.width}", file=file)
    words = {"system": (25,), "label": (34,)} if text is None else text
    return read_columns(source, numbers, words)


@dataclass(frozen=True, eq=False)
class _Truth:
    """Truth rows, one per epoch."""

    time: FloatArray
    pos_e: FloatArray
    heading: FloatArray

    @classmethod
    def of(cls, rows: Columns, place: str, heading: str) -> _Truth:
        time = from_week_sow(rows.numbers["week"][:, 0], rows.numbers["sow"][:, 0])
        if (np.diff(time) < 0.0).any():
            increasing(rows.table, time, "GPSSecondsOfWeek")
        _, first = np.unique(time, return_index=True)
        if first.size < 2:
            raise DataError(
                f"expected at least 2 epochs of truth, found {first.size}", file=rows.table.file
            )
        lla = rows.numbers[place][first] * [np.pi / 180.0, np.pi / 180.0, 1.0]
        north = wrap_angle(np.pi / 2 - rows.numbers[heading][first, 0])
        return cls(time[first], lla_to_ecef(*lla.T), north)


def _odometer(drive: Columns) -> Odometer:
    """Return speed, and yaw rate interpolated to its stamps."""
    week = drive.numbers["week"][:, 0]
    at = from_week_sow(week, drive.numbers["speed_sow"][:, 0])
    turned = from_week_sow(week, drive.numbers["yaw_sow"][:, 0])
    increasing(drive.table, at, "GPSSecondsOfWeek - Velocity")
    increasing(drive.table, turned, "GPSSecondsOfWeek - Yawrate")
    return Odometer(
        time=at,
        speed=drive.numbers["speed"][:, 0],
        yaw_rate=-np.interp(at, turned, drive.numbers["yaw_rate"][:, 0]),
    )


def _check_yaw_rate(odometer: Odometer, truth: _Truth, file: Path) -> str:
    assert odometer.yaw_rate is not None
    found = gyro_unit_ratio(odometer.time, odometer.yaw_rate, truth.time, truth.heading)
    if not found.conclusive:
        return "yaw rate: taken as documented, too little turning to verify"
    if not found.is_close_to(1.0):
        problem = (
            f"yaw rate contradicts the truth's heading: its integral is {found.ratio:.3g} ± "
            f"{found.sigma:.1g} times the change, expected 1 (rad/s, positive to the left)"
        )
        remedy = "check unit and sign of the yaw rate"
        return refuse(DataError(problem, file=file, remedy=remedy), "course")
    return f"yaw rate verified: integral / heading change = {found.ratio:.3f} ± {found.sigma:.3f}"


def _observations(
    folder: Path, raw: Columns, navigation: tuple[Path, ...]
) -> tuple[GnssObservations, list[str]]:
    m = {key: raw.numbers[f"m_{key}"][:, 0] for key in _MEASURED}
    time = from_week_sow(m["week"], m["tow"])
    sat, wavelength = _signals(raw, m["number"], m["slot"])
    label = _labels(raw)
    n = time.size
    state, note = _states(folder, navigation, sat, time, m)
    usable = np.isfinite(state[:, :6]).all(axis=1) & np.isfinite(state[:, 7])
    observations = GnssObservations(
        time=time,
        sat=sat,
        signal=np.full(n, "1C"),
        wavelength=wavelength,
        pseudorange=m["pseudorange"],
        carrier=np.where(m["carrier"] == 0.0, np.nan, m["carrier"]),
        range_rate=-wavelength * m["doppler"],
        cn0=m["cn0"],
        loss_of_lock=np.zeros(n, dtype=int),
        sat_pos_e=state[:, :3],
        sat_vel_e=state[:, 3:6],
        sat_clock=state[:, 6],
        sat_clock_drift=state[:, 7],
        elevation=np.full(n, np.nan),
        azimuth=np.full(n, np.nan),
        rejected=np.where(usable, "", "no ephemeris"),
        label=label,
    )
    clear, blocked = int((label == "los").sum()), int((label == "nlos").sum())
    return observations, [
        f"raw GNSS: {n} rows, {int(usable.sum())} with satellite states ({note})",
        f"labels: {clear} line of sight, {blocked} not, {n - clear - blocked} unknown; "
        "nothing is rejected for its label",
    ]


def _signals(raw: Columns, number: FloatArray, slot: FloatArray) -> tuple[StrArray, FloatArray]:
    """Return RINEX satellite names and wavelengths [m]."""
    names = np.array([s.strip().lower() for s in raw.text["system"]])
    unknown = ~np.isin(names, list(_SYSTEMS))
    glonass = names == "glonass"
    wrong = unknown | (glonass & ((slot < 0) | (slot > 13)))
    if wrong.any():
        k = int(np.argmax(wrong))
        what = f"system '{raw.text['system'][k]}'" if unknown[k] else f"GLONASS slot {slot[k]:g}"
        raise DataError(
            f"{what}: expected one of {', '.join(_SYSTEMS)}, and GLONASS slots 0 … 13",
            file=raw.table.file,
            line=int(raw.table.line[k]),
        )
    shown = np.where(names == "sbas", number - 100, number).astype(int)
    sat = np.array([f"{_SYSTEMS[s]}{k:02d}" for s, k in zip(names, shown, strict=True)])
    channel = np.where(glonass, slot - 7.0, 0.0)
    wavelength = np.where(glonass, SPEED_OF_LIGHT / (1602e6 + 562.5e3 * channel), _L1)
    wavelength[names == "beidou"] = SPEED_OF_LIGHT / 1561.098e6
    return sat, wavelength


def _labels(raw: Columns) -> StrArray:
    found = np.array(raw.text["label"])
    unknown = ~np.isin(found, list(_LABELS))
    if unknown.any():
        k = int(np.argmax(unknown))
        raise DataError(
            f"NLOS label: expected 0, 1 or #, found '{found[k]}'",
            file=raw.table.file,
            line=int(raw.table.line[k]),
        )
    return np.array([_LABELS[value] for value in found], dtype="U4")


def _states(
    folder: Path,
    navigation: tuple[Path, ...],
    sat: StrArray,
    time: FloatArray,
    m: dict[str, FloatArray],
) -> tuple[FloatArray, str]:
    """Return position, velocity, clock and drift of each row, NaN where unknown, shape (n, 8)."""
    state = np.full((sat.size, 8), np.nan)
    if navigation:
        from ..rtklib import satellite_states

        known = ~np.char.startswith(sat, "S")
        sent = time[known] - m["pseudorange"][known] / SPEED_OF_LIGHT
        found = satellite_states(navigation, sat[known], sent)
        state[known] = np.column_stack([found.pos_e, found.vel_e, found.clock, found.clock_drift])
        state[np.flatnonzero(known)[~found.healthy]] = np.nan
        return state, "broadcast"
    file = folder / _SATELLITES
    if not file.is_file():
        return state, "no ephemerides: name the day's broadcast file with navigation=…"
    table = read_columns(open_text(file), _STATE).numbers
    of = {
        (int(prn), round(tow * 100)): k
        for k, (prn, tow) in enumerate(zip(table["prn"][:, 0], table["tow"][:, 0], strict=True))
    }
    tow = time % SECONDS_PER_WEEK
    rows = [
        of.get((int(s[1:]), round(t * 100)), -1) if s[0] == "G" else -1
        for s, t in zip(sat, tow, strict=True)
    ]
    at: NDArray[np.int64] = np.array(rows)
    hit = at >= 0
    state[hit, :3], state[hit, 3:6] = table["pos"][at[hit]], table["vel"][at[hit]]
    state[hit, 7] = 0.0
    return state, f"GPS from {_SATELLITES}; satellite clock drift, a few mm/s, taken as zero"


def _reference(truth: _Truth) -> Reference:
    rpy = np.full((truth.time.size, 3), np.nan)
    rpy[:, 2] = truth.heading
    return Reference(
        time=truth.time,
        pos_e=truth.pos_e,
        vel_e=np.gradient(truth.pos_e, truth.time, axis=0),
        rpy=rpy,
        lever_b=np.zeros(3),
        point="not documented",
        source="NovAtel SPAN, independent of the u-blox receiver",
        attitude_frame="v",
    )


def _fixes(folder: Path) -> GnssFixes | None:
    """Return the receiver's positions: hAcc per horizontal axis, twice that where vAcc is void."""
    file = folder / FIXES
    if not file.is_file():
        return None
    rows = _read(file, _FIX, text={})
    time = from_week_sow(rows.numbers["week"][:, 0], rows.numbers["itow"][:, 0] * 1e-3)
    increasing(rows.table, time, "iTOW")
    lat, lon = np.radians(rows.numbers["place"][:, :2]).T
    horizontal, vertical = rows.numbers["accuracy"].T
    vertical = np.where(vertical > 0.0, vertical, 2.0 * horizontal)
    variance = np.column_stack([horizontal, horizontal, vertical]) ** 2
    C_en, n = C_en_at(lat, lon), time.size
    return GnssFixes(
        time=time,
        pos_e=lla_to_ecef(lat, lon, rows.numbers["place"][:, 2]),
        pos_cov_e=np.einsum("nij,nj,nkj->nik", C_en, variance, C_en),
        vel_e=np.full((n, 3), np.nan),
        vel_cov_e=np.full((n, 3, 3), np.nan),
        satellites=np.full(n, -1),
        quality=np.full(n, "receiver"),
    )
