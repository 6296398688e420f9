"""The tables and plots of a comparison's page, recording by recording."""

from __future__ import annotations

import re
from collections.abc import Callable
from html import escape
from typing import Any

from ..page import document
from ..page.plots import Plots
from ..page.quantities import duration
from ..page.tables import Column, Table
from . import panels
from .intervals import FEWEST, LEVEL
from .runs import TOGETHER, Comparison, durations_agree, spells_of

#: Each recording, and the figures of its methods.
Figures = list[tuple[str, dict[str, Any]]]
Row = tuple[object, ...]

_METHOD, _INTERVAL = Column("method"), f"{100 * LEVEL:.0f} % interval of the RMS"


def _metres(title: str) -> Column:
    return Column(title, "m", "3")


def _degrees(title: str) -> Column:
    return Column(title, "°", "3")


def methods(comparison: Comparison) -> str:
    """Return what each method does, in a sentence."""
    rows = [(name, what) for name, what in comparison.definitions.items() if what]
    if not rows:
        return ""
    table = document.table(["method", "what it does"], rows, numbers_from=2)
    switches = Plots.switches(panels.samples(comparison), "Methods")
    return f"<h2>Methods</h2>\n{table}\n<p>Shown in the plots below:</p>{switches}"


def drift(comparison: Comparison, figures: Figures, plots: Plots) -> str:
    """Return the drift per spell."""
    columns = (
        _METHOD, Column("spells"), _metres("median"), _metres("RMS"),
        Column(f"{_INTERVAL}, from", "m", "3"), _metres("to"), _metres("95 % of spells"),
        _metres("largest error, RMS"), _metres("at end, median"),
        Column("velocity, RMS", "m/s", "3"),
        _degrees("heading, RMS"),
    )  # fmt: skip

    def row(name: str, f: dict[str, Any]) -> Row | None:
        d, m, v = f["drift_m"], f["max_error_m"], f["velocity_error_mps"]
        if d["median"] is None:
            return None
        return (
            name, f["spells"], d["median"], d["rms_of_maxima"],
            *(f["drift_interval_m"] or (None, None)), d["p95"], m["rms_of_maxima"],
            f["final_error_m"]["median"], v["rms_of_maxima"],
            f["heading_drift_deg"]["rms_of_maxima"],
        )  # fmt: skip

    tables = _tables("drift", "Drift per spell", columns, figures, row)
    if not tables:
        return ""
    drawn = plots.cells(panels.drift(comparison, plots), "Drift of every spell by method")
    return (
        "<h2>Drift per spell</h2>\n<p>How far the horizontal error has moved since the spell "
        "began, at its worst: max |e(t) − e(t₀)|. The interval is by bootstrap over the spells; "
        f"of fewer than {FEWEST} stretches of road there is none. The further "
        "columns: largest horizontal error, horizontal error at the end of the spell, largest "
        "horizontal velocity error, and change of the heading error."
        f'{_why_apart(comparison, figures)}</p>\n{tables}\n<p class="note">Each dot a spell; '
        f"bar: median; diamond: RMS of maxima. Logarithmic.</p>{drawn}"
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


def growth(comparison: Comparison, plots: Plots) -> str:
    """Return the drift against time since loss."""
    found = panels.growth(comparison, plots)
    if not found:
        return ""
    medians, *apart = found
    first = plots.cells([medians], "Median drift against time since loss")
    rest = plots.cells(apart, "Drift against time since loss", columns=4)
    return (
        '<h2>Drift against time since loss</h2>\n<p class="note">Medians of all methods, then each '
        "with its spells: thin: every spell; shaded: from the smallest to the largest. Logarithmic "
        f"from 0.1 m on; axes are shared.</p>\n{first}\n{rest}"
    )


def tracks(comparison: Comparison, plots: Plots) -> str:
    """Return the tracks of all methods."""
    found = panels.tracks(comparison, plots)
    if not found:
        return ""
    return (
        '<h2>Tracks</h2>\n<p class="note">First variant of each drive. Wide grey: what it is '
        "judged by, which the map shows at first.</p>\n"
        + plots.cells(found, "Tracks of all methods, north up", columns=2)
    )


def errors(figures: Figures) -> str:
    """Return the errors over the whole drive."""
    columns = (
        _METHOD, _metres("horizontal RMS"), _metres("95 %"), _metres("largest"), _metres("up RMS"),
        _metres("3D RMS"), Column("velocity RMS", "m/s", "3"), _degrees("roll RMS"),
        _degrees("pitch RMS"), _degrees("heading RMS"), _degrees("heading, misalignment removed"),
        Column("available", "%", ".3g"), Column("within 5 m", "%", ".3g"),
    )  # fmt: skip
    keys = (
        "horizontal_rms_m", "horizontal_p95_m", "horizontal_max_m", "up_rms_m",
        "position_3d_rms_m", "velocity_3d_rms_mps", "roll_rms_deg", "pitch_rms_deg",
        "heading_rms_deg", "heading_rms_after_misalignment_deg",
    )  # fmt: skip

    def row(name: str, f: dict[str, Any]) -> Row | None:
        if f["errors"]["horizontal_rms_m"] is None:
            return None
        shares = (None if f[k] is None else 100.0 * f[k] for k in ("availability", "within_5_m"))
        return (name, *(f["errors"][k] for k in keys), *shares)

    alone = [(name, table) for name, table in figures if name != TOGETHER]
    return (
        "<h2>Errors over the whole drive</h2>\n<p>Spells and all; where a method has several runs "
        "on a recording, the median of their figures. Available: epochs with a solution that is "
        "not merely the last one held.</p>\n"
        + _tables("errors", "Errors over the whole drive", columns, alone, row)
    )


def consistency(figures: Figures) -> str:
    """Return what the covariances were worth."""
    columns = (
        _METHOD, Column("position in spells (ideal 3)", "", "3"),
        Column("outside (ideal 3)", "", "3"), Column("velocity (ideal 3)", "", "3"),
        Column("heading (ideal 1)", "", "3"), Column("NIS per dof (ideal 1)", "", "3"),
    )  # fmt: skip
    keys = ("nees_in", "nees_out", "nees_velocity", "nees_heading", "nis_mean")

    def row(name: str, f: dict[str, Any]) -> Row | None:
        c = f["consistency"]
        return None if all(v is None for v in c.values()) else (name, *(c.get(k) for k in keys))

    tables = _tables("consistency", "Squared error over the stated variance", columns, figures, row)
    if not tables:
        return ""
    return (
        "<h2>Consistency</h2>\n<p>Mean of the squared error over the stated variance: of position "
        "eᵀP⁻¹e, of velocity the sum over its axes, of heading its own. Above the ideal a method "
        "claims more than it knows; below, less.</p>\n" + tables
    )


def updates(figures: Figures) -> str:
    """Return what each method used."""
    columns = (
        _METHOD, Column("update"), Column("offered"), Column("accepted"),
        Column("accepted", "%", ".3g"), Column("NIS per dof", "", "3"),
    )  # fmt: skip
    parts = []
    for name, by_method in figures:
        rows = tuple(
            (method, kind, u["offered"], u["accepted"],
             100.0 * u["accepted"] / u["offered"] if u["offered"] else None, u["nis_mean"])
            for method, f in by_method.items()
            for kind, u in f["updates"].items()
        )  # fmt: skip
        if rows and name != TOGETHER:
            file = file_name("updates", name, len(figures))
            table = Table(file, f"What each method used, {name}", columns, rows, words=2)
            parts.append(under(name, table.html(), len(figures)))
    if not parts:
        return ""
    return (
        "<h2>Updates</h2>\n<details><summary>What each method used</summary>"
        f"{''.join(parts)}</details>"
    )


def headings(figures: Figures) -> str:
    """Return the headings of sliding-window alignment."""
    columns = (
        _METHOD, Column("windows", "", "g"), Column("passed", "", "g"),
        _degrees("of these heading MAE"), _degrees("largest"), _degrees("all: heading MAE"),
        _degrees("largest"), Column("begin in spells", "", "g"),
        Column("of these solved", "", "g"), _degrees("heading MAE in spells"),
    )  # fmt: skip
    keys = (
        "windows", "passed", "mae_passed_deg", "largest_passed_deg", "mae_deg", "max_deg",
        "windows_in_spells", "solved_in_spells", "mae_in_spells_deg",
    )  # fmt: skip

    def row(name: str, f: dict[str, Any]) -> Row | None:
        w = f.get("alignment_windows")
        return (name, *(w[k] for k in keys)) if w else None

    alone = [each for each in figures if each[0] != TOGETHER]
    tables = _tables("headings", "Heading of sliding-window alignment", columns, alone, row)
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
    file: str, caption: str, columns: tuple[Column, ...], figures: Figures,
    row: Callable[[str, dict[str, Any]], Row | None],
) -> str:  # fmt: skip
    """Return one table a recording, each under its name where there are several."""
    parts = []
    for name, by_method in figures:
        rows = tuple(r for m, f in by_method.items() if (r := row(m, f)) is not None)
        if rows:
            several = len(figures)
            table = Table(file_name(file, name, several), f"{caption}, {name}", columns, rows)
            parts.append(under(name, table.html(), several))
    return "\n".join(parts)


def file_name(file: str, name: str, several: int) -> str:
    """Return the name of a table's files, with the recording's where there are several."""
    return file if several == 1 else f"{file}_{re.sub(r'[^A-Za-z0-9-]+', '_', name)}"


def under(name: str, table: str, several: int) -> str:
    """Return a table under the recording's name where there are several."""
    return f"<h3>{escape(name)}</h3>\n{table}" if several > 1 else table
