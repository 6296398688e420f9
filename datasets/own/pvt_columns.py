"""Positions and velocities in declared columns: what [gnss] and [reference] have in common.

Position: latitude, longitude, height, the angles also in degrees, minutes and seconds, or ECEF x,
y, z. Velocity: north-east-down, east-north-up
or ECEF. Deviations stand in the same axes and order as what they belong to; those of latitude,
longitude and height are metres north, east and up. A height needs its datum: 50 m lie between
geoid and ellipsoid.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...filters.earth import C_en_of, lla_to_ecef
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ..displacement import check_velocity, horizontal_sigma
from ..formats.inertial_explorer import dms_to_radians
from ..receivers.bags import bag_table, is_bag
from ..text.columns import Column, Columns, open_text, read_columns
from ..text.tables import Table, increasing
from ..time_scales import UNITS, TimeScale, evenly_spaced, gps_time, late_weeks
from .declaration import (
    ANGLE_UNITS,
    LENGTH_UNITS,
    POSITION_FRAMES,
    SPEED_UNITS,
    VELOCITY_FRAMES,
    Section,
)

#: From the axes of a declared velocity to north-east-down.
_TO_NED = {"ned": np.eye(3), "enu": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])}
_COORDINATES = 'position = ["lat", "lon", "height"]'
_VELOCITY = 'velocity = ["vn", "ve", "vd"]'


class Timed(NamedTuple):
    """The columns of a file with their GPS time [s], and what was done to their stamps."""

    columns: Columns
    time: FloatArray
    notes: list[str]


@dataclass(frozen=True, eq=False)
class PvtColumns:
    """Positions and velocities of one file, in ECEF.

    Attributes
    ----------
    file : Path
    columns : Columns
    time : ndarray, shape (n,)
        GPS time [s].
    pos_e, vel_e : ndarray, shape (n, 3)
        [m], [m/s]; velocity NaN where the file has none.
    pos_cov_e, vel_cov_e : ndarray, shape (n, 3, 3)
        NaN where not declared.
    notes : tuple of str
    """

    file: Path
    columns: Columns
    time: FloatArray
    pos_e: FloatArray
    vel_e: FloatArray
    pos_cov_e: FloatArray
    vel_cov_e: FloatArray
    notes: tuple[str, ...]


def time_columns(section: Section, scale: TimeScale) -> tuple[Column, ...]:
    """Return the columns of a section's time, as many as its scale has."""
    counts = {"gps-week-sow": (2,), "gps-calendar": (1, 2), "utc": (1, 2)}.get(scale.name, (1,))
    line = 'time = ["week", "sow"]' if counts == (2,) else 'time = "t"'
    return section.columns("time", counts, line)


def read_timed(
    section: Section,
    scale: TimeScale,
    numbers: dict[str, tuple[Column, ...]],
    text: dict[str, tuple[Column, ...]] | None = None,
    may_miss: tuple[str, ...] = (),
) -> Timed:
    """Return the columns of a section's file and their GPS time, which has to increase."""
    separator = section.text("separator", "", default="") or None
    source = open_text(_table_of(section), separator)
    stamp = {"time": time_columns(section, scale)}
    columns = read_columns(
        source,
        numbers if scale.is_text else {**stamp, **numbers},
        {**(text or {}), **(stamp if scale.is_text else {})},
        may_miss,
    )
    time = gps_time(
        columns.table,
        scale,
        columns.numbers.get("time", np.empty((0, 0))),
        columns.text.get("time", []),
    )
    notes, file = [], columns.table.file.name
    if scale.rate is not None:
        time = evenly_spaced(columns.table, time, scale.rate)
        notes.append(f"{file}: rounded stamps replaced by {scale.rate:g} Hz, as declared")
    if (
        scale.name == "gps-week-sow"
        and (late := late_weeks(columns.numbers["time"] * [1.0, UNITS[scale.unit]])).any()
    ):
        line = int(columns.table.line[np.flatnonzero(late)[0]])
        notes.append(
            f"{file}: the week number of {np.count_nonzero(late)} rows from line {line} was not "
            "in step with the seconds of week at the week's end: mended"
        )
    increasing(columns.table, time, "time")
    return Timed(columns, time, notes)


def _table_of(section: Section) -> Path:
    """Return the file of a section, or that of the topic of a bag."""
    path = section.path()
    if section.has("topic"):
        return bag_table(path, section.text("topic", ""))
    if is_bag(path):
        raise section.missing('topic = "/imu/data"', f"which one of {path.name}")
    return path


