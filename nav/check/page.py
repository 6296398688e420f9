"""What a check found as a page: the findings, and the motion they were judged by.

Everything is drawn as it was recorded, before any correction: what is late, reversed or in another
unit is seen to be.
"""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import numpy as np

from ...datasets.sequence import Sequence
from ...filters.rotation import FloatArray
from ...velocity.tracks import Track, Tracks, tracks
from ..page import document
from ..page.board import Board
from ..page.palette import BLUE, GREEN, GREY, INK, ORANGE
from ..page.tables import Column, Table
from ..page.thinning import pieces, thin
from . import motion
from .findings import HEADINGS, MEASURED, Finding, Report

#: Stretches of which a line keeps least and greatest.
_BINS = 1500
#: One line that is drawn: seconds, values, colour, name.
_Line = tuple[FloatArray, FloatArray, str, str]


def build_page(report: Report, sequence: Sequence | None) -> str:
    """Return what a check found as one HTML page that loads nothing from anywhere.

    Parameters
    ----------
    report : Report
    sequence : Sequence, optional
        Of which it is; None where it could not be read.
    """
    start, end = sequence.span if sequence is not None else (0.0, 1.0)
    board = Board(start, 0.0, end - start)
    name = sequence.name if sequence is not None else report.path
    drawn = "" if sequence is None else _plots(sequence, board)
    body = [
        f"<h1>{escape(name)}</h1>",
        f'<p class="meta">{escape(report.path)}</p>',
        _verdict(report),
        *(_findings(report, severity, board) for severity in ("fatal", "doubtful")),
        _measured(report),
        drawn and f'<h2>As recorded</h2>\n<p class="controls span">{board.zooming()}</p>{drawn}',
        _contents(report),
        _findings(report, "note", board),
        _numbers(report),
    ]
    return document.document(f"{name} checked · certnav", *board.fill("\n".join(body)))


def _verdict(report: Report) -> str:
    return f'<p class="verdict"><strong>{escape(f"It {report.verdict}.")}</strong></p>'


def _findings(report: Report, severity: str, board: Board) -> str:
    found = report.of(severity)
    if not found:
        return ""
    lines = "".join(f"<li>{_line(f, board)}</li>" for f in found)
    return f'<h2>{escape(HEADINGS[severity])}</h2>\n<ul class="findings">{lines}</ul>'


def _line(finding: Finding, board: Board) -> str:
    remedy = f"<br><em>{escape(finding.remedy)}</em>" if finding.remedy else ""
    return (
        f'<span class="{finding.severity}">{escape(finding.subject)}</span>: '
        f"{escape(finding.found)}{board.button(finding.found)}{remedy}"
    )


def _measured(report: Report) -> str:
    """Return what was measured other than declared, as lines to paste."""
    parts = [
        f"<p>{escape(f.subject)}</p><pre>{escape(f.declare)}</pre>"
        for f in report.findings
        if f.declare
    ]
    return f"<h2>{escape(MEASURED)}</h2>\n{''.join(parts)}" if parts else ""


def _contents(report: Report) -> str:
    items = "".join(f"<li>{escape(line)}</li>" for line in report.contents)
    return f"<h2>Contents</h2>\n<ul>{items}</ul>" if items else ""


def _numbers(report: Report) -> str:
    rows = tuple((f.subject, *number) for f in report.findings for number in f.numbers.items())
    if not rows:
        return ""
    columns = (Column("finding"), Column("quantity"), Column("value", "", ".4g"))
    table = Table("check", "Figures of a check", columns, rows, words=2)
    return (
        "<h2>Figures</h2>\n<details><summary>All figures of the findings</summary>"
        f"{table.html()}</details>"
    )


