"""What has come of a dataset as one site: an index that leads to every page, and every table.

``index.html``; ``tables/`` with each table of each step as ``.tex`` and ``.csv``, and
``tables.tex``, a document of all of them; ``great.json`` with the figures of the index.
"""

from __future__ import annotations

import json
import shutil
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ....datasets.great.files import SIDECAR
from ....datasets.placing import write_file, written_whole
from ....filters.errors import DataError
from ...compare.report import PAGE as COMPARISON_PAGE
from ...config_files import to_toml
from ...page import document
from ...page.document import Link
from ...page.quantities import duration
from ...page.tables import Column, Table, latex_text
from ...results.summary import strict
from ...study.report import PAGE as STUDY_PAGE
from .dataset import COMPARISON, RUNS, STUDY, TUNED, TUNING, Outcome, Ran, Work

PAGE, DATA, TABLES = "index.html", "great.json", "tables"
#: Pages of the steps, in the order in which one reads them.
_PAGES = (
    ("study", STUDY, STUDY_PAGE, "Doppler velocity from pairs of satellites: the DDIA-VE paper's "
     "tables and figures of every recording"),
    ("tune", TUNING, "tuning.html", "which settings a run should have, judged by whole runs"),
    ("compare", COMPARISON, COMPARISON_PAGE, "loose coupling, alignment alone and GNSS alone in "
     "the same spells of weak GNSS"),
)  # fmt: skip
_NO_PAGES = "no page: see below what went wrong"
#: Where the errors of runs are in a summary, and how a table has them.
_ERRORS = (
    ("horizontal_rms_m", Column("horizontal RMS", "m", ".2f")),
    ("horizontal_p95_m", Column("95 %", "m", ".2f")),
    ("horizontal_max_m", Column("largest", "m", ".2f")),
    ("position_3d_rms_m", Column("3D RMS", "m", ".2f")),
    ("velocity_3d_rms_mps", Column("velocity RMS", "m/s", ".3f")),
    ("roll_rms_deg", Column("roll", "°", ".2f")),
    ("pitch_rms_deg", Column("pitch", "°", ".2f")),
    ("heading_rms_deg", Column("heading", "°", ".2f")),
    ("heading_rms_after_misalignment_deg", Column("heading, misalignment out", "°", ".2f")),
)


def check_replaceable(out: Path) -> None:
    """Refuse (`DataError`) a folder with pages in it that are not of this command."""
    if out.exists() and not out.is_dir():
        raise DataError("is a file", file=out, remedy="name another output directory")
    if (out / PAGE).exists() and not (out / DATA).is_file():
        raise DataError(
            f"{PAGE} is not of certnav great", file=out, remedy="name another output directory"
        )


def write_site(work: Work, found: Outcome, out: Path) -> Path:
    """Gather the tables and write the index; return its path."""
    own = [recordings_table(found), runs_table(found), steps_table(found)]
    with written_whole(out / TABLES) as draft:
        for table in own:
            table.write(draft)
        for name in (STUDY, TUNING, COMPARISON):
            for file in sorted((out / name).glob("*")):
                if file.suffix == ".tex":
                    shutil.copyfile(file, draft / file.name)
                    if (listed := file.with_suffix(".csv")).exists():
                        shutil.copyfile(listed, draft / listed.name)
        names = [table.name for table in own]
        others = sorted({f.stem for f in draft.glob("*.tex")} - set(names))
        (draft / "tables.tex").write_text(_all_tables([*names, *others], found), encoding="utf-8")
    content = strict(as_dict(found))
    text = json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False)
    write_file(out / DATA, (text + "\n").encode())
    write_file(out / PAGE, build_index(work, found, out).encode())
    return out / PAGE


def as_dict(found: Outcome) -> dict[str, Any]:
    """Return the figures of the index as plain values."""
    return {
        "simulated": found.simulated,
        "recordings": {o.name: {**o.figures, "left_out": o.why} for o in found.looked},
        "runs": [
            {"recording": r.name, "settings": r.settings, "failed": r.why, **_errors(r)}
            for r in found.runs
        ],
        "tuned": found.tuned,
        "steps": [{"step": n, "seconds": s, "failed": w} for n, s, w in found.steps],
    }


