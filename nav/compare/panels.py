"""The interactive plots of a comparison: drift per spell, against time since loss, tracks.

What belongs to a method is switched on and off with it, in all plots at once.
"""

from __future__ import annotations

import warnings

import numpy as np
from bokeh.models import ColumnDataSource, FactorRange, FixedTicker, HoverTool, Range1d
from bokeh.plotting import figure

from ...filters.rotation import FloatArray
from ..notes import clock
from ..page.palette import INK
from ..page.plots import Plots, decade_marks
from .figures import LEAST, metres, spells_by_run, style_of
from .runs import Comparison, Run

#: Bokeh's names of what matplotlib calls line styles.
_DASHES = {"-": "solid", "--": "dashed", ":": "dotted", "-.": "dotdash"}
#: Curves of single spells that a plot can show.
_CURVES = 60
_DRIVES = 4


def samples(comparison: Comparison) -> list[tuple[str, str, str]]:
    """Return name, colour and dash of each method."""
    return [(m, *_look(m, comparison.methods)) for m in comparison.methods]


def drift(comparison: Comparison, plots: Plots) -> list[figure]:
    """Draw a dot a spell by method, their median and the RMS of them."""
    methods = [m for m in comparison.methods if spells_by_run(comparison, m)]
    if not methods:
        return []
    plot = plots.free(
        "horizontal drift of a spell [m]", "", "Drift of every spell", 90 + 27 * len(methods),
        x_axis_type="log", y_range=FactorRange(*reversed(methods)), min_border_left=10,
    )  # fmt: skip
    plot.ygrid.visible = False
    drifts = [s.drift for m in methods for _, s in spells_by_run(comparison, m)]
    if ticks := decade_marks(np.maximum(drifts, LEAST / 2)):
        plot.xaxis.ticker = FixedTicker(ticks=ticks)
    for method in methods:
        found = spells_by_run(comparison, method)
        colour, _ = _look(method, comparison.methods)
        true = np.array([spell.drift for _, spell in found])
        shown = np.maximum(true, LEAST / 2)
        source = ColumnDataSource({
            "x": shown, "y": [method] * shown.size, "drift": true,
            "at": [f"{run.sequence}{run.variant}" for run, _ in found],
            "when": [f"{clock(s.start)} … {clock(s.end)}" for _, s in found],
            "most": [s.max_error for _, s in found],
        })  # fmt: skip
        dots = plot.scatter("x", "y", source=source, size=7, color=colour, alpha=0.45,
                            line_color=None)  # fmt: skip
        plots.tell(
            plot,
            dots,
            ("", "@at"),
            ("spell", "@when"),
            ("drift", "@drift{0.00} m"),
            ("largest error", "@most{0.00} m"),
        )
        median, rms = float(np.median(shown)), float(np.sqrt(np.mean(true**2)))
        marks = ColumnDataSource({"x": [median, max(rms, LEAST / 2)], "y": [method] * 2,
                                  "what": ["median", "RMS of maxima"],
                                  "drift": [float(np.median(true)), rms]})  # fmt: skip
        bar = plot.scatter("x", "y", source=ColumnDataSource({"x": [median], "y": [method]}),
                           marker="dash", angle=np.pi / 2, size=18, color=INK,
                           line_width=2.5)  # fmt: skip
        diamond = plot.scatter(
            "x", "y", source=ColumnDataSource({"x": marks.data["x"][1:], "y": [method]}),
            marker="diamond", size=13, color=colour, line_color=INK,
        )  # fmt: skip
        felt = plot.scatter("x", "y", source=marks, size=13, alpha=0.0)
        plots.tell(plot, felt, ("@y", "@what @drift{0.00} m"))
        plots.series(method, [dots, bar, diamond, felt])
    return [plot]


