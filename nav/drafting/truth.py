"""The reference: which of two files it is, its clock, its angles, and the point it is of."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np

from ...datasets.axes import ATTITUDE, rpy_of
from ...datasets.displacement import agreement
from ...datasets.own.blanks import BLANK
from ...datasets.own.declaration import ANGLE_UNITS
from ...datasets.own.draft import Draft
from ...datasets.sequence import Sequence
from ...filters.rotation import FloatArray
from ...velocity.tracks import Track, reference_track, tracks
from ..check import reference as against
from ..check.axes import track_turning
from ..check.motion import COURSE_SPEED
from . import clocks, trial

#: Positions that scatter less by this factor about their own velocities are the truth: that of RTK
#: to code. Between a receiver's fixes and its own fused solution lies a factor of five, either way.
_BETTER = 10.0
_NAMED = re.compile(r"(^|[^a-z])(ref|reference|truth|gt|ground_?truth|ppk|span)([^a-z]|$)", re.I)
#: Headings within this of the course are in the right convention, others further [deg].
_WITHIN, _BEYOND = 12.0, 25.0
#: A point so near to the antenna, in all directions and known so well [m].
_THERE, _SURE = 0.3, 0.1


def better_of(draft: Draft) -> dict[str, str]:
    """Return the roles of two files of positions where they are the other way round; {} if not.

    Only where neither has an attitude: what has one is the reference.
    """
    if draft.has("reference", "attitude") or not {"gnss", "reference"} <= draft.sections.keys():
        return {}
    names = (draft.get("gnss", "file"), draft.get("reference", "file"))
    called = [bool(_NAMED.search(Path(name).name)) for name in names]
    if called[0] != called[1]:
        if called[0]:
            return {names[0]: "reference", names[1]: "gnss"}
        draft.put("reference", "file", names[1], "so its name says")
        return {}
    fixes, reference = trial.fixes_of(draft), trial.reference_of(draft)
    if fixes is None or reference is None:
        return {}
    scatter = []
    for record in (fixes, reference):
        found = agreement(record.time, record.pos_e, record.vel_e)
        scatter.append(np.nan if found is None else max(found.scatter, 1e-3))
    if not np.isfinite(scatter).all() or 1.0 / _BETTER < scatter[0] / scatter[1] < _BETTER:
        draft.head.append(
            f"{names[0]} and {names[1]} both hold positions: which is the truth was not measured; "
            "exchange [gnss] and [reference] if they are the wrong way round"
        )
        return {}
    text = "positions scatter by {:.2g} m about their velocities, those of {} by {:.2g} m"
    if scatter[0] > scatter[1]:
        said = text.format(scatter[1], names[0], scatter[0])
        draft.put("reference", "file", names[1], f"measured: its {said}")
        return {}
    return {names[0]: "reference", names[1]: "gnss"}


def measure(draft: Draft, track: Track, theirs: clocks.Clock) -> None:
    """Fill in clock and angles of the reference."""
    reference = trial.reference_of(draft)
    if reference is None:
        return
    ours = clocks.clock_of(draft, "reference", reference.time)
    _clock(draft, reference_track(reference), track, ours, theirs)
    if draft.has("reference", "attitude"):
        _angles(draft)


def _clock(
    draft: Draft, mine: Track, track: Track, ours: clocks.Clock, theirs: clocks.Clock
) -> None:
    """Write the reference's time scale and offset where its motion tells them."""
    for shift, keys, words in clocks.readings(ours, theirs):
        moved = Track(mine.name, mine.time + shift, mine.pos_e, mine.vel_n)
        if moved.time[-1] < track.time[0] or moved.time[0] > track.time[-1]:
            continue
        lag, found = against.time_offset(moved, track, 2.0)
        numbers = found[0].numbers
        if "offset_s" not in numbers:
            break
        measured = f"{numbers['offset_s']:+.3f} ± {numbers['offset_sigma_s']:.3f} s"
        evidence = f"measured: {words}, offset against the GNSS {measured}"
        if draft.asks("reference", "time_scale"):
            after = "time"
            for key, value in keys.get("reference", _as_gnss(draft)).items():
                draft.put("reference", key, value, evidence, after)
                after, evidence = key, ""
        if lag:
            evidence = f"measured: {measured} late against the GNSS"
            draft.put("reference", "time_offset_s", round(-lag, 3), evidence, "time_scale")
        return
    if draft.asks("reference", "time_scale"):
        draft.leave("reference", "time_scale", "not measured: no motion in common with the GNSS")


