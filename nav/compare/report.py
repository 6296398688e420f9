"""One page that sets methods side by side: its verdict, and what each step bought."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import Any

from ...datasets.placing import write_file
from ...filters.errors import DataError
from ..page import document
from ..page.pictures import save
from ..page.plots import Plots
from ..page.quantities import length
from ..page.tables import Column, Table
from ..results.summary import strict
from ..spells.drift import statistics
from . import exports, sections
from .figures import FIGURES
from .intervals import FEWEST, LEVEL, change
from .runs import TOGETHER, Comparison, Run, as_dict, drifts, figures_of, spells_of, tables

PAGE, DATA = "comparison.html", "comparison.json"
_TABLES = ("comparison.csv", "spells.csv", "comparison.tex")

Tables = list[tuple[str, dict[str, list[Run]]]]
Figures = list[tuple[str, dict[str, Any]]]

#: What is added from one method to the next: name, from, to.
STEPS = (
    ("GNSS after the start, with ≥ 4 satellites", "alignment-only", "lc4"),
    ("the same, from a certified start", "certified-only", "lc4"),
    ("the same, with vehicle constraints", "alignment-only+vehicle", "lc4+vehicle"),
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
#: Of these the verdict speaks.
_TOLD = (("alignment-only", "lc4"), ("lc4", "lc+rows"), ("lc4+vehicle", "lc+rows+vehicle"))
#: Recordings of which it speaks where they cannot be taken together.
_MOST = 4
#: A change that no table of three digits shows.
_SAME = 5e-4


def check_replaceable(out: Path) -> None:
    """Refuse (`DataError`) to write over anything but a comparison or an empty folder."""
    if not out.exists() or (out / DATA).is_file() or (out.is_dir() and not any(out.iterdir())):
        return
    raise DataError(
        "exists and is not a comparison of certnav's", file=out,
        remedy="name another output directory, or remove this one",
    )  # fmt: skip


def write_page(comparison: Comparison, out: Path) -> Path:
    """Write the page, its numbers as JSON, CSV and LaTeX, and figures as PDF into `out`.

    Returns the page's path.
    """
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(strict(as_dict(comparison)), indent=2, ensure_ascii=False, allow_nan=False)
    files = {
        DATA: text + "\n",
        "comparison.csv": exports.figures_csv(comparison),
        "spells.csv": exports.spells_csv(comparison),
        "comparison.tex": exports.latex(comparison),
        PAGE: build_page(comparison),
    }
    for name, content in files.items():
        write_file(out / name, content.encode())
    for name, draw in FIGURES:
        save(draw, comparison, out / f"{name}.pdf")
    return out / PAGE


def build_page(comparison: Comparison) -> str:
    """Return the comparison as one HTML page that loads nothing from anywhere."""
    title = ", ".join(comparison.reference) or "Comparison"
    found = tables(comparison)
    figures = [
        (name, {m: figures_of(runs) for m, runs in by_method.items() if runs})
        for name, by_method in found
    ]
    plots = Plots()
    body = "\n".join(
        [
            f"<h1>{escape(title)}</h1>",
            f'<p class="meta">{escape(_what(comparison))}</p>',
            _verdict(comparison, found, figures),
            sections.methods(comparison),
            sections.drift(comparison, figures, plots),
            _steps_section(found),
            sections.growth(comparison, plots),
            sections.tracks(comparison, plots),
            sections.errors(figures),
            sections.consistency(figures),
            sections.updates(figures),
            sections.headings(figures),
            sections.notes(comparison),
            document.files_beside((DATA, *_TABLES, *(f"{name}.pdf" for name, _ in FIGURES))),
        ]
    )
    return document.document(f"{title}: methods compared · certnav", *plots.fill(body))


def _what(comparison: Comparison) -> str:
    names = {run.sequence for run in comparison.runs}
    parts = [f"{len(comparison.methods)} methods"]
    if len(names) > 1:
        parts.append(f"{len(names)} recordings")
    spells = max((len(spells_of(comparison.of(m))) for m in comparison.methods), default=0)
    if comparison.outages and spells:
        parts += [f"weak GNSS {comparison.outages}", f"{spells} spells each"]
    return " · ".join(parts)


def _verdict(comparison: Comparison, found: Tables, figures: Figures) -> str:
    """Say which method drifted least, and what the others were worth beside it."""
    sentences = []
    together = [(n, t) for n, t in figures if n == TOGETHER] or figures
    for name, table in together[:_MOST]:
        where = "" if len(figures) == 1 or name == TOGETHER else f"{name}: "
        sentences.append(where + _best(table))
        by_method = dict(found)[name]
        for before, after in _TOLD:
            said = _compared(by_method, before, after)
            if said and len(together) == 1:
                sentences.append(said)
    sentences = [s for s in sentences if s]
    if not sentences:
        return ""
    first, *rest = map(escape, sentences)
    more = f" {' '.join(rest)}" if rest else ""
    return f'<p class="verdict"><strong>{first}</strong>{more}</p>'


def _best(table: dict[str, Any]) -> str:
    drift = {n: f["drift_m"]["rms_of_maxima"] for n, f in table.items()}
    known = {n: d for n, d in drift.items() if d is not None}
    if known:
        live = {n: d for n, d in known.items() if not n.endswith("+smooth")}
        best = min(live or known, key=lambda n: known[n])
        return f"Least drift as it happens: {best}, {length(known[best])} (RMS of maxima)."
    rms = {n: f["errors"]["horizontal_rms_m"] for n, f in table.items()}
    known = {n: r for n, r in rms.items() if r is not None}
    if not known:
        return ""
    best = min(known, key=lambda n: known[n])
    return f"Smallest horizontal error: {best}, {length(known[best])} RMS."


def _compared(by_method: dict[str, list[Run]], before: str, after: str) -> str:
    """Return a sentence on two methods in the same spells; '' where there is none."""
    one, two = (drifts(by_method.get(m, ())) for m in (before, after))
    a, b = (statistics(v for k in d.values() for v in k)["rms_of_maxima"] for d in (one, two))
    changed = change(one, two)
    if a is None or b is None or changed is None:
        return ""
    return f"{after} drifts {length(b)} where {before} drifts {length(a)}: {in_words(*changed)}."


def in_words(changed: float, interval: tuple[float, float] | None, *, short: bool = False) -> str:
    """Return a change of drift in words: how much, and whether other spells might turn it round.

    Always as a share: of "three times less" nobody knows what it is three times of.

    Parameters
    ----------
    changed : float
        After over before, less 1.
    interval : (float, float), optional
        Of the same.
    short : bool
        For a cell of a table.
    """
    if abs(changed) < _SAME:
        return "the same"
    words = f"{_percent(changed)} % of it"
    if interval is None:
        return words
    low, high = interval
    ends = f"{100 * LEVEL:.0f} % interval {_percent(low)} … {_percent(high)} %"
    if low <= 0.0 <= high:
        return (
            f"{words}, undecided ({ends})" if short
            else f"{words}, which other spells might turn round ({ends})"
        )  # fmt: skip
    return f"{words} ({ends})"


def _percent(change: float) -> str:
    share = 100.0 * (1.0 + change)
    return f"{share:.1f}" if share < 9.95 or 99.0 < share < 101.0 else f"{share:.0f}"


def _steps_section(found: Tables) -> str:
    parts = []
    for name, by_method in found:
        rows = []
        for what, before, after in STEPS:
            one, two = (drifts(by_method.get(m, ())) for m in (before, after))
            changed = change(one, two)
            a, b = (statistics(v for k in d.values() for v in k)["rms_of_maxima"]
                    for d in (one, two))  # fmt: skip
            if changed is not None and a is not None and b is not None:
                said = in_words(*changed, short=True)
                rows.append((what, f"{before} → {after}", a, b, said))
        if rows:
            several = len(found)
            table = Table(
                sections.file_name("steps", name, several), f"What each step bought, {name}",
                (Column("step"), Column("from → to"), Column("drift before", "m", "3"),
                 Column("after", "m", "3"), Column("after in % of before")),
                tuple(rows), words=2,
            )  # fmt: skip
            parts.append(sections.under(name, table.html(), several))
    if not parts:
        return ""
    return (
        "<h2>What each step bought</h2>\n<p>RMS of maxima. Intervals are by bootstrap over the "
        f"spells, both methods in the same ones; of fewer than {FEWEST} stretches of road there "
        "is none, and nothing is decided by so few.</p>\n" + "\n".join(parts)
    )
