"""``sequence.toml``: everything a navigation engineer has to say about own files.

Every key is checked: one that is missing is an error that prints the line to add, one that is
unknown names the nearest known one, and a ``"?"`` left by ``certnav declare`` is an error with
its line. Vectors are forward-right-down, in metres, from the IMU. Columns go by header name or by
number, counted from 1. Paths are relative to the file.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray, matrix_from_rpy
from ...filters.sensors import PRESETS, STANDARD_GRAVITY, ImuSpec, imu_preset
from ..axes import ATTITUDE, axes_matrix
from ..text.columns import Column
from ..text.toml_files import read_toml
from ..time_scales import SCALES, UNITS, TimeScale
from .blanks import refuse_blanks

NAME = "sequence.toml"
#: A line that declares a lever arm, for messages.
LEVER_LINE = "lever_frd_m = [0.0, 0.0, -1.0]"

_DEG, _G = np.pi / 180.0, STANDARD_GRAVITY
#: Factor to rad/s or rad, and whether the column holds increments.
GYRO_UNITS: dict[str, tuple[float, bool]] = {
    "rad/s": (1.0, False),
    "deg/s": (_DEG, False),
    "deg/h": (_DEG / 3600.0, False),
    "rad": (1.0, True),
    "deg": (_DEG, True),
}
#: Factor to m/s² or m/s, and whether the column holds increments.
ACCEL_UNITS: dict[str, tuple[float, bool]] = {
    "m/s2": (1.0, False),
    "g": (_G, False),
    "mg": (1e-3 * _G, False),
    "m/s": (1.0, True),
}
SPEED_UNITS = {
    "m/s": 1.0, "km/h": 1.0 / 3.6, "knots": 1852.0 / 3600.0, "ft/s": 0.3048, "mm/s": 1e-3,
}  # fmt: skip
LENGTH_UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "ft": 0.3048}
ANGLE_UNITS = {"deg": _DEG, "rad": 1.0, "1e-7deg": 1e-7 * _DEG}
POSITION_FRAMES = ("lla", "ecef")
VELOCITY_FRAMES = ("ned", "enu", "ecef")
GNSS_FORMATS = ("csv", "rtklib", "great-pvt", "kf-gins", "nmea", "ubx")
REFERENCE_FORMATS = ("csv", "inertial-explorer", "kf-gins", "rtklib")

_TIME_KEYS = ("time", "time_scale", "week", "time_unit", "time_offset_s", "rate_hz")
_PVT_KEYS = (
    *("position", "position_frame", "angle_unit", "height", "height_unit", "geoid_m"),
    *("velocity", "velocity_frame", "velocity_unit"),
    *(f"{what}_{kind}" for what in ("position", "velocity") for kind in ("sigma", "variance")),
    *("position_sigma_unit", "velocity_sigma_unit"),
    *("position_sigma_m", "velocity_sigma_mps", "satellites", "quality"),
)
_NOISE_UNITS = {
    # other ways datasheets print white noise, and the factor to the field of ImuSpec
    "gyro_noise_degps_sqrthz": ("gyro_arw_deg_sqrth", 60.0),
    "accel_noise_ug_sqrthz": ("accel_vrw_mps_sqrth", 60.0 * 1e-6 * _G),
}
_NOISE_FIELDS = tuple(f.name for f in dataclasses.fields(ImuSpec) if f.name not in ("name",))
KEYS: dict[str, tuple[str, ...]] = {
    "": ("name", "time", "imu", "antenna", "vehicle", "gnss", "rinex", "odometer", "reference"),
    "time": ("scale", "week", "unit", "offset_s"),
    "imu": (
        *("file", "topic", "separator", *_TIME_KEYS, "time_offset_sigma_s"),
        *("gyro", "accel", "gyro_unit", "accel_unit"),
        *("axes", "samples", "noise"),
    ),
    "imu.noise": ("preset", *_NOISE_FIELDS, *_NOISE_UNITS),
    "antenna": ("lever_frd_m", "lever_sigma_m", "source"),
    "gnss": (
        *("file", "topic", "format", "separator", *_TIME_KEYS, "time_offset_sigma_s"),
        *_PVT_KEYS,
    ),
    "vehicle": ("mounting_rpy_deg", "mounting_sigma_deg", "wheels_frd_m", "wheels_sigma_m"),
    "rinex": ("observations", "navigation", "systems", "signals"),
    "odometer": (
        *("file", "topic", "separator", *_TIME_KEYS, "speed", "speed_unit"),
        *("yaw_rate", "yaw_rate_unit", "yaw_rate_axis"),
    ),
    "reference": (
        *("file", "topic", "format", "separator", *_TIME_KEYS, *_PVT_KEYS),
        *("point", "lever_frd_m"),
        *("attitude", "attitude_unit", "attitude_convention", "attitude_of", "source"),
    ),
}


@dataclass(frozen=True)
class Section:
    """One table of the declaration, read key by key.

    Parameters
    ----------
    file : Path
        The declaration.
    name : str
    values : mapping
    """

    file: Path
    name: str
    values: Mapping[str, Any]

    def has(self, key: str) -> bool:
        """Return whether the key is declared."""
        return key in self.values

    def refuse(self, key: str, expected: str) -> ConfigError:
        """Return the error for a value that cannot be used."""
        return ConfigError(
            f"{self.file}: [{self.name}] {key}: expected {expected}, found {self.values[key]!r}"
        )

    def missing(self, line: str, why: str = "") -> ConfigError:
        """Return the error for what is not declared: it prints the line to add."""
        reason = f" ({why})" if why else ""
        key = line.split("=", 1)[0].strip()
        return ConfigError(
            f"{self.file}: {key} is not declared{reason} — add under [{self.name}]: {line}"
        )

    def text(self, key: str, line: str, why: str = "", default: str | None = None) -> str:
        """Return a string."""
        if key not in self.values:
            if default is None:
                raise self.missing(line, why)
            return default
        value = self.values[key]
        if not isinstance(value, str) or not value or "\0" in value:
            raise self.refuse(key, "a text")
        return value

    def choice(
        self, key: str, known: Iterable[str], line: str, why: str = "", default: str | None = None
    ) -> str:
        """Return a string out of `known`."""
        value = self.text(key, line, why, default)
        known = tuple(known)
        if value not in known:
            raise self.refuse(key, "one of " + ", ".join(f'"{k}"' for k in known))
        return value

    def columns(self, key: str, counts: tuple[int, ...], line: str) -> tuple[Column, ...]:
        """Return column names or numbers; a single one need not be a list."""
        if key not in self.values:
            raise self.missing(line)
        value = self.values[key]
        items = value if isinstance(value, list) else [value]
        good = all(isinstance(v, str | int) and not isinstance(v, bool) for v in items)
        if not good or len(items) not in counts:
            some = " or ".join(map(str, counts))
            raise self.refuse(key, f"{some} column name(s) or number(s)")
        return tuple(items)

    def numbers(
        self, key: str, counts: tuple[int, ...], line: str, default: FloatArray | None = None
    ) -> FloatArray:
        """Return finite numbers; a single one need not be a list."""
        if key not in self.values:
            if default is None:
                raise self.missing(line)
            return default
        value = self.values[key]
        items = value if isinstance(value, list) else [value]
        good = all(isinstance(v, int | float) and not isinstance(v, bool) for v in items)
        if not good or len(items) not in counts or not np.isfinite(items).all():
            raise self.refuse(key, " or ".join(map(str, counts)) + " number(s)")
        return np.array(items, dtype=float)

    def sigma(self, key: str, default: float = 0.0) -> float:
        """Return a 1σ; 0 is exact."""
        value = float(self.numbers(key, (1,), "", np.array([default]))[0])
        if value < 0.0:
            raise self.refuse(key, "0 or more, 1σ")
        return value

    def path(self, key: str = "file") -> Path:
        """Return a file beside the declaration."""
        name = self.text(key, f'{key} = "{self.name}.csv"')
        return self.file.parent / name


@dataclass(frozen=True, eq=False)
class Declaration:
    """A declaration that has been read and whose keys are known.

    Attributes
    ----------
    file : Path
    name : str
    sections : mapping of str to Section
    """

    file: Path
    name: str
    sections: Mapping[str, Section]

    def section(self, name: str) -> Section | None:
        """Return a section, or None where there is none."""
        return self.sections.get(name)

    def required(self, name: str, lines: str) -> Section:
        """Return a section that has to be there."""
        if name not in self.sections:
            raise ConfigError(f"{self.file}: [{name}] is not declared — add: {lines}")
        return self.sections[name]

    def time_scale(self, section: Section) -> TimeScale:
        """Return the time scale of a section: its own keys before those of [time]."""
        common = self.sections.get("time", Section(self.file, "time", {}))
        own = {"scale": "time_scale", "week": "week", "unit": "time_unit"}
        own["offset_s"] = "time_offset_s"
        values = dict(common.values)
        values |= {key: section.values[k] for key, k in own.items() if section.has(k)}
        merged = Section(self.file, "time", values)
        scale = merged.choice(
            "scale", SCALES, 'scale = "gps-sow"', "one of " + ", ".join(SCALES) + "; never guessed"
        )
        week = None
        if scale == "gps-sow":
            week = merged.numbers("week", (1,), "week = 2129", None)
            if week[0] != int(week[0]) or not 0 <= week[0] <= 9999:
                raise merged.refuse("week", "a GPS week number")
        unit = merged.choice("unit", UNITS, 'unit = "s"', default="s")
        offset = merged.numbers("offset_s", (1,), "offset_s = 0.0", np.zeros(1))
        rate = None
        if section.has("rate_hz"):
            rate = float(section.numbers("rate_hz", (1,), "")[0])
            if not rate > 0.0:
                raise section.refuse("rate_hz", "rows a second, above zero")
        return TimeScale(
            scale, None if week is None else int(week[0]), unit, float(offset[0]), rate
        )

    def week(self, section: Section) -> int:
        """Return the GPS week of a file that holds none: of its section, or of [time]."""
        common = self.sections.get("time")
        holder = section if section.has("week") or common is None else common
        return int(holder.numbers("week", (1,), "week = 2129")[0])


def read_declaration(path: str | Path) -> Declaration:
    """Return a declaration with its sections and keys checked, but not yet its values.

    Parameters
    ----------
    path : path
        The file, or the folder that holds ``sequence.toml``.

    Raises
    ------
    DataError
        Not there, or not TOML.
    ConfigError
        An unknown section or key, or a blank left to fill in.
    """
    file = Path(path)
    file = file / NAME if file.is_dir() else file
    if not file.exists():
        raise DataError("no such file", file=file, remedy="certnav declare FILE… drafts one")
    content, text = read_toml(file)
    _check_keys(file, "", content)
    sections = {}
    for name, table in content.items():
        if name == "name":
            continue
        if not isinstance(table, dict):
            raise ConfigError(f"{file}: {name}: expected a table [{name}], found {table!r}")
        _check_keys(file, name, table)
        sections[name] = Section(file, name, table)
    noise = content.get("imu", {}).get("noise")
    if noise is not None:
        if not isinstance(noise, dict):
            raise sections["imu"].refuse("noise", "a table [imu.noise]")
        _check_keys(file, "imu.noise", noise)
        sections["imu.noise"] = Section(file, "imu.noise", noise)
    refuse_blanks(file, text, content)
    name = content.get("name", file.resolve().parent.name)
    if not isinstance(name, str) or not re.fullmatch(r"[^/\\\x00]+", name):
        raise ConfigError(f"{file}: name: expected a short name, found {name!r}")
    return Declaration(file, name, sections)


def _check_keys(file: Path, section: str, table: Mapping[str, Any]) -> None:
    for key in table:
        if key not in KEYS[section]:
            where = f"{file}: [{section}]" if section else str(file)
            raise ConfigError.unknown_key(key, KEYS[section], where=where)


def imu_spec(declaration: Declaration) -> ImuSpec:
    """Return the noise model: a preset, datasheet values, or values that replace a preset's."""
    section = declaration.required("imu.noise", '[imu.noise] and preset = "adis16470"')
    values = dict(section.values)
    preset = values.pop("preset", None)
    for key, (field, factor) in _NOISE_UNITS.items():
        if key in values:
            if field in values:
                raise ConfigError(f"{section.file}: [imu.noise] give either {key} or {field}")
            values[field] = float(section.numbers(key, (1,), "")[0]) * factor
            del values[key]
    for key in values:
        if key != "source" and key in section.values:
            values[key] = float(section.numbers(key, (1,), "")[0])
    if preset is not None:
        if not isinstance(preset, str) or preset not in PRESETS:
            raise ConfigError.unknown_key(
                str(preset), PRESETS, where=f"{section.file}: [imu.noise] preset"
            )
        return dataclasses.replace(imu_preset(preset), **values)
    for spec_field in dataclasses.fields(ImuSpec):
        key = spec_field.name
        if key not in ("name", "source", *values) and spec_field.default is dataclasses.MISSING:
            known = ", ".join(f'"{name}"' for name in PRESETS)
            raise section.missing(f"{key} = …", f"from the data sheet, or preset = one of {known}")
    values.setdefault("source", f"declared in {section.file.name}")
    return ImuSpec(name="declared", **values)


