"""A comparison as tables for other programs and for a paper: CSV and LaTeX."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from typing import Any

from ..page.quantities import quantity
from .runs import Comparison, figures_of, tables

#: Figures of a method on a recording: column, and where it is found.
_COLUMNS: tuple[tuple[str, tuple[str | int, ...]], ...] = (
    ("runs", ("runs",)),
    ("spells", ("spells",)),
    ("drift_median_m", ("drift_m", "median")),
    ("drift_rms_m", ("drift_m", "rms_of_maxima")),
    ("drift_rms_low_m", ("drift_interval_m", 0)),
    ("drift_rms_high_m", ("drift_interval_m", 1)),
    ("drift_p95_m", ("drift_m", "p95")),
    ("largest_error_rms_m", ("max_error_m", "rms_of_maxima")),
    ("final_error_median_m", ("final_error_m", "median")),
    ("velocity_error_rms_mps", ("velocity_error_mps", "rms_of_maxima")),
    ("heading_drift_rms_deg", ("heading_drift_deg", "rms_of_maxima")),
    ("horizontal_rms_m", ("errors", "horizontal_rms_m")),
    ("horizontal_p95_m", ("errors", "horizontal_p95_m")),
    ("horizontal_max_m", ("errors", "horizontal_max_m")),
    ("up_rms_m", ("errors", "up_rms_m")),
    ("position_3d_rms_m", ("errors", "position_3d_rms_m")),
    ("velocity_3d_rms_mps", ("errors", "velocity_3d_rms_mps")),
    ("roll_rms_deg", ("errors", "roll_rms_deg")),
    ("pitch_rms_deg", ("errors", "pitch_rms_deg")),
    ("heading_rms_deg", ("errors", "heading_rms_deg")),
    ("available", ("availability",)),
    ("within_5_m", ("within_5_m",)),
    ("nees_in_spells", ("consistency", "nees_in")),
    ("nees_outside", ("consistency", "nees_out")),
    ("nees_velocity", ("consistency", "nees_velocity")),
    ("nees_heading", ("consistency", "nees_heading")),
    ("nis_per_dof", ("consistency", "nis_mean")),
)
_SPELL = (
    "start", "end", "drift", "max_error", "final_drift", "final_error", "velocity_error",
    "heading_drift", "nees_before", "nees_end",
)  # fmt: skip
#: Of a table in a paper: head, column, whether it is of spells.
_PAPER = (
    ("spells", "spells", True),
    ("median", "drift_median_m", True),
    ("RMS", "drift_rms_m", True),
    (r"95\,\% interval", "drift_rms_low_m", True),
    (r"95\,\%", "drift_p95_m", True),
    ("horizontal", "horizontal_rms_m", False),
    ("3D", "position_3d_rms_m", False),
    (r"heading [$^\circ$]", "heading_rms_deg", False),
)
_SPECIAL = {c: "\\" + c for c in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\~{}",
    "^": r"\^{}",
}


def figures_csv(comparison: Comparison) -> str:
    """Return a row for each method on each recording, and on all where they are taken together."""
    rows = [
        (recording, method, *(_at(figures, path) for _, path in _COLUMNS))
        for recording, method, figures in _all(comparison)
    ]
    return _csv(("recording", "method", *(name for name, _ in _COLUMNS)), rows)


def spells_csv(comparison: Comparison) -> str:
    """Return a row for each spell of each run: times in GPS seconds, metres, radians."""
    rows = [
        (run.sequence, run.variant, run.method, *(getattr(spell, name) for name in _SPELL))
        for run in comparison.runs
        for spell in run.spells
    ]
    units = ("s", "s", "m", "m", "m", "m", "mps", "rad", "", "")
    head = [f"{n}_{u}".rstrip("_") for n, u in zip(_SPELL, units, strict=True)]
    return _csv(("recording", "variant", "method", *head), rows)


def latex(comparison: Comparison) -> str:
    """Return one table a recording, to be included where ``booktabs`` is loaded."""
    where = dict(_COLUMNS)
    parts = ["% certnav compare: \\usepackage{booktabs}; metres unless said otherwise\n"]
    for recording, by_method in tables(comparison):
        figures = {m: figures_of(runs) for m, runs in by_method.items() if runs}
        figures = {m: f for m, f in figures.items() if f["runs"]}
        weak = any(f["spells"] for f in figures.values())
        shown = [(head, name) for head, name, of_spells in _PAPER if weak or not of_spells]
        parts.append(
            f"% {_escaped(recording)}\n\\begin{{tabular}}{{l{'r' * len(shown)}}}\n\\toprule\n"
        )
        if weak:
            count = sum(of_spells for *_, of_spells in _PAPER)
            parts.append(
                f" & \\multicolumn{{{count}}}{{c}}{{drift per spell}} & "
                f"\\multicolumn{{{len(shown) - count}}}{{c}}{{whole drive, RMS}} \\\\\n"
            )
        parts.append(" & ".join(["method", *(head for head, _ in shown)]) + " \\\\\n\\midrule\n")
        for method, f in figures.items():
            cells = [
                _interval(f) if name == "drift_rms_low_m" else _cell(_at(f, where[name]))
                for _, name in shown
            ]
            parts.append(" & ".join([_escaped(method), *cells]) + " \\\\\n")
        parts.append("\\bottomrule\n\\end{tabular}\n\n")
    return "".join(parts)


def _all(comparison: Comparison) -> Iterable[tuple[str, str, dict[str, Any]]]:
    for recording, by_method in tables(comparison):
        for method, runs in by_method.items():
            if runs:
                yield recording, method, figures_of(runs)


def _at(figures: Any, path: tuple[str | int, ...]) -> Any:
    for key in path:
        if figures is None:
            return None
        figures = figures.get(key) if isinstance(key, str) else figures[key]
    return figures


def _csv(head: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        writer.writerow("" if v is None or v != v else v for v in row)
    return out.getvalue()


def _interval(figures: dict[str, Any]) -> str:
    ends = figures["drift_interval_m"]
    return "--" if ends is None else f"{_cell(ends[0])}--{_cell(ends[1])}"


def _cell(value: float | None) -> str:
    return "--" if value is None or value != value else quantity(value, "")


def _escaped(text: str) -> str:
    return "".join(_SPECIAL.get(c, c) for c in text)
