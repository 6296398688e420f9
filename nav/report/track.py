"""The map of a run: its track over the reference, coloured by what GNSS could do."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...filters.earth import C_en_of, lla_to_ecef
from ...filters.rotation import FloatArray
from ..page.palette import BLUE, INK, ORANGE, VERMILLION
from ..results.directory import Result
from .coverage import gnss_state, state_names

#: Colours of the three GNSS states of `gnss_state`.
STATE_COLOURS = (BLUE, ORANGE, VERMILLION)


def track(result: Result) -> Figure:
    """Draw the track over the reference, metres east and north of the start."""
    trajectory, evaluation = result.solution.trajectory, result.evaluation
    to_ned = C_en_of(trajectory.pos_e[0])
    ned = (trajectory.pos_e - trajectory.pos_e[0]) @ to_ned
    figure = Figure(figsize=(7.2, 6.2))
    axes = figure.subplots()
    if evaluation.has_reference:
        ref_e = lla_to_ecef(*evaluation.ref_lla.T)
        ref = (ref_e - trajectory.pos_e[0]) @ to_ned
        keep = _shape_points(ref)
        axes.plot(ref[keep, 1], ref[keep, 0], color="#111111", linewidth=4.2, alpha=0.28,
                  label="reference")  # fmt: skip
    keep = _shape_points(ned)
    state, north_east = gnss_state(result)[keep], ned[keep]
    for code, (colour, name) in enumerate(zip(STATE_COLOURS, state_names(result), strict=True)):
        mask = state == code
        mask[1:] |= mask[:-1].copy()  # up to the next point, so that no piece is missing
        if (state == code).any():
            line = np.where(mask[:, None], north_east, np.nan)
            axes.plot(line[:, 1], line[:, 0], color=colour, linewidth=1.7 + 0.5 * (code > 0),
                      label=name)  # fmt: skip
    ends = ((ned[0], "o", 6, 6, "start"), (ned[-1], "s", 10, 5, "end"))
    for point, marker, size, layer, name in ends:
        axes.plot(point[1], point[0], marker, color="white", markeredgecolor=INK,
                  markeredgewidth=1.6, markersize=size, zorder=layer, label=name)  # fmt: skip
    _equal_limits(axes, ned)
    _scale_bar(axes, ned)
    axes.set_xlabel("east of start [m]")
    axes.set_ylabel("north of start [m]")
    figure.legend(loc="outside upper left", ncols=4, columnspacing=1.4)
    return figure


def _shape_points(ned: FloatArray, points: int = 6000) -> np.ndarray:
    return np.unique(np.append(np.arange(0, len(ned), -(-len(ned) // points)), len(ned) - 1))


def _equal_limits(axes: Axes, ned: FloatArray, shape: float = 1.15) -> None:
    """Make a metre the same length both ways, `shape` wide to high, and the map at least 20 m."""
    low, high = ned[:, [1, 0]].min(axis=0), ned[:, [1, 0]].max(axis=0)
    middle, half = (low + high) / 2, np.maximum(0.56 * (high - low), 10.0)
    half = max(half[0] / shape, half[1]) * np.array([shape, 1.0])
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_aspect("equal")


def _scale_bar(axes: Axes, ned: FloatArray) -> None:
    """Draw a bar of 1, 2 or 5 times a power of ten metres in the corner the track leaves free."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    target = 0.22 * (right - left)
    decade = 10.0 ** np.floor(np.log10(target))
    length = decade * max(f for f in (1.0, 2.0, 5.0) if f * decade <= target)
    u, v = (ned[:, 1] - left) / (right - left), (ned[:, 0] - bottom) / (top - bottom)
    corners = [(0.04, 0.05), (0.74, 0.05), (0.04, 0.90), (0.74, 0.90)]
    busy = [
        np.sum((np.abs(u - x - 0.11) < 0.15) & (np.abs(v - y - 0.02) < 0.08)) for x, y in corners
    ]
    x, y = corners[int(np.argmin(busy))]
    x, y = left + x * (right - left), bottom + y * (top - bottom)
    axes.plot([x, x + length], [y, y], color=INK, linewidth=2.5, solid_capstyle="butt")
    axes.text(x + length / 2, y + 0.012 * (top - bottom), f"{length:g} m", ha="center", va="bottom")
