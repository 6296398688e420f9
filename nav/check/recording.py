"""``certnav check``: is this recording what it is declared to be, and can it be navigated?

Reading comes first: what a reader refuses is a fatal finding. What it lets pass is tested
against physics, part by part; a part that cannot be tested says so.
"""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...datasets import gpstime
from ...datasets.observations import GnssFixes
from ...datasets.physics import collected_refusals
from ...datasets.sequence import Sequence
from ...filters.earth import SPEED_OF_LIGHT
from ...filters.errors import ConfigError, DataError, NavError
from ...filters.rotation import FloatArray
from ...velocity.tracks import Track, Tracks, differenced, thinned, tracks
from ..config import GnssConfig
from ..notes import clock, counted_from
from ..vehicles import VEHICLES, would_explain
from . import axes, motion, timing
from .findings import Finding, Report, in_order
from .gnss import gnss_findings
from .inertial import inertial_findings
from .reference import reference_findings

#: Parts that overlap the IMU for less than this share of their time are doubtful.
_OVERLAP = 0.5
#: So much of the IMU's time has GNSS, or it is worth a doubt.
_GNSS_COVER = 0.8
#: Single-point positions computed to compare the reference with.
_FIXES = 250


#: A finding (subject, severity), and whose doubts come from it.
_CONSEQUENCES = (
    (("gyro", "fatal"), "gyro noise"),
    (("gyro", "fatal"), "gyro bias"),
    (("gravity", "fatal"), "accelerometer noise"),
    (("gravity", "fatal"), "accelerometer axes"),
    (("time, reference and GNSS", "doubtful"), "time, IMU and reference"),
    *(
        (("IMU sampling", "fatal"), subject)
        for subject in (
            *("gyro", "gyro noise", "gyro bias"),
            *("accelerometer", "accelerometer noise", "accelerometer axes"),
        )
    ),
)
#: What wrong axes and units of a gyro show in.
_OF_AXES = ("gravity", "gyro", axes.AXES)
#: What has to be in order before the mounting can be measured.
_NEEDED_BY_MOUNTING = (
    *("reading", "IMU", "IMU sampling", "gyro", "gravity", "accelerometer axes"),
    *("time, IMU and GNSS", "GNSS", "GNSS velocity", "Doppler"),
)


def check(path: str | Path, options: Mapping[str, Any] | None = None, kind: str = "car") -> Report:
    """Load a recording and test it against physics.

    Parameters
    ----------
    path : path
        Anything `datasets.loading.load` reads.
    options : mapping, optional
        Options of the reader, as in the configuration's section ``data``.
    kind : str
        What moves, of `nav.vehicles.VEHICLES`.

    Returns
    -------
    Report
        What cannot be read is a fatal finding, not an exception.
    """
    return read_and_checked(path, options, kind)[0]


def read_and_checked(
    path: str | Path, options: Mapping[str, Any] | None = None, kind: str = "car"
) -> tuple[Report, Sequence | None]:
    """Return what `check` returns, and the recording it is of; None where it cannot be read."""
    from ...datasets.loading import load
    from .declarations import with_declarations
    from .mounting import mounting_findings  # slow to import, and a run does without

    try:
        # Units and axes a reader would refuse are judged here, with everything else beside them.
        with collected_refusals() as refused:
            sequence = load(path, **dict(options or {}))
    except (DataError, ConfigError) as error:
        return Report(str(path), (), (refusal(error),)), None
    found = check_sequence(sequence, kind=kind)
    if not any(f.severity == "fatal" for f in found):
        holds = VEHICLES[kind].holds_course
        found += [refusal(error) for error, against in refused if holds or against != "course"]
    doubted = any(f.severity != "note" and f.subject in _NEEDED_BY_MOUNTING for f in found)
    if VEHICLES[kind].holds_course and not doubted:
        found += mounting_findings(sequence)
    found = with_declarations(found, sequence, path, options or {})
    return Report(str(path), contents(sequence), in_order(found)), sequence


def refusal(error: NavError) -> Finding:
    """Return what a reader refused as a fatal finding."""
    problem, remedy = str(error), ""
    if isinstance(error, DataError):
        remedy = error.remedy or ""
        problem = problem.removesuffix(f" — {remedy}") if remedy else problem
    elif " — " in problem:
        problem, _, remedy = problem.partition(" — ")
    subject = "declaration" if isinstance(error, ConfigError) else "reading"
    return Finding("fatal", subject, problem, remedy)


