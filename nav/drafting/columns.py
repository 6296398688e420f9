"""Columns that no name tells: which three are the gyro's, positions or velocities.

Three neighbouring columns are a position and three others its velocity where the one moves as the
other says; three are a gyro where their rate about down follows the course.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator

import numpy as np

from ...datasets.own import column_roles as roles
from ...datasets.own.blanks import BLANK
from ...datasets.own.declaration import ANGLE_UNITS
from ...datasets.own.draft import Draft
from ...datasets.text.columns import open_text
from ...datasets.time_scales import UNITS
from ...filters.rotation import FloatArray
from ...velocity.tracks import Track
from ..check.motion import integrals
from . import clocks, trial, turned
from .velocities import Found, matches

_FRAMES = ("ned", "enu", "ecef")
#: Rows are thinned to so many for it.
_ROWS = 3000


def find_positions(draft: Draft, section: str) -> None:
    """Fill in columns of position and velocity where exactly one choice of them agrees."""
    asked = [k for k in ("position", "velocity") if draft.asks(section, k)]
    if not asked or draft.asks(section, "time") or draft.get(section, "format"):
        return
    table = roles.sample(open_text(draft.home / draft.get(section, "file")))
    taken = roles.time_columns(table)
    k = roles.time_index(table)
    if k is None or not np.isfinite(table.value[:, k]).all():
        return
    time = table.value[:, k] * trial_seconds(draft, section)
    found = list(_pairs(draft, section, table, time, taken, asked))
    if len(found) != 1:
        reason = "no three columns move as three others say" if not found else "several would do"
        for key in asked:
            draft.leave(section, key, f"not measured: {reason}")
        return
    (place, velocity), match = found[0]
    evidence = "measured: these move as the velocity beside them says"
    if "position" in asked:
        draft.sections[section] = [
            line for line in draft.sections[section] if line.key or "position" not in line.comment
        ]
        draft.put(section, "position", [table.column(c) for c in place], evidence)
        draft.put(section, "position_frame", "lla" if match.angle_unit else "ecef", evidence)
        if match.angle_unit:
            draft.put(section, "angle_unit", match.angle_unit, evidence)
            if match.angle_unit == "1e-7deg":
                draft.put(section, "height_unit", BLANK, "m or mm", after="height")
        else:
            for key in ("angle_unit", "height"):
                draft.drop(section, key)
    draft.sections[section] = [
        line for line in draft.sections[section] if line.key or "elocity" not in line.comment
    ]
    draft.put(section, "velocity", [table.column(c) for c in velocity], evidence)
    draft.put(section, "velocity_frame", match.frame, evidence)


def trial_seconds(draft: Draft, section: str) -> float:
    """Return the unit of a section's stamps [s]."""
    unit = draft.get(section, "time_unit", "s")
    return UNITS.get(unit, 1.0)


def _pairs(
    draft: Draft,
    section: str,
    table: roles.Sampled,
    time: FloatArray,
    taken: set[int],
    asked: list[str],
) -> Iterator[tuple[tuple[list[int], list[int]], Found]]:
    """Yield columns of positions and velocities that agree, and how."""
    names = list(range(table.value.shape[1]))
    free = [k for k in names if k not in taken and np.isfinite(table.value[:, k]).any()]
    triples = [[k, k + 1, k + 2] for k in free if {k, k + 1, k + 2} <= set(free)]
    places = triples
    if "position" not in asked:
        known = draft.get(section, "position")
        places = [[table.source.index(column, "position") for column in known]]
    rows = slice(None, None, max(1, time.size // _ROWS))
    for place, velocity in itertools.product(places, triples):
        if set(place) & set(velocity):
            continue
        p, v = table.value[rows][:, place], table.value[rows][:, velocity]
        if np.abs(np.nanmedian(v)) > 1e3 or not np.nanstd(v[:, :2]) > 0.0:
            continue
        radius = float(np.nanmedian(np.linalg.norm(p, axis=1)))
        frame = "ecef" if 6.3e6 < radius < 6.5e6 else "lla"
        frames = ("ecef",) if frame == "ecef" else _FRAMES
        for match in matches(time[rows], p, v, frame, tuple(ANGLE_UNITS), frames):
            # Three columns that begin one later match as well, if only by their first two.
            if frame == "lla" and not _is_height(p[:, 2], match.angle_unit):
                continue
            yield (place, velocity), match


def _is_height(value: FloatArray, angle_unit: str) -> bool:
    """Return whether numbers can be heights in m, or beside 1e-7 degrees in mm."""
    unit = 1e3 if angle_unit == "1e-7deg" else 1.0
    inside = np.nanmin(value) > -500.0 * unit and np.nanmax(value) < 9000.0 * unit
    return bool(inside and np.nanstd(value) > 0.0)


def find_gyro(draft: Draft, track: Track, theirs: clocks.Clock) -> None:
    """Fill in the gyro's columns where exactly one choice of three neighbours is one."""
    if not draft.asks("imu", "gyro") or draft.asks("imu", "accel"):
        return
    table = roles.sample(open_text(draft.home / draft.get("imu", "file")))
    accel = [table.source.index(column, "accel") for column in draft.get("imu", "accel")]
    taken = roles.time_columns(table) | set(accel)
    free = [k for k in range(table.value.shape[1]) if k not in taken]
    good = []
    for k in free:
        triple = [k, k + 1, k + 2]
        if not set(triple) <= set(free) or roles.is_other_sensor(table, triple):
            continue
        draft_k = copy.deepcopy(draft)
        columns = [table.column(c) for c in triple]
        draft_k.put("imu", "gyro", columns)
        imu = trial.imu_of(draft_k)
        if imu is None:
            continue
        ours = clocks.clock_of(draft_k, "imu", imu.time)
        together = clocks.measure(draft_k, integrals(imu), track, ours, theirs)
        turned.measure(draft_k, imu, together)
        if not draft_k.asks("imu", "gyro_unit") and draft_k.get("imu", "axes") != BLANK:
            good.append(columns)
    if len(good) == 1:
        draft.put("imu", "gyro", good[0], "measured: their rate about down follows the course")
