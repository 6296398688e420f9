"""The interactive plots of a study's page: Figs. 3 to 8 of the paper, a plot a recording."""

from __future__ import annotations

import math

import numpy as np
from bokeh.models import (
    ColumnDataSource,
    DataRange1d,
    FactorRange,
    LinearColorMapper,
    Range1d,
    Span,
)
from bokeh.palettes import Viridis256
from bokeh.plotting import figure
from bokeh.transform import dodge

from ..page.palette import BLUE, GREEN, GREY, INK, ORANGE, VERMILLION
from ..page.plots import Plots
from .figures import FACTORS, K_SHOWN, SNR_SHOWN, range_words
from .recording import Studied, Study
from .tables import by_epoch


def error_over_k(study: Study, plots: Plots) -> list[figure]:
    """Fig. 3: RMS of the velocity error in bins of |k|."""
    shown, out = _shown(study), []
    known = [
        b["rms_mps"] for one in shown for b in one.figures["bins"] if _positive(b["rms_mps"])
    ]  # fmt: skip
    if not known:
        return []
    across, up = Range1d(0.0, 1.0), Range1d(0.5 * min(known), 2.0 * max(known))
    for one in shown:
        plot = plots.free("|k| = |SDV·RMD|", "RMS error [m/s]", one.name, 240, y_axis_type="log",
                          x_range=across, y_range=up)  # fmt: skip
        bins = [b for b in one.figures["bins"] if _positive(b["rms_mps"])]
        source = ColumnDataSource({
            "left": [b["low"] + 0.003 for b in bins], "right": [b["high"] - 0.003 for b in bins],
            "rms": [b["rms_mps"] for b in bins], "count": [b["count"] for b in bins],
            "from": [b["low"] for b in bins], "to": [b["high"] for b in bins],
            "floor": [1e-9] * len(bins),
        })  # fmt: skip
        drawn = plot.quad("left", "right", "rms", "floor", source=source, color=BLUE)
        plots.tell(plot, drawn, ("|k|", "@from{0.00} … @to{0.00}"), ("RMS", "@rms{0.000} m/s"),
              ("pairs", "@count{0,0}"))  # fmt: skip
        plot.add_layout(
            Span(location=0.05, dimension="height", line_color=VERMILLION, line_dash="dashed")
        )
        out.append(plot)
    return out


def outage_attitude(study: Study, plots: Plots) -> list[figure]:
    """Fig. 4: attitude and velocity differences over the first outage of each recording."""
    out = []
    for one in study.recordings:
        if not one.outages:
            continue
        outage = one.outages[0]
        since = outage.time - outage.start
        time = DataRange1d(range_padding=0.01)
        speed = by_epoch(outage.pair_time, outage.difference_e, outage.time)
        for values, names, label, unit in (
            (np.degrees(outage.rpy_error), ("roll", "pitch", "yaw"), "attitude error [°]", "°"),
            (speed, "xyz", "velocity [m/s]", "m/s"),
        ):
            plot = plots.free("since the last satellite [s]", label, one.name, 240, x_range=time)
            for column, colour, name in zip(values.T, (BLUE, ORANGE, GREEN), names, strict=True):
                source = ColumnDataSource({"x": since, "y": column})
                if unit == "°":
                    drawn = plot.line("x", "y", source=source, color=colour, line_width=1.6)
                else:
                    drawn = plot.scatter("x", "y", source=source, color=colour, size=3)
                plots.legend(plot, name, [drawn])
                plots.tell(plot, drawn, (name, f"@y{{0.000}} {unit}, @x{{0.0}} s"))
            plot.add_layout(Span(location=0.0, dimension="width", line_color=GREY))
            out.append(plot)
    return out


def factors(study: Study, plots: Plots) -> list[figure]:
    """Fig. 5: |Pearson| and |Spearman| of each factor with the error."""
    across, names, out = Range1d(0.0, 1.0), list(FACTORS.values()), []
    most = 0.0
    for one in _shown(study):
        found = one.figures["correlation"]
        plot = plots.free("correlation with the error", "", one.name, 270, min_border_left=10,
                          x_range=across, y_range=FactorRange(*reversed(names)))  # fmt: skip
        plot.ygrid.visible = False
        for key, shift, colour in (("pearson", 0.2, BLUE), ("spearman", -0.2, ORANGE)):
            signed = np.array([found[name][key] for name in FACTORS], dtype=float)
            size = np.abs(np.nan_to_num(signed))
            most = max(most, float(size.max()))
            source = ColumnDataSource({"y": names, "size": size, "signed": signed})
            drawn = plot.hbar(dodge("y", shift, range=plot.y_range), 0.36, "size", source=source,
                              color=colour)  # fmt: skip
            plots.legend(plot, f"|{key.title()}|", [drawn])
            plots.tell(plot, drawn, ("@y", f"{key.title()} @signed{{+0.00}}"))
        out.append(plot)
    across.end = max(1.1 * most, 0.1)
    return out


