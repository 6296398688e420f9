"""Time scales and offsets of an IMU and its GNSS, from when both feel the same motion.

What a clock counts from is in its numbers (`datasets.own.tables`) or nowhere: what is measured is
whether two clocks are one. Where their stamps overlap under one reading of them and the motion
agrees, that reading stands. Where one clock counts from a start of its own, the lag between
motions is that start, if no other lag explains them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ...datasets import gpstime
from ...datasets.own.draft import Draft
from ...filters.rotation import FloatArray
from ...velocity.tracks import Track
from ..check.lag import SEARCH, Lag, find_lag
from ..check.motion import Inertial, increments
from ..check.orientation import orientation
from ..check.timing import LAG_TOLERANCE, SIGNIFICANT, Offset, leap_second_words, time_offset
from . import trial

#: Distance from the IMU to the antenna that nobody has declared [m].
_DISTANCE = 2.0
#: Share of the shorter of two recordings in which both have stamps, if their clocks are one.
_COMMON = 0.5
#: A start of a clock is found where turns explain so much, and another motion agrees to this [s].
_TURNS, _SAME = 0.8, 0.3
#: Longest difference of starts that is searched beyond the recordings' own [s].
_BESIDE = 30.0
#: Shorter than this from zero, stamps that overlap may be of two clocks that were both just
#: switched on [s].
_JUST_STARTED = 1000.0
#: GPS − UTC since 2017 [s]; dates without a zone are off by it or not at all.
_OPEN = (9e8, 1.6e9)


class Clock(NamedTuple):
    """How the stamps of a section were read for the trial.

    Attributes
    ----------
    section : str
    kind : {'gps', 'dates', 'bare', 'open'}
        GPS time; dates of which it is open whether they are UTC; seconds from anywhere; seconds
        from 1980 or 1970.
    start, end : float
        [s].
    """

    section: str
    kind: str
    start: float
    end: float


class Together(NamedTuple):
    """IMU and track on the track's clock.

    Attributes
    ----------
    imu : Inertial
        In the file's axes; stamps as corrected by what was found.
    track : Track
    known : bool
        Whether the motion has shown that they belong together.
    """

    imu: Inertial
    track: Track
    known: bool


class Reading(NamedTuple):
    """One reading of two clocks: what to add to ours [s], the keys it means, and in words."""

    shift: float
    keys: dict[str, dict[str, Any]]
    words: str


def clock_of(draft: Draft, section: str, time: FloatArray) -> Clock:
    """Return how the stamps of a section were read."""
    kind = "gps"
    if section != "rinex" and draft.get(section, "format", "csv") == "csv":
        if draft.asks(section, "time_scale"):
            kind = "open" if _OPEN[0] < float(np.median(time)) <= _OPEN[1] else "bare"
            kind = "dates" if trial.has_dates(draft, section) else kind
        elif draft.get(section, "time_scale") == "relative":
            kind = "bare"
    return Clock(section, kind, float(time[0]), float(time[-1]))


def measure(draft: Draft, imu: Inertial, track: Track, ours: Clock, theirs: Clock) -> Together:
    """Fill in the time scales of IMU and GNSS and the IMU's offset, and return both on one clock.

    Parameters
    ----------
    draft : Draft
    imu : Inertial
        In the file's axes, stamps as read.
    track : Track
        Stamps as read.
    ours, theirs : Clock
        Of `imu` and `track`.
    """
    for shift, scales, words in readings(ours, theirs):
        begun, ended = ours.start + shift, ours.end + shift
        common = min(ended, theirs.end) - max(begun, theirs.start)
        shorter = min(ours.end - ours.start, theirs.end - theirs.start)
        if common < _COMMON * shorter:
            continue
        moved = imu.shifted(shift)
        offset = _offset(moved, track)
        if offset is None:
            return _untold(draft, ours, theirs, Together(moved, track, False))
        _say_scales(draft, scales, words, offset)
        if offset.significant:
            _say_offset(draft, offset, theirs)
            moved = moved.shifted(-offset.lag)
        else:
            _say_unsure(draft, offset)
        return Together(moved, track, True)
    return _own_start(draft, imu, track, ours, theirs)


def readings(ours: Clock, theirs: Clock) -> Iterator[Reading]:
    """Yield what to add to the IMU's stamps under each reading of both clocks, and the keys."""
    kinds = {ours.kind, theirs.kind}
    if ours.kind == theirs.kind:
        # One reading for both: which, no motion tells, and nothing but the date depends on it.
        scale = {c.section: {"time_scale": "relative"} for c in (ours, theirs)}
        same = scale if ours.kind == "bare" else {}
        yield Reading(0.0, same, "both count from the same start")
        return
    if kinds == {"gps", "dates"}:
        # Trials read dates as GPS time; in UTC they are later by the leap seconds.
        dated = ours if ours.kind == "dates" else theirs
        leap = gpstime.gps_minus_utc(dated.start)
        yield Reading(0.0, {dated.section: {"time_scale": "gps-calendar"}}, "dates in GPS time")
        sign = 1.0 if dated is ours else -1.0
        yield Reading(sign * leap, {dated.section: {"time_scale": "utc"}}, "dates in UTC")
        return
    if kinds == {"gps", "open"}:
        open_ = ours if ours.kind == "open" else theirs
        sign = 1.0 if open_ is ours else -1.0
        yield Reading(0.0, {open_.section: {"time_scale": "gps"}}, "seconds since 1980")
        shift = float(gpstime.from_unix(open_.start)) - open_.start
        keys = {open_.section: {"time_scale": "unix"}}
        yield Reading(sign * shift, keys, "seconds since 1970")
        return
    if kinds == {"gps", "bare"}:
        bare, dated = (ours, theirs) if ours.kind == "bare" else (theirs, ours)
        sign = 1.0 if bare is ours else -1.0
        week = int(gpstime.to_week_sow(dated.start)[0])
        if bare.start >= 0.0 and bare.end < 8 * 86400.0:
            key = {"time_scale": "gps-sow", "week": week}
            shift = sign * week * gpstime.SECONDS_PER_WEEK
            yield Reading(shift, {bare.section: key}, "seconds of week")