def growth(comparison: Comparison, plots: Plots) -> list[figure]:
    """Draw the median drift of all methods over time since loss, then each method's spells."""
    methods = [m for m in comparison.methods if spells_by_run(comparison, m)]
    if not methods:
        return []
    curves = {m: _curves([s for _, s in spells_by_run(comparison, m)]) for m in methods}
    longest = max(c.shape[1] for c in curves.values()) - 1.0
    top = max(10.0 * LEAST, 1.5 * max(float(np.nanmax(c)) for c in curves.values()))
    time, drifted = Range1d(0.0, max(longest, 1.0)), Range1d(LEAST, top)
    axes = {"y_axis_type": "log", "x_range": time, "y_range": drifted}
    all_of_them = plots.free("time since loss [s]", "median drift [m]", "Medians", 340, **axes)
    out = [all_of_them]
    for method in methods:
        found = curves[method]
        since = np.arange(found.shape[1], dtype=float)
        colour, dash = _look(method, comparison.methods)
        low, middle, high = _extent(found)
        line = all_of_them.line(since, middle, color=colour, line_width=2.2, line_dash=dash)
        plots.tell(all_of_them, line, (method, "@y{0.00} m, @x{0} s after loss"))
        alone = plots.free("time since loss [s]", "drift [m]", method, 190, **axes)
        thin = alone.multi_line([since] * len(found[:_CURVES]), list(found[:_CURVES]), color=colour,
                                line_width=0.6, line_alpha=0.45)  # fmt: skip
        band = alone.varea(since, low, high, fill_color=colour, fill_alpha=0.14)
        thick = alone.line(since, middle, color=colour, line_width=2.4)
        alone.add_tools(HoverTool(renderers=[thick], mode="vline", visible=False, tooltips=[
            ("median", "@y{0.00} m, @x{0} s after loss")]))  # fmt: skip
        plots.series(method, [line, thin, band, thick, alone])
        out.append(alone)
    return out


def _curves(spells: list) -> FloatArray:
    """Return the drift of each spell on whole seconds, none below what is drawn; NaN after it."""
    out = np.full((len(spells), max(s.since.size for s in spells)), np.nan)
    for curve, spell in zip(out, spells, strict=True):
        curve[: spell.since.size] = np.maximum(spell.growth, LEAST)
    return out


def _extent(curves: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # seconds that no spell knows
        return np.nanmin(curves, axis=0), np.nanmedian(curves, axis=0), np.nanmax(curves, axis=0)


def tracks(comparison: Comparison, plots: Plots) -> list[figure]:
    """Draw the tracks of all methods, a plot a drive."""
    names = list(dict.fromkeys(run.sequence for run in comparison.runs if run.track.size))[:_DRIVES]
    out = []
    for name in names:
        runs: dict[str, Run] = {}
        for run in comparison.runs:
            if run.sequence == name and run.track.size:
                runs.setdefault(run.method, run)
        judged = comparison.reference.get(name)
        if judged is None or not judged.size:
            judged = next(iter(runs.values())).track
        origin = judged[0]
        plot = _map(name, metres(judged, origin), plots, 520 if len(names) == 1 else 400)
        if comparison.reference.get(name) is not None:
            plot.line(*metres(judged, origin), color="#111111", line_width=7, line_alpha=0.22)
        for method, run in runs.items():
            colour, dash = _look(method, comparison.methods)
            east, north = metres(run.track, origin)
            drawn = plot.line(east, north, color=colour, line_dash=dash, line_width=1.4)
            plots.tell(plot, drawn, (method, "@x{0.0} m east, @y{0.0} m north"))
            plots.series(method, [drawn])
        out.append(plot)
    return out


def _map(
    name: str, shown: tuple[FloatArray, FloatArray], plots: Plots, height: int
) -> figure:  # fmt: skip
    """Return a plot with one scale on both axes that shows all of a track."""
    plot = plots.free("east of start [m]", "north of start [m]", name, height, match_aspect=True,
                      min_border_left=76)  # fmt: skip
    # What is seen at first is what it is judged by: a method that flew away is found by zooming.
    corners = plot.scatter(*([v.min(), v.max()] for v in shown), size=1, alpha=0.0)
    for axis in (plot.x_range, plot.y_range):
        axis.renderers, axis.range_padding, axis.default_span = [corners], 0.08, 20.0
    return plot


def _look(method: str, methods: list[str]) -> tuple[str, str]:
    colour, line = style_of(method, methods)
    return colour, _DASHES[line]
