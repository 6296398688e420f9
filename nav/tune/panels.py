"""The interactive plots of a tuning's page."""

from __future__ import annotations

import numpy as np
from bokeh.models import (
    ColorBar,
    ColumnDataSource,
    FactorRange,
    LinearColorMapper,
    LogColorMapper,
    Range1d,
    Span,
)
from bokeh.palettes import Viridis256
from bokeh.plotting import figure

from ...filters.rotation import FloatArray
from ..page.palette import BLUE, GREEN, GREY, INK, ORANGE, VERMILLION
from ..page.plots import Plots
from .candidates import PAPER
from .settings import Settings
from .tuning import Tuning

#: A change beyond these is drawn at the edge [%].
_LEAST, _MOST = -90.0, 150.0


def trade_off(tuning: Tuning, plots: Plots) -> list[figure]:
    """Draw RMS against retention: all combinations, the Pareto front, the choice."""
    score, t = tuning.score, tuning.thresholds
    plot = plots.free("pairs retained [%]", "RMS velocity error [m/s]", "", 380,
                      y_axis_type="log")  # fmt: skip
    snr, k = (grid.ravel() for grid in np.meshgrid(tuning.snr, tuning.k, indexing="ij"))
    kept, rms, front = 100.0 * score.retention.ravel(), score.rms.ravel(), tuning.pareto.ravel()

    def dots(chosen: np.ndarray, label: str, **style: object) -> None:
        source = ColumnDataSource({
            "kept": kept[chosen], "rms": rms[chosen], "snr": snr[chosen], "k": k[chosen],
        })  # fmt: skip
        drawn = plot.scatter("kept", "rms", source=source, **style)
        plots.legend(plot, label, [drawn])
        plots.tell(plot, drawn, ("C/N0 >", "@snr dB-Hz, k > @k"), ("RMS", "@rms{0.000} m/s"),
              ("retained", "@kept{0.0} %"))  # fmt: skip

    known = np.isfinite(rms) & (rms > 0.0)
    dots(known & ~front, "all", color=GREY, size=4, alpha=0.7)
    best = np.flatnonzero(known & front)
    best = best[np.argsort(kept[best])]
    plot.line(kept[best], rms[best], color=BLUE, line_width=1.6)
    dots(best, "Pareto front", color=BLUE, size=6)
    marks = [
        ("taken", (t.min_cn0_dbhz, t.min_k), "circle", ORANGE),
        ("paper", PAPER, "diamond", GREEN),
        ("knee", tuning.knee, "square", VERMILLION),
    ]
    for label, where, marker, colour in marks:
        if where is not None:
            here = known & np.isclose(snr, where[0]) & np.isclose(k, where[1])
            if here.any():
                dots(here, label, marker=marker, size=13, fill_color=None, line_color=colour,
                     line_width=3)  # fmt: skip
    unseen = plot.scatter([100.0 * tuning.cv_retention], [tuning.cv_rms], marker="x", size=13,
                          color=ORANGE, line_width=3)  # fmt: skip
    plots.legend(plot, "cross-validated", [unseen])
    plots.tell(
        plot, unseen, (f"cross-validated over {tuning.folds_by}", "@y{0.000} m/s, @x{0.0} %")
    )
    if tuning.min_kept:
        plot.add_layout(
            Span(location=100.0 * tuning.min_kept, dimension="height", line_color=INK,
                 line_dash="dashed")
        )  # fmt: skip
    return [plot]


def heat_maps(tuning: Tuning, plots: Plots) -> list[figure]:
    """Draw RMS and retention over the grid (Fig. 8), with common axes."""
    t, k_step, snr_step = tuning.thresholds, _step(tuning.k), _step(tuning.snr)
    across = Range1d(tuning.k[0] - k_step / 2, tuning.k[-1] + k_step / 2)
    up = Range1d(tuning.snr[0] - snr_step / 2, tuning.snr[-1] + snr_step / 2)
    snr, k = (grid.ravel() for grid in np.meshgrid(tuning.snr, tuning.k, indexing="ij"))
    rms, kept = tuning.score.rms.ravel(), 100.0 * tuning.score.retention.ravel()
    out = []
    for values, title, mapper in (
        (rms, "RMS error [m/s]", LogColorMapper),
        (kept, "retained [%]", LinearColorMapper),
    ):
        plot = plots.free("k = |SDV·RMD| above", "C/N0 above [dB-Hz]", title, 330,
                          x_range=across, y_range=up)  # fmt: skip
        plot.grid.visible = False
        known = values[np.isfinite(values) & (values > 0.0)]
        ends = (float(known.min()), float(known.max())) if known.size else (0.1, 1.0)
        colours = mapper(Viridis256, low=ends[0], high=max(ends[1], 1.001 * ends[0]),
                         nan_color="#F2F3F5")  # fmt: skip
        source = ColumnDataSource({"k": k, "snr": snr, "value": values, "rms": rms, "kept": kept})
        drawn = plot.rect("k", "snr", k_step, snr_step, source=source, line_color=None,
                          fill_color={"field": "value", "transform": colours})  # fmt: skip
        plots.tell(plot, drawn, ("C/N0 >", "@snr dB-Hz, k > @k"), ("RMS", "@rms{0.000} m/s"),
              ("retained", "@kept{0.0} %"))  # fmt: skip
        plot.scatter([t.min_k], [t.min_cn0_dbhz], size=15, fill_color=None, line_color=ORANGE,
                     line_width=3)  # fmt: skip
        plot.add_layout(ColorBar(color_mapper=colours, width=10, padding=4,
                                 background_fill_alpha=0.0), "right")  # fmt: skip
        out.append(plot)
    return out


