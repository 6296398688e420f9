"""Recommended settings, written down: thresholds.toml, tuning.json, CSV, LaTeX and a page."""

from __future__ import annotations

import dataclasses
import json
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...datasets.placing import written_whole
from ..config import Config
from ..config_files import to_toml
from ..page import document
from ..page.palette import BLUE, GREEN, GREY, ORANGE, VERMILLION
from ..page.pictures import WIDTH, save
from ..page.plots import Plots
from ..page.tables import Column, Table
from ..results.summary import strict
from . import panels
from .candidates import insisting_keys
from .choice import Change
from .report import check_replaceable
from .settings import Settings, interval

_PARTS = ("as recorded", "weak GNSS")


def write_settings(found: Settings, out: str | Path) -> Path:
    """Write thresholds.toml, tuning.json, tuning.html, tables and figure, all or nothing.

    Raises
    ------
    DataError
        If `out` exists and is no tuning result.
    """
    out = Path(out).resolve()
    check_replaceable(out)
    with written_whole(out) as draft:
        (draft / "thresholds.toml").write_text(settings_toml(found), encoding="utf-8")
        text = json.dumps(strict(as_dict(found)), indent=1, allow_nan=False, ensure_ascii=False)
        (draft / "tuning.json").write_text(text + "\n", encoding="utf-8")
        for table in (candidates_table(found), folds_table(found), receivers_table(found)):
            table.write(draft)
        save(candidates_figure, found, draft / "candidates.pdf")
        (draft / "tuning.html").write_text(build_page(found), encoding="utf-8")
    return out


def settings_toml(found: Settings) -> str:
    """Return the settings as a configuration for ``certnav run --config``.

    Only what differs from certnav's own defaults; nothing where these are to be kept. The Doppler
    noise that was fitted is there in any case, as a comment where it is not recommended.
    """
    name = found.candidates[found.chosen].name
    lines = [
        f"# Settings tuned on {', '.join(found.recordings)}: {name}.",
        f"# {found.decided[0].upper()}{found.decided[1:]}.",
        f"# Cross-validated over {found.folds_by}: {interval(found.validated)}.",
    ]
    for recording, fits in found.fits.items():
        for spread, words in (("mad", "undisturbed signals"), ("rms", "reflections included")):
            keys = ", ".join(
                f"{k} = {json.dumps(v)}" for k, v in insisting_keys(fits[spread].noise).items()
            )
            lines.append(f"# Doppler noise on {recording}, {words}: {keys}")
    lines += changed_toml(found.config)
    return "\n".join(line.replace("\n", " ") for line in lines) + "\n"


def changed_toml(config: Config) -> list[str]:
    """Return what differs from the defaults, as lines of TOML."""
    plain, lines, section, out = to_toml(Config()).splitlines(), [], "", []
    for line in to_toml(config).splitlines():
        if line.startswith("["):
            section = line
        elif line and not line.startswith("#"):
            lines.append((section, line))
    section, usual = "", set()
    for line in plain:
        section = line if line.startswith("[") else section
        usual.add((section, line))
    for section, line in lines:
        if (section, line) not in usual:
            if section not in out:
                out.append(section)
            out.append(line)
    return out


def as_dict(found: Settings) -> dict[str, Any]:
    """Return everything as plain values; what is not known is NaN or None."""
    return {
        "objective": "run",
        "recordings": found.recordings,
        "recommended": {
            "name": found.candidates[found.chosen].name,
            "keep_default": found.chosen == 0,
            "gnss": dataclasses.asdict(found.config.gnss),
            "decided": found.decided,
        },
        "least_error": found.candidates[found.best].name,
        "knee": None if found.knee is None else found.candidates[found.knee].name,
        "cross_validated": {
            "over": found.folds_by,
            "change": vars(found.validated),
            "folds": [
                {"left_out": name, "chosen": found.candidates[k].name} for name, k in found.folds
            ],
        },
        "outages": found.outages.text,
        "candidates": [
            {
                "name": candidate.name,
                "gnss": dict(candidate.changes),
                "weights": candidate.weights,
                "change": vars(found.changes[k]),
                "parts": {
                    part: {"rms_m": found.rms(k, part), "change": vars(alone)}
                    for part in _PARTS
                    if (alone := found.change_in(k, part)) is not None
                },
                "held": found.held[k],
                "reason": found.reasons[k],
            }
            for k, candidate in enumerate(found.candidates)
        ],
        "noise": {
            recording: {
                spread: {
                    **insisting_keys(fit.noise),
                    "misfit": fit.misfit,
                    "cn0_dbhz": fit.cn0,
                    "spread_mps": fit.spread,
                }
                for spread, fit in fits.items()
            }
            for recording, fits in found.fits.items()
        },
        "notes": list(found.notes),
    }


def candidates_table(found: Settings) -> Table:
    """Return all candidates with their errors and differences, the default first."""
    columns = (
        Column("settings"), Column("as recorded, RMS", "m", ".3g"), Column("difference", "%"),
        Column("weak GNSS, RMS drift", "m", ".3g"), Column("difference", "%"),
        Column("held", "share", ".0%"), Column("both together", "%"), Column("", ""),
    )  # fmt: skip
    rows = []
    for k, candidate in enumerate(found.candidates):
        cells: list[object] = [candidate.name]
        for part in _PARTS:
            cells += [_finite(found.rms(k, part)), _words(found.change_in(k, part), k)]
        remark = " and ".join(
            word
            for word, here in (
                ("recommended", k == found.chosen), ("least error", k == found.best),
                ("knee", k == found.knee),
            )
            if here
        )  # fmt: skip
        whole = _words(found.changes[k], k)
        rows.append((*cells, found.held[k], whole, found.reasons[k] or remark))
    caption = "Candidates: change of the error against the settings as they are, 95 % intervals"
    return Table("candidates", caption, columns, tuple(rows))


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _words(value: Change | None, candidate: int) -> str:
    if value is None or candidate == 0:
        return "–"
    return interval(value).replace(" %", "")


