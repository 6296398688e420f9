"""The figures of a comparison for a paper: drift per spell, against time since loss, tracks."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ...filters.rotation import FloatArray
from ..page.palette import BLUE, GREEN, GREY, INK, ORANGE, SKY, VERMILLION
from ..page.pictures import WIDTH
from ..spells.drift import SpellFigures
from .runs import Comparison, Run

#: Colour by what a method is at heart; line by what was added.
_COLOURS = {
    "gnss-only": GREY, "alignment-only": "#CC79A7",
    "certified-only": GREEN, "lc4": VERMILLION,
    "lc+ddia": ORANGE, "lc+rows": BLUE,
}  # fmt: skip
_OTHERS = (SKY, "#CC79A7", INK)
_LINES = {"": "-", "+vehicle": "--", "+smooth": ":", "+vehicle+smooth": "-."}
#: Below this nothing in a comparison of metres matters, and a logarithm needs an end [m].
LEAST = 0.1


def style_of(method: str, methods: list[str]) -> tuple[str, str]:
    """Return colour and line style of a method."""
    base = method.removesuffix("+smooth").removesuffix("+vehicle")
    unknown = [m for m in methods if m not in _COLOURS and not m.startswith(tuple(_COLOURS))]
    if base in _COLOURS:
        return _COLOURS[base], _LINES.get(method.removeprefix(base), "-")
    return _OTHERS[unknown.index(method) % len(_OTHERS)], "-"


def spells_by_run(comparison: Comparison, method: str) -> list[tuple[Run, SpellFigures]]:
    """Return the spells of a method, each with its run."""
    return [(run, spell) for run in comparison.of(method) for spell in run.spells]


def _spells(comparison: Comparison, method: str) -> list[SpellFigures]:
    return [spell for _, spell in spells_by_run(comparison, method)]


def drift_figure(comparison: Comparison) -> Figure | None:
    methods = [m for m in comparison.methods if _spells(comparison, m)]
    if not methods:
        return None
    figure = Figure(figsize=(WIDTH, 0.9 + 0.27 * len(methods)))
    axes = figure.subplots()
    for k, method in enumerate(methods):
        drift = np.maximum([s.drift for s in _spells(comparison, method)], LEAST / 2)
        colour, _ = style_of(method, methods)
        axes.plot(drift, np.full(drift.size, k), "o", color=colour, markersize=4, alpha=0.35,
                  markeredgewidth=0)  # fmt: skip
        axes.plot([np.median(drift)] * 2, [k - 0.35, k + 0.35], color=INK, linewidth=1.8)
        rms = float(np.sqrt(np.mean(drift**2)))
        axes.plot(rms, k, "D", color=colour, markeredgecolor=INK, markersize=6)
    axes.set_xscale("log")
    axes.set_yticks(range(len(methods)), methods)
    axes.invert_yaxis()
    axes.set_xlabel("horizontal drift of a spell [m]")
    return figure


def growth_figure(comparison: Comparison) -> Figure | None:
    methods = [m for m in comparison.methods if _spells(comparison, m)]
    if not methods:
        return None
    columns = min(4, len(methods))
    rows = -(-len(methods) // columns)
    figure = Figure(figsize=(WIDTH, 0.4 + 2.0 * rows))
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in grid.ravel()[len(methods) :]:
        axes.set_visible(False)
    for axes, method in zip(grid.ravel(), methods, strict=False):
        spells = _spells(comparison, method)
        colour, _ = style_of(method, methods)
        size = max(s.since.size for s in spells)
        curves = np.full((len(spells), size), np.nan)
        for curve, spell in zip(curves, spells, strict=True):
            curve[: spell.since.size] = np.maximum(spell.growth, LEAST)
        since = np.arange(size, dtype=float)
        for curve in curves[:60]:
            axes.plot(since, curve, color=colour, linewidth=0.5, alpha=0.35)
        axes.fill_between(since, np.nanmin(curves, axis=0), np.nanmax(curves, axis=0),
                          color=colour, alpha=0.12, linewidth=0)  # fmt: skip
        axes.plot(since, np.nanmedian(curves, axis=0), color=colour, linewidth=2.2)
        axes.set_title(method)
        axes.set_yscale("log")
        axes.set_ylim(bottom=LEAST)
    for axes in grid[:, 0]:
        axes.set_ylabel("drift [m]")
    for axes in grid[-1]:
        axes.set_xlabel("time since loss [s]")
    return figure


def track_figure(comparison: Comparison) -> Figure | None:
    names = list(dict.fromkeys(run.sequence for run in comparison.runs if run.track.size))[:4]
    if not names:
        return None
    columns = min(2, len(names))
    rows = -(-len(names) // columns)
    size = (WIDTH, 6.4 if columns == 1 else 0.6 + 5.0 * rows)
    figure = Figure(figsize=size)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid[len(names) :]:
        axes.set_visible(False)
    for axes, name in zip(grid, names, strict=False):
        runs: dict[str, Run] = {}
        for run in comparison.runs:
            if run.sequence == name and run.track.size:
                runs.setdefault(run.method, run)
        judged = comparison.reference.get(name)
        origin = (judged if judged is not None else next(iter(runs.values())).track)[0]
        if judged is not None:
            east, north = metres(judged, origin)
            axes.plot(east, north, color="#111111", linewidth=5.0, alpha=0.25, label="reference")
        for method, run in runs.items():
            east, north = metres(run.track, origin)
            colour, line = style_of(method, comparison.methods)
            axes.plot(east, north, color=colour, linestyle=line, linewidth=1.1, label=method)
        shown = metres(judged if judged is not None else next(iter(runs.values())).track, origin)
        middle = np.array([(v.min() + v.max()) / 2 for v in shown])
        half = 0.6 * max(20.0, *(float(np.ptp(v)) for v in shown))
        axes.set_aspect("equal", adjustable="box")
        wide = 1.5 if columns == 1 else 1.0
        axes.set_xlim(middle[0] - wide * half, middle[0] + wide * half)
        axes.set_ylim(middle[1] - half, middle[1] + half)
        axes.set_title(name)
        axes.set_xlabel("east of start [m]")
        axes.set_ylabel("north of start [m]")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", ncols=1)
    return figure


def metres(track: FloatArray, origin: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return metres east and north of `origin` on a sphere: for drawing, to a few per mille."""
    per_degree = np.radians(1.0) * 6.371e6
    east = (track[:, 0] - origin[0]) * per_degree * np.cos(np.radians(origin[1]))
    return east, (track[:, 1] - origin[1]) * per_degree


#: Name of the file, and drawing.
FIGURES = (("drift", drift_figure), ("growth", growth_figure), ("tracks", track_figure))
