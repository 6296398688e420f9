"""smartLoc (TU Chemnitz): a car in Berlin and Frankfurt, raw GNSS with line-of-sight labels.

``RXM-RAWX.csv`` (semicolons): a u-blox M8T, one row per satellite and epoch: pseudorange, carrier,
Doppler [Hz, positive when approaching], C/N0, and whether the path was line of sight (0), not (1)
or unknown (#); GLONASS with its frequency slot (channel + 7). The carrier counts where the
receiver's tracking status calls it valid; a lock time that does not reach back to the epoch before
becomes bit 0 of the loss-of-lock indicator, an unresolved half cycle bit 1. Each row repeats the
NovAtel SPAN truth. ``MY_DATASET.csv`` (commas): odometer speed and yaw rate, each with its own
seconds of week, and the truth, which repeats between its own epochs. ``NAV-POSLLH.csv``: the
receiver's positions. There is no IMU.

Of Berlin1 the raw data of the whole run are to be had as RINEX (GraphGNSSLib), one ``*.obs`` with
broadcast files, in a folder of its own inside that of the set. It is read with the set's odometer,
truth and positions, and with its labels where it has them.

Conventions, tested on the data: the truth's heading is mathematical (rad, 0 = east,
counter-clockwise) and its yaw rate and the odometer's are positive to the left; heading is turned
to north and clockwise, yaw rate to the down axis. The truth's heading lies 1.2° to the right of
the course of its positions, and its printed speed is 1.4 % above their differences: the velocity
of the reference is that of the positions.

Satellite states come from broadcast ephemerides, or from a table
``derived_gps_doppler_merged.csv`` beside the files, which has GPS only, no clock and no clock
drift (a few mm/s, taken as zero). Its positions are in the axes of the transmission instant.
"""

from __future__ import annotations

import re
from collections.abc import Sequence as Many
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...filters.earth import SPEED_OF_LIGHT, C_en_at, lla_to_ecef
from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ..fields import StrArray
from ..gpstime import SECONDS_PER_WEEK, from_week_sow
from ..observations import GnssFixes, GnssObservations
from ..sequence import Sequence
from ..text.columns import Columns, open_text, read_columns
from ..text.tables import increasing
from .smartloc_drive import (
    Drive,
    Truth,
    calibration,
    read_drive,
    read_numbered,
    receiver_fixes,
    reference_note,
    reference_of,
)

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
    "lock_ms": (28,),
    "cn0": (29,),
    "status": (33,),
}
_FIX = {"week": (1,), "itow": (17,), "place": (19, 18, 20), "accuracy": (22, 23)}
_STATE = {
    "tow": ("tow_s",),
    "prn": ("prn",),
    "pos": ("sat_x_m", "sat_y_m", "sat_z_m"),
    "vel": ("sat_vx_mps", "sat_vy_mps", "sat_vz_mps"),
}
#: Bits of u-blox's tracking status: carrier phase valid, its half cycle resolved.
_PHASE, _WHOLE_CYCLES = 2, 4


def is_smartloc(folder: Path) -> bool:
    """Return whether the folder holds ``RXM-RAWX.csv``, or the RINEX of a set around it."""
    return (folder / RAW).is_file() or _rinex_of_set(folder) is not None


