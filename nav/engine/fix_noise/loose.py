"""The innovations of positions from a filter that is not given them: it goes by velocities."""

from __future__ import annotations

import dataclasses
from collections import deque

import numpy as np

from ....filters import measurements
from ....filters.earth import C_en_of
from ....filters.ekf import ErrorStateFilter
from ....filters.rotation import FloatArray
from ..events import GnssEvent
from ..legs import FITTED_TO, Course
from ..loop import Diverged, FilterLoop
from ..start.state import Start, start_filter
from ..watch.sanity import Lost
from .estimate import Innovations


def loose_pass(course: Course, start: Start) -> tuple[list[GnssEvent], Innovations, bool]:
    """Return the positions after a start, and what they differ by from a filter without them.

    Parameters
    ----------
    course : Course
    start : Start

    Returns
    -------
    positions, innovations
        Where the filter is lost before the end of the data, those until then; of a recording of
        many hours those of the first (`legs.FITTED_TO`). Positions with
        resolved ambiguities are not among them.
    below_four : bool
        Whether what Doppler does below four satellites has mattered.
    """
    config = dataclasses.replace(
        course.config,
        filter=dataclasses.replace(course.config.filter, smooth=False, output_rate_hz=1.0),
    )
    model = dataclasses.replace(course.model, fix_correlation=0.0)
    kalman = start_filter(start, course.stream, course.calibration, model, config.filter)
    spells = deque(course.spells)
    loop = FilterLoop(kalman, course.calibration, course.vehicle, config, spells)
    lever_b = course.calibration.lever_antenna_b
    end = min(course.stream.end, kalman.time + FITTED_TO)
    used: list[GnssEvent] = []
    seen: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    try:
        for event in course.events:
            if event.time > end:
                break
            if event.kind != "position":
                loop.offer(event)
            elif not (event.reason or event.resolved) and kalman.time <= event.time:
                loop.advance(event.time)
                used.append(event)
                seen.append(_innovation(kalman, event, lever_b))
    except (Diverged, Lost):
        used = used[: len(seen)]
    time = np.array([event.time for event in used])
    value_n, filter_n, declared_n = (
        np.array([row[k] for row in seen]).reshape(-1, 3) for k in range(3)
    )
    found = Innovations(time, value_n, filter_n, declared_n, _kept(used))
    return used, found, loop.below_four


def _innovation(
    kalman: ErrorStateFilter, event: GnssEvent, lever_b: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return z and the variances of filter and position, north-east-down [m], [m²]."""
    antenna = kalman.antenna_point(lever_b)
    m = measurements.position(
        kalman.state, kalman.model.size, event.value_e, event.cov_e, antenna, kalman.omega_b
    )
    C_en = C_en_of(event.value_e)
    return (
        C_en.T @ m.z,
        np.diag(C_en.T @ m.H @ kalman.P @ m.H.T @ C_en),
        np.diag(C_en.T @ event.cov_e @ C_en),
    )


def _kept(events: list[GnssEvent]) -> FloatArray:
    """Return the share of satellites that each position has in common with the one before."""
    kept = np.ones(len(events))
    for k in range(1, len(events)):
        before, now = set(events[k - 1].satellites), set(events[k].satellites)
        kept[k] = len(before & now) / len(before | now) if before else 1.0
    return kept
