"""One page that sets methods side by side."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from ...datasets.placing import write_file
from ...filters.errors import DataError
from ..page import document
from ..page.quantities import length, percent, quantity
from ..results.summary import strict
from .figures import drift_figure, growth_figure, track_figure
from .runs import Comparison, as_dict, figures_of

PAGE, DATA = "comparison.html", "comparison.json"

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


def check_replaceable(out: Path) -> None:
    """Refuse (`DataError`) to write over anything but a comparison or an empty folder."""
    if not out.exists() or (out / DATA).is_file() or (out.is_dir() and not any(out.iterdir())):
        return
    raise DataError(
        "exists and is not a comparison of certnav's", file=out,
        remedy="name another output directory, or remove this one",
    )  # fmt: skip


def write_page(comparison: Comparison, out: Path) -> Path:
    """Write ``comparison.html`` and ``comparison.json`` into `out`; return the page's path."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(strict(as_dict(comparison)), indent=2, ensure_ascii=False, allow_nan=False)
    for name, content in ((DATA, text + "\n"), (PAGE, build_page(comparison))):
        write_file(out / name, content.encode())
    return out / PAGE


def build_page(comparison: Comparison) -> str:
    """Return the comparison as one HTML page that loads nothing from anywhere."""
    table = {name: figures_of(comparison.of(name)) for name in comparison.methods}
    title = ", ".join(comparison.reference) or "Comparison"
    body = "\n".join(
        [
            f"<h1>{escape(title)}</h1>",
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
    return document.document(f"{title}: methods compared · certnav", body)


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
    image = document.image(
        drift_figure, comparison, "Drift per method",
        "Each dot a spell; bar: median; diamond: RMS of maxima. Logarithmic.",
    )  # fmt: skip
    return (
        "<h2>Drift per spell</h2>\n<p>How far the horizontal error has moved since the spell "
        "began, at its worst: max |e(t) − e(t₀)|. The further columns: largest horizontal error, "
        "horizontal error at the end of the spell, largest horizontal velocity error, and change "
        f"of the heading error.</p>\n{document.table(head, rows)}\n{image}"
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
    return f"<h2>What each step bought</h2>\n{document.table(head, rows, numbers_from=2)}"


def _growth_section(comparison: Comparison) -> str:
    image = document.image(
        growth_figure, comparison, "Drift against time since loss",
        "Thin: every spell; shaded: from the smallest to the largest; thick: median. Logarithmic, "
        "ends at 0.1 m.",
    )  # fmt: skip
    return f"<h2>Drift against time since loss</h2>\n{image}" if image else ""


def _track_section(comparison: Comparison) -> str:
    return "<h2>Tracks</h2>\n" + document.image(
        track_figure, comparison, "Tracks of all methods",
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
        f"last one held.</p>\n{document.table(head, rows)}"
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
        "the method claims more than it knows; below, less.</p>\n" + document.table(head, rows)
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
        f"{document.table(head, rows, numbers_from=2)}</details>"
    )


def _alignment_section(table: dict[str, Any]) -> str:
    rows = []
    for name, f in table.items():
        w = f.get("alignment_windows")
        if w:
            rows.append(
                (name, f"{w['windows']:g}", f"{w['passed']:g}", quantity(w["mae_deg"], "°"),
                 quantity(w["max_deg"], "°"), f"{w['windows_in_spells']:g}",
                 f"{w['solved_in_spells']:g}", quantity(w["mae_in_spells_deg"], "°"))
            )  # fmt: skip
    if not rows:
        return ""
    head = ["method", "windows", "passed", "heading MAE", "largest", "begin in spells",
            "of these solved", "heading MAE in spells"]  # fmt: skip
    return f"<h2>Heading of sliding-window alignment</h2>\n{document.table(head, rows)}"


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