def recordings_table(found: Outcome) -> Table:
    """Return what each recording holds."""
    keys = (
        ("begin", Column("begins (GPS time)"), ""),
        ("duration_s", Column("duration", "s", ".0f"), 0),
        ("distance_km", Column("distance", "km", ".2f"), 0),
        ("imu_hz", Column("IMU", "Hz", ".0f"), 0),
        ("epochs", Column("GNSS epochs", "", ",d"), 0),
        ("satellites", Column("satellites, median", "", ".0f"), 0),
        ("below_four", Column("epochs below four", "", ".0%"), 0),
        ("systems", Column("systems"), ""),
    )
    rows = [(o.name, *(o.figures.get(key) for key, *_ in keys)) for o in found.looked]
    columns = (Column("recording"), *(column for _, column, _ in keys))
    return Table("recordings", _said(found, "Recordings"), columns, tuple(rows), 2)


def runs_table(found: Outcome) -> Table:
    """Return the errors of every run against its reference."""
    rows = []
    for run in sorted(found.runs, key=lambda r: [o.name for o in found.looked].index(r.name)):
        errors = _errors(run)
        waited = run.summary.get("alignment", {}).get("time_s")
        rows.append((run.name, run.settings, waited, *(errors.get(key) for key, _ in _ERRORS)))
    columns = (
        Column("recording"), Column("settings"), Column("aligned after", "s", ".0f"),
        *(column for _, column in _ERRORS),
    )  # fmt: skip
    return Table("runs", _said(found, "Errors against the reference"), columns, tuple(rows), 2)


def steps_table(found: Outcome) -> Table:
    """Return how long each step took."""
    rows = tuple((name, seconds, why or "done") for name, seconds, why in found.steps)
    columns = (Column("step"), Column("time", "s", ".0f"), Column("came of it"))
    return Table("steps", _said(found, "Steps"), columns, rows)


def build_index(work: Work, found: Outcome, out: Path) -> str:
    """Return the index as one page."""
    failed = [name for name, _, why in found.steps if why]
    whole = sum(seconds for _, seconds, _ in found.steps)
    cards = (
        (len(found.looked), "recordings"),
        (len(found.good()), "navigated"),
        (len(failed), "steps that failed"),
        (duration(whole), "all steps together"),
    )
    parts = [
        "<h1>GREAT, from archives to tables</h1>",
        f'<p class="meta">certnav {escape(version("certnav"))}</p>',
        f'<p class="verdict">{_verdict(found)}</p>',
        '<div class="cards">'
        + "".join(f"<div><b>{escape(str(n))}</b><span>{what}</span></div>" for n, what in cards)
        + "</div>",
        "<h2>Pages</h2>",
        document.table(["step", "what is there"], _pages(out), 9),
        "<h2>Recordings</h2>",
        _linked(recordings_table(found), "checks", "{}.html", out),
        "<h2>Runs</h2>",
        "<p>A name leads to the report of the run. Attitude is against the reference's axes as it "
        "is; in the last column a constant misalignment between the two is taken out.</p>",
        _runs(found, out),
    ]
    if found.good(TUNED):
        parts.append(
            '<p class="note">Tuned settings are judged here on the recordings they were chosen on; '
            "what choosing is worth where the choice had not been made is on the page of tuning."
            "</p>"
        )
    parts += [_left_out(found), "<h2>For a paper</h2>", _files(out)]
    parts += ["<h2>Time</h2>", steps_table(found).html()]
    parts += ["<h2>What was in force</h2>", _in_force(work)]
    return document.document("GREAT · certnav", "\n".join(part for part in parts if part))


