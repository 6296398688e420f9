"""Positions with the noise that fits the recording, and what a run says of it."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np

from ....filters.earth import C_en_of
from ...notes import Note, plain
from ...solution import FixErrors
from ..events import SHARED, GnssEvent
from ..legs import Course, fitted_part, found_start
from .estimate import ALLOWANCE, fit, parts
from .loose import loose_pass

#: Positions from which on the scale of white errors is known to 1/√(6 n) = 10 %. Of fewer the prior
#: would decide nearly alone.
_FEWEST = 15
#: A scale beyond this is none: receivers' σ are off by two or three, jumps by as much as they like.
_LARGEST = 5.0
#: Single-point positions declare what reflections may do. Where a tenth of the signals were
#: reflected, chi²/dof would be a tenth at least, and where signals are reflected others are
#: blocked, so that now and then there is no position: below both there is nothing to allow for.
_REFLECTED = 0.1
#: Of the variance so much at least is taken as each position's own, as of declared ones. What a
#: receiver's filter makes of errors is smoother than a Gauss–Markov process, and differences of
#: millimetres, believed, pass for a lever arm that turns, or for a velocity. So much of one
#: position a second: where such a filter gives ten, each of them has ten times that variance.
_OWN = 1.0 - SHARED
#: Of what residuals do not show, errors common to all satellites, an eighth of σ at least is
#: thought probable beforehand: 0.5 m, as of broadcast orbits and clocks, of the usual 4 m.
_LEAST_CENTRE = 0.125


def with_fitted_noise(
    course: Course, misfit: float | None, report: Callable[[float, str], None]
) -> tuple[Course, FixErrors | None, tuple[Note, ...]]:
    """Return a course whose positions have the noise that fits them, and what was found.

    Positions with resolved ambiguities are left as they are: a centimetre is what the IMU's time
    tag and a false resolution spoil, not noise, and no scale makes Gaussian.

    Parameters
    ----------
    course : Course
    misfit : float or None
        chi²/dof of single-point positions; None where positions are others.
    report : callable
        Told what is being done.
    """
    if course.config.gnss.position_noise == "declared":
        return course, None, ()
    positions = [e for e in course.events if e.kind == "position" and not e.reason]
    if not positions:
        return course, None, ()
    why = _why_not(course, positions)
    if why:
        return course, None, _declared(why)
    if course.start is None:
        report(0.0, "alignment")
        began = time.perf_counter()
        start = found_start(course, course.events)
        course = dataclasses.replace(course, start=(start, time.perf_counter() - began))
    else:
        start = course.start[0]
    report(0.0, "noise of positions")
    used, found, below = loose_pass(course, start)
    course = dataclasses.replace(course, below_four=course.below_four or below)
    if len(found) < _FEWEST:
        return course, None, _declared(f"only {len(found)} after the start to fit it to")
    if misfit is None:
        errors = fit(found, reflections=False)
    else:
        centre = float(np.clip(np.sqrt(np.nan_to_num(misfit, nan=1.0)), _LEAST_CENTRE, 1.0))
        # Reflections that do not last at all would be no reflections.
        lasting = max(course.config.gnss.position_correlation_s, 1.0)
        errors = fit(found, _reflections(course.events, misfit), centre, lasting)
    if errors.scale > _LARGEST:
        text = (
            f"noise of positions: {errors.scale:.0f} times what is declared would fit them, which "
            "is a jump or wrong data, not noise; as declared"
        )
        return course, None, (Note("doubtful", text),)
    return with_noise(course, errors), errors, plain([
        _said(errors, f"{len(used)} positions{fitted_part(course, start)}")
    ])  # fmt: skip


def _why_not(course: Course, positions: list[GnssEvent]) -> str:
    """Say why the noise of the positions cannot be found; '' where it can."""
    if len(positions) < _FEWEST:
        return f"{len(positions)} positions are too few to fit it to"
    resolved = sum(event.resolved for event in positions)
    if 2 * resolved > len(positions):
        return f"of {len(positions)} positions {resolved} have their ambiguities resolved"
    if not any(e.kind != "position" and not e.reason for e in course.events):
        return "without velocities there is nothing to compare positions with"
    return ""


def _reflections(events: tuple[GnssEvent, ...], misfit: float) -> bool:
    """Tell whether single-point positions have to expect reflections."""
    offered = [not event.reason for event in events if event.kind == "position"]
    return not (misfit < _REFLECTED and np.mean(offered) > 1.0 - _REFLECTED)


def with_noise(course: Course, errors: FixErrors) -> Course:
    """Return the course with the errors that were found, in its events and in its start."""
    times = [e.time for e in course.events if e.kind == "position" and not e.reason]
    own = _OWN * max(1.0, 1.0 / float(np.median(np.diff(times))))
    made = [
        _with_noise(e, errors, own) if e.kind == "position" and not (e.reason or e.resolved) else e
        for e in course.events
    ]
    model = dataclasses.replace(course.model, fix_correlation=errors.correlation_s)
    start = course.start
    if start is not None and start[0].fix is not None:
        begun, old = start[0], start[0].fix
        # By its time: a start may have been found with the same recording before it was degraded.
        new = next((e for e in made if e.kind == old.kind and e.time == old.time), old)
        begun = dataclasses.replace(
            begun, fix=new, pos_cov_e=begun.pos_cov_e - old.cov_e + new.cov_e
        )
        start = begun, start[1]
    return dataclasses.replace(course, events=tuple(made), model=model, start=start)


def _with_noise(event: GnssEvent, errors: FixErrors, least: float = _OWN) -> GnssEvent:
    """Return a position with the covariance that was found, and its shared part."""
    usual = np.array(errors.usual_n)
    if errors.meaning == ALLOWANCE:
        usual_e = np.full((3, 3), min(1.0, float(usual.sum() / np.trace(event.cov_e))))
    else:
        C_en = C_en_of(event.value_e)
        usual_e = (C_en * usual) @ C_en.T
    W, U, C, D = parts(event.cov_e, usual_e, errors.meaning)
    own = errors.scale**2 * max(1.0 - errors.share, least) * U + D
    common = errors.scale**2 * errors.share * W + C
    shared = event.shared or errors.share > 0.0
    return dataclasses.replace(event, cov_e=own + common, shared=shared, shared_cov_e=common)


def _declared(why: str) -> tuple[Note, ...]:
    return plain([f"noise of positions: as declared ({why})"])


def _said(errors: FixErrors, data: str) -> str:
    text = f"noise of positions: {errors.scale:.2g} times the declared σ, "
    if errors.share == 0.0:
        text += "each of its own"
    else:
        text += f"{100.0 * errors.share:.3g} % of the variance shared for "
        text += f"{errors.correlation_s:.3g} s"
    if errors.meaning == ALLOWANCE:
        text += ", beyond it as declared for reflections"
    return f"{text} (fitted to {data}; what is constant throughout does not show)"
