"""Figs. 3 to 8 of the paper, for a paper: a panel a recording."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..page.palette import BLUE, GREEN, GREY, INK, ORANGE, VERMILLION
from ..page.pictures import WIDTH
from .recording import Studied, Study
from .tables import by_epoch

#: Cells of Fig. 8 that are written out; all others are in the CSV.
SNR_SHOWN = (30.0, 35.0, 40.0, 45.0, 50.0)
K_SHOWN = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
#: Names of what may go with the error, by that of its figure.
FACTORS = {
    "azimuth": "azimuth", "elevation": "elevation", "elevation_low": "lower elevation",
    "k": "|k|", "snr": "SNR", "snr_high": "higher SNR", "snr_low": "lower SNR",
    "snr_mean": "mean SNR",
}  # fmt: skip


def _panels(
    study: Study, height: float, columns: int = 3, shared: bool = True
) -> tuple[Figure, list[tuple[Axes, Studied]]]:
    """Return a figure with one panel for each recording that has figures."""
    shown = [one for one in study.recordings if one.figures]
    columns = min(columns, len(shown))
    rows = -(-len(shown) // columns)
    figure = Figure(figsize=(WIDTH, height * rows))
    grid = figure.subplots(rows, columns, squeeze=False, sharex=shared, sharey=shared)
    cells = grid.ravel()
    for axes in cells[len(shown) :]:
        axes.set_axis_off()
    for axes, one in zip(cells, shown, strict=False):
        axes.set_title(_short(one.name))
    return figure, list(zip(cells, shown, strict=False))


def _short(name: str, most: int = 40) -> str:
    """Return a name that fits above a panel, without what matplotlib takes for mathematics."""
    text = name if len(name) <= most else name[: most - 1] + "…"
    return text.replace("$", r"\$")


def _outer(axes: Axes, across: str, up: str) -> None:
    spec = axes.get_subplotspec()
    assert spec is not None
    if spec.is_first_col():
        axes.set_ylabel(up)
    axes.set_xlabel(across)
    axes.tick_params(labelbottom=True)


def error_over_k(study: Study) -> Figure:
    """Fig. 3: RMS of the velocity error in bins of |k|."""
    figure, panels = _panels(study, 2.5)
    for axes, one in panels:
        bins = [b for b in one.figures["bins"] if np.isfinite(b["rms_mps"]) and b["rms_mps"] > 0]
        axes.bar([b["low"] + 0.025 for b in bins], [b["rms_mps"] for b in bins], 0.043, color=BLUE)
        axes.axvline(0.05, color=VERMILLION, lw=0.9, ls="--")
        axes.set_yscale("log")
        _outer(axes, "|k| = |SDV·RMD|", "RMS error [m/s]")
    return figure


def outage_attitude(study: Study) -> Figure | None:
    """Fig. 4: attitude and velocity differences over the first outage of each recording."""
    shown = [one for one in study.recordings if one.outages]
    if not shown:
        return None
    figure = Figure(figsize=(WIDTH, 2.1 * len(shown)))
    grid = figure.subplots(len(shown), 2, squeeze=False)
    for (left, right), one in zip(grid, shown, strict=True):
        outage = one.outages[0]
        since = outage.time - outage.start
        colours = (BLUE, ORANGE, GREEN)
        names = ("roll", "pitch", "yaw")
        for column, colour, name in zip(
            np.degrees(outage.rpy_error).T, colours, names, strict=True
        ):
            left.plot(since, column, color=colour, label=name)
        speed = by_epoch(outage.pair_time, outage.difference_e, outage.time)
        for column, colour, name in zip(speed.T, colours, "xyz", strict=True):
            right.plot(since, column, ".", ms=2.5, color=colour, label=name)
        left.set_title(_short(one.name))
        left.set_ylabel("attitude error [°]")
        right.set_ylabel("velocity [m/s]")
        for axes in (left, right):
            axes.axhline(0.0, color=GREY, lw=0.7)
            axes.set_xlabel("since the last satellite [s]")
    for axes in grid[0]:
        axes.legend(ncols=3, loc="upper right")
    return figure


def factors(study: Study) -> Figure:
    """Fig. 5: |Pearson| and |Spearman| of each factor with the error."""
    figure, panels = _panels(study, 2.6)
    for axes, one in panels:
        found = one.figures["correlation"]
        place = np.arange(len(FACTORS))
        for key, shift, colour in (("pearson", 0.2, BLUE), ("spearman", -0.2, ORANGE)):
            sizes = [abs(found[name][key]) for name in FACTORS]
            axes.barh(place + shift, np.nan_to_num(sizes), 0.38, color=colour,
                      label=f"|{key.title()}|")  # fmt: skip
        axes.set_yticks(place, list(FACTORS.values()))
        axes.grid(axis="y", visible=False)
        _outer(axes, "correlation with the error", "")
    panels[0][0].legend(loc="lower right")
    return figure


def snr_by_satellite(study: Study) -> Figure:
    """Fig. 6: mean and standard deviation of the pairs' mean SNR by satellite."""
    figure, panels = _panels(study, 2.5, columns=2, shared=False)
    for axes, one in panels:
        sats = one.figures["by_satellite"]
        place = np.arange(len(sats))
        axes.errorbar(
            place, [s["mean_dbhz"] for s in sats], [s["std_db"] for s in sats], fmt="o", ms=4,
            color=BLUE, ecolor=GREY, elinewidth=1.0, capsize=2.0,
        )  # fmt: skip
        axes.set_xticks(place, [s["sat"] for s in sats], rotation=90)
        axes.grid(axis="x", visible=False)
        axes.set_ylabel("SNR [dB-Hz]")
    return figure


