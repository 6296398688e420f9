"""report.html: one file that says how a run went, built from its result directory alone."""

from __future__ import annotations

from html import escape
from pathlib import Path

import numpy as np

from ...datasets.gpstime import to_calendar, to_week_sow
from ...datasets.placing import write_file
from ..evaluation.accuracy import normalised_nis, standard_deviation
from ..page import document
from ..page.quantities import duration, length, quantity
from ..results.directory import Result, read_result
from . import figures
from .track import track
from .verdict import gate_activity, verdict


def write_report(directory: Path) -> Path:
    """Build ``report.html`` from a result directory and put it there; return its path."""
    path = Path(directory) / "report.html"
    write_file(path, build_report(read_result(directory)).encode())
    return path


def build_report(result: Result) -> str:
    """Return the report of a result as one HTML page that loads nothing from anywhere."""
    title = escape(result.name)
    body = "\n".join(
        [
            f"<h1>{title}</h1>",
            f'<p class="meta">{escape(_provenance(result))}</p>',
            _verdict(result),
            _cards(result),
            _track_section(result),
            _satellite_section(result),
            _figure_section("Position", figures.position, result, _position_caption(result)),
            _protection_section(result),
            _separation_section(result),
            _figure_section("Velocity", figures.velocity, result, _velocity_caption(result)),
            _figure_section("Attitude", figures.attitude, result, _attitude_caption(result)),
            _figure_section("Biases", figures.biases, result, "Measured minus true, body axes "
                            "(x forward, y right, z down)."),
            _update_section(result),
            _run_section(result),
        ]
    )  # fmt: skip
    return document.document(f"{result.name} · certnav", body)


def _verdict(result: Result) -> str:
    first, *rest = (escape(sentence) for sentence in verdict(result))
    return f'<p class="verdict"><strong>{first}</strong> {" ".join(rest)}</p>'


def _provenance(result: Result) -> str:
    summary, time = result.summary, result.solution.trajectory.time
    sensors, timing = summary["sensors"], summary["timing"]
    week, sow = to_week_sow(time[0])
    when = f"{to_calendar(time[0]):%Y-%m-%d %H:%M:%S} GPS time (week {week}, {sow:.3f} s)"
    if week == 0:
        when = f"{sow:.3f} s (no date in the files)"
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


def _track_section(result: Result) -> str:
    evaluation = result.evaluation
    caption = "Metres in the local level plane at the start."
    if evaluation.has_reference:
        caption += (
            f" Wide grey line: reference ({evaluation.source}), which follows the "
            f"{evaluation.point.replace('imu', 'IMU')}; the solution follows the IMU."
        )
    image = document.image(track, result, "Track of the vehicle", caption)
    return (
        f'<h2>Track</h2>\n<div class="split"><div>{image}</div><div>{_metrics(result)}</div></div>'
    )


def _metrics(result: Result) -> str:
    m, consistency = result.evaluation.metrics, result.evaluation.consistency
    reference = result.summary["reference"]
    if reference is None:
        return _claims(result)
    rows = [
        ("Horizontal RMS", length(m["horizontal_rms_m"])),
        ("Horizontal 50 %", length(m["horizontal_p50_m"])),
        ("Horizontal 95 %", length(m["horizontal_p95_m"])),
        ("Horizontal largest", length(m["horizontal_max_m"])),
        ("Up RMS", length(m["up_rms_m"])),
        ("Position 3D RMS", length(m["position_3d_rms_m"])),
        ("Velocity 3D RMS", quantity(m["velocity_3d_rms_mps"], "m/s")),
    ]
    for axis in ("roll", "pitch", "heading"):
        rows.append((f"{axis.capitalize()} RMS", quantity(m[f"{axis}_rms_deg"], "°")))
        aligned = m[f"{axis}_rms_after_misalignment_deg"]
        if aligned is not None:
            rows.append(("– misalignment removed", quantity(aligned, "°")))
    rows += [
        ("NEES position (ideal 3)", quantity(consistency["nees_position_mean"], "")),
        ("NIS per dof (ideal 1)", quantity(consistency["nis_mean"], "")),
    ]
    table = document.table(["Solution − reference", ""], rows)
    return table + (
        f'<p class="note">{reference["epochs_compared"]} reference epochs compared, '
        f"{reference['epochs_left_out']} left out because the solution does not cover them.</p>"
    )


def _claims(result: Result) -> str:
    trajectory = result.solution.trajectory
    claims = [
        ("North, 1σ", standard_deviation(trajectory.cov_pos_n)[:, 0], "m"),
        ("East, 1σ", standard_deviation(trajectory.cov_pos_n)[:, 1], "m"),
        ("Down, 1σ", standard_deviation(trajectory.cov_pos_n)[:, 2], "m"),
        ("Velocity, 1σ", np.sqrt(np.trace(trajectory.cov_vel_n, axis1=1, axis2=2)), "m/s"),
        ("Heading, 1σ", np.rad2deg(standard_deviation(trajectory.cov_att_n)[:, 2]), "°"),
    ]
    rows = [(name, quantity(float(np.median(sigma)), unit), quantity(float(sigma.max()), unit))
            for name, sigma, unit in claims]  # fmt: skip
    rows.append(
        ("NIS per dof (ideal 1)", quantity(result.evaluation.consistency["nis_mean"], ""), "")
    )
    return document.table(["The filter claims", "median", "largest"], rows) + (
        '<p class="note">No reference: there is nothing to compare these claims with.</p>'
    )