def _plots(sequence: Sequence, board: Board) -> str:
    """Return the motion as IMU, GNSS, odometer and reference have it; '' where there is none."""
    found = tracks(sequence)
    groups = [
        ("Horizontal speed", "speed [m/s]", "m/s", _speeds(sequence, found)),
        *_motions(sequence, found),
        ("Specific force, all axes together", "|f| [m/s²]", "m/s²", _force(sequence)),
        ("Satellites with an observation", "satellites", "", _satellites(sequence)),
        ("Signal strength, median", "C/N0 [dB-Hz]", "dB-Hz", _strength(sequence)),
    ]
    rows = []
    for title, label, unit, lines in groups:
        known = [line for line in lines if np.isfinite(line[1]).sum() > 1]
        if not known:
            continue
        plot = board.panel(label, title)
        for time, values, colour, name in known:
            keep, cut = pieces(time, values, None, _BINS)
            board.line(plot, time[keep] - board.start, values[keep], colour, name, unit, cut=cut,
                       scale=True)  # fmt: skip
        rows.append([plot])
    return board.place(rows, "Motion as recorded, over time") if rows else ""


def _named(found: Tracks) -> list[tuple[Track, str, str]]:
    """Return the tracks that have velocities, with their colours."""
    each = ((found.reference, INK, "reference"), (found.gnss, BLUE, "GNSS"))
    return [(track, colour, name) for track, colour, name in each if track is not None]


def _speeds(sequence: Sequence, found: Tracks) -> Iterable[_Line]:
    for track, colour, name in _named(found):
        yield track.time, track.speed, colour, name
    if sequence.odometer is not None:
        yield sequence.odometer.time, sequence.odometer.speed, GREEN, "odometer"


def _motions(
    sequence: Sequence, found: Tracks
) -> Iterable[tuple[str, str, str, list[_Line]]]:  # fmt: skip
    """Yield turn rate and accelerations: of the IMU over a second, and of the tracks over it."""
    turns: list[_Line] = []
    along: list[_Line] = []
    across: list[_Line] = []
    for track, colour, name in _named(found):
        changes = motion.increments(track)
        if changes is None:
            continue
        span = changes.end - changes.start
        middle = 0.5 * (changes.start + changes.end)
        turns.append((middle, np.rad2deg(changes.turn / span), colour, name))
        along.append((middle, changes.along / span, colour, name))
        across.append((middle, changes.across / span, colour, name))
    if sequence.imu is not None:
        imu = motion.inertial(sequence)
        end = np.arange(imu.time[0] + 1.0, imu.time[-1], 0.2)
        angle, velocity = (
            np.stack([np.interp(end, imu.time, v[:, k]) - np.interp(end - 1.0, imu.time, v[:, k])
                      for k in range(3)], axis=-1)
            for v in (imu.angle, imu.velocity)
        )  # fmt: skip
        turns.append((end - 0.5, np.rad2deg(angle[:, 2]), ORANGE, "IMU, z"))
        along.append((end - 0.5, velocity[:, 0], ORANGE, "IMU, x"))
        across.append((end - 0.5, velocity[:, 1], ORANGE, "IMU, y"))
    yield "Turn rate, to the right, over a second", "turn rate [°/s]", "°/s", turns
    yield "Acceleration forward, over a second", "forward [m/s²]", "m/s²", along
    yield "Acceleration to the right, over a second", "right [m/s²]", "m/s²", across


def _force(sequence: Sequence) -> Iterable[_Line]:
    if sequence.imu is not None:
        norm = np.linalg.norm(sequence.imu.accel_b, axis=1)
        keep = thin(norm, _BINS)
        yield sequence.imu.time[keep], norm[keep], ORANGE, "IMU"


def _satellites(sequence: Sequence) -> Iterable[_Line]:
    if sequence.observations is not None:
        observations = sequence.observations
        pairs = np.unique(np.rec.fromarrays([observations.time, observations.sat]))
        time, count = np.unique(pairs["f0"], return_counts=True)
        yield time, count.astype(float), BLUE, "satellites"


def _strength(sequence: Sequence) -> Iterable[_Line]:
    if sequence.observations is not None:
        observations = sequence.observations
        order = np.argsort(observations.time, kind="stable")
        time, first = np.unique(observations.time[order], return_index=True)
        parts = np.split(observations.cn0[order], first[1:])
        known = [part[np.isfinite(part)] for part in parts]
        median = np.array([np.median(part) if part.size else np.nan for part in known])
        yield time, median, GREY, "median"
