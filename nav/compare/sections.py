"""The tables and pictures of a comparison's page, recording by recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import Any

import numpy as np

from ..page import document
from ..page.quantities import duration, length, percent, quantity
from .figures import drift_figure, growth_figure, track_figure
from .intervals import FEWEST, LEVEL
from .runs import TOGETHER, Comparison, durations_agree, spells_of

#: Each recording, and the figures of its methods.
Figures = list[tuple[str, dict[str, Any]]]
Row = tuple[object, ...]


def methods(comparison: Comparison) -> str:
    """Return what each method does, in a sentence."""
    rows = [(name, what) for name, what in comparison.definitions.items() if what]
    if not rows:
        return ""
    table = document.table(["method", "what it does"], rows, numbers_from=2)
    return f"<h2>Methods</h2>\n{table}"


def drift(comparison: Comparison, figures: Figures) -> str:
    """Return the drift per spell."""
    head = ["method", "spells", "median", "RMS", f"{100 * LEVEL:.0f} % interval", "95 % of spells",
            "largest error, RMS", "at end, median", "velocity, RMS", "heading, RMS"]  # fmt: skip

    def row(name: str, f: dict[str, Any]) -> Row | None:
        d, m, v = f["drift_m"], f["max_error_m"], f["velocity_error_mps"]
        if d["median"] is None:
            return None
        return (
            name, f["spells"], length(d["median"]), length(d["rms_of_maxima"]),
            _interval(f["drift_interval_m"]), length(d["p95"]), length(m["rms_of_maxima"]),
            length(f["final_error_m"]["median"]), quantity(v["rms_of_maxima"], "m/s"),
            quantity(f["heading_drift_deg"]["rms_of_maxima"], "°"),
        )  # fmt: skip

    tables = _tables(head, figures, row)
    if not tables:
        return ""
    image = document.image(
        drift_figure, comparison, "Drift per method",
        "Each dot a spell; bar: median; diamond: RMS of maxima. Logarithmic.",
    )  # fmt: skip
    return (
        "<h2>Drift per spell</h2>\n<p>How far the horizontal error has moved since the spell "
        "began, at its worst: max |e(t) − e(t₀)|. The interval is that of the RMS, by bootstrap "
        f"over the spells; of fewer than {FEWEST} stretches of road there is none. The further "
        "columns: largest horizontal error, horizontal error at the end of the spell, largest "
        "horizontal velocity error, and change of the heading error."
        f"{_why_apart(comparison, figures)}</p>\n{tables}\n{image}"
    )


def _why_apart(comparison: Comparison, figures: Figures) -> str:
    """Say why recordings are not taken together."""
    spells = spells_of(comparison.runs)
    if len(figures) < 2 or not spells or durations_agree(spells):
        return ""
    ends = [s.end - s.start for s in spells]
    return (
        f" Spells are from {duration(min(ends))} to {duration(max(ends))} long: no figure stands "
        "for all of them, and recordings are not taken together."
    )


def growth(comparison: Comparison) -> str:
    """Return the drift against time since loss."""
    image = document.image(
        growth_figure, comparison, "Drift against time since loss",
        "Thin: every spell; shaded: from the smallest to the largest; thick: median. Logarithmic, "
        "ends at 0.1 m.",
    )  # fmt: skip
    return f"<h2>Drift against time since loss</h2>\n{image}" if image else ""


def tracks(comparison: Comparison) -> str:
    """Return the tracks of all methods."""
    return "<h2>Tracks</h2>\n" + document.image(
        track_figure, comparison, "Tracks of all methods",
        "First variant of each drive. Wide grey: what it is judged by. The map covers the "
        "reference; what leaves it is cut off.",
    )  # fmt: skip


def errors(figures: Figures) -> str:
    """Return the errors over the whole drive."""
    head = ["method", "horizontal RMS", "95 %", "largest", "up RMS", "3D RMS", "velocity RMS",
            "roll RMS", "pitch RMS", "heading RMS", "– misalignment removed", "available",
            "within 5 m"]  # fmt: skip

    def row(name: str, f: dict[str, Any]) -> Row | None:
        e = f["errors"]
        if e["horizontal_rms_m"] is None:
            return None
        return (
            name, length(e["horizontal_rms_m"]), length(e["horizontal_p95_m"]),
            length(e["horizontal_max_m"]), length(e["up_rms_m"]),
            length(e["position_3d_rms_m"]), quantity(e["velocity_3d_rms_mps"], "m/s"),
            *(quantity(e[f"{angle}_rms_deg"], "°") for angle in ("roll", "pitch", "heading")),
            quantity(e["heading_rms_after_misalignment_deg"], "°"),
            _share(f["availability"]), _share(f["within_5_m"]),
        )  # fmt: skip

    alone = [(name, table) for name, table in figures if name != TOGETHER]
    return (
        "<h2>Errors over the whole drive</h2>\n<p>Spells and all; where a method has several runs "
        "on a recording, the median of their figures. Available: epochs with a solution that is "
        f"not merely the last one held.</p>\n{_tables(head, alone, row)}"
    )


def consistency(figures: Figures) -> str:
    """Return what the covariances were worth."""
    head = ["method", "position in spells (ideal 3)", "outside (ideal 3)", "velocity (ideal 3)",
            "heading (ideal 1)", "NIS per dof (ideal 1)"]  # fmt: skip
    keys = ("nees_in", "nees_out", "nees_velocity", "nees_heading", "nis_mean")

    def row(name: str, f: dict[str, Any]) -> Row | None:
        c = f["consistency"]
        if all(v is None for v in c.values()):
            return None
        return (name, *(quantity(c.get(k), "") for k in keys))

    tables = _tables(head, figures, row)
    if not tables:
        return ""
    return (
        "<h2>Consistency</h2>\n<p>Mean of the squared error over the stated variance: of position "
        "eᵀP⁻¹e, of velocity the sum over its axes, of heading its own. Above the ideal a method "
        "claims more than it knows; below, less.</p>\n" + tables
    )


def updates(figures: Figures) -> str:
    """Return what each method used."""
    head = ["method", "update", "offered", "accepted", "", "NIS per dof"]
    parts = []
    for name, table in figures:
        rows = [
            (method if k == 0 else "", kind, u["offered"], u["accepted"],
             percent(u["accepted"], u["offered"]), quantity(u["nis_mean"], ""))
            for method, f in table.items()
            for k, (kind, u) in enumerate(f["updates"].items())
        ]  # fmt: skip
        if rows and name != TOGETHER:
            title = f"<h3>{escape(name)}</h3>\n" if len(figures) > 1 else ""
            parts.append(title + document.table(head, rows, numbers_from=2))
    if not parts:
        return ""
    return (
        "<h2>Updates</h2>\n<details><summary>What each method used</summary>"
        f"{''.join(parts)}</details>"
    )


def headings(figures: Figures) -> str:
    """Return the headings of sliding-window alignment."""
    head = ["method", "windows", "passed", "of these heading MAE", "largest", "all: heading MAE",
            "largest", "begin in spells",
            "of these solved", "heading MAE in spells"]  # fmt: skip

    def row(name: str, f: dict[str, Any]) -> Row | None:
        w = f.get("alignment_windows")
        if not w:
            return None
        return (
            name, f"{w['windows']:g}", f"{w['passed']:g}", quantity(w["mae_passed_deg"], "°"),
            quantity(w["largest_passed_deg"], "°"), quantity(w["mae_deg"], "°"),
            quantity(w["max_deg"], "°"), f"{w['windows_in_spells']:g}",
            f"{w['solved_in_spells']:g}", quantity(w["mae_in_spells_deg"], "°"),
        )  # fmt: skip

    tables = _tables(head, [each for each in figures if each[0] != TOGETHER], row)
    return f"<h2>Heading of sliding-window alignment</h2>\n{tables}" if tables else ""


def notes(comparison: Comparison) -> str:
    """Return what is not available, and what else there is to say."""
    missing = dict.fromkeys(
        f"{run.method} is not available on {run.sequence}{run.variant}: {run.reason}"
        for run in comparison.runs
        if run.reason
    )
    listed = "".join(f"<li>{escape(note)}</li>" for note in [*missing, *comparison.notes])
    return f"<h2>Notes</h2>\n<ul>{listed}</ul>" if listed else ""


def _tables(
    head: Sequence[str], figures: Figures, row: Callable[[str, dict[str, Any]], Row | None]
) -> str:
    """Return one table a recording, each under its name where there are several."""
    parts = []
    for name, table in figures:
        rows: Iterable[Row] = [r for m, f in table.items() if (r := row(m, f)) is not None]
        if rows:
            title = f"<h3>{escape(name)}</h3>\n" if len(figures) > 1 else ""
            parts.append(title + document.table(head, rows))
    return "\n".join(parts)


def _interval(ends: tuple[float, float] | None) -> str:
    return "–" if ends is None else f"{quantity(ends[0], '')} … {length(ends[1])}"


def _share(value: float | None) -> str:
    return "–" if value is None or not np.isfinite(value) else f"{100.0 * value:.3g} %"