def k_within_snr(study: Study) -> Figure:
    """Fig. 7: correlation of |k| with the error within ranges of SNR, and how many pairs."""
    figure, panels = _panels(study, 2.5, shared=False)
    for axes, one in panels:
        ranges = one.figures["within_snr"]
        place = np.arange(len(ranges))
        for key, shift, colour in (("pearson", -0.2, BLUE), ("spearman", 0.2, ORANGE)):
            axes.bar(place + shift, np.nan_to_num([abs(r[key]) for r in ranges]), 0.38,
                     color=colour, label=f"|{key.title()}|")  # fmt: skip
        axes.set_xticks(
            place, [f"{range_words(r['above'], r['up_to'])}\n{r['count']:,d}" for r in ranges]
        )
        axes.grid(axis="x", visible=False)
        axes.set_ylim(0.0, 1.0)
        _outer(axes, "mean SNR [dB-Hz], pairs", "correlation of |k|")
    panels[0][0].legend(loc="upper left")
    return figure


def range_words(low: float, high: float) -> str:
    """Return a range of SNR in words, open at an end that is infinite."""
    if not np.isfinite(low):
        return f"≤ {high:g}"
    return f"> {low:g}" if not np.isfinite(high) else f"{low:g}–{high:g}"


def thresholds(study: Study) -> Figure:
    """Fig. 8: RMS and share kept, written into every cell, over thresholds of SNR and |k|."""
    figure, panels = _panels(study, 2.9, columns=2, shared=False)
    for axes, one in panels:
        rms, kept = (
            np.array([[one.at(s, k).get(key, np.nan) for k in K_SHOWN] for s in SNR_SHOWN])
            for key in ("rms_mps", "kept")
        )
        positive = np.where(rms > 0.0, rms, np.nan)
        known = np.isfinite(positive)
        axes.pcolormesh(np.ma.masked_invalid(np.log(positive)), cmap="viridis_r", edgecolors="w")
        middle = float(np.median(np.log(positive[known]))) if known.any() else 0.0
        for i, j in np.ndindex(rms.shape):
            ink = INK
            if known[i, j] and np.log(positive[i, j]) > middle:
                ink = "white"
            error = f"{rms[i, j]:.3g}" if known[i, j] else "–"
            axes.text(j + 0.5, i + 0.5, f"{error}\n{100.0 * kept[i, j]:.0f} %", ha="center",
                      va="center", color=ink, fontsize=6.5, linespacing=1.05)  # fmt: skip
        axes.set_xticks(np.arange(len(K_SHOWN)) + 0.5, [f"{k:g}" for k in K_SHOWN])
        axes.set_yticks(np.arange(len(SNR_SHOWN)) + 0.5, [f"{s:g}" for s in SNR_SHOWN])
        axes.grid(visible=False)
        _outer(axes, "|k| above", "mean SNR above [dB-Hz]")
    return figure


#: Name of the file, drawing, heading and caption.
FIGURES = (
    ("fig3", error_over_k, "Error by |k| (Fig. 3)",
     "RMS of ‖Δv‖ of all pairs in bins of 0.05; left of the dashed line geometry is singular."),
    ("fig4", outage_attitude, "Attitude and velocity in an outage (Fig. 4)",
     "First outage of each recording: attitude of the IMU alone against the reference, and what "
     "that does to the velocity, ECEF, median of the pairs."),
    ("fig5", factors, "What goes with the error (Fig. 5)",
     "Factors of a single satellite count for both satellites of a pair."),
    ("fig6", snr_by_satellite, "Signal strength by satellite (Fig. 6)",
     "Mean and standard deviation of the mean SNR of the pairs each satellite is in."),
    ("fig7", k_within_snr, "|k| and the error within SNR ranges (Fig. 7)",
     "Pairs within ranges of their mean SNR."),
    ("fig8", thresholds, "Error and retention over thresholds (Fig. 8)",
     "RMS of ‖Δv‖ [m/s] and share of the pairs kept by both thresholds, after k > 0.05 and 3 RMS."),
)  # fmt: skip
