"""Panels of what bounds a position: protection levels, and how far two halves of data part."""

from __future__ import annotations

import numpy as np
from bokeh.models import Plot, Span

from ..page.palette import BLUE, GREY, INK, ORANGE, VERMILLION
from ..page.plots import decade_marks
from .timeline import Timeline

#: A zero has no place on a logarithmic axis.
_LEAST = 1e-3


def protection(panels: Timeline) -> list[list[Plot]]:
    """Draw the protection levels over errors and σ; nothing where there are none."""
    trajectory, evaluation = panels.trajectory, panels.result.evaluation
    if not np.isfinite(trajectory.protection).any():
        return []
    error, cov = evaluation.error_pos_n, trajectory.cov_pos_n
    sigma = np.sqrt(np.maximum(cov[:, 0, 0], cov[:, 1, 1])), np.sqrt(cov[:, 2, 2])
    off = np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])
    rows = []
    for k, name in enumerate(("horizontal", "vertical")):
        what = "level, error, σ" if evaluation.has_reference else "level and σ"
        drawn = [
            trajectory.protection[:, k],
            sigma[k],
            *([off[k]] if evaluation.has_reference else []),
        ]
        plot = panels.panel(f"{name} [m]", f"{name.capitalize()}: {what}", logarithmic=True,
                            ticks=decade_marks(np.concatenate(drawn)))  # fmt: skip
        panels.line(
            plot, panels.t, trajectory.protection[:, k], VERMILLION, "protection level", "m"
        )
        panels.line(plot, panels.t, sigma[k], GREY, "1σ", "m")
        if evaluation.has_reference:
            t = evaluation.time - panels.board.start
            panels.line(plot, t, np.maximum(off[k], _LEAST), BLUE, "error", "m")
        rows.append([plot])
    return rows


def separation(panels: Timeline) -> list[list[Plot]]:
    """Draw forward and backward less smoothed positions, and χ²; nothing where there are none."""
    found = panels.result.solution.separation
    if found is None:
        return []
    t, known = found.time - panels.board.start, np.isfinite(found.chi2)
    rows = []
    for k, name in enumerate(("north", "east", "down")):
        plot = panels.panel(f"{name} [m]", name.capitalize())
        panels.line(plot, t, found.forward_n[:, k], BLUE, "forward − smoothed", "m", scale=True)
        if known.any():
            panels.line(plot, t[known], found.backward_n[known, k], ORANGE, "backward − smoothed",
                        "m", scale=True)  # fmt: skip
        rows.append([plot])
    if known.any():
        plot = panels.panel("χ², 3 dof [1]", "χ² of what is between them", logarithmic=True)
        panels.line(plot, t[known], np.maximum(found.chi2[known], _LEAST), INK, "χ²", "")
        plot.add_layout(Span(location=3.0, dimension="width", line_color=GREY, line_dash="dashed"))
        rows.append([plot])
    return rows
