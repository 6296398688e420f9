"""The draft of one text table: which section it is of, and what its columns are."""

from __future__ import annotations

import numpy as np

from ...filters.errors import DataError
from ..axes import ATTITUDE
from . import column_roles as roles
from .blanks import BLANK
from .column_roles import Sampled
from .draft import Line, remark

SPEEDS = "m/s, km/h, knots, ft/s or mm/s"
#: Intervals between rows that the files of each section can have [s]: a unit of stamps that makes
#: others is none. Each spans less than a factor of 1000, so that one unit is left.
_INTERVALS = {"imu": (2.4e-4, 0.11), "gnss": (0.018, 12.0)}
_TICKS = {"s": 1.0, "ms": 1e-3, "100us": 1e-4, "us": 1e-6, "ns": 1e-9}
#: Higher than any road [m]: then heights are in mm.
_NO_ROAD = 7000.0


def draft_table(table: Sampled, file: Line, role: str = "") -> tuple[str, list[Line]]:
    """Return section and lines of a table, by what its columns look like.

    Parameters
    ----------
    table : Sampled
    file : Line
        The line that names it.
    role : {'', 'gnss', 'reference'}
        What positions in it are, where that is known.
    """
    where = roles.place(table) or roles.ecef(table)
    accel = roles.triad(table, "accel")
    taken = roles.time_columns(table)
    columns = accel[0] if accel else None if where else roles.gravity_triad(table, taken)
    if columns is not None and where is None:
        lines, taken = _time_lines(table, "imu")
        return "imu", [file, *lines, *_imu_lines(table, columns, taken)]
    lines, taken = _time_lines(table, "gnss")
    lines = [file, *lines]
    if where is not None:
        return _positions(table, where, lines, taken, role)
    speed = table.find(r"^(speed|v|vel|velocity|wheel_?speed|odo(meter)?)$")
    if speed and not role:
        lines.append(Line("speed", table.column(speed[0])))
        said = roles.unit_said(table, speed[:1], ("m/s", "km/h"))
        lines.append(Line("speed_unit", said or BLANK, "says the header" if said else SPEEDS))
        return "odometer", lines
    numeric = np.isfinite(table.value).any(axis=0).sum() - len(taken)
    if table.source.names is None or numeric < 3:
        raise DataError(
            "neither inertial data (specific force of the size of gravity), nor positions (lat, "
            "lon, height or ECEF), nor a speed found",
            file=table.source.file,
            remedy="give the columns names in a header, or write the declaration by hand",
        )
    lines += _unnamed_lines(table, taken, deviations=role != "reference")
    return (role or "gnss"), lines + (
        reference_lines(attitude=False) if role == "reference" else []
    )


def _positions(
    table: Sampled, where: list[int], lines: list[Line], taken: set[int], role: str
) -> tuple[str, list[Line]]:
    """Return section and lines of a table with positions: with an attitude it is a reference."""
    lines = lines + _pvt_lines(table, where)
    attitude = [table.find(p) for p in (r"^roll", r"^pitch", r"^(yaw|heading|hdg|azimuth)")]
    angles = [a[0] for a in attitude if a]
    if (role or ("reference" if len(angles) == 3 else "gnss")) == "gnss":
        lines += velocity_lines(table) or _no_velocity_lines(table, taken | set(where))
        return "gnss", lines + _deviation_lines(table, roles.place(table) is not None)
    lines += velocity_lines(table)
    if len(angles) != 3:
        return "reference", lines + reference_lines(attitude=False)
    size = float(np.nanmax(np.abs(table.value[:, angles])))
    unit = Line("attitude_unit", BLANK, "deg or rad")
    if size > 6.5:
        unit = Line("attitude_unit", "deg", f"largest is {size:.3g}: too large for rad")
    how = ", ".join(ATTITUDE) + " (body axes, local axes)"
    lines += [
        Line("attitude", [table.column(k) for k in angles]),
        unit,
        Line("attitude_convention", BLANK, how),
    ]
    return "reference", lines + reference_lines()


def reference_lines(*, attitude: bool = True) -> list[Line]:
    """Return what is asked of every reference."""
    of = [Line("attitude_of", BLANK, "imu or vehicle")] if attitude else []
    return [
        *of,
        Line("point", BLANK, "imu, antenna, vehicle, or a name of your own with lever_frd_m"),
        Line("source", BLANK, "what made it, and whether it is independent of the GNSS"),
    ]


def _unnamed_lines(table: Sampled, taken: set[int], *, deviations: bool) -> list[Line]:
    """Return a draft for columns that neither names nor numbers tell: positions, most likely."""
    rest = [str(table.column(k)) for k in range(table.value.shape[1]) if k not in taken]
    lines = [
        remark("No column looks like a position; if this file holds none, it belongs to another"),
        remark(f"section, or to none. Its columns: {', '.join(rest)}"),
        Line("position", BLANK, "three columns: latitude, longitude, height, or X, Y, Z"),
        Line("position_frame", BLANK, "lla or ecef"),
        Line("angle_unit", BLANK, "deg or rad; of lla only"),
        Line("height", BLANK, "ellipsoid; or geoid (mean sea level) with geoid_m = …; lla only"),
    ]
    velocity = velocity_lines(table) or _no_velocity_lines(table, taken)
    return [*lines, *velocity, *(_deviation_lines(table, True) if deviations else [])]


