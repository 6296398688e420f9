"""What a check measured to be other than declared, as lines to paste into the declaration.

A lag, a mounting or a lever arm beyond three of its σ is no thing found in order: a run is better
for having it declared, and the line to do so stands beside what was measured. Where the format has
no key for it, that is said instead.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...datasets.loading import formats, recognise
from ...datasets.own.declaration import GYRO_UNITS, NAME, imu_axes, read_declaration
from ...datasets.sequence import Sequence
from ...filters.rotation import FloatArray, matrix_from_rpy, rpy_from_matrix, wrap_angle
from .findings import Finding
from .mounting import with_roll_of
from .orientation import SQUARE_DEG, mounting_rpy_deg, named
from .timing import SIGNIFICANT

#: A gyro's unit is named where the slope against the course is so near to it.
_NEAR = 0.10
#: Files that hold declarations, and their keys: section and key of each quantity.
_FILES = {"declared": NAME, "great": "great.toml"}
_MOUNTING = {"declared": "[vehicle]\nmounting_rpy_deg", "great": "mounting_rpy_deg"}
_LEVER = {"declared": "[antenna]\nlever_frd_m", "great": "lever_antenna_frd_m"}


def with_declarations(
    findings: Iterable[Finding], sequence: Sequence, path: str | Path, options: Mapping[str, Any]
) -> list[Finding]:
    """Return the findings, with the line to declare where what was measured is significant.

    Parameters
    ----------
    findings : iterable of Finding
    sequence : Sequence
        As it was read, with what is declared in it.
    path : path
        Where from.
    options : mapping
        Options of the reader it was read with.
    """
    kind = str(options.get("format") or recognise(path))
    makers = {
        "time, IMU and GNSS": _time, "orientation": _orientation, "mounting": _mounting,
        "lever arm": _lever,
    }  # fmt: skip
    out = []
    for finding in findings:
        maker = makers.get(finding.subject)
        line = ""  # what is fatal is another fault than a wrong number
        if maker is not None and finding.severity != "fatal":
            line = maker(finding, sequence, path, kind, options)
        out.append(dataclasses.replace(finding, declare=line) if line else finding)
    return out


def _time(
    finding: Finding, sequence: Sequence, path: str | Path, kind: str, options: Mapping[str, Any]
) -> str:
    n = finding.numbers
    if "offset_s" not in n or abs(n["offset_s"]) <= SIGNIFICANT * n["offset_sigma_s"]:
        return ""
    sigma = f"  # ± {n['offset_sigma_s']:.3f}"
    if kind == "declared":
        declared = read_declaration(path)
        before = declared.time_scale(declared.sections["imu"]).offset
        return f"# {NAME}\n[imu]\ntime_offset_s = {before - n['offset_s']:.3f}{sigma}"
    defaults = formats()[kind].defaults
    if "imu_lag" in defaults:
        before = float(options.get("imu_lag", defaults["imu_lag"]))
        return f"[data]\nimu_lag = {before + n['offset_s']:.3f}{sigma}"
    verb = "subtract" if n["offset_s"] > 0.0 else "add"
    return f"# {kind} has no key for it: {verb} {abs(n['offset_s']):.3f} s, IMU stamps"


def _orientation(
    finding: Finding, sequence: Sequence, path: str | Path, kind: str, options: Mapping[str, Any]
) -> str:
    """Return axes, mounting and gyro unit as the file really has them."""
    n = finding.numbers
    C_bv = matrix_from_rpy(np.radians([n["roll_deg"], n["pitch_deg"], n["yaw_deg"]])).T
    if kind != "declared":
        angles = np.degrees(rpy_from_matrix(C_bv.T))
        return _vector(_MOUNTING, kind, "roll, pitch, yaw", angles, f"± {n['sigma_deg']:.1f}")
    section = read_declaration(path).sections["imu"]
    name, C_bv = named(imu_axes(section).T @ C_bv)
    square = max(map(abs, rpy := mounting_rpy_deg(C_bv))) < SQUARE_DEG
    lines = [f'axes = "{name}"  # {finding.found}']
    unit = _gyro_unit(str(section.values["gyro_unit"]), n.get("yaw_over_course", 1.0))
    if unit != section.values["gyro_unit"]:
        lines.append(f'gyro_unit = "{unit}"')
    mounting = f"mounting_rpy_deg = {[0.0, 0.0, 0.0] if square else rpy}  # ± {n['sigma_deg']:.1f}"
    return "\n".join([f"# {NAME}", "[imu]", *lines, "[vehicle]", mounting])


def _gyro_unit(declared: str, ratio: float) -> str:
    """Return the unit in which a gyro turns as the course does; the declared one if in none."""
    factor, summed = GYRO_UNITS[declared]
    return next(
        (
            unit for unit, (size, increments) in GYRO_UNITS.items()
            if increments == summed and abs(abs(ratio) * size / factor - 1.0) < _NEAR
        ),
        declared,
    )  # fmt: skip


def _mounting(
    finding: Finding, sequence: Sequence, path: str | Path, kind: str, options: Mapping[str, Any]
) -> str:
    n, C_bv = finding.numbers, sequence.calibration.C_bv
    values = with_roll_of(C_bv, n["pitch_deg"], n["yaw_deg"])
    sigma = np.radians([n["pitch_sigma_deg"], n["yaw_sigma_deg"]])
    off = np.radians(values[1:]) - rpy_from_matrix(C_bv.T)[1:]
    if (np.abs(wrap_angle(off)) <= SIGNIFICANT * sigma).all():
        return ""
    note = f"pitch ± {n['pitch_sigma_deg']:.2f}, yaw ± {n['yaw_sigma_deg']:.2f}"
    return _vector(_MOUNTING, kind, "roll, pitch, yaw", values, note)


def _lever(
    finding: Finding, sequence: Sequence, path: str | Path, kind: str, options: Mapping[str, Any]
) -> str:
    n, calibration, reference = finding.numbers, sequence.calibration, sequence.reference
    # A known arm is not measured anew: what contradicts it is a doubt, and is said as one.
    if "lever_forward_m" not in n or calibration.lever_antenna_sigma <= 0.0:
        return ""
    # Seen from a reference at another point, the arm is not the IMU's.
    if reference is None or reference.point != "imu":
        return ""
    measured = np.array([n["lever_forward_m"], n["lever_right_m"]])
    miss = np.abs(measured - calibration.lever_antenna_b[:2])
    if (miss <= SIGNIFICANT * n["lever_sigma_m"]).all():
        return ""
    values = np.append(measured, calibration.lever_antenna_b[2])
    return _vector(
        _LEVER, kind, "forward, right, down", values, f"forward, right ± {n['lever_sigma_m']:.2f}"
    )


def _vector(keys: Mapping[str, str], kind: str, what: str, values: FloatArray, note: str) -> str:
    text = ", ".join(f"{value:.2f}" for value in values + 0.0)
    if kind not in keys:
        return f"# {kind} has no key for it: {what} = [{text}]  # {note}"
    return f"# {_FILES[kind]}\n{keys[kind]} = [{text}]  # {note}"
