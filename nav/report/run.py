"""report.html: one file that says how a run went, built from its result directory alone."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np

from ...datasets.gpstime import to_calendar, to_week_sow
from ...datasets.placing import write_file
from ..evaluation.accuracy import normalised_nis
from ..page import document
from ..page.board import Board
from ..page.quantities import duration, length, quantity
from ..results.directory import Result, read_result
from .bounds import protection, separation
from .calibration import calibration
from .coverage import state_names
from .map import track_map
from .sky import Sky
from .span import span_table
from .timeline import SHADES, Timeline, start_up
from .verdict import coverage, doubts, gate_activity, verdict


def write_report(directory: Path) -> Path:
    """Build ``report.html`` from a result directory and put it there; return its path."""
    path = Path(directory) / "report.html"
    write_file(path, build_report(read_result(directory)).encode())
    return path


def build_report(result: Result) -> str:
    """Return the report of a result as one HTML page that loads nothing from anywhere."""
    trajectory, alignment = result.solution.trajectory, result.solution.alignment
    start = alignment.time - alignment.waited
    if not np.isfinite(start):
        start = float(trajectory.time[0])
    board = Board(start, *(trajectory.time[[0, -1]] - start))
    panels = Timeline(result, board)
    body = "\n".join(
        [
            f"<h1>{escape(result.name)}</h1>",
            f'<p class="meta">{escape(_provenance(result))}</p>',
            _verdict(result, board),
            _further_doubts(result, board),
            _cards(result),
            f'<p class="controls span">{board.zooming()}</p>',
            _track_section(result, board),
            _satellite_section(result, board, panels),
            _section("Position", board, panels.position(), _position_caption(result)),
            _protection_section(result, board, panels),
            _separation_section(result, board, panels),
            _section("Drift", board, panels.since_fix(), "One point an epoch of the reference."),
            _section("Distribution", board, panels.distribution(), "Dashed: errors that are normal "
                     "with the filter's σ."),
            _section("Velocity", board, panels.velocity(), ""),
            _section("Attitude", board, panels.attitude(), _attitude_caption(result)),
            _section("Motion", board, panels.motion(), ""),
            _bias_section(board, panels),
            calibration(result.summary["installation"]),
            _update_section(result, board, panels),
            _start_section(result, board),
            _run_section(result),
        ]
    )  # fmt: skip
    body, scripts = board.fill(body)
    return document.document(f"{result.name} · certnav", body, scripts)


def _verdict(result: Result, board: Board) -> str:
    """Return the first paragraph; a sentence that names a span has a link to it."""
    first, *rest = (f"{escape(s)}{board.button(s)}" for s in verdict(result))
    return f'<p class="verdict"><strong>{first}</strong> {" ".join(rest)}</p>'


def _further_doubts(result: Result, board: Board) -> str:
    """Return the doubts that the first paragraph leaves out, each with a link to its span."""
    lines = "".join(
        f"<li>{escape(note.text)}{board.button(note.text)}</li>" for note in doubts(result)[1:]
    )
    return f'<ul class="doubts">{lines}</ul>' if lines else ""


def _provenance(result: Result) -> str:
    summary, time = result.summary, result.solution.trajectory.time
    sensors, timing = summary["sensors"], summary["timing"]
    week, sow = to_week_sow(time[0])
    when = f"{to_calendar(time[0]):%Y-%m-%d %H:%M:%S} GPS time (week {week}, {sow:.3f} s)"
    if week <= 0:
        when = f"{time[0]:.3f} s (no date in the files)"
    parts = [
        f"Start {when}",
        f"{duration(summary['duration_s'])}",
        f"IMU {sensors['imu']}, {sensors['imu_rate_hz']:.4g} Hz, {summary['imu_samples']} samples",
    ]
    if timing["total_s"]:
        speed = summary["duration_s"] / timing["total_s"]
        parts.append(f"navigated in {timing['total_s']:.3g} s ({speed:.3g} times real time)")
    return " · ".join([*parts, f"certnav {summary['certnav_version']}"])


def _cards(result: Result) -> str:
    m = result.evaluation.metrics
    cards = [
        ("horizontal, RMS", length(m["horizontal_rms_m"])),
        ("horizontal, 95 %", length(m["horizontal_p95_m"])),
        ("up, RMS", length(m["up_rms_m"])),
        ("velocity, 3D RMS", quantity(m["velocity_3d_rms_mps"], "m/s")),
        ("heading, RMS", quantity(m["heading_rms_deg"], "°")),
    ]
    if not result.evaluation.has_reference:
        return ""
    cells = "".join(f"<div><b>{value}</b><span>{name}</span></div>" for name, value in cards)
    return f'<div class="cards">{cells}</div>'


def _track_section(result: Result, board: Board) -> str:
    evaluation, caption = result.evaluation, ""
    if evaluation.has_reference:
        of = "both are of the IMU"
        if evaluation.point != "imu":
            of = f"it is of the {evaluation.point}, the solution of the IMU"
        caption = f"Wide grey line: the reference ({evaluation.source}); {of}."
        left_out = result.summary["reference"]["epochs_left_out"]
        caption += f" {left_out} reference epochs are left out: the solution does not cover them."
    return (
        f'<h2>Track</h2>\n<div class="split"><div>{track_map(result, board)}'
        f'<p class="note">{escape(caption)}</p></div>'
        f"<div>{span_table(result, board.start)}</div></div>"
    )


def _section(title: str, board: Board, rows: list, caption: str) -> str:
    """Return a section of plots; nothing where there are none."""
    if not rows:
        return ""
    text = f'<p class="note">{escape(caption)}</p>' if caption else ""
    return f"<h2>{title}</h2>\n{text}{board.place(rows, f'{title} of the run')}"


def _satellite_section(result: Result, board: Board, panels: Timeline) -> str:
    rows = panels.satellites()
    _, some, none = state_names(result)
    shaded = [
        f'<span style="background: {SHADES[code]}">{name}</span>'
        for code, name in ((1, some), (2, none)) if name
    ]  # fmt: skip
    text = f"Shaded in all plots: {', '.join(shaded)}."
    if rows:
        text = (
            "Dashed: 4, below which there is no position, and 2, below which there is no velocity. "
            f"{text} What is beyond the range of a plot is at its edge."
        )
    plots = board.place(rows, "Satellites over time") if rows else ""
    signals = result.solution.signals
    if signals is not None and len(signals):
        sky = Sky(signals, board)
        for grid, alt in (
            (sky.use(), "When each satellite was used, and why not"),
            (sky.strength(), "Signal strength over time"),
            (sky.residuals(), "Residuals of range rates over time"),
            (sky.dilution(), "Dilution of precision over time"),
            (sky.plot(), "Where the satellites stood"),
        ):
            if grid:
                plots += f"\n{board.place(grid, alt, stretch=grid[0][0].sizing_mode is not None)}"
    return f'<h2>Satellites</h2>\n<p class="note">{coverage(result)} {text}</p>{plots}'


def _position_caption(result: Result) -> str:
    if result.evaluation.has_reference:
        return "Solution minus reference at the reference point, north, east, down."
    return "Without a reference only what the filter claims: ±3σ."


def _protection_section(result: Result, board: Board, panels: Timeline) -> str:
    told = result.summary["protection"]
    if told is None:
        return ""
    caption = (
        f"What the error exceeds with a probability of {told['risk']:g} at most, whichever one of "
        f"these is wrong: {', '.join(told['covers']) or 'none; σ alone'}."
    )
    if told["lacks"]:
        caption += f" Not covered: {'; '.join(told['lacks'])}."
    return _section("Protection level", board, protection(panels), caption)


def _separation_section(result: Result, board: Board, panels: Timeline) -> str:
    told = result.summary["separation"]
    if told is None:
        return ""
    caption = (
        "Position from the data before each epoch, and what the data after it make of it, less the "
        f"smoothed one; below, χ² of what is between them, {quantity(told['chi2_mean'], '')} on "
        "the average: 3 (dashed) if σ is right."
    )
    return _section("Forward, backward and combined", board, separation(panels), caption)


def _attitude_caption(result: Result) -> str:
    misalignment = np.rad2deg(result.evaluation.misalignment_rpy)
    if not np.isfinite(misalignment).any():
        return ""
    values = ", ".join(
        f"{name} {round(value, 2) + 0.0:+.2f}°"
        for name, value in zip(("roll", "pitch", "heading"), misalignment, strict=True)
        if np.isfinite(value)
    )
    return (
        f"Constant misalignment between the solution's and the reference's axes: {values}. "
        "Aligned: with it removed, which also hides a constant error of the filter; tables have "
        "the raw errors."
    )


def _bias_section(board: Board, panels: Timeline) -> str:
    columns = "".join(
        f"<div>{board.place(column, f'{name} biases over time')}</div>"
        for name, column in zip(("Gyro", "Accelerometer"), panels.biases(), strict=True)
    )
    note = "Measured minus true, body axes (x forward, y right, z down)."
    return f'<h2>Biases</h2>\n<p class="note">{note}</p><div class="two">{columns}</div>'


def _update_section(result: Result, board: Board, panels: Timeline) -> str:
    rows = []
    for kind, counts in result.summary["updates"].items():
        nis = normalised_nis(result.solution.updates, kind)
        rows.append((kind, "", counts["offered"], counts["accepted"], "", quantity(nis, "")))
        rows += [(kind, reason, "", "", n, "") for reason, n in counts["rejected"].items()]
        although = counts.get("accepted_although", {})
        rows += [(kind, reason, "", n, "", "") for reason, n in although.items()]
    headings = ["update", "reason", "offered", "accepted", "not used", "NIS per dof"]
    table = (
        document.table(headings, rows, numbers_from=2, sortable=True)
        if rows
        else "<p>No update was offered.</p>"
    )
    gates = "".join(f"<li>{escape(s[0].upper() + s[1:])}</li>" for s in gate_activity(result))
    plots = panels.innovations()
    drawn = board.place(plots, "Whitened innovations of each kind of update") if plots else ""
    note = (
        '<p class="note">Innovations divided by their predicted standard deviation, decorrelated; '
        "dashed: ±3. Values beyond ±6 are drawn at the edge.</p>"
    )
    return f"<h2>Updates</h2>\n{table}\n<ul>{gates}</ul>\n{note if plots else ''}{drawn}"


def _start_section(result: Result, board: Board) -> str:
    rows = start_up(result.solution.alignment.attempts, board)
    return _section("Start", board, rows, "Each mark is an attempt to align in motion.")


def _resolution(result: Result) -> str:
    """Return how many positions are relative to a base, and how surely resolved."""
    found = result.solution.resolution
    if found is None:
        return ""
    total = max(found.fixed + found.floating + found.dgps + found.single, 1)
    rows = [
        (name, str(n), f"{100.0 * n / total:.1f} %")
        for name, n in (
            ("fixed", found.fixed), ("float", found.floating), ("code alone", found.dgps),
            ("single-point", found.single),
            ("– of them contradicted by the relative one", found.contradicted),
        )
    ]  # fmt: skip
    ratio = (
        f"Ratio of the second-best to the best ambiguities, of the fixed ones: median "
        f"{quantity(found.ratio_median, '')}, 5 % {quantity(found.ratio_p5, '')}. "
        if found.fixed
        else ""
    )
    return (
        "<h3>Positions relative to the base station</h3>"
        f"{document.table(['position', 'epochs', 'share'], rows)}<p>{ratio}{found.direction}, "
        f"{found.frequencies} frequencies, constellations {escape(found.systems)}; the base's own "
        f"single-point mean is {length(found.base_apart_m)} from where it is taken to be.</p>\n"
    )


def _alignment_details(result: Result) -> str:
    """Return what was proved of a certified start, and what was missing until then."""
    alignment, parts = result.solution.alignment, []
    if alignment.bound is not None:
        proved = "".join(
            f"<li>{escape(name)}: {escape(text)}</li>" for name, text in alignment.verdicts
        )
        parts.append(
            f"<p>Attitude proved within {quantity(np.rad2deg(alignment.bound), '°')} at the end of "
            f"the window (3σ).</p><ul>{proved}</ul>\n"
        )
    if alignment.attempts:
        begin = alignment.time - alignment.waited
        lines = "\n".join(
            f"{time - begin:7.1f} s  {message}" for time, message in alignment.attempts
        )
        parts.append(
            f"<details><summary>{len(alignment.attempts)} attempts to align in motion, by time "
            f"since the start of the data</summary><pre>{escape(lines)}</pre></details>\n"
        )
    return "".join(parts)


def _after(seconds: float | None) -> str:
    return quantity(None if seconds is None else round(seconds, 2), "s")


def _run_section(result: Result) -> str:
    alignment, sensors = result.summary["alignment"], result.summary["sensors"]
    sigma = quantity(alignment["sigma_heading_deg"], "°")
    message = alignment["message"]
    message = f" {message[0].upper()}{message[1:]}." if message else ""
    lever = ", ".join(f"{v:.3g}" for v in sensors["lever_antenna_b_m"])
    notes = "".join(  # doubts stand at the top
        f"<li>{escape(note.text)}</li>" for note in result.solution.notes if not note.doubtful
    )
    timing = ", ".join(
        f"{name.removesuffix('_s')} {value:.3g} s"
        for name, value in result.summary["timing"].items()
        if value is not None
    )
    return (
        "<h2>Run</h2>\n"
        f"<h3>Alignment</h3><p>{escape(str(alignment['status']).capitalize())} "
        f"({escape(alignment['method'])}) {_after(alignment['time_s'])} after the start of the "
        f"data, heading 1σ {sigma} there.{escape(message)}</p>\n"
        f"{_alignment_details(result)}"
        f"{_resolution(result)}"
        f"<h3>Antenna</h3><p>Lever arm ({lever}) m forward, right, down of the IMU, from "
        f"{escape(sensors['lever_antenna_source'])}.</p>\n"
        + (f"<h3>Notes</h3><ul>{notes}</ul>\n" if notes else "")
        + (f"<h3>Time</h3><p>{escape(timing)}</p>\n" if timing else "")
        + f"<h3>Files</h3><p>{_files(result)}</p>\n"
        + "<h3>Configuration</h3><details><summary>Configuration in force</summary>"
        f"<pre>{escape(result.config_text)}</pre></details>"
    )


def _files(result: Result) -> str:
    """Return links to the tables that lie beside the page."""
    names = [
        "solution.csv",
        "updates.csv",
        "epochs.csv",
        "signals.csv",
        "separation.csv",
        "alignment.csv",
        "reference_errors.csv",
        "config.toml",
        "summary.json",
    ]
    there = [name for name in names if (result.path / name).exists()]
    return ", ".join(f'<a href="{name}" download>{name}</a>' for name in there)