def _level(imu: Inertial, track: Track) -> Inertial:
    return imu.turned(orientation(imu, track).C_sl.T)


def _offset(imu: Inertial, track: Track) -> Offset | None:
    leap = gpstime.gps_minus_utc(float(track.time[0])) if track.time[0] > 1e8 else 18.0
    return time_offset(_level(imu, track), track, _DISTANCE, expected=(leap,))


def _untold(draft: Draft, ours: Clock, theirs: Clock, found: Together) -> Together:
    for clock in (ours, theirs):
        if draft.asks(clock.section, "time_scale"):
            reason = "not measured: too little motion to tell whether IMU and GNSS have one clock"
            draft.leave(clock.section, "time_scale", reason)
    return found


def _say_scales(
    draft: Draft, scales: dict[str, dict[str, Any]], words: str, offset: Offset
) -> None:
    evidence = f"measured: {words} ({offset.words})"
    for section, keys in scales.items():
        if draft.asks(section, "time_scale"):
            after = "time"
            for key, value in keys.items():
                draft.put(section, key, value, evidence, after=after)
                after, evidence = key, ""
            evidence = "the same clock"
    for section in draft.sections:
        if draft.asks(section, "time_scale") and section in ("imu", "gnss") and not scales:
            draft.leave(section, "time_scale", "measured: IMU and GNSS are in the same")


