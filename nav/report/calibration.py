"""How IMU and antenna sit in the vehicle, as a run knew it in the end: each with its σ."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from ..page.tables import Column, Table


def calibration(installation: Mapping[str, Any] | None) -> str:
    """Return the section of the report; '' where the run was not asked.

    Parameters
    ----------
    installation : mapping, optional
        As `nav.installation.Installation.figures` has it, read back from summary.json.
    """
    if installation is None:
        return ""
    columns = (
        Column("calibration"), Column("unit"), Column("value", "", "+z.3f"),
        Column("1σ", "", ".3f"), Column("known from"),
    )  # fmt: skip
    rows = _antenna(installation["antenna"])
    words = ""
    if installation["nhc"] == "off":
        words = f"<p>Mounting and wheels were not used: {escape(installation['why_off'])}.</p>"
    else:
        rows = (*_mounting(installation), *rows)
    table = Table("calibration", "Calibration in the end", columns, rows, words=2)
    return f"<h2>Calibration</h2>\n{words}{table.html()}"


def _mounting(found: Mapping[str, Any]) -> tuple[tuple[object, ...], ...]:
    forward, _, down = found["wheels_vehicle_m"]
    s_forward, s_down = found["wheels_vehicle_sigma_m"]
    source = found["source"]
    return (
        ("IMU in the vehicle, yaw", "°", found["yaw_deg"], *_known(found["yaw_sigma_deg"], source)),
        ("IMU in the vehicle, pitch", "°", found["pitch_deg"],
         *_known(found["pitch_sigma_deg"], source)),
        ("wheels, forward of the IMU", "m", forward, *_known(s_forward, source)),
        ("wheels, down of the IMU", "m", down, *_known(s_down, source)),
    )  # fmt: skip


def _antenna(found: Mapping[str, Any]) -> tuple[tuple[object, ...], ...]:
    parts = zip(
        ("forward", "right", "down"), found["lever_frd_m"], found["lever_sigma_m"],
        found["lever_observed"], strict=True,
    )  # fmt: skip
    rows: list[tuple[object, ...]] = [
        (f"antenna, {axis} of the IMU", "m", value, *_known(sigma, "declared", seen))
        for axis, value, sigma, seen in parts
    ]
    late = found["delay_s"], *_known(found["delay_sigma_s"], "declared", found["delay_observed"])
    return (*rows, ("GNSS later than stamped", "s", *late))


def _known(sigma: float | None, source: str, observed: bool = True) -> tuple[float | None, str]:
    """Return 1σ, and where a value comes from."""
    if not sigma:
        return None, f"{source}, taken as exact"
    return sigma, "the run" if observed else "not observed: as it was assumed"
