"""Draft a ``sequence.toml`` from the files themselves: what `certnav declare` prints.

What numbers show is filled in with its evidence; where only the user can know, the draft has
``"?"``, which the reader refuses with the line, so that no blank is ever taken for an answer.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...filters.errors import DataError
from ...filters.sensors import PRESETS
from ..axes import ATTITUDE
from ..formats.kfgins import kind_of
from ..formats.rtklib_pos import is_pos
from ..great.pvt import is_flt
from ..receivers.bags import is_bag
from ..text.columns import open_text
from . import column_roles as roles
from .column_roles import Sampled
from .declaration import BLANK, NAME
from .receivers import bag_sections, kinds_of, with_week

_COLUMN = 44
_SPEEDS = "m/s, km/h, knots or ft/s"
#: Stamps this far apart may be in another unit than seconds.
_LONG_STEP = 2.0
# A frame of a known class: the two bytes of its start alone are "µb", as in µbar.
_UBX = re.compile(rb"\xb5b[\x01-\x06\x09-\x0b\x0d\x10\x13\x21\x27\x28]")
_NMEA = re.compile(rb"(?:^|[\s\xbf])\$(?:G[ABILNPQ]|B[DC]|QZ)[A-Z]{3},")


def draft_declaration(files: Sequence[str | Path]) -> str:
    """Return a draft of ``sequence.toml`` for some files.

    Parameters
    ----------
    files : sequence of path
        Inertial data, GNSS solution or RINEX, odometer, reference; gzipped or not.

    Returns
    -------
    str
        TOML; every key that needs an answer holds ``"?"`` and says what is asked.

    Raises
    ------
    DataError
        No files, or one that cannot be read as a table.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.datasets import draft_declaration
    >>> rows = np.hstack([0.01 * np.arange(300)[:, None], np.tile([0, 0, 0, 0, 0, -9.8], (300, 1))])
    >>> np.savetxt("imu.csv", rows, delimiter=",", header="t,gx,gy,gz,ax,ay,az", comments="")
    >>> draft = draft_declaration(["imu.csv"])
    >>> '"?"' in draft  # where only its owner knows the answer
    True
    """
    paths = [Path(f) for f in files]
    if not paths:
        raise DataError("no files named", remedy="certnav declare imu.csv gnss.csv …")
    home = _absolute(paths[0]).parent
    sections: dict[str, list[str]] = {}
    rinex: dict[str, list[str]] = {"O": [], "N": []}
    observed: Path | None = None
    for path in paths:
        if path.exists() and is_bag(path):
            sections = bag_sections(path, _relative(path, home)) | sections
            continue
        if path.is_dir():
            raise DataError(
                "expected files, found a folder", file=path, remedy=f"name them: {path}/*.csv …"
            )
        if not path.is_file():
            raise DataError("file not found", file=path, remedy="check the name")
        name = _relative(path, home)
        kinds = kinds_of(path)
        for kind in kinds:
            rinex[kind].append(name)
        if "O" in kinds:
            observed = path
        if kinds:
            continue
        section, lines = _draft_file(path, name)
        if section in sections:
            taken = sections[section][0]
            lines = [f"# {name} looks like [{section}] too; {taken.strip()} is drafted above"]
            sections.setdefault("", []).extend(lines)
            continue
        sections[section] = lines
    if rinex["O"] or rinex["N"]:
        sections["rinex"] = _rinex_section(rinex)
    if observed is not None and "imu" in sections:
        sections["imu"] = with_week(sections["imu"], observed)
    return _assemble(sections)


def _assemble(sections: dict[str, list[str]]) -> str:
    lines = [
        f'# {NAME}: draft by certnav declare. Fill in every "{BLANK}"; nothing is guessed.',
        "# Columns by name, or by number from 1. Vectors forward, right, down in metres.",
        *sections.pop("", []),
    ]
    if "imu" not in sections:
        sections = {
            "imu": [_line("file", BLANK, "inertial data; no file looked like it")]
        } | sections
    order = ("imu", "gnss", "rinex", "odometer", "reference")
    for name in order:
        if name in sections:
            lines += ["", f"[{name}]", *sections[name]]
        if name == "imu":
            known = ", ".join(PRESETS)
            lines += [
                "",
                "[imu.noise]",
                _line("preset", BLANK, f"{known}; or the data sheet's values instead"),
                "",
                "[antenna]",
                _line("lever_frd_m", BLANK, "IMU to antenna, e.g. [0.5, 0.0, -1.2]"),
                _line("lever_sigma_m", 0.0, "how well you know it"),
                "",
                "[vehicle]",
                _line("mounting_rpy_deg", BLANK, "IMU in the car; [0.0, 0.0, 0.0] if aligned"),
            ]
    return "\n".join(lines) + "\n"


def _line(key: str, value: object, comment: str = "") -> str:
    text = f"{key} = {json.dumps(value, ensure_ascii=False)}"
    return f"{text:<{_COLUMN}}  # {comment}" if comment else text


def _absolute(path: Path) -> Path:
    """Return the absolute path with links as they are: the declaration lies beside the links."""
    return Path(os.path.abspath(path))


def _relative(path: Path, home: Path) -> str:
    full = _absolute(path)
    return str(full.relative_to(home)) if full.is_relative_to(home) else str(full)


def _rinex_section(rinex: dict[str, list[str]]) -> list[str]:
    observations = rinex["O"]
    lines = [
        _line("observations", observations[0] if len(observations) == 1 else BLANK,
              "the rover's, one of " + ", ".join(observations) if len(observations) > 1 else
              "" if observations else "the rover's observations")
    ]  # fmt: skip
    navigation: object = rinex["N"] or BLANK
    lines.append(_line("navigation", navigation, "" if rinex["N"] else "broadcast ephemerides"))
    return lines


def _draft_file(path: Path, name: str) -> tuple[str, list[str]]:
    """Return the section a file belongs to and its drafted lines."""
    file = _line("file", name)
    with path.open("rb") as stream:
        head = stream.read(4096)
    if _UBX.search(head):
        return "gnss", [file, _line("format", "ubx")]
    if _NMEA.search(head):
        return "gnss", [
            file,
            _line("format", "nmea"),
            _line("position_sigma_m", BLANK, "1σ, e.g. [2.0, 2.0, 4.0]; drop it if there is GST"),
            _line("velocity_sigma_mps", BLANK, "1σ of speed and course, e.g. 0.2"),
        ]
    if not head.startswith(b"\x1f\x8b"):
        if is_pos(path):
            return "gnss", [file, _line("format", "rtklib")]
        if is_flt(path):
            return "gnss", [file, _line("format", "great-pvt"), _week_line()]
        if b"GPSTime" in head:
            return "reference", [file, _line("format", "inertial-explorer"), *_reference_lines()]
        kind = kind_of(path)
        if kind == "nav":
            return "reference", [file, _line("format", "kf-gins"), *_reference_lines()]
    return _draft_table(roles.sample(open_text(path)), file)


def _week_line() -> str:
    return _line("week", BLANK, "GPS week of the first row, e.g. 2129; the file does not hold it")


def _draft_table(table: Sampled, file: str) -> tuple[str, list[str]]:
    """Return section and lines of a table, by what its columns look like."""
    time_lines, taken = _time_lines(table)
    lines = [file, *time_lines]
    where = roles.place(table) or roles.ecef(table)
    accel = roles.triad(table, "accel")
    columns = accel[0] if accel else None if where else roles.gravity_triad(table, taken)
    if columns is not None and where is None:
        return "imu", lines + _imu_lines(table, columns, taken)
    if where is not None:
        attitude = [table.find(p) for p in (r"^roll", r"^pitch", r"^(yaw|heading|hdg|azimuth)")]
        lines += _pvt_lines(table, where)
        if all(attitude[:2]) and attitude[2]:
            names = [table.column(a[0]) for a in attitude]
            lines += [*_velocity_lines(table), _line("attitude", names), *_attitude_lines()]
            return "reference", lines
        lines += _velocity_lines(table) or _no_velocity_lines(table, taken | set(where))
        return "gnss", lines + _deviation_lines(table, roles.place(table) is not None)
    speed = table.find(r"^(speed|v|vel|velocity|wheel_?speed|odo(meter)?)$")
    if speed:
        lines.append(_line("speed", table.column(speed[0])))
        said = roles.unit_said(table, speed[:1], ("m/s", "km/h"))
        lines.append(_line("speed_unit", said or BLANK, "says the header" if said else _SPEEDS))
        return "odometer", lines
    numeric = np.isfinite(table.value).any(axis=0).sum() - len(taken)
    if table.source.names is None or numeric < 3:
        raise DataError(
            "neither inertial data (specific force of the size of gravity), nor positions (lat, "
            "lon, height or ECEF), nor a speed found",
            file=table.source.file,
            remedy="give the columns names in a header, or write the declaration by hand",
        )
    return "gnss", lines + _unnamed_lines(table, taken)


def _unnamed_lines(table: Sampled, taken: set[int]) -> list[str]:
    """Return a draft for columns that neither names nor numbers tell: positions, most likely."""
    rest = [str(table.column(k)) for k in range(table.value.shape[1]) if k not in taken]
    lines = [
        "# No column looks like a position; if this file holds none, it belongs to another",
        f"# section, or to none. Its columns: {', '.join(rest)}",
        _line("position", BLANK, "three columns: latitude, longitude, height, or X, Y, Z"),
        _line("position_frame", BLANK, "lla or ecef"),
        _line("angle_unit", BLANK, "deg or rad; of lla only"),
        _line("height", BLANK, "ellipsoid; or geoid (mean sea level) with geoid_m = …; lla only"),
    ]
    velocity = _velocity_lines(table) or _no_velocity_lines(table, taken)
    return [*lines, *velocity, *_deviation_lines(table, True)]


def _time_lines(table: Sampled) -> tuple[list[str], set[int]]:
    """Return the lines about time and the columns they use."""
    k, week = roles.time_index(table), roles.week_index(table)
    if k is None:
        return [_line("time", BLANK, "no column increases throughout")], set()
    value = table.value[:, k]
    if np.isnan(value).all():
        return [
            _line("time", table.column(k)),
            _line("time_scale", BLANK, "dates: utc or gps-calendar (18 s apart)"),
        ], {k}
    if week is not None and 0.0 <= value[0] <= 7 * 86400.0:
        columns = [table.column(week), table.column(k)]
        return [_line("time", columns), _line("time_scale", "gps-week-sow")], {k, week}
    said, step = roles.time_unit_said(table, k), float(np.median(np.diff(value)))
    unit = [_line("time_unit", said, "says the header")] if said else []
    if not said and step >= _LONG_STEP:
        unit = [_line("time_unit", BLANK, f"s, ms, us or ns: stamps step by {step:.6g}")]
    return [_line("time", table.column(k)), *_scale_lines(float(np.median(value)), unit)], {k}


def _scale_lines(middle: float, unit_if_any: list[str]) -> list[str]:
    """Return time_scale and time_unit for stamps of that size."""
    for unit, factor in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        seconds = middle * factor
        unit_line = [_line("time_unit", unit)] if unit != "s" else []
        if 1.6e9 < seconds < 2.2e9:
            hint = "1970 epoch; if the logger left leap seconds out: time_offset_s = -18.0"
            return [_line("time_scale", "unix", hint), *unit_line]
        if 9e8 < seconds <= 1.6e9:
            hint = "gps (seconds since 1980) or unix (since 1970): this size fits both"
            if seconds < 1.2e9:
                hint = "gps (seconds since 1980), or unix if recorded before 2008"
            return [_line("time_scale", BLANK, hint), *unit_line]
    hint = "gps-sow (then add week = …); relative: counts from no date"
    return [_line("time_scale", BLANK, hint), *unit_if_any]


def _imu_lines(table: Sampled, accel: list[int], taken: set[int]) -> list[str]:
    named = roles.triad(table, "gyro")
    gyro = named[0] if named is not None else _beside(table, accel, taken)
    unit, evidence = roles.accel_unit(table, accel)
    said = roles.unit_said(table, gyro, ("rad/s", "deg/s"))
    lines = [
        _line(
            "gyro", [table.column(k) for k in gyro] or BLANK, "" if gyro else _left(table, taken)
        ),
        _line("accel", [table.column(k) for k in accel]),
    ]
    peak = float(np.nanmax(np.abs(table.value[:, gyro]))) if gyro else np.nan
    largest = f"; largest is {peak:.3g}" if gyro else ""
    if unit == "m/s":
        lines.append(_line("gyro_unit", BLANK, f"increments: rad or deg{largest}"))
    elif said:
        lines.append(_line("gyro_unit", said, f"says the header{largest}"))
    elif peak > 12.0:  # 690 deg/s: no car turns so fast
        lines.append(_line("gyro_unit", "deg/s", f"largest is {peak:.3g}: too fast for rad/s"))
    else:
        hint = f"rad/s or deg/s (or rad, deg: increments){largest}"
        lines.append(_line("gyro_unit", BLANK, hint))
    lines.append(_line("accel_unit", unit or BLANK, evidence))
    hint = f"FRD, FLU, RFU …: {roles.up_axis(table, accel)}, where x points only you can know"
    return [*lines, _line("axes", BLANK, hint)]


def _left(table: Sampled, taken: set[int]) -> str:
    """Return the columns that may be the three of the gyro, as a question."""
    names = [str(table.column(k)) for k in range(table.value.shape[1]) if k not in taken]
    return f"three of {', '.join(names)}" if len(names) > 2 else "three columns"


def _beside(table: Sampled, accel: list[int], taken: set[int]) -> list[int]:
    """Return the three columns before or after those of the accelerometer."""
    for start in (accel[0] - 3, accel[2] + 1):
        side = [start, start + 1, start + 2]
        inside = start >= 0 and side[2] < table.value.shape[1]
        if inside and not taken & set(side) and not roles.is_other_sensor(table, side):
            return side
    return []


def _pvt_lines(table: Sampled, where: list[int]) -> list[str]:
    geodetic = roles.place(table) is not None
    lines = [
        _line("position", [table.column(k) for k in where]),
        _line("position_frame", "lla" if geodetic else "ecef"),
    ]
    if geodetic:
        size = float(np.nanmax(np.abs(table.value[:, where[:2]])))
        unit, hint = ("deg", "") if size > 6.3 else (BLANK, "deg or rad")
        lines.append(_line("angle_unit", unit, hint))
        lines.append(
            _line("height", BLANK, "ellipsoid; or geoid (mean sea level) with geoid_m = …")
        )
    return lines


def _no_velocity_lines(table: Sampled, taken: set[int]) -> list[str]:
    """Return the question for a velocity that no name tells: a run cannot start without."""
    return [
        "# No column is known as a velocity, and a run starts from one. Of speed and course make",
        "# columns: north = speed cos(course), east = speed sin(course), down = 0.",
        _line("velocity", BLANK, _left(table, taken)),
        _line("velocity_frame", BLANK, "ned, enu or ecef"),
        _line("velocity_unit", BLANK, _SPEEDS),
    ]


def _velocity_lines(table: Sampled) -> list[str]:
    velocity = roles.triad(table, "velocity")
    if velocity is None:
        return []
    columns, letters = velocity
    frame = letters if letters != "xyz" else BLANK
    said = roles.unit_said(table, columns, ("m/s", "km/h"))
    return [
        _line("velocity", [table.column(k) for k in columns]),
        _line("velocity_frame", frame, "" if frame != BLANK else "ecef, ned or enu"),
        _line("velocity_unit", said or BLANK, "says the header" if said else _SPEEDS),
    ]


def _deviation_lines(table: Sampled, geodetic: bool) -> list[str]:
    lines = []
    for what, short, key, example in (
        ("position", "pos", "position_sigma_m", "[2.0, 2.0, 4.0]"),
        ("velocity", "vel", "velocity_sigma_mps", "[0.1, 0.1, 0.2]"),
    ):
        velocity = roles.triad(table, "velocity")
        axes = velocity[1] if what == "velocity" and velocity else "ned" if geodetic else "xyz"
        forms = (axes, "neu") if axes == "ned" else (axes,)
        found = next((f for a in forms if (f := roles.deviations(table, a, short))), None)
        if found:
            names = [table.column(k) for k in found]
            lines.append(_line(f"{what}_sigma", names, "1σ; variances: " + f"{what}_variance"))
        else:
            hint = f"1σ, e.g. {example}; or columns: {what}_sigma = [horizontal twice, vertical]"
            lines.append(_line(key, BLANK, hint))
    return lines


def _attitude_lines() -> list[str]:
    return [
        _line("attitude_unit", BLANK, "deg or rad"),
        _line("attitude_convention", BLANK, ", ".join(ATTITUDE) + " (body axes, local axes)"),
        *_reference_lines(),
    ]


def _reference_lines() -> list[str]:
    return [
        _line("attitude_of", BLANK, "imu or vehicle"),
        _line("point", BLANK, "imu, antenna, vehicle, or a name of your own with lever_frd_m"),
        _line("source", BLANK, "what made it, and whether it is independent of the GNSS"),
    ]
