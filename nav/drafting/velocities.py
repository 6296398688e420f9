"""Frame and unit of velocities, and the unit of latitudes, from the positions beside them.

Positions are regressed on the integral of the velocities (`datasets.displacement`): in order, the
matrix between them is the identity times the unit.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np

from ...datasets.displacement import Agreement, agreement
from ...datasets.own.blanks import BLANK
from ...datasets.own.declaration import ANGLE_UNITS, LENGTH_UNITS, SPEED_UNITS
from ...datasets.own.draft import Draft
from ...filters.earth import C_en_of, lla_to_ecef
from ...filters.rotation import FloatArray
from . import trial

#: A unit is named where the factor is so near to it; the next two, km/h and ft/s, are 9 % apart.
_NEAR = 0.04
#: And what no unit explains is less than this share of the way.
_ELSEWHERE = 0.15
#: Vertical motion that shows a unit: correlation of heights with the integral of velocities.
_CORRELATED = 0.9
_TO_NED = {"ned": np.eye(3), "enu": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])}


class Found(NamedTuple):
    """A frame and units in which positions move as velocities say."""

    angle_unit: str
    frame: str
    speed_unit: str
    agrees: Agreement
    factor: float


def measure(draft: Draft, section: str) -> None:
    """Fill in frame and unit of a section's velocity, and the unit of its angles."""
    if not trial.readable(draft, section) or draft.get(section, "format"):
        return
    said = draft.get(section, "velocity")
    if said in (None, BLANK):
        return
    timed = trial.columns_of(draft, section, {"position": 3, "velocity": 3})
    position, velocity = timed.columns.numbers["position"], timed.columns.numbers["velocity"]
    frame_of = draft.get(section, "position_frame")
    found = matches(
        timed.time, position, velocity, frame_of,
        _choices(draft.get(section, "angle_unit"), tuple(ANGLE_UNITS)),
        _choices(draft.get(section, "velocity_frame"), ("ned", "enu", "ecef")),
    )  # fmt: skip
    if len(found) != 1:
        several = " and ".join(f"{f.frame} in {f.speed_unit}" for f in found)
        _leave(draft, section, f"fits as {several}" if found else "too little motion, or none fits")
        return
    _fill(draft, section, found[0])
    if frame_of == "lla" and found[0].frame != "ecef":
        down = velocity @ _TO_NED[found[0].frame][2] * SPEED_UNITS[found[0].speed_unit]
        _vertical(draft, section, timed.time, position[:, 2], down)


def matches(
    time: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    position_frame: str,
    angle_units: tuple[str, ...],
    frames: tuple[str, ...],
) -> list[Found]:
    """Return in which units and frames columns of positions and velocities agree.

    Parameters
    ----------
    time : ndarray, shape (n,)
        [s].
    position, velocity : ndarray, shape (n, 3)
        As in the file.
    position_frame : {'lla', 'ecef'}
    angle_units, frames : tuple of str
        To be tried.
    """
    out = []
    for angle, frame in itertools.product(
        angle_units if position_frame == "lla" else ("",), frames
    ):
        pos_e = position
        if position_frame == "lla":
            lat, lon = position[:, :2].T * ANGLE_UNITS[angle]
            if not (np.nanmax(np.abs(lat)) <= np.pi / 2 and np.nanmax(np.abs(lon)) <= 2 * np.pi):
                continue
            pos_e = lla_to_ecef(lat, lon, np.zeros(lat.size))
        vel_e = velocity
        if frame != "ecef":
            vel_e = np.einsum("nij,nj->ni", C_en_of(pos_e) @ _TO_NED[frame], velocity)
        found = agreement(time, pos_e, vel_e)
        unit = None if found is None else _unit(found)
        if unit is not None and found is not None:
            out.append(Found(angle, frame, unit[0], found, unit[1]))
    return out


def _unit(found: Agreement) -> tuple[str, float] | None:
    """Return the unit of speed for which positions and velocities agree, and the factor."""
    X = found.root @ found.root.T
    factor = float(np.trace(found.B @ X) / np.trace(X))
    if not factor > 0.0 or found.misfit(factor * np.eye(2)) > _ELSEWHERE:
        return None
    if found.unexplained(factor * np.eye(2)) > _ELSEWHERE or found.sigma > _NEAR * factor:
        return None
    name = min(SPEED_UNITS, key=lambda u: abs(np.log(factor / SPEED_UNITS[u])))
    return (name, factor) if abs(factor / SPEED_UNITS[name] - 1.0) < _NEAR else None


def _choices(said: Any, all_of: tuple[str, ...]) -> tuple[str, ...]:
    return all_of if said in (None, BLANK) else (str(said),)


def _fill(draft: Draft, section: str, found: Found) -> None:
    ratio = found.factor / SPEED_UNITS[found.speed_unit]
    evidence = f"measured: positions move {ratio:.2f} times as far as velocities say"
    if draft.asks(section, "angle_unit"):
        draft.put(section, "angle_unit", found.angle_unit, evidence)
    if draft.asks(section, "velocity_frame"):
        draft.put(section, "velocity_frame", found.frame, evidence)
    said = draft.get(section, "velocity_unit")
    if said in (BLANK, found.speed_unit):
        before = "says the header; " if said != BLANK else ""
        draft.put(section, "velocity_unit", found.speed_unit, before + evidence)
    else:
        draft.leave(
            section, "velocity_unit", f"{said} says the header, {found.speed_unit} was measured"
        )


def _leave(draft: Draft, section: str, reason: str) -> None:
    for key in ("angle_unit", "velocity_frame", "velocity_unit"):
        if draft.asks(section, key):
            draft.leave(section, key, f"not measured: {reason}")


def _vertical(
    draft: Draft, section: str, time: FloatArray, height: FloatArray, down: FloatArray
) -> None:
    """Fill in the unit of heights from the vertical velocity, and doubt a sign that contradicts."""
    good = np.isfinite(height) & np.isfinite(down)
    t, h, v = time[good], height[good], down[good]
    step = np.diff(t)
    climbed = np.concatenate([[0.0], np.cumsum(-0.5 * (v[1:] + v[:-1]) * step)])
    a, b = _without_trend(t, climbed), _without_trend(t, h)
    size = float(np.sqrt((a @ a) * (b @ b)))
    if size == 0.0 or abs(float(a @ b)) < _CORRELATED * size:
        return
    slope = float((a @ b) / (a @ a))
    if slope < 0.0:
        key = "velocity_frame"
        draft.leave(section, key, f"{draft.get(section, key)} fits but for the vertical: reversed")
        return
    unit = min(LENGTH_UNITS, key=lambda u: abs(np.log(slope * LENGTH_UNITS[u])))
    unsaid = draft.asks(section, "height_unit") or not draft.has(section, "height_unit")
    if (
        unsaid
        and abs(slope * LENGTH_UNITS[unit] - 1.0) < 0.3
        and not (unit == "m" and not draft.has(section, "height_unit"))
    ):
        evidence = f"measured: heights change by {slope:.3g} for 1 m of climbing"
        draft.put(section, "height_unit", unit, evidence, after="height")


def _without_trend(t: FloatArray, y: FloatArray) -> FloatArray:
    A = np.column_stack([np.ones_like(t), t - t[0]])
    return np.asarray(y - A @ np.linalg.lstsq(A, y, rcond=None)[0])
