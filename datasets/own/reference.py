"""The declared reference trajectory: which point, whose attitude, in which convention.

None of the three is in any file of numbers, and each is worth metres or degrees: all are asked.
"""

from __future__ import annotations

import numpy as np

from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray
from ..axes import rpy_of
from ..series import Reference
from ..text.columns import Column
from ..text.tables import sampling_note
from .declaration import (
    ANGLE_UNITS,
    LEVER_LINE,
    REFERENCE_FORMATS,
    Declaration,
    Section,
    attitude_convention,
    lever,
)
from .pvt_columns import read_pvt


def read_reference(
    declared: Declaration, lever_antenna_b: FloatArray, wheels_b: FloatArray
) -> tuple[Reference | None, list[str]]:
    """Return the declared reference on its declared point, and notes.

    Parameters
    ----------
    declared : Declaration
    lever_antenna_b, wheels_b : array_like, shape (3,)
        From the IMU to antenna and vehicle point, forward-right-down [m].

    Raises
    ------
    ConfigError
        Point, source or attitude not declared.
    DataError
        Unreadable files, or velocities that contradict the positions.
    """
    section = declared.section("reference")
    if section is None:
        return None, ["no reference"]
    point = section.text(
        "point", 'point = "antenna"', "which point the trajectory is of: imu, antenna, vehicle …"
    )
    known = {"imu": np.zeros(3), "antenna": lever_antenna_b, "vehicle": wheels_b}
    if point in known and section.has("lever_frd_m"):
        raise ConfigError(
            f'{section.file}: [reference] point = "{point}" needs no lever_frd_m: drop one of them'
        )
    if point == "vehicle" and not declared.sections["vehicle"].has("wheels_frd_m"):
        raise declared.sections["vehicle"].missing("wheels_frd_m = [-1.0, 0.0, 0.5]", "of the IMU")
    lever_b = known[point] if point in known else lever(section, "lever_frd_m", LEVER_LINE)
    source = section.text(
        "source", 'source = "Inertial Explorer, tactical IMU"', "and whether it is independent"
    )
    frame = {"imu": "b", "vehicle": "v"}
    kind = section.choice("format", REFERENCE_FORMATS, 'format = "csv"', default="csv")
    of = "imu"
    if kind != "rtklib" and (kind != "csv" or section.has("attitude")):
        of = section.choice(
            "attitude_of", frame, 'attitude_of = "vehicle"', "whose attitude: imu or vehicle"
        )
    time, pos_e, vel_e, rpy, notes = _trajectory(declared, section, kind)
    reference = Reference(
        time=time, pos_e=pos_e, vel_e=vel_e, rpy=rpy, lever_b=lever_b, point=point,
        source=source, attitude_frame=frame[of],
    )  # fmt: skip
    return reference, [sampling_note(time, f"reference of the {point}"), *notes]


def _trajectory(
    declared: Declaration, section: Section, kind: str
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[str, ...]]:
    """Return time, position, velocity, roll-pitch-heading and notes of the reference."""
    if kind == "inertial-explorer":
        from ..formats.inertial_explorer import read_reference_table

        t = read_reference_table(section.path())
        return t.time, t.pos_e, t.vel_e, t.rpy, t.notes
    if kind == "kf-gins":
        from ..formats.kfgins import read_nav

        week = declared.week(section) if section.has("week") or "time" in declared.sections else 0
        nav = read_nav(section.path(), week=week)
        return nav.time, nav.pos_e, nav.vel_e, nav.rpy, ()
    if kind == "rtklib":
        from ..formats.rtklib_pos import read_pos

        fixes = read_pos(section.path())
        return fixes.time, fixes.pos_e, fixes.vel_e, np.full((len(fixes), 3), np.nan), ()
    extra: dict[str, tuple[Column, ...]] = {}
    if section.has("attitude"):
        extra["attitude"] = section.columns("attitude", (1, 3), "")
        convention = attitude_convention(section)
        unit = section.choice("attitude_unit", ANGLE_UNITS, 'attitude_unit = "deg"')
    pvt = read_pvt(section, declared.time_scale(section), deviations=False, extra=extra)
    rpy = np.full((pvt.time.size, 3), np.nan)
    if extra:
        angles = pvt.columns.numbers["attitude"] * ANGLE_UNITS[unit]
        rpy[:, 3 - angles.shape[1] :] = angles  # one column: heading alone
        rpy = rpy_of(rpy, convention)
    return pvt.time, pvt.pos_e, pvt.vel_e, rpy, pvt.notes