def check_sequence(
    sequence: Sequence, gnss: GnssConfig | None = None, kind: str = "car"
) -> list[Finding]:
    """Test a recording that has been read.

    Parameters
    ----------
    sequence : Sequence
    gnss : GnssConfig, optional
        For what a run would screen out.
    kind : str
        What moves, of `nav.vehicles.VEHICLES`: it sets which tests apply.
    """
    start = sequence.span[0] if sequence.imu is None else float(sequence.imu.time[0])
    with counted_from(start):
        return _tested(sequence, gnss, kind)


def _tested(sequence: Sequence, gnss: GnssConfig | None, kind: str) -> list[Finding]:
    """Return all findings, worst first, without those that follow from others."""
    found = tracks(sequence)
    min_cn0 = (gnss or GnssConfig()).min_cn0_dbhz
    gnss_found = gnss_findings(sequence, found, min_cn0, VEHICLES[kind])
    if sequence.fixes is not None and any(
        f.severity == "fatal" and f.subject == "GNSS velocity" for f in gnss_found
    ):
        # Said already: what comes next shall not find the same fault again under another name.
        moved = differenced("differenced positions", *_usable(sequence.fixes))
        found = dataclasses.replace(found, gnss=moved)
    out = [
        *dates(sequence),
        *overlap(sequence),
        *gnss_found,
        *limits(found.gnss, kind),
        *_imu(sequence, found, kind),
        *(axes.odometer(sequence, found.gnss) if found.gnss is not None else ()),
        *reference_findings(sequence, found, _positions(sequence)),
        *undeclared(sequence),
    ]
    if found.gnss is None:
        out.append(
            Finding(
                "fatal", "GNSS", "no positions and no velocities can be made of it",
                "give navigation files, or positions",
            )
        )  # fmt: skip
    return list(in_order(_causes_only(out)))


def _imu(sequence: Sequence, found: Tracks, kind: str) -> Iterator[Finding]:
    """Test the IMU by itself, then its time, then, with time put right, its axes."""
    if sequence.imu is None:
        remedy = "a run needs accelerometers and gyros; speed and yaw rate only serve alignment"
        if sequence.rover_file is not None:
            remedy = "name the IMU's file beside the receiver's: certnav run FILE --imu IMU.csv"
        yield Finding("fatal", "IMU", "none in this recording", remedy)
        return
    by_itself = inertial_findings(sequence, found.gnss)
    yield from by_itself
    imu = motion.inertial(sequence)
    if found.gnss is None:
        return
    calibration = sequence.calibration
    distance = float(np.linalg.norm(calibration.lever_antenna_b)) + calibration.lever_antenna_sigma
    expected = timing.expected_lags(sequence)
    offset = timing.time_offset(imu, found.gnss, distance, expected=expected)
    yield from timing.offset_findings(offset, "GNSS", expected)
    as_read = imu
    if offset is not None and offset.significant:
        imu = imu.shifted(-offset.lag)
    turning = imu if offset is None or offset.of_gyro is None else as_read.shifted(-offset.of_gyro)
    track = _judge(found, offset)
    if track is None:
        cannot = "units and axes cannot be told: no Doppler, no reference, only rough positions"
        yield Finding("note", "IMU axes", cannot)
        return
    if VEHICLES[kind].holds_course:
        judged = [*axes.gyro(turning, track), *axes.accelerometer(imu, track)]
        for finding in judged:
            yield _with_kinds(finding, kind)
        if any(f.severity != "note" and f.subject in _OF_AXES for f in (*by_itself, *judged)):
            yield from axes.as_it_is(imu.turned(sequence.calibration.C_bv), track)
    else:
        words = f"not tested against the course, which is not the heading of {VEHICLES[kind].words}"
        yield Finding("note", "IMU axes", words)
    reference = sequence.reference
    if reference is None or found.reference is None:
        return
    heading = reference.rpy[:, 2] if len(reference) == len(found.reference) else None
    distance = float(np.linalg.norm(reference.lever_b)) + calibration.lever_antenna_sigma
    against = timing.time_offset(imu, found.reference, distance, heading, expected)
    if against is not None and against.significant:
        for finding in timing.offset_findings(against, "reference", expected):
            # Not fatal: a run does not need the reference.
            yield dataclasses.replace(finding, severity="doubtful")