def folds_table(found: Settings) -> Table:
    """Return what was chosen without each fold."""
    rows = tuple((name, found.candidates[k].name) for name, k in found.folds)
    caption = f"Cross-validation over {found.folds_by}"
    return Table("folds", caption, (Column("left out"), Column("chosen without it")), rows, words=2)


def receivers_table(found: Settings) -> Table:
    """Return the fitted Doppler noise of every recording's receiver."""
    rows = []
    for recording, fits in found.fits.items():
        for spread, words in (("mad", "undisturbed"), ("rms", "with reflections")):
            noise = fits[spread].noise
            rows.append((recording, words, noise.sigma_45, noise.floor, fits[spread].misfit))
    columns = (
        Column("recording"), Column("fitted to"), Column("σ at 45 dB-Hz", "m/s", ".3g"),
        Column("floor", "m/s", ".3g"), Column("misfit", "", ".2f"),
    )  # fmt: skip
    return Table("receivers", "Doppler noise", columns, tuple(rows), words=2)


def candidates_figure(found: Settings) -> Figure:
    """Draw every candidate's change with its interval; right, error over what is held."""
    figure = Figure(figsize=(WIDTH, 1.2 + 0.24 * len(found.candidates)))
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    for k, value in enumerate(found.changes):
        colour = {found.chosen: ORANGE, found.best: GREEN}.get(k, BLUE)
        if np.isfinite([value.value, value.low, value.high]).all():
            ends = 100.0 * np.clip([value.low, value.high], -0.9, 1.5)
            left.plot(ends, [k, k], color=colour, lw=1.6)
            left.plot(100.0 * min(value.value, 1.5), k, "o", color=colour, ms=5)
        else:
            left.text(0.0, k, "not judged", va="center", color=GREY)
    left.axvline(0.0, color=GREY, lw=0.9)
    left.set_yticks(range(len(found.candidates)), [c.name for c in found.candidates])
    left.invert_yaxis()
    left.grid(axis="y", visible=False)
    left.set_xlabel("change of the error [%], 95 % interval")
    part = "weak GNSS"
    drift = np.array([found.rms(k, part) for k in range(len(found.candidates))])
    held = 100.0 * np.array(found.held)
    known = np.isfinite(drift) & np.isfinite(held)
    right.plot(held[known], drift[known], ".", color=BLUE, ms=6)
    marked = [(0, GREY, "default"), (found.chosen, ORANGE, "recommended")]
    if found.knee is not None:
        marked.append((found.knee, VERMILLION, "knee"))
    for k, colour, words in marked:
        if known[k]:
            right.plot(held[k], drift[k], "o", mfc="none", mec=colour, ms=10, mew=1.6, label=words)
    right.set_xlabel("epochs of weak GNSS that gave something [%]")
    right.set_ylabel("RMS drift [m]")
    if known.any():
        right.legend()
    else:
        right.set_axis_off()
    return figure


def build_page(found: Settings) -> str:
    """Return the tuning as one HTML page that loads nothing from anywhere."""
    keep = found.chosen == 0
    head = (
        "Keep the settings as they are."
        if keep
        else f"Take '{found.candidates[found.chosen].name}'."
    )
    decided = found.decided[0].upper() + found.decided[1:]
    if found.knee is not None:
        decided += (
            ". What holding more epochs of weak GNSS costs bends at "
            f"'{found.candidates[found.knee].name}'"
        )
    toml, plots = settings_toml(found), Plots()
    costs = panels.held(found, plots)
    body = [
        "<h1>Settings for a run</h1>",
        f'<p class="meta">{escape(", ".join(found.recordings))} · weak GNSS '
        f"{escape(found.outages.text)}</p>",
        f'<p class="verdict"><strong>{escape(head)}</strong> {escape(decided)}.</p>',
        "<h2>Candidates</h2>",
        "<p>Whole runs of the filter, on the recordings as they are (horizontal RMS) and with GNSS "
        "made weak in spells (RMS of their drift). Differences are relative to the settings as "
        "they are, with 95 % intervals over blocks of time or spells, over recordings where there "
        "are three or more. Weights are never judged on what they were fitted to.</p>",
        candidates_table(found).html(),
        '<p class="note">Below: change of both together with its 95 % interval; orange is '
        "recommended, green has the least error. What is beyond −90 % or +150 % ends there.</p>",
        plots.cells(panels.changes(found, plots), "Change of the error with its interval"),
        plots.cells(costs, "Drift over epochs held") if costs else "",
        f"<h2>Cross-validation over {found.folds_by}</h2>",
        f"<p>Chosen without the part it is judged by: {escape(interval(found.validated))}.</p>",
        folds_table(found).html(),
    ]
    if found.fits:
        body += ["<h2>Receivers</h2>", receivers_table(found).html()]
    save_it = document.download("thresholds.toml", toml, "Save as thresholds.toml")
    body += [
        f"<h2>For certnav run</h2><pre>{escape(toml)}</pre>",
        f'<p class="controls downloads">{save_it}</p>',
    ]
    body += [f'<p class="note">{escape(note)}</p>' for note in found.notes]
    body.append(document.files_beside(("thresholds.toml", "tuning.json", "candidates.pdf")))
    return document.document("Settings · certnav", *plots.fill("\n".join(body)))
