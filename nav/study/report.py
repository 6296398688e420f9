"""A study written down: one page, and every table and figure as a paper needs it.

``study.html``, ``study.json``; ``table2`` to ``table5``, ``operating_points`` and ``fig3`` to
``fig8`` as ``.csv``; the tables as ``.tex``, the figures as ``.pdf``.
"""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import Any

from ...datasets.placing import written_whole
from ...filters.errors import DataError
from ..page import document
from ..page.pictures import save
from ..page.plots import Plots
from ..results.summary import strict
from .figures import FIGURES
from .panels import PANELS
from .recording import Study
from .tables import series, tables

PAGE, DATA = "study.html", "study.json"
_DIRECTIONS = {
    "motion": "direction of motion from the reference's velocity",
    "attitude": "direction of motion from the reference's attitude",
}


def check_replaceable(out: Path) -> None:
    """Refuse (`DataError`) to write over anything but a study or an empty folder."""
    if not out.exists() or (out / DATA).is_file() or (out.is_dir() and not any(out.iterdir())):
        return
    raise DataError(
        "exists and is not a study of certnav's", file=out,
        remedy="name another output directory, or remove this one",
    )  # fmt: skip


def write_study(study: Study, out: str | Path) -> Path:
    """Write page, JSON, CSV, LaTeX and PDF to `out`, all or nothing.

    Raises
    ------
    DataError
        If `out` exists and is no study.
    """
    out = Path(out).resolve()
    check_replaceable(out)
    with written_whole(out) as draft:
        for table in tables(study):
            table.write(draft)
        for table in series(study):
            (draft / f"{table.name}.csv").write_text(table.csv(), encoding="utf-8")
        for name, draw, _, _ in FIGURES:
            save(draw, study, draft / f"{name}.pdf")
        text = json.dumps(strict(as_dict(study)), indent=1, allow_nan=False, ensure_ascii=False)
        (draft / DATA).write_text(text + "\n", encoding="utf-8")
        (draft / PAGE).write_text(build_page(study), encoding="utf-8")
    return out


def as_dict(study: Study) -> dict[str, Any]:
    """Return everything as plain values; what is not known is NaN or missing."""
    return {
        "systems": study.options.systems,
        "direction": study.options.direction,
        "label": study.options.label,
        "outage_epochs": study.options.epochs,
        "recordings": {
            one.name: {
                "epochs": one.epochs,
                **one.figures,
                "attitude": one.attitude,
                "notes": list(one.notes),
            }
            for one in study.recordings
        },
    }


def build_page(study: Study) -> str:
    """Return the study as one HTML page that loads nothing from anywhere."""
    names = [one.name for one in study.recordings]
    chosen = f"satellites {study.options.systems}, {_DIRECTIONS[study.options.direction]}"
    if study.options.label:
        chosen += f", rows labelled '{study.options.label}'"
    parts = [
        "<h1>Doppler velocity from pairs of satellites</h1>",
        f'<p class="meta">{escape(", ".join(names))} · {escape(chosen)}</p>',
        f'<p class="verdict">{_verdict(study)}</p>',
        "<p>Tables and figures of the DDIA-VE paper (PMC12736487), with its own figures below "
        "ours. Each table can be saved as CSV and LaTeX, the numbers behind each figure as CSV; "
        "the figures lie beside this page as PDF.</p>",
    ]
    numbers = {table.name: table for table in series(study)}
    plots = Plots()
    for table in tables(study):
        parts += [f"<h2>{escape(table.caption)}</h2>", table.html()]
    for name, _, heading, caption in FIGURES:
        draw, columns = PANELS[name]
        drawn = draw(study, plots)
        if drawn:
            parts += [
                f'<h2>{escape(heading)}</h2>\n<p class="note">{escape(caption)}</p>',
                plots.cells(drawn, heading, columns),
                f'<p class="controls downloads">{numbers[name].links()}</p>',
            ]
    notes = [note for one in study.recordings for note in one.notes]
    if notes:
        items = "".join(f"<li>{escape(note)}</li>" for note in notes)
        parts.append(f"<h2>Notes</h2>\n<ul>{items}</ul>")
    parts.append(document.files_beside((DATA, *(f"{name}.pdf" for name, *_ in FIGURES))))
    return document.document("Doppler study · certnav", *plots.fill("\n".join(parts)))


def sentences(study: Study) -> list[str]:
    """Return what thresholds of 40 dB-Hz and 0.2 do to each recording."""
    out = []
    for one in study.recordings:
        if not one.figures:
            out.append(f"{one.name}: not judged, see the notes.")
            continue
        cell, f = one.at(40.0, 0.2), one.figures
        kept = f"nothing of {f['pairs']} pairs left at SNR > 40, k > 0.2"
        if cell["count"]:
            kept = (
                f"{f['rms_k05_mps']:.3g} m/s RMS of {f['k05_kept']} pairs with k > 0.05, "
                f"{cell['rms_mps']:.3g} m/s with {cell['kept']:.1%} kept at SNR > 40, k > 0.2"
            )
        out.append(f"{one.name}: {kept}.")
    return out


def _verdict(study: Study) -> str:
    return "<br>".join(escape(text) for text in sentences(study))