def _with_kinds(finding: Finding, kind: str) -> Finding:
    """Add to what contradicts the course whose course need not be the heading.

    Not to what is certain: units and exchanged axes are none of that.
    """
    other = would_explain(lambda v: not v.holds_course, kind)
    if finding.severity != "doubtful" or not finding.remedy:
        return finding
    return dataclasses.replace(finding, remedy=f"{finding.remedy}; {other}")


def limits(track: Track | None, kind: str) -> list[Finding]:
    """Test whether the vehicle moves as its kind can: speed, and rate of climb and descent."""
    if track is None or not track.precise:
        return []
    known = np.isfinite(track.vel_n).all(axis=1)
    if known.sum() < 20:
        return []
    # What is exceeded for a twentieth of the time is no outlier.
    speed = float(np.percentile(track.speed[known], 95))
    climb = float(np.percentile(np.abs(track.vel_n[known, 2]), 95))
    vehicle, out = VEHICLES[kind], []
    numbers = {"speed_p95_mps": speed, "height_rate_p95_mps": climb}
    if speed > vehicle.max_speed:
        text = f"{speed:.0f} m/s (95 %): {vehicle.words} is not so fast"
        remedy = would_explain(lambda v: v.max_speed > speed, kind)
        out.append(Finding("doubtful", "speed", text, remedy, numbers))
    if climb > vehicle.max_height_rate:
        text = f"changes by {climb:.0f} m/s (95 %): {vehicle.words} does not climb so fast"
        remedy = would_explain(lambda v: v.max_height_rate > climb, kind)
        out.append(Finding("doubtful", "height", text, remedy, numbers))
    return out


def _judge(found: Tracks, offset: timing.Offset | None) -> Track | None:
    """Return the track to judge axes by: GNSS, or the reference where it shows more turning."""
    gnss, reference = found.gnss, found.reference
    if gnss is None or not gnss.precise:
        return reference
    if reference is None or offset is not None:
        return gnss

    def turning(track: Track) -> float:
        return axes.track_turning(track.course(motion.COURSE_SPEED))

    return reference if turning(reference) > 1.5 * turning(gnss) else gnss


def _causes_only(findings: list[Finding]) -> list[Finding]:
    """Leave out doubts that are the consequence of something found already."""
    found = {(f.subject, f.severity) for f in findings}
    implied = {what for cause, what in _CONSEQUENCES if cause in found}
    return [f for f in findings if f.severity != "doubtful" or f.subject not in implied]


def _usable(fixes: GnssFixes) -> tuple[FloatArray, FloatArray]:
    return fixes.time[fixes.usable], fixes.pos_e[fixes.usable]


def _positions(sequence: Sequence) -> tuple[FloatArray, FloatArray] | None:
    """Return antenna positions to a few metres: carried ones, else single-point positions."""
    if sequence.fixes is not None and sequence.fixes.usable.sum() > 8:
        return _usable(sequence.fixes)
    observations = thinned(sequence.observations, _FIXES)
    if observations is None or not sequence.navigation or sequence.reference is None:
        return None
    from ...datasets.rtklib import single_point

    try:
        found = single_point(observations, sequence.navigation, elevation_mask=np.radians(10.0))
    except DataError:
        return None
    if len(found.fixes) < 8:
        return None
    # by the receiver's clock, which may be far from GPS time
    return found.fixes.time - found.clock / SPEED_OF_LIGHT, found.fixes.pos_e


def dates(sequence: Sequence) -> list[Finding]:
    """Test whether the recording lies in the past of satellite navigation."""
    if sequence.time_scale != "gps":
        found = "relative, no date: nothing that needs satellites is possible"
        return [Finding("note", "time", found)]
    start, _ = sequence.span
    week, sow = gpstime.to_week_sow(start)
    if not 0 <= week < 10000:
        remedy = "correct the GPS week or the time scale"
        return [Finding("fatal", "time", f"GPS second {start:.6g}: cannot be", remedy)]
    date = gpstime.to_calendar(start)
    found = f"GPS week {int(week)}, SOW {float(sow):.2f}: {date:%Y-%m-%d %H:%M:%S} GPST"
    numbers = {"week": float(week)}
    today = datetime.datetime.now(datetime.UTC).replace(tzinfo=None)
    if date > today + datetime.timedelta(days=1) or week < 500:
        remedy = "correct the GPS week (receivers lose 1024 weeks at a roll-over)"
        return [Finding("fatal", "time", f"{found}: cannot be", remedy, numbers)]
    return [Finding("note", "time", found, "", numbers)]