def _time_lines(table: Sampled, kind: str) -> tuple[list[Line], set[int]]:
    """Return the lines about time and the columns they use."""
    k, week = roles.time_index(table), roles.week_index(table)
    if k is None:
        return [Line("time", BLANK, "no column increases throughout")], set()
    value = table.value[:, k]
    column = table.column(k)
    if np.isnan(value).all():
        said, day = roles.zone_said(table, k), roles.time_of_day(table, k)
        hint = "says the zone in it" if said else "dates: utc or gps-calendar (18 s apart)"
        columns = column if day is None else [column, table.column(day)]
        taken = {k} if day is None else {k, day}
        return [Line("time", columns), Line("time_scale", said or BLANK, hint)], taken
    unit = _time_unit(table, k, kind)
    seconds = value[0] * _TICKS.get(unit.value if unit else "s", 1.0)
    if week is not None and 0.0 <= seconds <= 7 * 86400.0:
        columns = [table.column(week), column]
        lines = [Line("time", columns), Line("time_scale", "gps-week-sow")]
        return lines + ([unit] if unit else []), {k, week}
    middle = float(np.median(value)) * _TICKS.get(unit.value if unit else "s", 1.0)
    return [Line("time", column), *_scale_lines(middle), *([unit] if unit else [])], {k}


def _time_unit(table: Sampled, k: int, kind: str) -> Line | None:
    """Return the line of the unit of stamps, where it is not the second."""
    said, known = roles.time_unit_said(table, k)
    step = float(np.median(np.diff(table.value[:, k])))
    low, high = _INTERVALS[kind]
    if said and low <= step * _TICKS[said] <= high:
        return Line("time_unit", said, known)
    fits = [unit for unit, tick in _TICKS.items() if low <= step * tick <= high and unit != "100us"]
    if len(fits) != 1:
        return Line("time_unit", BLANK, f"s, ms, us or ns: stamps step by {step:.6g}")
    if fits[0] == "s":
        return None
    rate = 1.0 / (step * _TICKS[fits[0]])
    return Line("time_unit", fits[0], f"stamps step by {step:.6g}: {rate:.4g} rows a second")


def _scale_lines(seconds: float) -> list[Line]:
    """Return time_scale for stamps of that size."""
    if 1.6e9 < seconds < 2.2e9:
        hint = "1970 epoch; if the logger left leap seconds out: time_offset_s = -18.0"
        return [Line("time_scale", "unix", hint)]
    if 9e8 < seconds <= 1.6e9:
        hint = "gps (seconds since 1980) or unix (since 1970): this size fits both"
        if seconds < 1.2e9:
            hint = "gps (seconds since 1980), or unix if recorded before 2008"
        return [Line("time_scale", BLANK, hint)]
    hint = "gps-sow (then add week = …); relative: counts from no date"
    return [Line("time_scale", BLANK, hint)]


def _imu_lines(table: Sampled, accel: list[int], taken: set[int]) -> list[Line]:
    named = roles.triad(table, "gyro")
    gyro = named[0] if named is not None else _beside(table, accel, taken)
    unit, evidence = roles.accel_unit(table, accel)
    said = roles.unit_said(table, gyro, ("rad/s", "deg/s"))
    lines = [
        Line("gyro", [table.column(k) for k in gyro] or BLANK, "" if gyro else _left(table, taken)),
        Line("accel", [table.column(k) for k in accel]),
    ]
    peak = float(np.nanmax(np.abs(table.value[:, gyro]))) if gyro else np.nan
    largest = f"; largest is {peak:.3g}" if gyro else ""
    if unit == "m/s":
        lines.append(Line("gyro_unit", BLANK, f"increments: rad or deg{largest}"))
    elif said:
        lines.append(Line("gyro_unit", said, f"says the header{largest}"))
    elif peak > 12.0:  # 690 deg/s: no car turns so fast
        lines.append(Line("gyro_unit", "deg/s", f"largest is {peak:.3g}: too fast for rad/s"))
    else:
        hint = f"rad/s or deg/s (or rad, deg: increments){largest}"
        lines.append(Line("gyro_unit", BLANK, hint))
    lines.append(Line("accel_unit", unit or BLANK, evidence))
    hint = f"FRD, FLU, RFU …: {roles.up_axis(table, accel)}, where x points only you can know"
    return [*lines, Line("axes", BLANK, hint)]