def _say_offset(draft: Draft, offset: Offset, theirs: Clock) -> None:
    """Write the IMU's offset; exactly the leap seconds where it is these within its σ."""
    late = offset.lag
    leap = gpstime.gps_minus_utc(theirs.start) if theirs.start > 1e8 else 18.0
    whole = leap_second_words(late, (leap,))
    if whole and abs(abs(late) - leap) < LAG_TOLERANCE + SIGNIFICANT * offset.sigma:
        late = float(np.copysign(leap, late))
    words = "late" if late > 0.0 else "early"
    evidence = f"measured: stamps {abs(offset.lag):.3f} ± {offset.sigma:.3f} s {words}"
    before = float(draft.get("imu", "time_offset_s", 0.0))
    after = "week" if draft.has("imu", "week") else "time_scale"
    value = round(before - late, 3)
    draft.put(
        "imu", "time_offset_s", value, evidence + (whole if late != offset.lag else ""), after
    )
    if late == offset.lag:
        sigma = max(round(offset.sigma, 3), 0.01)
        draft.put(
            "imu", "time_offset_sigma_s", sigma, "a run estimates what is left", "time_offset_s"
        )


def _say_unsure(draft: Draft, offset: Offset) -> None:
    """Have a run estimate an offset that is neither shown nor excluded."""
    size = float(np.hypot(offset.lag, offset.sigma))
    if size > LAG_TOLERANCE:
        evidence = f"measured: stamps {offset.lag:+.2f} ± {offset.sigma:.2f} s late, or right"
        after = "week" if draft.has("imu", "week") else "time_scale"
        draft.put("imu", "time_offset_sigma_s", round(size, 2), evidence, after)


def _own_start(draft: Draft, imu: Inertial, track: Track, ours: Clock, theirs: Clock) -> Together:
    """Find the start of a clock of its own from motion alone."""
    shift = theirs.start - ours.start
    moved = imu.shifted(shift)
    lengths = (ours.end - ours.start, theirs.end - theirs.start)
    found = _found_start(
        _level(moved, track), track, max(SEARCH, abs(lengths[0] - lengths[1]) + _BESIDE)
    )
    bare = next((c for c in (ours, theirs) if c.kind == "bare"), None)
    if found is None or bare is None:
        reason = (
            "no reading of the stamps makes IMU and GNSS overlap, and the motion tells no start"
        )
        for clock in (ours, theirs):
            if draft.asks(clock.section, "time_scale"):
                draft.leave(clock.section, "time_scale", f"not measured: {reason}")
        return Together(moved, track, False)
    start = shift - found.lag
    evidence = f"measured: turns agree there, {100.0 * found.explained:.0f} % explained"
    if {ours.kind, theirs.kind} == {"bare"}:
        for clock in (ours, theirs):
            draft.put(
                clock.section, "time_scale", "relative", "two clocks, one offset between them"
            )
        draft.put("imu", "time_offset_s", round(start, 3), evidence, "time_scale")
    else:
        add = start if bare is ours else -start
        draft.put(bare.section, "time_scale", "gps", "a clock with a start of its own")
        draft.put(bare.section, "time_offset_s", round(add, 3), evidence, "time_scale")
    sigma = max(round(found.sigma, 3), 0.02)
    draft.put("imu", "time_offset_sigma_s", sigma, "a run estimates what is left", "time_scale")
    return Together(moved.shifted(-found.lag), track, True)


def _found_start(imu: Inertial, track: Track, search: float) -> Lag | None:
    """Return the lag that turns show and another motion confirms; None where they do not."""
    moves = increments(track)
    if moves is None:
        return None
    turns = find_lag(
        imu.time, imu.angle, moves.start, moves.end, moves.turn[:, None], search=search
    )
    if turns is None or turns.explained < _TURNS or not turns.conclusive:
        return None
    # Turns lag behind the course by the way to the axle, or lead it by that to the antenna; so
    # does cornering, speed does not: together they say to what.
    near = time_offset(imu.shifted(-turns.lag), track, _DISTANCE)
    if near is None or not any(
        what != "turn rate" and abs(lag.lag) < _SAME for what, lag in near.evidence
    ):
        return None
    return dataclasses.replace(turns, lag=turns.lag + near.lag, sigma=near.sigma)
