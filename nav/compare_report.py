"""One page that sets methods side by side, made by a comparison or from result directories."""

from __future__ import annotations

import json
import os
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from filters.earth import lla_to_ecef
from filters.errors import DataError
from filters.rotation import FloatArray
from nav import figures
from nav.compare import (
    SIDECAR,
    Comparison,
    Run,
    SpellFigures,
    as_dict,
    figures_of,
    reduced,
    thin_track,
)
from nav.report import _STYLE, _table
from nav.results import is_result, read_result
from nav.summary import strict
from nav.verdict import length, percent, quantity

PAGE, DATA = "comparison.html", "comparison.json"

#: Colour by what a method is at heart; line by what was added.
_COLOURS = {
    "gnss-only": figures.GREY, "alignment-only": "#CC79A7", "lc4": figures.VERMILLION,
    "lc+ddia": figures.ORANGE, "lc+rows": figures.BLUE,
}  # fmt: skip
_OTHERS = (figures.GREEN, figures.SKY, "#CC79A7", figures.INK)
_LINES = {"": "-", "+vehicle": "--", "+smooth": ":", "+vehicle+smooth": "-."}
#: Below this nothing in a comparison of metres matters, and a logarithm needs an end [m].
_LEAST = 0.1

#: What is added from one method to the next: name, from, to.
_STEPS = (
    ("IMU, with ≥ 4 satellites only", "gnss-only", "lc4"),
    ("2–3 satellites: DDIA-VE", "lc4", "lc+ddia"),
    ("2–3 satellites: rows instead of DDIA-VE", "lc+ddia", "lc+rows"),
    ("2–3 satellites: rows", "lc4", "lc+rows"),
    ("vehicle constraints, ≥ 4 satellites only", "lc4", "lc4+vehicle"),
    ("vehicle constraints with rows", "lc+rows", "lc+rows+vehicle"),
    ("rows with vehicle constraints", "lc4+vehicle", "lc+rows+vehicle"),
    ("DDIA-VE with vehicle constraints", "lc4+vehicle", "lc+ddia+vehicle"),
    ("smoothing, ≥ 4 satellites only", "lc4", "lc4+smooth"),
    ("smoothing with rows", "lc+rows", "lc+rows+smooth"),
    ("smoothing with rows and constraints", "lc+rows+vehicle", "lc+rows+vehicle+smooth"),
)


