"""What figures over time have in common: one axis, what GNSS could do behind, thinned lines.

Every time plot shares one axis, seconds since the first solution epoch, and shades where GNSS fell
short. Lines are thinned to what a page resolves, keeping the extremes of every stretch.
"""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from ...filters.rotation import FloatArray
from ..evaluation.accuracy import usable_at
from ..page.pictures import SKY
from ..results.directory import Result

#: Shading behind lines, by the three GNSS states of `gnss_state`.
_SHADES = (None, "#FBE7BF", "#DCDFE4")


def gnss_state(result: Result) -> np.ndarray:
    """Return what GNSS could do at each solution epoch: 0 position, 1 velocity only, 2 nothing.

    From the usable satellites (≥ 4, 2–3, < 2) where there are observations; for a set of fixes,
    2 means that no position was accepted for 3 s or 3 usual intervals.
    """
    time = result.solution.trajectory.time
    usable = usable_at(result.solution.epochs, time)
    if (usable >= 0).all():
        return np.where(usable >= 4, 0, np.where(usable >= 2, 1, 2))
    accepted = [u.time for u in result.solution.updates if u.accepted and u.kind == "position"]
    fixes = np.array([-np.inf, *accepted])
    limit = max(3.0, 3.0 * float(np.median(np.diff(accepted)))) if len(accepted) > 1 else 3.0
    age = time - fixes[np.searchsorted(fixes, time + 1e-6, side="right") - 1]
    return np.where(age <= limit, 0, 2)


def state_names(result: Result) -> tuple[str, str, str]:
    """Return the names of the three states of `gnss_state`."""
    if (result.solution.epochs.usable >= 0).any():
        return ("≥ 4 satellites usable", "2–3 usable", "fewer than 2 usable")
    return ("position fixes accepted", "", "no position accepted")


def thin(values: FloatArray, bins: int = 800) -> np.ndarray:
    """Return indices that keep the least and greatest of `values` in each of `bins` stretches."""
    if values.size <= 2 * bins:
        return np.arange(values.size)
    width = -(-values.size // bins)
    padded = np.full(width * -(-values.size // width), np.nan)
    padded[: values.size] = values
    rows = padded.reshape(-1, width)
    unknown = np.isnan(rows)
    first = np.arange(len(rows)) * width
    low = first + np.where(unknown, np.inf, rows).argmin(axis=1)
    high = first + np.where(unknown, -np.inf, rows).argmax(axis=1)
    return np.unique(np.concatenate([low, high, [0, values.size - 1]]))


def line(axes: Axes, t: FloatArray, y: FloatArray, wrap: float | None = None, **style) -> None:
    """Plot a thinned line, broken at holes in time and where an angle wraps."""
    if t.size == 0:
        return
    step = np.diff(t, prepend=t[0])
    hole = step > max(1.5, 5.0 * float(np.median(step)))
    if wrap:
        hole |= np.abs(np.diff(y, prepend=y[0])) > wrap / 2
    keep = np.union1d(thin(y), np.flatnonzero(hole | np.roll(hole, -1)))
    keep = keep if keep.size < 8000 else thin(y)
    piece = np.cumsum(hole)[keep]
    cut = np.flatnonzero(np.diff(piece)) + 1
    marker = "." if keep.size == 1 else None
    axes.plot(np.insert(t[keep], cut, np.nan), np.insert(y[keep], cut, np.nan), marker=marker,
              **style)  # fmt: skip


def band(axes: Axes, t: FloatArray, centre: FloatArray, sigma3: FloatArray) -> None:
    keep = thin(sigma3, 300)
    low, high = (centre - sigma3)[keep], (centre + sigma3)[keep]
    axes.fill_between(t[keep], low, high, color=SKY, alpha=0.35, edgecolor=SKY, linewidth=0.7,
                      label="±3σ")  # fmt: skip


def finish(figure: Figure, grid: np.ndarray, result: Result) -> None:
    """Shade the outages, set the common time axis, and put one legend on top."""
    time = result.solution.trajectory.time
    end = max(float(time[-1] - time[0]), 1e-3)
    state, names = gnss_state(result), state_names(result)
    handles: dict[str, Artist] = {}
    for axes in grid.ravel():
        for code in (1, 2):
            bars = _runs(time - time[0], state == code, end)
            if bars:
                axes.broken_barh(bars, (0, 1), transform=axes.get_xaxis_transform(), zorder=0,
                                 facecolor=_SHADES[code], linewidth=0)  # fmt: skip
        axes.set_xlim(0.0, end)
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    for code in (1, 2):
        if (state == code).any():
            handles[names[code]] = Patch(facecolor=_SHADES[code])
    for axes in grid[-1]:
        axes.set_xlabel("time since start [s]")
    figure.legend(list(handles.values()), list(handles), loc="outside upper right", ncols=6,
                  columnspacing=1.4)  # fmt: skip


def _runs(t: FloatArray, mask: np.ndarray, end: float) -> list[tuple[float, float]]:
    """Return (start, width) where `mask` holds; runs closer than a pixel are joined."""
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    starts, stops = t[edges[:-1] == 1], np.append(t, end)[np.flatnonzero(edges == -1)]
    if not starts.size:
        return []
    apart = starts[1:] - stops[:-1] > end / 1500.0
    starts, stops = starts[np.r_[True, apart]], stops[np.r_[apart, True]]
    return [(float(a), float(b - a)) for a, b in zip(starts, stops, strict=True)]