def changes(found: Settings, plots: Plots) -> list[figure]:
    """Draw every candidate's change with its interval, its name above it."""
    count = len(found.candidates)
    rows = [str(k) for k in range(count)]
    plot = plots.free("change of the error [%], 95 % interval", "", "",
                      90 + 34 * count, y_range=FactorRange(*reversed(rows)),
                      min_border_left=10)  # fmt: skip
    plot.yaxis.visible = plot.ygrid.visible = False
    values = 100.0 * np.array([[c.value, c.low, c.high] for c in found.changes])
    judged = np.asarray(np.isfinite(values).all(axis=1))
    drawn = np.clip(np.where(judged[:, None], values, 0.0), _LEAST, _MOST)
    colours = [{found.chosen: ORANGE, found.best: GREEN}.get(k, BLUE) for k in range(count)]
    names = [
        c.name + ("" if judged[k] else " (not judged)") for k, c in enumerate(found.candidates)
    ]
    source = ColumnDataSource({
        "row": rows, "name": names, "value": drawn[:, 0], "low": drawn[:, 1], "high": drawn[:, 2],
        "true": values[:, 0], "from": values[:, 1], "to": values[:, 2], "colour": colours,
        "size": np.where(judged, 9, 0), "why": [found.reasons[k] for k in range(count)],
    })  # fmt: skip
    plot.segment("low", "row", "high", "row", source=source, color="colour", line_width=2.2)
    dots = plot.scatter("value", "row", source=source, size="size", color="colour")
    low, high = min(float(drawn.min()), -1.0), max(float(drawn.max()), 1.0)
    room = 0.05 * (high - low)
    plot.x_range = Range1d(low - room, high + room)
    plot.add_layout(Span(location=0.0, dimension="height", line_color=GREY))
    plot.text(low - 0.7 * room, "row", "name", source=source, text_font_size="11px",
              text_color=INK, y_offset=-6)  # fmt: skip
    plots.tell(plot, dots, ("@name", "@true{+0.0} % (@from{+0.0} … @to{+0.0} %)"), ("", "@why"))
    return [plot]


def held(found: Settings, plots: Plots) -> list[figure]:
    """Draw the drift over the epochs of weak GNSS that gave something."""
    drift = np.array([found.rms(k, "weak GNSS") for k in range(len(found.candidates))])
    share = 100.0 * np.array(found.held)
    known = np.isfinite(drift) & np.isfinite(share)
    if not known.any():
        return []
    plot = plots.free("epochs of weak GNSS that gave something [%]", "RMS drift [m]",
                      "What holding more of them costs", 340)  # fmt: skip
    names = np.array([c.name for c in found.candidates])

    def dots(chosen: np.ndarray, label: str, **style: object) -> None:
        source = ColumnDataSource({"x": share[chosen], "y": drift[chosen], "name": names[chosen]})
        drawn = plot.scatter("x", "y", source=source, **style)
        plots.legend(plot, label, [drawn])
        plots.tell(plot, drawn, ("@name", "@y{0.00} m, @x{0.0} %"))

    dots(known, "candidates", color=BLUE, size=7)
    for k, colour, label in (
        (0, GREY, "default"), (found.chosen, ORANGE, "recommended"),
        (found.knee, VERMILLION, "knee"),
    ):  # fmt: skip
        if k is not None and known[k]:
            dots(np.arange(known.size) == k, label, size=14, fill_color=None, line_color=colour,
                 line_width=3)  # fmt: skip
    return [plot]


def _step(values: FloatArray) -> float:
    return float(np.median(np.diff(values))) if np.size(values) > 1 else 1.0
