"""What velocities and range rates differ by from a filter, before it is given them."""

from __future__ import annotations

import dataclasses
from collections import deque
from dataclasses import dataclass

import numpy as np

from ....filters import measurements
from ....filters.ekf import ErrorStateFilter
from ....filters.measurements import Measurement
from ....filters.rotation import FloatArray
from ....velocity.range_rate import doppler_rows
from ..doppler_update import rows_measurement
from ..events import GnssEvent, doppler_noise
from ..legs import FITTED_TO, Course
from ..loop import Diverged, FilterLoop
from ..start.state import Start, start_filter
from ..watch.sanity import Lost

#: Epochs with range rates that are enough.
_ENOUGH = 600


@dataclass(frozen=True, eq=False)
class Epoch:
    """Innovations of one epoch.

    Parameters
    ----------
    time, since : float
        GPS time, and time since the one before [s].
    names : ndarray of str, shape (n,)
        Satellites; '' where they are axes.
    cn0 : ndarray, shape (n,)
        [dB-Hz]; NaN where unknown.
    z : ndarray, shape (n,)
        Measurement − filter [m/s].
    filter_cov : ndarray, shape (n, n)
        Of the filter's share [m²/s²].
    noise_cov : ndarray, shape (n, n)
        Of the measurement as declared [m²/s²].
    """

    time: float
    since: float
    names: np.ndarray
    cn0: FloatArray
    z: FloatArray
    filter_cov: FloatArray
    noise_cov: FloatArray

    def take(self, rows: np.ndarray) -> Epoch:
        """Return some of its rows."""
        both = np.ix_(rows, rows)
        return dataclasses.replace(
            self, names=self.names[rows], cn0=self.cn0[rows], z=self.z[rows],
            filter_cov=self.filter_cov[both], noise_cov=self.noise_cov[both],
        )  # fmt: skip


def collected(course: Course, start: Start) -> tuple[list[Epoch], bool]:
    """Return the innovations of what was offered, to where the filter is lost or the data end.

    Of a recording of many hours those of the first (`legs.FITTED_TO`). With them comes whether what
    Doppler does below four satellites has mattered.

    Parameters
    ----------
    course : Course
        Its positions are not offered where Doppler is: a filter that goes by velocities alone
        does not share in the positions' errors.
    start : Start
    """
    config = dataclasses.replace(
        course.config,
        filter=dataclasses.replace(course.config.filter, smooth=False, output_rate_hz=1.0),
    )
    raw = any(event.observations is not None for event in course.events)
    model = dataclasses.replace(course.model, fix_correlation=0.0) if raw else course.model
    kalman = start_filter(start, course.stream, course.calibration, model, config.filter)
    loop = FilterLoop(kalman, course.calibration, course.vehicle, config, deque(course.spells))
    out: list[Epoch] = []
    before, end = kalman.time, min(course.stream.end, kalman.time + FITTED_TO)
    apart = (end - kalman.time) / _ENOUGH if raw else 0.0
    try:
        for event in course.events:
            if event.time > end:
                break
            if raw and (event.kind == "position" or event.time < before + apart - 1e-3):
                continue
            wanted = event.kind != "position" and not event.reason
            if not wanted or not kalman.time <= event.time:
                loop.offer(event)
                continue
            loop.advance(event.time)
            seen = _innovations(course, kalman, event, event.time - before)
            update = loop.offer(event)
            before = event.time
            # Of satellites those that passed; what was refused whole tells of a σ too small, too.
            if not raw:
                out.append(seen)
            elif update.accepted:
                out.append(seen.take(np.flatnonzero(np.isin(seen.names, update.satellites))))
    except (Diverged, Lost):
        pass
    return out, loop.below_four


def _innovations(course: Course, kalman: ErrorStateFilter, event: GnssEvent, since: float) -> Epoch:
    """Return the innovations of an event's rows, or of its velocity."""
    calibration = course.calibration
    if event.observations is None:
        m = measurements.velocity(
            kalman.state, kalman.model.size, event.value_e, event.cov_e,
            kalman.antenna_point(calibration.lever_antenna_b), kalman.omega_b,
        )  # fmt: skip
        return _epoch(kalman, event.time, since, m, np.array([""] * 3), np.full(3, np.nan))
    antenna_e = kalman.pos_e + kalman.C_eb @ calibration.lever_antenna_b
    rows = doppler_rows(event.observations, antenna_e, doppler_noise(course.config.gnss))
    m = rows_measurement(kalman, calibration, rows)  # whitened
    m = Measurement(rows.sigma * m.z, rows.sigma[:, None] * m.H, np.diag(rows.sigma**2))
    return _epoch(kalman, event.time, since, m, rows.sat, event.observations.cn0[rows.row])


def _epoch(
    kalman: ErrorStateFilter, time: float, since: float, m: Measurement, names: np.ndarray,
    cn0: FloatArray,
) -> Epoch:  # fmt: skip
    return Epoch(time, since, names, cn0, m.z, m.H @ kalman.P @ m.H.T, m.R)
