"""Thresholds of pairs, written down: thresholds.toml, tuning.json, CSV, LaTeX and a page."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...datasets.placing import written_whole
from ...filters.errors import DataError
from ..page import document
from ..page.palette import BLUE, GREEN, ORANGE, VERMILLION
from ..page.pictures import save
from ..page.plots import Plots
from ..page.tables import Column, Table
from ..results.summary import strict
from . import panels
from .candidates import PAPER
from .tuning import Tuning

_GREY = "#999999"
_K_NAMES = {"sdv": "|SDV·RMD|", "cosine": "the cosine between SDV and direction of motion"}
#: What a tuning of either objective may have written.
_FILES = (
    "thresholds.toml", "tuning.json", "tuning.html", "trade_off.png", "heat_map.png",
    "trade_off.pdf", "heat_map.pdf", "folds.csv", "folds.tex", "candidates.csv", "candidates.tex",
    "receivers.csv", "receivers.tex", "candidates.pdf",
)  # fmt: skip


def check_replaceable(out: Path) -> None:
    """Refuse (`DataError`) to write over anything but a tuning result."""
    if out.exists():
        foreign = [p.name for p in out.iterdir() if p.name not in _FILES] if out.is_dir() else [""]
        if foreign:
            raise DataError(
                "exists and is not a tuning result", file=out, remedy="choose another --out"
            )


def write_tuning(tuning: Tuning, out: str | Path) -> Path:
    """Write thresholds.toml, tuning.json, tuning.html, its tables and figures, all or nothing.

    Raises
    ------
    DataError
        If `out` exists and holds anything else.
    """
    out = Path(out).resolve()
    check_replaceable(out)
    with written_whole(out) as draft:
        (draft / "thresholds.toml").write_text(thresholds_toml(tuning), encoding="utf-8")
        text = json.dumps(strict(as_dict(tuning)), indent=1, allow_nan=False, ensure_ascii=False)
        (draft / "tuning.json").write_text(text + "\n", encoding="utf-8")
        folds_table(tuning).write(draft)
        for name, draw in (("trade_off", trade_off_figure), ("heat_map", heat_map_figure)):
            save(draw, tuning, draft / f"{name}.pdf")
        (draft / "tuning.html").write_text(_page(tuning), encoding="utf-8")
    return out


def thresholds_toml(tuning: Tuning) -> str:
    """Return the thresholds as a configuration for ``certnav run --config``.

    They are in force where ``gnss.below_four`` is 'ddia', which this does not make it. Thresholds
    of what the filter does not look at, the mean C/N0 of a pair or the cosine, are a comment.
    """
    t = tuning.thresholds
    keys = [f"ddia_min_cn0_dbhz = {t.min_cn0_dbhz!r}", f"ddia_min_k = {t.min_k!r}"]
    lines = [
        f"# Thresholds for pairs of satellites, tuned on {_names(tuning)}.",
        f"# Cross-validated over {tuning.folds_by}: RMS {tuning.cv_rms:.3g} m/s, "
        f"{tuning.cv_retention:.0%} retained; {tuning.decided}.",
        f"# C/N0 is the {t.cn0_of} of the pair; k is {_K_NAMES[t.k_of]}.",
    ]
    for name, fit in tuning.noise.items():
        lines.append(
            f"# Doppler noise on {name}: doppler_sigma_mps = {fit.noise.sigma_45:.3g}, "
            f"doppler_floor_mps = {fit.noise.floor:.3g}, tenfold in {fit.noise.decade_db:.3g} dB "
            "(a run has 20)"
        )
    if applied(tuning):
        lines += [
            '# In force with below_four = "ddia"; the method stays what it is.',
            "[gnss]",
            *keys,
        ]
    else:
        lines += [
            "# The filter asks C/N0 of every satellite and takes |SDV·RMD| as it is: tune with",
            "# --cn0-of min --k-of sdv for a file that a run can use. These are the paper's:",
            *(f"# {key}" for key in keys),
        ]
    return "\n".join(lines) + "\n"


def applied(tuning: Tuning) -> bool:
    """Return whether the thresholds are of what the filter applies them to."""
    return (tuning.thresholds.cn0_of, tuning.thresholds.k_of) == ("min", "sdv")


def as_dict(tuning: Tuning) -> dict[str, Any]:
    """Return everything as plain values for strict JSON; what is not known is None."""
    t = tuning.thresholds
    best = tuning.at(t.min_cn0_dbhz, t.min_k)
    rows = []
    for i, snr in enumerate(tuning.snr):
        for j, k in enumerate(tuning.k):
            rows.append(
                {
                    "snr": snr,
                    "k": k,
                    "rms": tuning.score.rms[i, j],
                    "kept": tuning.score.retention[i, j],
                    "pareto": bool(tuning.pareto[i, j]),
                }
            )
    values = strict(
        {
            "objective": "velocity",
            "unit": "m/s",
            "recommended": {
                "min_cn0_dbhz": t.min_cn0_dbhz,
                "min_k": t.min_k,
                "cn0_of": t.cn0_of,
                "k_of": t.k_of,
                "rms": best and best[0],
                "kept": best and best[1],
            },
            "cross_validated": {
                "over": tuning.folds_by,
                "rms": tuning.cv_rms,
                "kept": tuning.cv_retention,
                "folds": [vars(fold) for fold in tuning.folds],
            },
            "min_kept": tuning.min_kept,
            "decided": tuning.decided,
            "knee": tuning.knee
            and {
                "min_cn0_dbhz": tuning.knee[0],
                "min_k": tuning.knee[1],
                **(_pair(tuning.at(*tuning.knee)) or {}),
            },
            "paper": _pair(tuning.at(*PAPER)),
            "alone": {
                name: {
                    "recommended": _pair(tuning.at(t.min_cn0_dbhz, t.min_k, score)),
                    "paper": _pair(tuning.at(*PAPER, score)),
                }
                for name, score in tuning.alone.items()
            },
            "noise": {
                name: {
                    "sigma_45_mps": fit.noise.sigma_45,
                    "floor_mps": fit.noise.floor,
                    "decade_db": fit.noise.decade_db,
                    "misfit": fit.misfit,
                    "cn0_dbhz": fit.cn0,
                    "spread_mps": fit.spread,
                }
                for name, fit in tuning.noise.items()
            },
            "grid": rows,
            "statistics": tuning.statistics,
            "notes": tuning.notes,
        }
    )
    assert isinstance(values, dict)
    return values


def _pair(value: tuple[float, float] | None) -> dict[str, float] | None:
    return None if value is None else {"rms": value[0], "kept": value[1]}


def folds_table(tuning: Tuning) -> Table:
    """Return the cross-validation: what was left out, what was chosen, what it did."""
    columns = (
        Column("left out"), Column("C/N0", "dB-Hz", "g"), Column("k", "", "g"),
        Column("RMS", "m/s", ".3g"), Column("retained", "share", ".0%"),
    )  # fmt: skip
    rows = tuple((f.left_out, f.snr, f.k, f.rms, f.retention) for f in tuning.folds)
    return Table("folds", f"Cross-validation over {tuning.folds_by}", columns, rows)


def _names(tuning: Tuning) -> str:
    return ", ".join(tuning.alone)


def trade_off_figure(tuning: Tuning) -> Figure:
    """Draw RMS against retention: all combinations, the Pareto front, the choice."""
    score, t = tuning.score, tuning.thresholds
    figure = Figure(figsize=(7.2, 4.4), layout="constrained")
    axes = figure.subplots()
    kept, rms = 100.0 * score.retention, score.rms
    known = np.isfinite(rms)
    axes.plot(kept[known], rms[known], ".", color=_GREY, ms=3, label="every combination")
    front = tuning.pareto & known
    order = np.argsort(kept[front])
    axes.plot(kept[front][order], rms[front][order], color=BLUE, lw=1.6, label="Pareto front")
    best = tuning.at(t.min_cn0_dbhz, t.min_k)
    if best is not None:
        label = f"taken: C/N0 > {t.min_cn0_dbhz:g} dB-Hz, k > {t.min_k:g}"
        axes.plot(100 * best[1], best[0], "o", color=ORANGE, ms=9, label=label)
    axes.plot(
        100 * tuning.cv_retention, tuning.cv_rms, "x", color=ORANGE, ms=9, mew=2,
        label=f"cross-validated over {tuning.folds_by}",
    )  # fmt: skip
    paper = tuning.at(*PAPER)
    if paper is not None and np.isfinite(paper[0]):
        axes.plot(100 * paper[1], paper[0], "D", color=GREEN, ms=7,
                  label=f"paper: {PAPER[0]:g} dB-Hz, {PAPER[1]:g}")  # fmt: skip
    if tuning.knee is not None and (bend := tuning.at(*tuning.knee)) is not None:
        label = f"knee: {tuning.knee[0]:g} dB-Hz, {tuning.knee[1]:g}"
        axes.plot(100 * bend[1], bend[0], "s", mfc="none", mec=VERMILLION, ms=9, label=label)
    if tuning.min_kept:
        axes.axvline(100 * tuning.min_kept, color="black", lw=0.8, ls="--")
    axes.set_yscale("log")
    axes.set(xlabel="pairs retained [%]", ylabel="RMS velocity error [m/s]")
    axes.grid(alpha=0.3, which="both")
    axes.legend(frameon=False, fontsize=9)
    return figure


def heat_map_figure(tuning: Tuning) -> Figure:
    """Draw RMS and retention over the grid (Fig. 8)."""
    t = tuning.thresholds
    figure = Figure(figsize=(9.6, 4.0), layout="constrained")
    titles = ["RMS error [m/s]", "retained [%]"]
    for axes, values, title in zip(
        figure.subplots(1, 2), (tuning.score.rms, 100 * tuning.score.retention), titles, strict=True
    ):
        mesh = axes.pcolormesh(
            tuning.k, tuning.snr, np.ma.masked_invalid(values), cmap="viridis", shading="nearest"
        )
        axes.plot(t.min_k, t.min_cn0_dbhz, "o", mfc="none", mec=ORANGE, ms=11, mew=2)
        axes.set(xlabel="k = |SDV·RMD| above", ylabel="C/N0 above [dB-Hz]", title=title)
        figure.colorbar(mesh, ax=axes)
    return figure


def _page(tuning: Tuning) -> str:
    t, best = tuning.thresholds, tuning.at(tuning.thresholds.min_cn0_dbhz, tuning.thresholds.min_k)
    assert best is not None
    k_name = _K_NAMES[t.k_of]
    verdict = (
        f"Keep pairs with {t.cn0_of} C/N0 above {t.min_cn0_dbhz:g} dB-Hz and {k_name} above "
        f"{t.min_k:g}. On data the choice had not seen: RMS {tuning.cv_rms:.3g} m/s with "
        f"{tuning.cv_retention:.0%} of the pairs retained (on all data: {best[0]:.3g} m/s, "
        f"{best[1]:.0%}). {tuning.decided[0].upper()}{tuning.decided[1:]}."
    )
    if tuning.knee is not None and (bend := tuning.at(*tuning.knee)) is not None:
        verdict += (
            f" The trade-off bends at C/N0 > {tuning.knee[0]:g} dB-Hz, k > {tuning.knee[1]:g}: "
            f"{bend[0]:.3g} m/s, {bend[1]:.0%} kept."
        )
    if not applied(tuning):
        verdict += " The filter screens by other quantities: this is the paper's figure."
    plots = Plots()
    body = [
        "<h1>Thresholds for Doppler velocity below four satellites</h1>",
        f'<p class="meta">{escape(_names(tuning))} · error of pairs</p>',
        f'<p class="verdict">{escape(verdict)}</p>',
        "<h2>Trade-off</h2>",
        plots.cells(panels.trade_off(tuning, plots), "RMS against retention"),
        "<h2>Over thresholds</h2>",
        plots.cells(panels.heat_maps(tuning, plots), "Over thresholds", columns=2),
        f"<h2>Cross-validation over {tuning.folds_by}</h2>",
        folds_table(tuning).html(),
        *_statistics(tuning),
        *(f'<p class="note">{escape(note)}</p>' for note in tuning.notes),
    ]
    beside = ("thresholds.toml", "tuning.json", "trade_off.pdf", "heat_map.pdf")
    body.append(document.files_beside(beside))
    return document.document("Thresholds · certnav", *plots.fill("\n".join(body)))


def _statistics(tuning: Tuning) -> list[str]:
    out = []
    if tuning.statistics:
        rows = tuple(
            (name, s["pairs"], s["k05_discarded_share"], s["rms_k05_mps"],
             s["k05_kept"] - s["kept_3rms"], s["rms_3rms_mps"], s["cn0"]["mean_dbhz"],
             s["cn0"]["std_db"], s["correlation"]["k"]["spearman"],
             s["correlation"]["snr_mean"]["spearman"])
            for name, s in tuning.statistics.items()
        )  # fmt: skip
        columns = (
            Column("pairs"), Column("number", "", ",d"), Column("k ≤ 0.05", "", ".1%"),
            Column("RMS", "m/s", ".2f"), Column("> 3 RMS", "", ",d"),
            Column("RMS without", "m/s", ".2f"), Column("C/N0", "dB-Hz", ".1f"),
            Column("its spread", "dB", ".1f"), Column("rank corr. k", "", "+.2f"),
            Column("rank corr. C/N0", "", "+.2f"),
        )  # fmt: skip
        table = Table("statistics", "Statistics of pairs", columns, rows)
        out += ["<h2>Statistics</h2>", table.html()]
    if tuning.noise:
        fits = tuple(
            (name, f.noise.floor, f.noise.sigma_45, f.noise.decade_db)
            for name, f in tuning.noise.items()
        )
        heads = (
            Column("Doppler noise"), Column("floor", "m/s", ".3f"),
            Column("at 45 dB-Hz", "m/s", ".3f"), Column("tenfold per", "dB", ".1f"),
        )  # fmt: skip
        out += ["<h2>Receivers</h2>", Table("receivers", "Doppler noise", heads, fits).html()]
    return out
