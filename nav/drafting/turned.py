"""The gyro's columns and unit, the axes and the mounting, from gravity and motion."""

from __future__ import annotations

import numpy as np

from ...datasets.own.blanks import BLANK
from ...datasets.own.declaration import GYRO_UNITS
from ...datasets.own.draft import Draft
from ...datasets.series import ImuData
from ..check.orientation import (
    SQUARE_DEG,
    Orientation,
    mounting_rpy_deg,
    named,
    orientation,
)
from .clocks import Together

#: A unit is named where the slope is so near to it.
_NEAR = 0.10


def measure(draft: Draft, imu: ImuData, together: Together) -> Orientation | None:
    """Fill in the gyro's unit, the axes and a coarse mounting; return what was measured."""
    if not together.known:
        for key in ("gyro_unit", "axes"):
            if draft.asks("imu", key):
                draft.leave("imu", key, "not measured: IMU and GNSS are not on one clock")
        return None
    found = orientation(together.imu, together.track)
    _unit(draft, imu, found)
    if found.problem:
        draft.leave("imu", "axes", f"not measured: {found.problem}")
        return None
    _axes(draft, found)
    return found


def _unit(draft: Draft, imu: ImuData, found: Orientation) -> None:
    """Write the gyro's unit; a header that says another one is contradicted, not corrected."""
    rate, said = found.rate, draft.get("imu", "gyro_unit")
    if not rate.conclusive:
        if said == BLANK:
            reason = f"not measured: {np.degrees(rate.turned):.0f}° of turning that agree"
            if rate.turned == 0.0 or not np.isfinite(rate.ratio):
                reason = "not measured: too little turning"
            draft.leave("imu", "gyro_unit", reason)
        return
    increments = draft.get("imu", "accel_unit") == "m/s"
    # The trial has read a blank as rad/s, or as increments in rad.
    as_read = GYRO_UNITS[said][0] if said != BLANK else 1.0
    fits = [
        unit for unit, (factor, summed) in GYRO_UNITS.items()
        if summed == increments and abs(abs(rate.ratio) * factor / as_read - 1.0) < _NEAR
    ]  # fmt: skip
    turned = f"{np.degrees(rate.turned):.0f}° of turning"
    if len(fits) != 1:
        reason = (
            f"not measured: the rate about down is {abs(rate.ratio):.3g} times that of the course"
        )
        draft.leave("imu", "gyro_unit", reason)
        return
    slope = abs(rate.ratio) * GYRO_UNITS[fits[0]][0] / as_read
    evidence = f"measured: {slope:.3f} times the course over {turned}"
    if said in (BLANK, fits[0]):
        before = draft.comment("imu", "gyro_unit") if said != BLANK else ""
        draft.put("imu", "gyro_unit", fits[0], f"{before}; {evidence}" if before else evidence)
        return
    draft.leave("imu", "gyro_unit", f"{said} by names or size, but {evidence} as {fits[0]}")


def _axes(draft: Draft, found: Orientation) -> None:
    name, C_bv = named(found.C_sv)
    draft.put("imu", "axes", name, f"measured: {name}, {found.share}")
    rpy = mounting_rpy_deg(C_bv)
    sigma = float(np.degrees(found.sigma))
    if max(map(abs, rpy)) < SQUARE_DEG:
        seen = ", ".join(f"{v:+.1f}" for v in rpy)
        evidence = f"measured: square to {seen}° ± {sigma:.1f}°"
        draft.put("vehicle", "mounting_rpy_deg", [0.0, 0.0, 0.0], evidence)
        draft.put(
            "vehicle", "mounting_sigma_deg", SQUARE_DEG, "a run estimates pitch and yaw from there"
        )
        return
    evidence = f"measured: gravity, speed and cornering, ± {sigma:.1f}°"
    draft.put("vehicle", "mounting_rpy_deg", rpy, evidence)
    draft.put(
        "vehicle", "mounting_sigma_deg", max(round(2.0 * sigma, 1), SQUARE_DEG),
        "a run estimates pitch and yaw from there",
    )  # fmt: skip