def _left(table: Sampled, taken: set[int]) -> str:
    """Return the columns that may be the three of the gyro, as a question."""
    names = [str(table.column(k)) for k in range(table.value.shape[1]) if k not in taken]
    return f"three of {', '.join(names)}" if len(names) > 2 else "three columns"


def _beside(table: Sampled, accel: list[int], taken: set[int]) -> list[int]:
    """Return the three columns before or after those of the accelerometer."""
    for start in (min(accel) - 3, max(accel) + 1):
        side = [start, start + 1, start + 2]
        inside = start >= 0 and side[2] < table.value.shape[1]
        if inside and not taken & set(side) and not roles.is_other_sensor(table, side):
            return side
    return []


def _pvt_lines(table: Sampled, where: list[int]) -> list[Line]:
    geodetic = roles.place(table) is not None
    lines = [
        Line("position", [table.column(k) for k in where]),
        Line("position_frame", "lla" if geodetic else "ecef"),
    ]
    if geodetic:
        size = float(np.nanmax(np.abs(table.value[:, where[:2]])))
        unit, hint = ("deg", "") if size > 6.3 else (BLANK, "deg or rad")
        if size > 1e3:
            unit, hint = "1e-7deg", f"largest is {size:.4g}"
        lines.append(Line("angle_unit", unit, hint))
        lines += _height_lines(table, where[2], unit)
    return lines


def _height_lines(table: Sampled, k: int, angle_unit: str) -> list[Line]:
    """Return datum and unit of heights: what their name says, or a question."""
    said = roles.datum_said(table, k)
    lines = [Line("height", BLANK, "ellipsoid; or geoid (mean sea level) with geoid_m = …")]
    if said:
        lines = [Line("height", said[0], said[1])]
    if said and said[0] == "geoid":
        column = roles.undulation(table)
        hint = "height of the geoid above the ellipsoid there [m]" if column is None else ""
        lines.append(Line("geoid_m", BLANK if column is None else table.column(column), hint))
    high = float(np.nanmedian(np.abs(table.value[:, k])))
    if high > _NO_ROAD:
        lines.append(Line("height_unit", "mm", f"median {high:.4g}: no road is so high in m"))
    elif angle_unit == "1e-7deg":
        lines.append(Line("height_unit", BLANK, "m or mm: receivers that count 1e-7° mostly in mm"))
    return lines


def _no_velocity_lines(table: Sampled, taken: set[int]) -> list[Line]:
    """Return the question for a velocity that no name tells: a run cannot start without."""
    return [
        remark("No column is known as a velocity, and a run starts from one. Of speed and course"),
        remark("make columns: north = speed cos(course), east = speed sin(course), down = 0."),
        Line("velocity", BLANK, _left(table, taken)),
        Line("velocity_frame", BLANK, "ned, enu or ecef"),
        Line("velocity_unit", BLANK, SPEEDS),
    ]


def velocity_lines(table: Sampled) -> list[Line]:
    """Return the lines of a velocity whose columns are known by name, or none."""
    velocity = roles.triad(table, "velocity")
    if velocity is None:
        return []
    columns, letters = velocity
    frame = letters if letters != "xyz" else BLANK
    said = roles.unit_said(table, columns, ("mm/s", "m/s", "km/h"))
    return [
        Line("velocity", [table.column(k) for k in columns]),
        Line("velocity_frame", frame, "" if frame != BLANK else "ecef, ned or enu"),
        Line("velocity_unit", said or BLANK, "says the header" if said else SPEEDS),
    ]


def _deviation_lines(table: Sampled, geodetic: bool) -> list[Line]:
    lines = []
    for what, short, key, example in (
        ("position", "pos", "position_sigma_m", "[2.0, 2.0, 4.0]"),
        ("velocity", "vel", "velocity_sigma_mps", "[0.1, 0.1, 0.2]"),
    ):
        velocity = roles.triad(table, "velocity")
        axes = velocity[1] if what == "velocity" and velocity else "ned" if geodetic else "xyz"
        forms = (axes, "neu", "lla") if axes == "ned" and short == "pos" else (axes,)
        found = next((f for a in forms if (f := roles.deviations(table, a, short))), None)
        if found:
            names = [table.column(k) for k in found]
            lines.append(Line(f"{what}_sigma", names, "1σ; variances: " + f"{what}_variance"))
            lines += _deviation_unit(table, found, what)
        else:
            hint = f"1σ, e.g. {example}; or columns: {what}_sigma = [horizontal twice, vertical]"
            lines.append(Line(key, BLANK, hint))
    return lines


def _deviation_unit(table: Sampled, columns: list[int], what: str) -> list[Line]:
    """Return the unit of deviations that are too large for metres."""
    median = float(np.nanmedian(table.value[:, columns]))
    most = 100.0 if what == "position" else 30.0
    if median < most:
        return []
    unit = "mm" if what == "position" else "mm/s"
    return [Line(f"{what}_sigma_unit", unit, f"median {median:.4g}")]