def overlap(sequence: Sequence) -> list[Finding]:
    """Test how much of each part lies inside the IMU's time."""
    if sequence.imu is None:
        return []
    first, last = sequence.span
    out = []
    for name in ("observations", "fixes", "odometer", "reference"):
        part = getattr(sequence, name)
        if part is None or not part.time.size:
            continue
        inside = float(((part.time >= first) & (part.time <= last)).mean())
        time = np.unique(part.time)
        covered = (min(last, time[-1]) - max(first, time[0])) / (last - first)
        if inside < _OVERLAP or covered < 0.2:
            found = (
                f"{name}: {100 * inside:.0f} % of the rows lie inside the IMU's time, which they "
                f"cover to {100 * covered:.0f} %"
            )
            remedy = "check that the files belong to one drive and one time scale"
            out.append(Finding("doubtful", "time overlap", found, remedy, {"inside": inside}))
        elif name in ("observations", "fixes") and covered < _GNSS_COVER:
            missing = max(time[0] - first, 0.0), max(last - time[-1], 0.0)
            found = (
                f"GNSS begins {missing[0]:.0f} s after the IMU and ends {missing[1]:.0f} s before"
            )
            remedy = "a file may be cut short; navigation is inertial alone there"
            out.append(Finding("doubtful", "time overlap", found, remedy, {"covered": covered}))
        longest = float(np.diff(time).max()) if time.size > 1 else 0.0
        if name in ("observations", "fixes") and longest > 30.0:
            at = float(time[int(np.argmax(np.diff(time)))])
            found = f"no GNSS for {longest:.0f} s from {clock(at)}"
            remedy = "expect free inertial drift there"
            out.append(Finding("note", "GNSS gap", found, remedy, {"gap_s": longest}))
    return out


def undeclared(sequence: Sequence) -> list[Finding]:
    """Say what the recording leaves open and only the user can know."""
    calibration = sequence.calibration
    if calibration.lever_antenna_sigma <= 0.0:
        return []
    found = (
        f"IMU→antenna {calibration.lever_antenna_b.round(2)} m, 1σ "
        f"{calibration.lever_antenna_sigma:g} m: {calibration.lever_antenna_source}"
    )
    remedy = "measure the vector from the IMU to the antenna (forward, right, down) and declare it"
    return [Finding("note", "lever arm", found, remedy)]


def contents(sequence: Sequence) -> tuple[str, ...]:
    """Return what a recording holds, a line for each part."""
    out = [sequence.notes[0] if sequence.notes else sequence.name]
    if sequence.imu is not None:
        out.append(f"IMU: {_span(sequence.imu.time)}, preset '{sequence.calibration.imu.name}'")
    if sequence.observations is not None:
        observations = sequence.observations
        systems = "".join(np.unique(observations.sat.astype("U1")))
        signals = ", ".join(np.unique(observations.signal))
        out.append(
            f"GNSS observations: {_span(np.unique(observations.time))}, systems {systems}, "
            f"signals {signals}"
        )
    out += sequence.logs
    if sequence.fixes is not None:
        with_velocity = 100.0 * float(sequence.fixes.has_velocity.mean())
        out.append(
            f"GNSS positions: {_span(sequence.fixes.time)}, {with_velocity:.0f} % with velocity"
        )
    if sequence.odometer is not None:
        out.append(f"odometer: {_span(sequence.odometer.time)}")
    if sequence.reference is not None:
        out.append(
            f"reference ({sequence.reference.point}): {_span(sequence.reference.time)}, "
            f"{sequence.reference.source}"
        )
    return tuple(out)


def _span(time: FloatArray) -> str:
    rate = 1.0 / float(np.median(np.diff(time))) if time.size > 1 else 0.0
    return f"{time.size} epochs, {rate:.4g} Hz, {time[-1] - time[0]:.1f} s"