def read_pvt(
    section: Section,
    scale: TimeScale,
    *,
    deviations: bool,
    extra: dict[str, tuple[Column, ...]] | None = None,
    text: dict[str, tuple[Column, ...]] | None = None,
) -> PvtColumns:
    """Return the declared positions and velocities of a section.

    Parameters
    ----------
    section : Section
    scale : TimeScale
    deviations : bool
        Whether standard deviations are needed (a GNSS solution) or not (a reference).
    extra, text : dict
        Further columns: numbers, whose cells may be empty, and text.

    Raises
    ------
    ConfigError
        Something needed is not declared; the message holds the line to add.
    DataError
        Values that cannot be what they are declared as.
    """
    numbers: dict[str, tuple[Column, ...]] = {
        "position": section.columns("position", (3, 7), _COORDINATES)
    }
    frame = section.choice("position_frame", POSITION_FRAMES, 'position_frame = "lla"')
    if section.has("velocity"):
        numbers["velocity"] = section.columns("velocity", (3,), _VELOCITY)
    if isinstance(section.values.get("geoid_m"), str):
        numbers["geoid_m"] = section.columns("geoid_m", (1,), "")
    for what in ("position", "velocity"):
        if deviations and what in numbers:
            numbers |= _deviation_columns(section, what)
    may_miss = tuple(k for k in ("velocity", *(extra or {})) if k in {**numbers, **(extra or {})})
    may_miss += tuple(k for k in numbers if k.startswith("velocity_"))
    columns, time, stamps = read_timed(section, scale, {**numbers, **(extra or {})}, text, may_miss)
    pos_e, notes = _position(section, frame, columns)
    n = time.size
    C_en = C_en_of(pos_e)
    C_ep = np.broadcast_to(np.eye(3), (n, 3, 3)) if frame == "ecef" else C_en
    vel_e, C_ev = np.full((n, 3), np.nan), np.broadcast_to(np.eye(3), (n, 3, 3))
    if "velocity" in numbers:
        vel_frame = section.choice("velocity_frame", VELOCITY_FRAMES, 'velocity_frame = "ned"')
        unit = section.choice("velocity_unit", SPEED_UNITS, 'velocity_unit = "m/s"')
        if vel_frame != "ecef":
            C_ev = C_en @ _TO_NED[vel_frame]
        vel_e = np.einsum("nij,nj->ni", C_ev, columns.numbers["velocity"] * SPEED_UNITS[unit])
    pos_cov_e = _covariance(section, columns, "position", C_ep, deviations)
    if "velocity" in numbers:
        sigma = horizontal_sigma(pos_cov_e)
        file = columns.table.file
        check_velocity(time, pos_e, vel_e, sigma, file=file, declared=vel_frame)
    return PvtColumns(
        columns.table.file,
        columns,
        time,
        pos_e,
        vel_e,
        pos_cov_e,
        _covariance(section, columns, "velocity", C_ev, deviations and "velocity" in numbers),
        (*stamps, *notes),
    )


def _degrees(value: FloatArray, table: Table) -> FloatArray:
    """Return latitude and longitude [deg] and height from degrees, minutes and seconds."""
    parts = value[:, [1, 2, 4, 5]]
    bad = np.any((parts < 0.0) | (parts > 60.0), axis=1)
    _refuse_rows(
        table.file, table.line, bad, "minutes and seconds: expected 0 … 60",
        [" ".join(f"{x:g}" for x in row) for row in parts] if bad.any() else [],
        'position = [deg, min, sec, deg, min, sec, height], or angle_unit = "deg"',
    )  # fmt: skip
    angles = [np.degrees(dms_to_radians(*value[:, k : k + 3].T)) for k in (0, 3)]
    return np.column_stack([*angles, value[:, 6]])


