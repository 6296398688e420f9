"""The figures of the span that a reader selects: what the page computes them from."""

from __future__ import annotations

import base64
import json

import numpy as np

from ...filters.rotation import FloatArray
from ..evaluation.accuracy import rpy_covariance, standard_deviation
from ..page.quantities import quantity
from ..results.directory import Result
from ..results.formats import geodetic_and_ned

#: Rows a page carries at most; of more, every second, third … is left.
ROWS = 40_000
#: Columns that the page makes of north, east and up itself.
_MADE = ("horizontal", "position")
#: name, column, statistic, unit, heading
_JUDGED = (
    ("horizontal_rms", "horizontal", "rms", "m", "Horizontal RMS"),
    ("horizontal_p50", "horizontal", "p50", "m", "Horizontal 50 %"),
    ("horizontal_p95", "horizontal", "p95", "m", "Horizontal 95 %"),
    ("horizontal_max", "horizontal", "largest", "m", "Horizontal largest"),
    ("up_rms", "up", "rms", "m", "Up RMS"),
    ("position_rms", "position", "rms", "m", "Position 3D RMS"),
    ("velocity_rms", "velocity", "rms", "m/s", "Velocity 3D RMS"),
    ("roll_rms", "roll", "rms", "°", "Roll RMS"),
    ("pitch_rms", "pitch", "rms", "°", "Pitch RMS"),
    ("heading_rms", "heading", "rms", "°", "Heading RMS"),
    ("nees", "nees", "mean", "", "NEES position (ideal 3)"),
    ("inside", "inside", "share", "%", "Horizontal error within 3σ"),
)
_CLAIMED = (
    ("north_sigma", "north", "p50", "m", "North, 1σ, median"),
    ("east_sigma", "east", "p50", "m", "East, 1σ, median"),
    ("down_sigma", "down", "p50", "m", "Down, 1σ, median"),
    ("largest_sigma", "horizontal", "largest", "m", "Horizontal, 1σ, largest"),
    ("velocity_sigma", "velocity", "p50", "m/s", "Velocity, 1σ, median"),
    ("heading_sigma", "heading", "p50", "°", "Heading, 1σ, median"),
)


def span_table(result: Result, start: float) -> str:
    """Return the table of the whole run and the selected span, and what the page needs for it.

    Parameters
    ----------
    result : Result
    start : float
        GPS time of zero on the page's time axis [s].
    """
    time, columns, rows = _judged(result) if result.evaluation.has_reference else _claimed(result)
    rows = tuple(row for row in rows if np.isfinite(columns[row[1]]).any())
    every = -(-time.size // ROWS)
    lines = "".join(
        f'<tr><th>{heading}</th><td class="n">{quantity(_figure(columns[column], how), unit)}</td>'
        f'<td class="n" data-span="{name}"></td></tr>'
        for name, column, how, unit, heading in rows
    )
    of = "solution − reference" if result.evaluation.has_reference else "the filter claims"
    count = f'<td class="n">{time.size}</td><td class="n" data-span="count"></td>'
    data = {
        "t": _base64((time - start)[::every], "f8"),
        "columns": {
            name: _base64(value[::every], "u1" if value.dtype == bool else "f4")
            for name, value in columns.items()
            if name not in _MADE or not result.evaluation.has_reference
        },
        "rows": [
            {"name": name, "column": column, "statistic": how, "unit": unit}
            for name, column, how, unit, _ in rows
        ],
    }
    note = "" if every == 1 else f'<p class="note">The span from every {every}th epoch.</p>'
    return (
        f'<div class="wide"><table><thead><tr><th>{of.capitalize()}</th><th class="n">whole run'
        '</th><th class="n">selected span</th></tr></thead><tbody>'
        f"{lines}<tr><th>Epochs</th>{count}</tr></tbody></table></div>{note}\n"
        f'<script type="application/json" id="span-data">{json.dumps(data)}</script>'
    )


def _judged(result: Result) -> tuple[FloatArray, dict[str, FloatArray], tuple]:
    e = result.evaluation
    horizontal = np.hypot(e.error_pos_n[:, 0], e.error_pos_n[:, 1])
    sigma = np.hypot(e.sigma_pos_n[:, 0], e.sigma_pos_n[:, 1])
    columns = {
        "north": e.error_pos_n[:, 0],
        "east": e.error_pos_n[:, 1],
        "up": e.error_pos_n[:, 2],
        "horizontal": horizontal,
        "position": np.linalg.norm(e.error_pos_n, axis=1),
        "velocity": np.linalg.norm(e.error_vel_n, axis=1),
        **dict(zip(("roll", "pitch", "heading"), np.rad2deg(e.error_rpy).T, strict=True)),
        "nees": e.nees_position,
        "inside": horizontal <= 3.0 * sigma,
    }
    return e.time, columns, _JUDGED


def _claimed(result: Result) -> tuple[FloatArray, dict[str, FloatArray], tuple]:
    trajectory = result.solution.trajectory
    _, _, rpy_deg = geodetic_and_ned(trajectory)
    north, east, down = standard_deviation(trajectory.cov_pos_n).T
    cov_rpy = rpy_covariance(trajectory.cov_att_n, np.deg2rad(rpy_deg))
    columns = {
        "north": north,
        "east": east,
        "down": down,
        "horizontal": np.hypot(north, east),
        "velocity": np.sqrt(np.trace(trajectory.cov_vel_n, axis1=1, axis2=2)),
        "heading": np.rad2deg(standard_deviation(cov_rpy)[:, 2]),
    }
    return trajectory.time, columns, _CLAIMED


def _figure(values: FloatArray, how: str) -> float:
    known = values[np.isfinite(values)]
    if how == "rms":
        return float(np.sqrt(np.mean(known**2)))
    if how in ("p50", "p95"):
        return float(np.percentile(known, float(how[1:])))
    if how == "largest":
        return float(np.abs(known).max())
    return float(np.mean(known)) * (100.0 if how == "share" else 1.0)


def _base64(values: FloatArray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype=f"<{kind}").tobytes()).decode()