def mounting(declaration: Declaration) -> FloatArray:
    """Return C_bv from ``mounting_rpy_deg``: ``x_v = matrix_from_rpy(rpy) @ x_b``."""
    section = declaration.required(
        "vehicle", "[vehicle] and mounting_rpy_deg = [0.0, 0.0, 0.0]  # IMU aligned with the car"
    )
    rpy = section.numbers(
        "mounting_rpy_deg", (3,), "mounting_rpy_deg = [0.0, 0.0, 0.0]  # IMU aligned with the car"
    )
    return matrix_from_rpy(np.radians(rpy)).T


def lever(section: Section, key: str, line: str) -> FloatArray:
    """Return a vector on a road vehicle [m]; more than 20 m is refused (millimetres?)."""
    vector = section.numbers(key, (3,), line)
    if np.linalg.norm(vector) > 20.0:
        raise section.refuse(key, "metres on a road vehicle")
    return vector


def imu_axes(section: Section) -> FloatArray:
    """Return C_bs of the IMU's declared axes."""
    name = section.text("axes", 'axes = "FRD"', "directions of x, y, z: FRD, FLU, RFU …")
    return axes_matrix(name, key=f"{section.file}: [{section.name}] axes")


def attitude_convention(section: Section) -> str:
    """Return the declared convention of attitude angles."""
    return section.choice(
        "attitude_convention", ATTITUDE, 'attitude_convention = "frd-ned"',
        "roll right down, pitch nose up, heading clockwise from north; or flu-enu, rfu-enu",
    )  # fmt: skip