def _verdict(found: Outcome) -> str:
    lines = []
    if found.simulated:
        lines.append(
            f"<strong>Simulated: {len(found.simulated)} of {len(found.looked)} recordings are "
            "simulated drives in the layout of GREAT. No figure of theirs is of the GREAT "
            "dataset.</strong>"
        )
    good = found.good()
    lines.append(f"{len(good)} of {len(found.looked)} recordings navigated.")
    if found.tuned:
        lines.append(f"Settings: {escape(found.tuned)}.")
    lines += [escape(text) for text in found.failures]
    return "<br>".join(lines)


def _pages(out: Path) -> list[tuple[object, ...]]:
    return [
        (Link(name, f"{folder}/{page}") if (out / folder / page).exists() else name,
         what if (out / folder / page).exists() else _NO_PAGES)
        for name, folder, page, what in _PAGES
    ]  # fmt: skip


def _linked(table: Table, folder: str, name: str, out: Path) -> str:
    """Return a table on the page whose first column leads to a file, where there is one."""
    rows: list[tuple[object, ...]] = []
    for first, *rest in table.texts():
        address = f"{folder}/{name.format(first)}"
        rows.append((Link(first, address) if (out / address).exists() else first, *rest))
    return document.table([c.heading for c in table.columns], rows, table.words)


def _runs(found: Outcome, out: Path) -> str:
    table = runs_table(found)
    rows: list[tuple[object, ...]] = []
    for first, settings, *rest in table.texts():
        address = f"{RUNS[settings]}/{first}/report.html"
        rows.append((Link(first, address) if (out / address).exists() else first, settings, *rest))
    return document.table([c.heading for c in table.columns], rows, table.words)


def _left_out(found: Outcome) -> str:
    if not found.failures:
        return ""
    items = "".join(f"<li>{escape(text)}</li>" for text in found.failures)
    return f"<h2>What went wrong</h2>\n<ul>{items}</ul>"


def _files(out: Path) -> str:
    folder = out / TABLES
    rows = []
    for file in sorted(folder.glob("*.tex")):
        listed = file.with_suffix(".csv").name
        beside: object = Link(listed, f"{TABLES}/{listed}") if (folder / listed).exists() else "–"
        rows.append((Link(file.name, f"{TABLES}/{file.name}"), beside))
    figures = sorted(p for n in (STUDY, TUNING) for p in (out / n).glob("*.pdf"))
    links = ", ".join(Link(p.name, p.relative_to(out).as_posix()).html for p in figures)
    return (
        "<p>Every table of these pages; <code>tables.tex</code> is a document of all of them.</p>"
        + document.table(["LaTeX", "CSV"], rows, 9)
        + (f"<p>Figures: {links}</p>" if links else "")
    )


def _in_force(work: Work) -> str:
    """Return what was declared of the recordings, and the configuration."""
    declared: dict[str, list[str]] = {}
    for folder in work.folders:
        file = folder / SIDECAR
        if file.is_file():
            declared.setdefault(file.read_text(encoding="utf-8"), []).append(folder.name)
    parts = [
        f"<h3>{escape(', '.join(names))}</h3>\n<pre>{escape(text)}</pre>"
        for text, names in declared.items()
    ]
    asked = escape(to_toml(work.config))
    parts.append(
        f"<details><summary>Configuration of the runs</summary><pre>{asked}</pre></details>"
    )
    return "\n".join(parts)


def _errors(run: Ran) -> dict[str, Any]:
    return dict(run.summary.get("errors") or {})


def _said(found: Outcome, caption: str) -> str:
    if not found.simulated:
        return caption
    return f"{caption}; {len(found.simulated)} of them simulated, not of the GREAT dataset"


def _all_tables(names: list[str], found: Outcome) -> str:
    title = "Tables" + (" (simulated drives: no figure is of GREAT)" if found.simulated else "")
    lines = [
        r"\documentclass{article}",
        r"\usepackage[a4paper,landscape,margin=1cm]{geometry}",
        r"\usepackage{booktabs}",
        r"\begin{document}",
        r"\footnotesize",
        rf"\section*{{{latex_text(title)}}}",
        *(rf"\input{{{name}}}" for name in names),
        r"\end{document}",
    ]
    return "\n".join(lines) + "\n"