def _rinex_of_set(folder: Path) -> Path | None:
    """Return the only observation file of a folder inside that of a set."""
    around = folder.resolve().parent
    if not ((around / RAW).is_file() and (around / DRIVE).is_file()):
        return None
    found = sorted(p for p in folder.glob("*.obs") if p.is_file())
    return found[0] if len(found) == 1 else None


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
        Folder with ``RXM-RAWX.csv``; odometer and the long truth come from ``MY_DATASET.csv``. Or
        a folder inside it with the whole run's RINEX.
    navigation : sequence of path
        Broadcast ephemerides of the day; default: the table of satellite states in the folder, and
        for RINEX the broadcast files beside it.
    lever_sigma_m : float
        1σ per axis of the lever arms, which are not documented [m].

    Raises
    ------
    DataError
        Missing or unreadable files, or an odometer that contradicts the truth.
    """
    folder = Path(path)
    if isinstance(navigation, str | Path):
        navigation = [navigation]
    ephemerides = tuple(Path(n) for n in navigation)
    notes: tuple[str, ...] = ("smartLoc: no IMU; odometer and yaw rate",)
    rinex = None if (folder / RAW).is_file() else _rinex_of_set(folder)
    if rinex is not None:
        return _whole_run(rinex, ephemerides, notes, lever_sigma_m)
    raw = _read_raw(folder / RAW)
    drive = read_drive(folder / DRIVE) if (folder / DRIVE).is_file() else None
    if drive is None:
        reference = reference_of(Truth.of(raw, "place", "heading"))
        notes += (f"no {DRIVE}: no odometer",)
    else:
        reference, notes = drive.reference, (*notes, *drive.notes)
    observations, more = _observations(folder, raw, ephemerides)
    return Sequence(
        name=folder.resolve().name,
        imu=None,
        calibration=calibration(lever_sigma_m),
        observations=observations,
        navigation=ephemerides,
        fixes=_fixes(folder),
        odometer=None if drive is None else drive.odometer,
        reference=reference,
        notes=(*notes, *more, reference_note(reference)),
    )


def _whole_run(
    rinex: Path, navigation: tuple[Path, ...], notes: tuple[str, ...], lever_sigma_m: float
) -> Sequence:
    """Return the run whose raw data are RINEX, with what the set around it says."""
    from ..rtklib import read_observations

    around = rinex.resolve().parent.parent
    navigation = navigation or _broadcast_beside(rinex)
    observations = read_observations(rinex, navigation)
    raw = _read_raw(around / RAW)
    observations = observations.with_columns(label=_labels_at(observations, raw))
    drive: Drive = read_drive(around / DRIVE)
    labelled = int((observations.label != "").sum())
    return Sequence(
        name=f"{around.name}-{rinex.parent.name}",
        imu=None,
        calibration=calibration(lever_sigma_m),
        observations=observations,
        navigation=navigation,
        fixes=receiver_fixes(around / DRIVE),
        odometer=drive.odometer,
        reference=drive.reference,
        rover_file=rinex,
        notes=(
            *notes, *drive.notes,
            f"raw GNSS: {len(observations)} rows of {rinex.name}, {labelled} of them labelled in "
            f"{RAW}; nothing is rejected for its label",
            reference_note(drive.reference),
        ),
    )  # fmt: skip


def _broadcast_beside(rinex: Path) -> tuple[Path, ...]:
    """Return the broadcast files in the folder of a RINEX file: by system, else mixed."""
    single = sorted(p for p in rinex.parent.iterdir() if re.search(r"\.\d\d[ng]$", p.name.lower()))
    found = single or sorted(rinex.parent.glob("*.rnx"))
    if not found:
        raise DataError(
            "no broadcast ephemerides beside it",
            file=rinex,
            remedy="name the day's file with navigation=…",
        )
    return tuple(found)


def _read_raw(file: Path) -> Columns:
    numbers = {**_TRUTH, **{f"m_{k}": v for k, v in _MEASURED.items()}}
    return read_numbered(file, numbers, {"system": (25,), "label": (34,)})


def _labels_at(observations: GnssObservations, raw: Columns) -> StrArray:
    """Return the labels of the rows by satellite and tenth of a second."""
    m = {key: raw.numbers[f"m_{key}"][:, 0] for key in ("week", "tow", "number", "slot")}
    sat, _ = _signals(raw, m["number"], m["slot"])
    time = np.round(10.0 * from_week_sow(m["week"], m["tow"]))
    of = dict(zip(zip(sat, time, strict=True), _labels(raw), strict=True))
    at = zip(observations.sat, np.round(10.0 * observations.time), strict=True)
    return np.array([of.get(key, "") for key in at], dtype="U4")


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
    status = m["status"].astype(int)
    observations = GnssObservations(
        time=time,
        sat=sat,
        signal=np.full(n, "1C"),
        wavelength=wavelength,
        pseudorange=m["pseudorange"],
        carrier=np.where((m["carrier"] != 0.0) & (status & _PHASE > 0), m["carrier"], np.nan),
        range_rate=-wavelength * m["doppler"],
        cn0=m["cn0"],
        loss_of_lock=_lost(time, sat, m["lock_ms"]) | 2 * (status & _WHOLE_CYCLES == 0),
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


def _lost(time: FloatArray, sat: StrArray, lock_ms: FloatArray) -> NDArray[np.int64]:
    """Return 1 where the carrier has been locked for less than the time since the epoch before."""
    order = np.lexsort((time, sat))
    same = np.append(False, sat[order][1:] == sat[order][:-1])
    since = np.where(same, np.diff(time[order], prepend=np.nan), np.inf)
    out = np.zeros(time.size, dtype=np.int64)
    # Lock times are rounded to the epoch, and stop counting at 64.5 s.
    out[order] = 1e-3 * lock_ms[order] < np.minimum(since, 64.0) - 0.05
    return out


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


def _fixes(folder: Path) -> GnssFixes | None:
    """Return the receiver's positions: hAcc per horizontal axis, twice that where vAcc is void."""
    file = folder / FIXES
    if not file.is_file():
        return None
    rows = read_numbered(file, _FIX, text={})
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
