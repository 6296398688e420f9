"""Pictures of a page: one palette and one style for all, drawn as SVG into the page itself.

Colours are Okabe and Ito's, which stay apart for colour-blind readers and in grey.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import matplotlib
from matplotlib.figure import Figure

T = TypeVar("T")

BLUE, ORANGE, GREEN, VERMILLION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
SKY, GREY, INK = "#56B4E9", "#8A8F98", "#1F2933"
#: A page is 1120 px wide; figures are drawn in inches of 100 px, so 9 pt is 12.5 px.
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


def render(draw: Callable[[T], Figure | None], shown: T) -> str | None:
    """Return a figure as a ``data:`` address (SVG), or None where it has nothing to show."""
    with matplotlib.rc_context(_STYLE):
        figure = draw(shown)
        if figure is None:
            return None
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", dpi=144, metadata={"Date": None})
    # Paths come with six decimals of a point; two are a fiftieth of a pixel and half the bytes.
    svg = re.sub(r' d="[^"]*"', lambda d: re.sub(r"(\.\d\d)\d+", r"\1", d[0]), buffer.getvalue())
    return "data:image/svg+xml;base64," + base64.b64encode(svg.encode()).decode("ascii")