def write_page(comparison: Comparison, out: Path) -> Path:
    """Write ``comparison.html`` and ``comparison.json`` into `out`; return the page's path."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(strict(as_dict(comparison)), indent=2, ensure_ascii=False, allow_nan=False)
    for name, content in ((DATA, text + "\n"), (PAGE, build_page(comparison))):
        draft = out / f".{name}.new"
        draft.write_text(content, encoding="utf-8")
        os.replace(draft, out / name)
    return out / PAGE


def merge(directories: list[Path]) -> Comparison:
    """Return the comparison of result directories made elsewhere.

    Parameters
    ----------
    directories : list of Path
        Result directories, or folders that hold some, at any depth.

    A result that took part in a comparison brings its spells along; a plain run has none, is
    called by its directory, and is compared by its errors alone.

    Raises
    ------
    DataError
        If there is no result directory, or one of them is damaged.
    """
    found: list[Path] = []
    for directory in map(Path, directories):
        if not directory.is_dir():
            raise DataError("no such directory", file=directory, remedy="name result directories")
        below = [directory, *sorted(p.parent for p in directory.rglob("summary.json"))]
        inside = [p for p in dict.fromkeys(below) if is_result(p)]
        if not inside:
            raise DataError(
                "holds no certnav result", file=directory, remedy="give what a run has written"
            )
        found += inside
    reference: dict[str, FloatArray] = {}
    runs, outages = [], []
    for path in dict.fromkeys(p.resolve() for p in found):
        run, spec, track = _run_from(path)
        runs.append(run)
        outages.append(spec)
        if track is not None:
            reference.setdefault(run.sequence, track)
    order = list(dict.fromkeys(run.method for run in runs))
    runs.sort(key=lambda run: order.index(run.method))
    spec = ", ".join(dict.fromkeys(s for s in outages if s))
    return Comparison(
        tuple(runs), reference, spec, (f"merged from {len(runs)} result directories",)
    )


def _run_from(path: Path) -> tuple[Run, str, FloatArray | None]:
    result = read_result(path)
    about: dict[str, Any] = {}
    if (path / SIDECAR).is_file():
        try:
            about = json.loads((path / SIDECAR).read_text(encoding="utf-8"))
            spells = np.array(about["spells"], dtype=float).reshape(-1, 2)
            names = about["method"], about["sequence"], about["variant"]
        except (ValueError, KeyError, TypeError):
            raise DataError("not as certnav writes it", file=path / SIDECAR) from None
    else:
        spells, names = np.zeros((0, 2)), (path.name, result.name, "")
    evaluation = result.evaluation
    track = None
    if evaluation.has_reference:
        track = thin_track(lla_to_ecef(*evaluation.ref_lla.T))
    run = reduced(
        *names, result.solution, evaluation, spells,
        availability=float(about.get("availability") or 1.0),
    )  # fmt: skip
    return run, str(about.get("outages", "")), track


def build_page(comparison: Comparison) -> str:
    """Return the comparison as one HTML page that loads nothing from anywhere."""
    table = {name: figures_of(comparison.of(name)) for name in comparison.methods}
    title = escape(", ".join(comparison.reference) or "Comparison")
    body = "\n".join(
        [
            f"<h1>{title}</h1>",
            f'<p class="meta">{escape(_what(comparison))}</p>',
            _verdict(table),
            _drift_section(comparison, table),
            _steps_section(table),
            _growth_section(comparison),
            _track_section(comparison),
            _error_section(table),
            _consistency_section(table),
            _update_section(table),
            _alignment_section(table),
            _notes_section(comparison, table),
        ]
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{title}: methods compared · certnav</title>\n<style>{_STYLE}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def _what(comparison: Comparison) -> str:
    runs = max((len(comparison.of(name)) for name in comparison.methods), default=0)
    spells = max((sum(len(r.spells) for r in comparison.of(m)) for m in comparison.methods),
                 default=0)  # fmt: skip
    parts = [f"{len(comparison.methods)} methods", f"{runs} runs each"]
    if comparison.outages:
        parts += [f"weak GNSS {comparison.outages}", f"{spells} spells each"]
    return " · ".join(parts)


def _verdict(table: dict[str, Any]) -> str:
    """Say which method drifted least, and what holding below four satellites was worth."""
    drift = {n: f["drift_m"]["rms_of_maxima"] for n, f in table.items()}
    known = {n: d for n, d in drift.items() if d is not None}
    if not known:
        rms = {n: f["errors"]["horizontal_rms_m"] for n, f in table.items()}
        known = {n: r for n, r in rms.items() if r is not None}
        if not known:
            return ""
        best = min(known, key=lambda n: known[n])
        first = f"Smallest horizontal error: {best}, {length(known[best])} RMS."
        return f'<p class="verdict"><strong>{escape(first)}</strong></p>'
    live = {n: d for n, d in known.items() if not n.endswith("+smooth")}
    best = min(live or known, key=lambda n: known[n])
    sentences = [f"Least drift as it happens: {best}, {length(known[best])} (RMS of maxima)."]
    for before, after in (("lc4", "lc+rows"), ("lc4+vehicle", "lc+rows+vehicle")):
        if before in known and after in known:
            sentences.append(
                f"{after} drifts {length(known[after])} where {before} drifts "
                f"{length(known[before])}: {_factor(known[before], known[after])}."
            )
    first, *rest = map(escape, sentences)
    return f'<p class="verdict"><strong>{first}</strong> {" ".join(rest)}</p>'


def _factor(before: float, after: float) -> str:
    if after <= 0.0 or before <= 0.0:
        return "–"
    return (
        f"{before / after:.3g} times less"
        if before >= after
        else (f"{after / before:.3g} times more")
    )


def _drift_section(comparison: Comparison, table: dict[str, Any]) -> str:
    rows = []
    for name, f in table.items():
        d, m, v = f["drift_m"], f["max_error_m"], f["velocity_error_mps"]
        if d["median"] is None:
            continue
        rows.append(
            (name, f["spells"], length(d["median"]), length(d["rms_of_maxima"]), length(d["p95"]),
             length(m["rms_of_maxima"]), length(f["final_error_m"]["median"]),
             quantity(v["rms_of_maxima"], "m/s"),
             quantity(f["heading_drift_deg"]["rms_of_maxima"], "°"))
        )  # fmt: skip
    if not rows:
        return ""
    head = ["method", "spells", "median", "RMS", "95 %", "largest error, RMS", "at end, median",
            "velocity, RMS", "heading, RMS"]  # fmt: skip
    image = _image(
        _drift_figure, comparison, "Drift per method",
        "Each dot a spell; bar: median; diamond: RMS of maxima. Logarithmic.",
    )  # fmt: skip
    return (
        "<h2>Drift per spell</h2>\n<p>How far the horizontal error has moved since the spell "
        "began, at its worst: max |e(t) − e(t₀)|. The further columns: largest horizontal error, "
        "horizontal error at the end of the spell, largest horizontal velocity error, and change "
        f"of the heading error.</p>\n{_table(head, rows)}\n{image}"
    )


def _steps_section(table: dict[str, Any]) -> str:
    rows = []
    for what, before, after in _STEPS:
        if before in table and after in table:
            a, b = (table[n]["drift_m"]["rms_of_maxima"] for n in (before, after))
            if a is not None and b is not None:
                rows.append((what, f"{before} → {after}", length(a), length(b), _factor(a, b)))
    if not rows:
        return ""
    head = ["step", "", "drift before", "after", ""]
    return f"<h2>What each step bought</h2>\n{_table(head, rows, numbers_from=2)}"


def _growth_section(comparison: Comparison) -> str:
    image = _image(
        _growth_figure, comparison, "Drift against time since loss",
        "Thin: every spell; shaded: from the smallest to the largest; thick: median. Logarithmic, "
        "ends at 0.1 m.",
    )  # fmt: skip
    return f"<h2>Drift against time since loss</h2>\n{image}" if image else ""


def _track_section(comparison: Comparison) -> str:
    return "<h2>Tracks</h2>\n" + _image(
        _track_figure, comparison, "Tracks of all methods",
        "First variant of each drive. Wide grey: what it is judged by. The map covers the "
        "reference; what leaves it is cut off.",
    )  # fmt: skip


def _error_section(table: dict[str, Any]) -> str:
    rows = []
    for name, f in table.items():
        e = f["errors"]
        if e["horizontal_rms_m"] is None:
            continue
        rows.append(
            (name, length(e["horizontal_rms_m"]), length(e["horizontal_p95_m"]),
             length(e["horizontal_max_m"]), length(e["up_rms_m"]),
             quantity(e["velocity_3d_rms_mps"], "m/s"), quantity(e["heading_rms_deg"], "°"),
             quantity(e["heading_rms_after_misalignment_deg"], "°"),
             _share(f["availability"]), _share(f["within_5_m"]))
        )  # fmt: skip
    head = ["method", "horizontal RMS", "95 %", "largest", "up RMS", "velocity RMS",
            "heading RMS", "– misalignment removed", "available", "within 5 m"]  # fmt: skip
    return (
        "<h2>Errors over the whole drive</h2>\n<p>Spells and all; where there are several runs, "
        "the median of their figures. Available: epochs with a solution that is not merely the "
        f"last one held.</p>\n{_table(head, rows)}"
    )


def _consistency_section(table: dict[str, Any]) -> str:
    rows = []
    for name, f in table.items():
        c = f["consistency"]
        if any(v is not None for v in c.values()):
            rows.append((name, *(quantity(c[k], "") for k in ("nees_in", "nees_out", "nis_mean"))))
    if not rows:
        return ""
    head = ["method", "NEES in spells (ideal 3)", "outside (ideal 3)", "NIS per dof (ideal 1)"]
    return (
        "<h2>Consistency</h2>\n<p>Mean of eᵀP⁻¹e of position, three degrees of freedom. Above 3 "
        "the method claims more than it knows; below, less.</p>\n" + _table(head, rows)
    )


def _update_section(table: dict[str, Any]) -> str:
    rows = []
    for name, f in table.items():
        for k, (kind, u) in enumerate(f["updates"].items()):
            rows.append(
                (name if k == 0 else "", kind, u["offered"], u["accepted"],
                 percent(u["accepted"], u["offered"]), quantity(u["nis_mean"], ""))
            )  # fmt: skip
    if not rows:
        return ""
    head = ["method", "update", "offered", "accepted", "", "NIS per dof"]
    return (
        "<h2>Updates</h2>\n<details><summary>What each method used</summary>"
        f"{_table(head, rows, numbers_from=2)}</details>"
    )


def _alignment_section(table: dict[str, Any]) -> str:
    rows = []
    for name, f in table.items():
        w = f.get("alignment_windows")
        if w:
            rows.append(
                (name, f"{w['windows']:g}", f"{w['certified']:g}", quantity(w["mae_deg"], "°"),
                 quantity(w["max_deg"], "°"), f"{w['windows_in_spells']:g}",
                 f"{w['solved_in_spells']:g}", quantity(w["mae_in_spells_deg"], "°"))
            )  # fmt: skip
    if not rows:
        return ""
    head = ["method", "windows", "certified", "heading MAE", "largest", "begin in spells",
            "of these solved", "heading MAE in spells"]  # fmt: skip
    return f"<h2>Heading of sliding-window alignment</h2>\n{_table(head, rows)}"


def _notes_section(comparison: Comparison, table: dict[str, Any]) -> str:
    missing = [
        f"{name} is not available: {reason}"
        for name, f in table.items()
        for reason in f.get("not_available", [])
    ]
    notes = "".join(f"<li>{escape(note)}</li>" for note in [*missing, *comparison.notes])
    return f"<h2>Notes</h2>\n<ul>{notes}</ul>" if notes else ""


def _share(value: float | None) -> str:
    return "–" if value is None or not np.isfinite(value) else f"{100.0 * value:.3g} %"


def _image(draw: Any, comparison: Comparison, alt: str, caption: str) -> str:
    address = figures.render(draw, comparison)  # type: ignore[arg-type]
    if address is None:
        return ""
    return (
        f'<figure><img src="{address}" alt="{escape(alt)}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def style_of(method: str, methods: list[str]) -> tuple[str, str]:
    """Return colour and line style of a method."""
    base = method.removesuffix("+smooth").removesuffix("+vehicle")
    unknown = [m for m in methods if m not in _COLOURS and not m.startswith(tuple(_COLOURS))]
    if base in _COLOURS:
        return _COLOURS[base], _LINES.get(method.removeprefix(base), "-")
    return _OTHERS[unknown.index(method) % len(_OTHERS)], "-"


def _spells(comparison: Comparison, method: str) -> list[SpellFigures]:
    return [spell for run in comparison.of(method) for spell in run.spells]


def _drift_figure(comparison: Comparison) -> Figure | None:
    methods = [m for m in comparison.methods if _spells(comparison, m)]
    if not methods:
        return None
    figure = Figure(figsize=(figures._WIDTH, 0.9 + 0.27 * len(methods)))
    axes = figure.subplots()
    for k, method in enumerate(methods):
        drift = np.maximum([s.drift for s in _spells(comparison, method)], _LEAST / 2)
        colour, _ = style_of(method, methods)
        axes.plot(drift, np.full(drift.size, k), "o", color=colour, markersize=4, alpha=0.35,
                  markeredgewidth=0)  # fmt: skip
        axes.plot([np.median(drift)] * 2, [k - 0.35, k + 0.35], color=figures.INK, linewidth=1.8)
        rms = float(np.sqrt(np.mean(drift**2)))
        axes.plot(rms, k, "D", color=colour, markeredgecolor=figures.INK, markersize=6)
    axes.set_xscale("log")
    axes.set_yticks(range(len(methods)), methods)
    axes.invert_yaxis()
    axes.set_xlabel("horizontal drift of a spell [m]")
    return figure


def _growth_figure(comparison: Comparison) -> Figure | None:
    methods = [m for m in comparison.methods if _spells(comparison, m)]
    if not methods:
        return None
    columns = min(4, len(methods))
    rows = -(-len(methods) // columns)
    figure = Figure(figsize=(figures._WIDTH, 0.4 + 2.0 * rows))
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in grid.ravel()[len(methods) :]:
        axes.set_visible(False)
    for axes, method in zip(grid.ravel(), methods, strict=False):
        spells = _spells(comparison, method)
        colour, _ = style_of(method, methods)
        size = max(s.since.size for s in spells)
        curves = np.full((len(spells), size), np.nan)
        for curve, spell in zip(curves, spells, strict=True):
            curve[: spell.since.size] = np.maximum(spell.growth, _LEAST)
        since = np.arange(size, dtype=float)
        for curve in curves[:60]:
            axes.plot(since, curve, color=colour, linewidth=0.5, alpha=0.35)
        axes.fill_between(since, np.nanmin(curves, axis=0), np.nanmax(curves, axis=0),
                          color=colour, alpha=0.12, linewidth=0)  # fmt: skip
        axes.plot(since, np.nanmedian(curves, axis=0), color=colour, linewidth=2.2)
        axes.set_title(method)
        axes.set_yscale("log")
        axes.set_ylim(bottom=_LEAST)
    for axes in grid[:, 0]:
        axes.set_ylabel("drift [m]")
    for axes in grid[-1]:
        axes.set_xlabel("time since loss [s]")
    return figure


def _track_figure(comparison: Comparison) -> Figure | None:
    names = list(dict.fromkeys(run.sequence for run in comparison.runs if run.track.size))[:4]
    if not names:
        return None
    columns = min(2, len(names))
    rows = -(-len(names) // columns)
    size = (figures._WIDTH, 6.4 if columns == 1 else 0.6 + 5.0 * rows)
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
            east, north = _metres(judged, origin)
            axes.plot(east, north, color="#111111", linewidth=5.0, alpha=0.25, label="reference")
        for method, run in runs.items():
            east, north = _metres(run.track, origin)
            colour, line = style_of(method, comparison.methods)
            axes.plot(east, north, color=colour, linestyle=line, linewidth=1.1, label=method)
        shown = _metres(judged if judged is not None else next(iter(runs.values())).track, origin)
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


def _metres(track: FloatArray, origin: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return metres east and north of `origin` on a sphere: for drawing, to a few per mille."""
    per_degree = np.radians(1.0) * 6.371e6
    east = (track[:, 0] - origin[0]) * per_degree * np.cos(np.radians(origin[1]))
    return east, (track[:, 1] - origin[1]) * per_degree
