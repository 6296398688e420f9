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
from ..page.palette import SKY
from ..page.thinning import pieces, runs, thin
from ..results.directory import Result
from .coverage import gnss_state, state_names

#: Shading behind lines, by the three GNSS states of `gnss_state`.
_SHADES = (None, "#FBE7BF", "#DCDFE4")


def line(axes: Axes, t: FloatArray, y: FloatArray, wrap: float | None = None, **style) -> None:
    """Plot a thinned line, broken at holes in time and where an angle wraps."""
    if t.size == 0:
        return
    keep, cut = pieces(t, y, wrap)
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
            bars = runs(time - time[0], state == code, end)
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
