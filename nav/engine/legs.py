"""A run in legs: from a start to the end of the data, or to where the solution is lost.

A solution that diverges, or that is lost, ends there; from the next event on a start is looked for
again, by the same rule, and a new leg begins. Where there is none, the run ends.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from ...datasets.imu_faults import Stretch
from ...datasets.sequence import Calibration
from ...filters.compiled import rows as layout
from ...filters.ekf import ErrorStateFilter
from ...filters.error_model import ErrorModel
from ...filters.errors import AlignmentError
from ...filters.rotation import FloatArray
from ...filters.smoother import Separation, separation, smooth
from ...filters.strapdown import InertialStream
from ..config import Config
from ..installation import Installation
from ..notes import Note, clock
from ..solution import Update
from .blind import Spell
from .events import GnssEvent
from .integrity.levels import Levels
from .loop import Diverged, FilterLoop
from .start.finder import again, find_start
from .start.state import Start, start_filter
from .vehicle import VehicleConstraints
from .watch.sanity import Lost

#: What noise is fitted to: so long from the start on [s]. What hours of driving say about a few
#: numbers is said by then, and passes over a whole day take longer than the run itself.
FITTED_TO = 7200.0
#: Starts in one run after which the data, not the filter, are to blame.
_MOST = 6


@dataclass(frozen=True, eq=False)
class Leg:
    """What came of one start.

    Parameters
    ----------
    start : Start
    rows : ndarray, shape (m, ROW_SIZE)
        As recorded, or smoothed where the leg ran to the end.
    causal : ndarray, shape (m, ROW_SIZE)
        As recorded.
    updates : tuple of Update
    lost : str
        Why it ended before the data; '' where it did not.
    until : float
        Where it ended [s].
    aligning : float
        Time the start has taken to find [s].
    installation : Installation
        How the IMU sits in the vehicle, as known at its end.
    levels : ndarray, shape (k, 3)
        Protection levels (`nav.engine.integrity.levels.Levels.made`).
    separation : Separation, optional
        Of a smoothed one.
    """

    start: Start
    rows: FloatArray
    causal: FloatArray
    updates: tuple[Update, ...]
    lost: str
    until: float
    installation: Installation
    aligning: float = 0.0
    levels: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    separation: Separation | None = None


@dataclass(frozen=True, eq=False)
class Course:
    """All a leg is made of; the start, and the time it has taken to find [s], if it is known.

    `blind` is where axes are frozen or clipped, `spells` what follows of that and of gaps;
    `below_four` tells whether what Doppler does below four satellites has mattered to the noise
    that was fitted.
    """

    events: tuple[GnssEvent, ...]
    stream: InertialStream
    calibration: Calibration
    vehicle: VehicleConstraints
    model: ErrorModel
    spells: tuple[Spell, ...]
    config: Config
    start: tuple[Start, float] | None = None
    blind: tuple[Stretch, ...] = ()
    below_four: bool = False


def legs(course: Course, report: Callable[[float, str], None]) -> Iterator[Leg]:
    """Yield the legs of a run, the first from its beginning.

    Raises
    ------
    AlignmentError
        If there is no start at all, or none after a leg was lost: the legs before are out by then.
    Diverged
        If the first solution diverged at once.
    """
    after = -np.inf
    for number in range(_MOST):
        leg = _leg(course, after, report)
        if leg.lost and len(leg.rows) < 2 and number == 0:
            raise Diverged(leg.lost, remedy="check units and axes of the IMU, and the IMU preset")
        yield leg
        if not leg.lost:
            return
        after = leg.until
        config = replace(course.config, alignment=again(course.config.alignment))
        course = replace(course, config=config, start=None)
    raise AlignmentError(f"lost {_MOST} times")


def fitted_part(course: Course, start: Start) -> str:
    """Return of what part of a recording noise is fitted, in words; '' of all after the start."""
    whole = course.stream.end - start.state.time <= FITTED_TO
    return "" if whole else f" of the first {FITTED_TO / 3600.0:g} h"


def found_start(course: Course, events: tuple[GnssEvent, ...]) -> Start:
    """Return the start of a leg over these of the events."""
    return find_start(
        events, course.stream, course.calibration, course.config.alignment, course.model,
        course.config.vehicle.kind,
    )  # fmt: skip


def _leg(course: Course, after: float, report: Callable[[float, str], None]) -> Leg:
    config, calibration = course.config, course.calibration
    events = tuple(e for e in course.events if e.time > after)
    report(0.0, "alignment")
    began = time.perf_counter()
    if course.start is not None:
        start, aligning = course.start
    else:
        start = found_start(course, events)
        aligning = time.perf_counter() - began
    kalman = start_filter(start, course.stream, calibration, course.model, config.filter)
    levels = _levels(kalman, start, config.filter.protection_risk)
    loop = FilterLoop(kalman, calibration, course.vehicle, config, deque(course.spells))
    begin, end = kalman.time, course.stream.end
    try:
        for number, event in enumerate(events):
            if number % 50 == 0:
                report(min(max((event.time - begin) / (end - begin), 0.0), 1.0), "filter")
            loop.offer(event)
        loop.advance(end)
    except (Diverged, Lost) as error:
        rows = _kept(kalman.rows)
        until = max(float(rows[-1, layout.ROW_TIME]) if len(rows) else begin, loop.reached)
        found = course.vehicle.installation(kalman)
        return Leg(
            start, rows, rows, tuple(loop.updates), str(error), until, found, aligning, levels()
        )
    rows = causal = kalman.rows
    apart = None
    if kalman.tape is not None:
        report(1.0, "smoother")
        rows = smooth(kalman.tape, kalman.P)
        apart = separation(kalman.tape, rows)
    found = course.vehicle.installation(kalman)
    updates = tuple(loop.updates)
    return Leg(start, rows, causal, updates, "", end, found, aligning, levels(), apart)


def _levels(kalman: ErrorStateFilter, start: Start, risk: float) -> Callable[[], FloatArray]:
    """Let protection levels go along with a filter; return what hands them over."""
    if risk == 0.0:
        return lambda: np.zeros((0, 3))
    levels = Levels(kalman, risk)
    if start.fix is not None and start.fix.ranges is not None:
        levels.begin(start.fix.ranges)
    kalman.follow(levels)
    return lambda: levels.made


def _kept(rows: FloatArray) -> FloatArray:
    """Return the rows before the first that is not finite, or whose covariance is none."""
    bad = ~np.isfinite(rows).all(axis=1) | (np.abs(rows[:, layout.ROW_VEL]) > 1e4)
    return rows[: int(np.argmax(bad))] if bad.any() else rows


def told(made: list[Leg], end: float, why_no_more: str) -> tuple[str, list[Note]]:
    """Return the status of a run and what its legs say.

    Parameters
    ----------
    made : list of Leg
    end : float
        Of the data [s].
    why_no_more : str
        Why no start was found after the last leg was lost; '' where it was not.
    """
    notes = []
    for leg, following in zip(made, [*made[1:], None], strict=True):
        if leg.start.doubt:
            when = clock(leg.start.state.time)
            notes.append(Note("doubtful", f"start at {when}: {leg.start.doubt}"))
        if not leg.lost:
            continue
        text = f"at {clock(leg.until)}: {leg.lost}"
        if following is None:
            text += f"; this solution ends there, {end - leg.until:.1f} s before the data"
            text += f" ({why_no_more})" if why_no_more else ""
        else:
            text += f"; started again at {clock(following.start.state.time)}, "
            text += following.start.attitude.message
        notes.append(Note("lost", text))
    status = "lost" if made[-1].lost else "restarted" if len(made) > 1 else "ok"
    return status, notes