def _position(section: Section, frame: str, columns: Columns) -> tuple[FloatArray, tuple[str, ...]]:
    value, table = columns.numbers["position"], columns.table
    if frame == "ecef":
        radius = np.linalg.norm(value, axis=1)
        _refuse_rows(
            table.file, table.line, (radius < 6.3e6) | (radius > 6.5e6),
            "ECEF position: expected 6300 … 6500 km from the Earth's centre",
            [f"{r / 1e3:.6g} km" for r in radius], 'position_frame = "lla" instead?',
        )  # fmt: skip
        return value, ()
    unit = section.choice("angle_unit", (*ANGLE_UNITS, "dms"), 'angle_unit = "deg"')
    if (unit == "dms") != (value.shape[1] == 7):
        raise ConfigError(
            f'{section.file}: [{section.name}] angle_unit = "{unit}" with {value.shape[1]} columns '
            'of position: expected seven for "dms" (degrees, minutes, seconds of latitude, of '
            "longitude, and the height), else three"
        )
    if unit == "dms":
        value, unit = _degrees(value, table), "deg"
    lat, lon = (value[:, :2] * ANGLE_UNITS[unit]).T
    bad = (np.abs(lat) > np.pi / 2) | (np.abs(lon) > 2.0 * np.pi)
    _refuse_rows(
        table.file, table.line, bad, f"latitude, longitude [{unit}] out of range",
        [f"{a:.8g}, {b:.8g}" for a, b in value[:, :2]] if bad.any() else [],
        "position = [latitude, longitude, height] in this order, or another angle_unit",
    )  # fmt: skip
    datum = section.choice(
        "height", ("ellipsoid", "geoid"), 'height = "ellipsoid"',
        "what heights count from: ellipsoid, or geoid (mean sea level)",
    )  # fmt: skip
    height = (
        value[:, 2] * LENGTH_UNITS[section.choice("height_unit", LENGTH_UNITS, "", default="m")]
    )
    notes: tuple[str, ...] = ()
    if datum == "geoid":
        if "geoid_m" in columns.numbers:
            separation = columns.numbers["geoid_m"][:, 0]
        else:
            line = "geoid_m = 48.0  # height of the geoid above the ellipsoid, or a column"
            separation = section.numbers("geoid_m", (1,), line)
        height = height + separation
        notes = (f"heights above the geoid raised by {np.median(separation):.2f} m, as declared",)
    return lla_to_ecef(lat, lon, height), notes


def _refuse_rows(
    file: Path,
    line: NDArray[np.int64],
    bad: NDArray[np.bool_],
    problem: str,
    found: list[str],
    remedy: str,
) -> None:
    if bad.any():
        k = int(np.argmax(bad))
        raise DataError(f"{problem}, found {found[k]}", file=file, line=int(line[k]), remedy=remedy)


def _deviation_columns(section: Section, what: str) -> dict[str, tuple[Column, ...]]:
    """Return the columns of standard deviations or variances; none where σ is declared."""
    declared = f"{what}_sigma_" + ("m" if what == "position" else "mps")
    keys = [k for k in (f"{what}_sigma", f"{what}_variance", declared) if section.has(k)]
    if len(keys) > 1:
        raise ConfigError(f"{section.file}: [{section.name}] give only one of {', '.join(keys)}")
    if not keys:
        example = "[2.0, 2.0, 4.0]" if what == "position" else "[0.1, 0.1, 0.2]"
        raise section.missing(
            f"{declared} = {example}",
            f'1σ; or columns: {what}_sigma = ["sn", "se", "sd"], {what}_variance = […]',
        )
    if keys[0] == declared:
        return {}
    line = f'{keys[0]} = ["sn", "se", "sd"]'
    return {keys[0]: section.columns(keys[0], (1, 3), line)}


def _covariance(
    section: Section, columns: Columns, what: str, C_ea: FloatArray, needed: bool
) -> FloatArray:
    """Return covariances in ECEF from deviations in the axes a; NaN where none are needed."""
    n = C_ea.shape[0]
    if not needed:
        return np.full((n, 3, 3), np.nan)
    units, plain = (LENGTH_UNITS, "m") if what == "position" else (SPEED_UNITS, "m/s")
    factor = units[section.choice(f"{what}_sigma_unit", units, "", default=plain)]
    if f"{what}_variance" in columns.numbers:
        variance = columns.numbers[f"{what}_variance"] * factor**2
    elif f"{what}_sigma" in columns.numbers:
        variance = (columns.numbers[f"{what}_sigma"] * factor) ** 2
    else:
        key = f"{what}_sigma_" + ("m" if what == "position" else "mps")
        variance = np.broadcast_to(section.numbers(key, (1, 3), "") ** 2, (n, 3))
    variance = np.broadcast_to(variance, (n, 3))
    bad = np.asarray(~(variance > 0.0).all(axis=1) & ~np.isnan(variance).any(axis=1))
    _refuse_rows(
        columns.table.file, columns.table.line, bad, f"{what} deviation: expected > 0",
        [str(v) for v in variance] if bad.any() else [],
        "a zero deviation is no measurement: leave the row out or declare σ",
    )  # fmt: skip
    return np.einsum("nij,nj,nkj->nik", C_ea, variance, C_ea)