def _as_gnss(draft: Draft) -> dict[str, Any]:
    keys = ("time_scale", "week")
    found = {k: v for k in keys if (v := draft.get("gnss", k)) not in (None, BLANK)}
    return found or {"time_scale": BLANK}


def _angles(draft: Draft) -> None:
    """Fill in unit and convention of the attitude: of its heading against the course."""
    section = "reference"
    timed = trial.columns_of(draft, section, {"attitude": 3})
    reference = trial.reference_of(draft)
    assert reference is not None
    track = reference_track(reference)
    angles = timed.columns.numbers["attitude"]
    if len(track) != len(angles):  # from differences: at the times between
        angles = 0.5 * (angles[1:] + angles[:-1])
    course = track.course(COURSE_SPEED)
    keys = [k for k in ("attitude_unit", "attitude_convention") if draft.asks(section, k)]
    known = np.isfinite(course) & np.isfinite(angles).all(axis=1)
    if known.sum() < 20 or track_turning(course) < np.pi / 2:
        for key in keys:
            draft.leave(section, key, "not measured: too little turning")
        return
    units = tuple(ANGLE_UNITS)[:2] if draft.asks(section, "attitude_unit") else (
        draft.get(section, "attitude_unit"),
    )  # fmt: skip
    apart = {
        (unit, how): _apart(rpy_of(angles[known] * ANGLE_UNITS[unit], how)[:, 2], course[known])
        for unit, how in itertools.product(units, ATTITUDE)
    }
    (unit, how), nearest = min(apart.items(), key=lambda item: item[1])
    second = sorted(apart.values())[1]
    if nearest > _WITHIN or second < _BEYOND:
        for key in keys:
            reason = f"not measured: heading {nearest:.0f}° from the course at best"
            draft.leave(section, key, reason)
        return
    evidence = f"measured: heading within {nearest:.1f}° of the course (median)"
    if "attitude_unit" in keys:
        draft.put(section, "attitude_unit", unit, evidence)
    if "attitude_convention" in keys:
        draft.put(section, "attitude_convention", how, evidence)


def _apart(heading: FloatArray, course: FloatArray) -> float:
    return float(np.degrees(np.median(np.abs(np.angle(np.exp(1j * (heading - course)))))))


def point(draft: Draft, sequence: Sequence) -> None:
    """Fill in the reference's point where it is the antenna; else say where the antenna is."""
    if not draft.asks("reference", "point") or sequence.fixes is None:
        return
    good = sequence.fixes.usable
    positions = sequence.fixes.time[good], sequence.fixes.pos_e[good]
    found = against.reference_findings(sequence, tracks(sequence), positions)
    n = next((f.numbers for f in found if f.subject == "lever arm"), {})
    if "lever_forward_m" not in n:
        return
    arm = np.array([n["lever_forward_m"], n["lever_right_m"], n["down_m"]])
    sigma = n["lever_sigma_m"]
    seen = f"{arm[0]:+.2f} forward, {arm[1]:+.2f} right, {arm[2]:+.2f} down (± {sigma:.2f} m)"
    if np.abs(arm).max() < _THERE and sigma < _SURE:
        draft.put("reference", "point", "antenna", f"measured: the antenna is there: {seen}")
        return
    draft.leave("reference", "point", f"measured: the antenna seen from it is {seen}")