def _satellite_section(result: Result) -> str:
    caption = (
        "Dashed: 4, below which there is no position, and 2, below which there is no velocity. "
        "Shaded in this and every later plot: where fewer than 4 were usable."
    )
    image = document.image(figures.satellites, result, "Satellites over time", caption)
    if not image:
        image = (
            "<p>No satellite observations in this run; plots are shaded where no position was "
            "accepted for some seconds.</p>"
        )
    return f"<h2>Satellites</h2>\n{image}"


def _position_caption(result: Result) -> str:
    if result.evaluation.has_reference:
        return "Solution minus reference at the reference point, north, east, down."
    return "Without a reference only what the filter claims: ±3σ."


def _protection_section(result: Result) -> str:
    told = result.summary["protection"]
    if told is None:
        return ""
    caption = (
        f"What the error exceeds with a probability of {told['risk']:g} at most, whichever one of "
        f"these is wrong: {', '.join(told['covers']) or 'none; σ alone'}."
    )
    if told["lacks"]:
        caption += f" Not covered: {'; '.join(told['lacks'])}."
    return _figure_section("Protection level", figures.protection, result, caption)


def _separation_section(result: Result) -> str:
    told = result.summary["separation"]
    if told is None:
        return ""
    caption = (
        "Position from the data before each epoch, and what the data after it make of it, less the "
        f"smoothed one; below, χ² of what is between them, {quantity(told['chi2_mean'], '')} on "
        "the average: 3 (dashed) if σ is right."
    )
    return _figure_section("Forward, backward and combined", figures.separation, result, caption)


def _velocity_caption(result: Result) -> str:
    if result.evaluation.has_reference:
        return "Left the solution; right solution minus reference at the reference point."
    return "Left the solution; right what the filter claims."


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
        "The figures over the plots are with it removed; removing it also hides a constant error "
        "of the filter."
    )


def _figure_section(title: str, draw, result: Result, caption: str) -> str:
    return f"<h2>{title}</h2>\n{document.image(draw, result, f'{title} over time', caption)}"


def _update_section(result: Result) -> str:
    rows = []
    for kind, counts in result.summary["updates"].items():
        nis = normalised_nis(result.solution.updates, kind)
        rows.append((kind, "", counts["offered"], counts["accepted"], "", quantity(nis, "")))
        rows += [("", reason, "", "", n, "") for reason, n in counts["rejected"].items()]
        although = counts.get("accepted_although", {})
        rows += [("", reason, "", n, "", "") for reason, n in although.items()]
    headings = ["update", "reason", "offered", "accepted", "not used", "NIS per dof"]
    table = (
        document.table(headings, rows, numbers_from=2) if rows else "<p>No update was offered.</p>"
    )
    gates = "".join(f"<li>{escape(s[0].upper() + s[1:])}</li>" for s in gate_activity(result))
    image = document.image(
        figures.innovations,
        result,
        "Whitened innovations of each kind of update",
        "Innovations divided by their predicted standard deviation, decorrelated; dashed: ±3. "
        "Values beyond ±6 are drawn at the edge.",
    )
    return f"<h2>Updates</h2>\n{table}\n<ul>{gates}</ul>\n{image}"


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


def _run_section(result: Result) -> str:
    alignment, sensors = result.summary["alignment"], result.summary["sensors"]
    sigma = quantity(alignment["sigma_heading_deg"], "°")
    message = f" {alignment['message']}" if alignment["message"] else ""
    lever = ", ".join(f"{v:.3g}" for v in sensors["lever_antenna_b_m"])
    notes = "".join(f"<li>{escape(str(note))}</li>" for note in result.solution.notes)
    timing = ", ".join(
        f"{name.removesuffix('_s')} {value:.3g} s"
        for name, value in result.summary["timing"].items()
        if value is not None
    )
    return (
        "<h2>Run</h2>\n"
        f"<h3>Alignment</h3><p>{escape(str(alignment['status']).capitalize())} by "
        f"{escape(alignment['method'])}, {quantity(alignment['time_s'], 's')} after the start of "
        f"the data; heading 1σ {sigma}.{escape(message)}</p>\n"
        f"{_alignment_details(result)}"
        f"<h3>Antenna</h3><p>Lever arm ({lever}) m forward, right, down of the IMU, from "
        f"{escape(sensors['lever_antenna_source'])}.</p>\n"
        + (f"<h3>Notes</h3><ul>{notes}</ul>\n" if notes else "")
        + (f"<h3>Time</h3><p>{escape(timing)}</p>\n" if timing else "")
        + "<h3>Configuration</h3><details><summary>Configuration in force</summary>"
        f"<pre>{escape(result.config_text)}</pre></details>"
    )
