"""The entrance: files, what is measured of them in which order, and what follows from it.

Velocities against positions come first, for they give the track; then the IMU's clock against it,
whatever its axes are; then, on one clock, its axes. Mounting and lever arm take a navigation, which
takes all of that.
"""

from __future__ import annotations

from collections.abc import Sequence as Items
from pathlib import Path

from ...datasets.own.declare import draft_of
from ...datasets.own.draft import Draft
from ...velocity.tracks import Track, gnss_tracks
from ..check.motion import integrals
from ..check.orientation import mounting_rpy_deg, named
from . import clocks, columns, installed, trial, truth, turned, velocities

#: What stands beside a key says what follows from it.
_FOLLOWS = {
    ("imu.noise", "preset"): "how fast the covariance grows where GNSS is gone",
    ("antenna", "lever_frd_m"): (
        "0.0 with lever_sigma_m = 1.5 where you cannot measure: estimated, off until turns show it"
    ),
    ("vehicle", "mounting_rpy_deg"): (
        "follows: no sideways velocity is asked of the rear axle (a car; not of a boat, walker: "
        "--set vehicle.kind)"
    ),
    ("gnss", "height"): "follows: heights of the result, by tens of metres; nothing else",
    ("reference", "point"): "follows: to which point the result is carried before it is judged",
    ("reference", "attitude_of"): "follows: whether the mounting is taken off before it is judged",
    ("reference", "source"): "any words; they stand in the report",
}


def measured_draft(files: Items[str | Path], *, navigated: bool = True) -> Draft:
    """Return the draft of a declaration with everything that files show of each other.

    Parameters
    ----------
    files : sequence of path
        Inertial data, GNSS solution or RINEX, odometer, reference; gzipped or not.
    navigated : bool
        Whether mounting, lever arm and the reference's point are measured, too, which takes two
        navigations of some minutes of the drive.

    Returns
    -------
    Draft
        Every value with its evidence; ``"?"`` where neither names, numbers nor motion tell.

    Raises
    ------
    DataError
        No files, or one that cannot be read as a table.
    """
    draft = draft_of(files)
    with trial.unmeasured(draft, "velocities"):
        _positions(draft)
    with trial.unmeasured(draft, "the reference"):
        roles_of = truth.better_of(draft)
        if roles_of:
            draft = draft_of(files, roles_of)
            _positions(draft)
            truth.better_of(draft)
    with trial.unmeasured(draft, "clocks and axes"):
        _motion(draft, navigated)
    _say_what_follows(draft)
    return draft


def _positions(draft: Draft) -> None:
    for section in ("gnss", "reference"):
        if section in draft.sections:
            columns.find_positions(draft, section)
            velocities.measure(draft, section)


def _motion(draft: Draft, navigated: bool) -> None:
    """Measure what takes IMU and GNSS together."""
    track, theirs = _track(draft)
    if track is None or theirs is None:
        _leave(draft, "no velocities or positions of GNSS to compare with")
        return
    columns.find_gyro(draft, track, theirs)
    imu = trial.imu_of(draft)
    if imu is None:
        _leave(draft, "columns of the IMU are not known")
        return
    ours = clocks.clock_of(draft, "imu", imu.time)
    together = clocks.measure(draft, integrals(imu), track, ours, theirs)
    found = turned.measure(draft, imu, together)
    with trial.unmeasured(draft, "the reference"):
        truth.measure(draft, track, theirs)
    if found is not None and navigated:
        _installation(draft, mounting_rpy_deg(named(found.C_sv)[1]))


def _track(draft: Draft) -> tuple[Track | None, clocks.Clock | None]:
    """Return the velocities of GNSS and how their stamps were read."""
    fixes, observations = trial.fixes_of(draft), trial.observations_of(draft)
    track = gnss_tracks(fixes, observations)[0]
    if track is None or not track.precise:
        return None, None
    section = "gnss" if observations is None else "rinex"
    return track, clocks.clock_of(draft, section, track.time)


def _installation(draft: Draft, coarse_rpy_deg: list[float]) -> None:
    """Measure mounting and lever arm, if the recording can be read with what is there."""
    answers = {("vehicle", "mounting_rpy_deg"): coarse_rpy_deg}
    sequence = None
    if not draft.asks("imu", "axes") and not draft.asks("imu", "gyro_unit"):
        sequence = trial.sequence_if_read(draft, answers)
    if sequence is None:
        draft.leave("antenna", "lever_frd_m", "not measured: the recording cannot be navigated yet")
        return
    installed.mounting(draft, sequence)
    sequence = trial.sequence_if_read(draft, {})
    if sequence is None:
        return
    installed.lever(draft, sequence)
    truth.point(draft, sequence)


def _leave(draft: Draft, reason: str) -> None:
    for section, key in (("imu", "gyro_unit"), ("imu", "axes"), ("imu", "time_scale")):
        if draft.asks(section, key):
            draft.leave(section, key, f"not measured: {reason}")


def _say_what_follows(draft: Draft) -> None:
    for (section, key), follows in _FOLLOWS.items():
        if draft.has(section, key):
            before, value = draft.comment(section, key), draft.get(section, key)
            draft.put(section, key, value, f"{before}; {follows}" if before else follows)