def snr_by_satellite(study: Study, plots: Plots) -> list[figure]:
    """Fig. 6: mean and standard deviation of the pairs' mean SNR by satellite."""
    out = []
    for one in _shown(study):
        sats = one.figures["by_satellite"]
        names = [s["sat"] for s in sats]
        plot = plots.free("", "SNR [dB-Hz]", one.name, 250, x_range=FactorRange(*names))
        plot.xgrid.visible, plot.xaxis.major_label_orientation = False, math.pi / 2
        mean, std = (np.array([s[key] for s in sats], float) for key in ("mean_dbhz", "std_db"))
        source = ColumnDataSource({
            "sat": names, "mean": mean, "std": std, "low": mean - std, "high": mean + std,
            "count": [s["count"] for s in sats],
        })  # fmt: skip
        plot.segment("sat", "low", "sat", "high", source=source, color=GREY, line_width=1.6)
        drawn = plot.scatter("sat", "mean", source=source, size=7, color=BLUE)
        plots.tell(plot, drawn, ("@sat", "@mean{0.0} ± @std{0.0} dB-Hz"), ("pairs", "@count{0,0}"))
        out.append(plot)
    return out


def k_within_snr(study: Study, plots: Plots) -> list[figure]:
    """Fig. 7: correlation of |k| with the error within ranges of SNR, and how many pairs."""
    out = []
    for one in _shown(study):
        ranges = one.figures["within_snr"]
        names = [range_words(r["above"], r["up_to"]) for r in ranges]
        plot = plots.free("mean SNR [dB-Hz]", "correlation of |k|", one.name, 250,
                          x_range=FactorRange(*names), y_range=Range1d(0.0, 1.0))  # fmt: skip
        plot.xgrid.visible = False
        for key, shift, colour in (("pearson", -0.2, BLUE), ("spearman", 0.2, ORANGE)):
            signed = np.array([r[key] for r in ranges], dtype=float)
            source = ColumnDataSource({
                "x": names, "size": np.abs(np.nan_to_num(signed)), "signed": signed,
                "count": [r["count"] for r in ranges], "rms": [r["rms_mps"] for r in ranges],
            })  # fmt: skip
            drawn = plot.vbar(dodge("x", shift, range=plot.x_range), 0.36, "size", source=source,
                              color=colour)  # fmt: skip
            plots.legend(plot, f"|{key.title()}|", [drawn])
            plots.tell(plot, drawn, ("@x dB-Hz", f"{key.title()} @signed{{+0.00}}"),
                  ("pairs", "@count{0,0}"), ("RMS", "@rms{0.000} m/s"))  # fmt: skip
        out.append(plot)
    return out


def thresholds(study: Study, plots: Plots) -> list[figure]:
    """Fig. 8: RMS and share kept over thresholds of SNR and |k|."""
    columns, rows = [f"{k:g}" for k in K_SHOWN], [f"{s:g}" for s in SNR_SHOWN]
    out = []
    for one in _shown(study):
        plot = plots.free("|k| above", "mean SNR above [dB-Hz]", one.name, 300,
                          x_range=FactorRange(*columns), y_range=FactorRange(*rows))  # fmt: skip
        plot.grid.visible = False
        cells = [(s, k, one.at(s, k)) for s in SNR_SHOWN for k in K_SHOWN]
        rms = np.array([cell.get("rms_mps", np.nan) for _, _, cell in cells], dtype=float)
        kept = np.array([cell.get("kept", np.nan) for _, _, cell in cells], dtype=float)
        shade = np.log(np.where(rms > 0.0, rms, np.nan))
        if not np.isfinite(shade).any():
            continue
        low, high = float(np.nanmin(shade)), float(np.nanmax(shade))
        source = ColumnDataSource({
            "k": [f"{k:g}" for _, k, _ in cells], "snr": [f"{s:g}" for s, _, _ in cells],
            "rms": rms, "kept": 100.0 * kept, "shade": shade,
            "text": [f"{r:.2g}" if np.isfinite(r) else "–" for r in rms],
            "share": [f"{100.0 * k:.0f} %" if np.isfinite(k) else "" for k in kept],
            "ink": ["white" if s > 0.5 * (low + high) else INK for s in shade],
        })  # fmt: skip
        mapper = LinearColorMapper(Viridis256[::-1], low=low, high=max(high, low + 1e-9),
                                   nan_color="#F2F3F5")  # fmt: skip
        drawn = plot.rect("k", "snr", 0.98, 0.96, source=source, line_color=None,
                          fill_color={"field": "shade", "transform": mapper})  # fmt: skip
        for field, above in (("text", 2), ("share", -11)):
            plot.text("k", "snr", field, source=source, text_color="ink", text_align="center",
                      text_baseline="bottom", text_font_size="9.5px", y_offset=-above)  # fmt: skip
        plots.tell(plot, drawn, ("SNR >", "@snr dB-Hz, |k| > @k"), ("RMS", "@rms{0.000} m/s"),
              ("kept", "@kept{0.0} %"))  # fmt: skip
        out.append(plot)
    return out


#: The figures of the page by the name of their file, and how many stand side by side.
PANELS = {
    "fig3": (error_over_k, 3),
    "fig4": (outage_attitude, 2),
    "fig5": (factors, 3),
    "fig6": (snr_by_satellite, 2),
    "fig7": (k_within_snr, 3),
    "fig8": (thresholds, 2),
}


def _shown(study: Study) -> list[Studied]:
    return [one for one in study.recordings if one.figures]


def _positive(value: float) -> bool:
    return math.isfinite(value) and value > 0.0
