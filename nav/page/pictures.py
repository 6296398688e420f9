"""Figures for papers: one style for all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import matplotlib
from matplotlib.figure import Figure

from .palette import INK

T = TypeVar("T")

#: Of a figure over the whole of a page [in].
WIDTH = 11.2
_STYLE = {
    "font.family": "DejaVu Sans", "font.size": 9.0, "axes.titlesize": 9.0,
    "axes.labelsize": 9.0, "xtick.labelsize": 8.5, "ytick.labelsize": 8.5,
    "legend.fontsize": 8.5, "legend.frameon": False, "legend.handlelength": 1.6,
    "text.color": INK, "axes.labelcolor": INK, "xtick.color": INK, "ytick.color": INK,
    "axes.edgecolor": "#A7AEB8", "axes.linewidth": 0.8, "axes.spines.top": False,
    "axes.spines.right": False, "axes.grid": True, "grid.color": "#E4E7EB",
    "grid.linewidth": 0.7, "axes.axisbelow": True, "axes.titlelocation": "left",
    "lines.linewidth": 1.2, "lines.solid_joinstyle": "round", "path.simplify_threshold": 0.4,
    "svg.hashsalt": "certnav", "figure.constrained_layout.use": True, "figure.dpi": 100.0,
    "axes.formatter.useoffset": False, "figure.constrained_layout.wspace": 0.03,
}  # fmt: skip


def save(draw: Callable[[T], Figure | None], shown: T, file: Path) -> bool:
    """Write a figure as pdf, svg or png, by its suffix; return whether there was one."""
    with matplotlib.rc_context(_STYLE | {"pdf.fonttype": 42}):
        figure = draw(shown)
        if figure is None:
            return False
        dated = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
        figure.savefig(file, dpi=200, metadata=dated.get(file.suffix))
    return True
