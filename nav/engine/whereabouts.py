"""Where the antenna roughly was, as lines of sight ask it; from Doppler alone if need be.

A recording whose receiver never had a fix has no position to compute lines of sight for. It may be
told where it begins (`GnssConfig.near_deg`), and with an odometer finds out better by itself
(`alignment.anywhere`); what is left of it is an unknown of every window in motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...alignment.local_velocity import (
    LocalTrack,
    inertial_track,
    planar_track,
    rate_at_rest,
)
from ...datasets.observations import GnssFixes, GnssObservations
from ...datasets.sequence import Sequence
from ...filters.earth import lla_to_ecef
from ...filters.errors import AlignmentError, ConfigError
from ...filters.rotation import FloatArray
from ...filters.strapdown import InertialStream
from ..config import GnssConfig
from .events import doppler_noise

if TYPE_CHECKING:
    from ...alignment.anywhere.align import AnywhereAlignment

#: As far as a vehicle gets between a position and an instant without one [m/s].
_FASTEST = 40.0
#: Windows without a position: their length and distance [s], and how many are tried.
_WINDOW, _STEP, _TRIED = 60.0, 15.0, 40
#: 1σ of the height where only a place is known [m], and of a car's level [rad].
_HEIGHT, _LEVEL = 300.0, float(np.radians(2.0))
#: Slower than this a window says nothing [m/s].
_SLOW = 2.0


@dataclass(frozen=True, eq=False)
class Whereabouts:
    """Positions at some times, and how far off the receiver's clock.

    Parameters
    ----------
    time : ndarray, shape (n,)
        By the receiver's clock [s].
    pos_e : ndarray, shape (n, 3)
        [m].
    clock : ndarray, shape (n,)
        Receiver − GPS time [s].
    sigma : ndarray, shape (n,)
        1σ per axis of the positions [m].
    assumed : bool
        Whether they are none of the receiver's: there are no others to wait for.
    """

    time: FloatArray
    pos_e: FloatArray
    clock: FloatArray
    sigma: FloatArray
    assumed: bool = False

    @classmethod
    def of(cls, fixes: GnssFixes, clock: FloatArray | None = None) -> Whereabouts:
        """Return those of positions."""
        off = np.zeros(len(fixes)) if clock is None else clock
        sigma = np.sqrt(np.trace(fixes.pos_cov_e, axis1=1, axis2=2) / 3.0)
        return cls(fixes.time, fixes.pos_e, off, np.asarray(sigma))

    def at(self, time: FloatArray) -> FloatArray:
        """Return positions interpolated to `time`, held beyond the ends, shape (n, 3)."""
        return np.column_stack([np.interp(time, self.time, column) for column in self.pos_e.T])

    def sigma_at(self, time: FloatArray) -> FloatArray:
        """Return 1σ per axis at `time` [m]: far from any position the vehicle may be elsewhere."""
        after = np.clip(np.searchsorted(self.time, time), 1, max(self.time.size - 1, 1))
        ends = np.stack([self.time[after - 1], self.time[np.minimum(after, self.time.size - 1)]])
        gap = np.abs(ends - time).min(axis=0)
        return np.hypot(np.interp(time, self.time, self.sigma), _FASTEST * gap)

    def true_time(self, time: float) -> float:
        """Return the GPS time of an epoch that the receiver labels `time`."""
        return time - float(np.interp(time, self.time, self.clock))


def without_fixes(
    sequence: Sequence, observations: GnssObservations, config: GnssConfig
) -> tuple[Whereabouts, str]:
    """Return where a recording without any position is, and how that is known.

    Parameters
    ----------
    sequence : Sequence
    observations : GnssObservations
    config : GnssConfig

    Raises
    ------
    ConfigError
        If nothing says where it is.
    """
    if not config.near_deg:
        raise ConfigError(
            "gnss.velocity: Doppler needs an approximate position, and there is none — "
            "add navigation files for single-point positions, or say where it begins: "
            "gnss.near_deg = [latitude, longitude], within gnss.near_radius_km"
        )
    latitude, longitude = np.radians(config.near_deg[:2])
    height = config.near_deg[2] if len(config.near_deg) > 2 else 0.0
    near = np.asarray(lla_to_ecef(latitude, longitude, height))
    radius = 1e3 * config.near_radius_km
    begin = float(observations.time[0])
    why = "there is no odometer to find it better by"
    if sequence.odometer is not None:
        why = "no window of odometer and Doppler says where within"
        for window in _windows(sequence, observations, near, radius, config):
            if window.passed and window.located.passed:
                return _found(window)
    said = (
        f"no position in the recording: within {config.near_radius_km:g} km of gnss.near_deg; {why}"
    )
    sigma = np.full(1, radius / np.sqrt(3.0))
    return Whereabouts(np.array([begin]), near[None], np.zeros(1), sigma, True), said


def _found(found: AnywhereAlignment) -> tuple[Whereabouts, str]:
    """Return the place at which a window without position began."""
    sigma = float(np.sqrt(np.trace(found.pos_cov_e) / 3.0))
    said = (
        f"no position in the recording: found from Doppler and odometer, ±{sigma:.0f} m (1σ), "
        f"{found.located.message}"
    )
    known = np.full(1, sigma)
    return Whereabouts(np.array([found.start]), found.pos_e[None], np.zeros(1), known, True), said


def _windows(
    sequence: Sequence, observations: GnssObservations, near: FloatArray, radius: float,
    config: GnssConfig,
) -> Iterator[AnywhereAlignment]:  # fmt: skip
    """Yield the alignments of windows of a recording in which it moves."""
    from ...alignment.anywhere.align import align_anywhere  # slow to import, and rarely needed
    from ...alignment.anywhere.signals import Signals

    signals = Signals.of(observations, doppler_noise(config))
    assert sequence.odometer is not None
    first = max(float(signals.time[0]), float(sequence.odometer.time[0]))
    last = min(float(signals.time[-1]), float(sequence.odometer.time[-1]))
    if sequence.imu is not None:
        first = max(first, float(sequence.imu.time[0]))
        last = min(last, float(sequence.imu.time[-1]))
    for number in range(_TRIED):
        start = first + number * _STEP
        end = min(start + _WINDOW, last)
        if end - start < 0.5 * _WINDOW:
            return
        try:
            track = _track(sequence, start, end)
            if float(np.linalg.norm(track.vel_w, axis=1).mean()) < _SLOW:
                continue
            yield align_anywhere(signals, track, near, radius, _HEIGHT, level_sigma=_LEVEL)
        except AlignmentError:
            continue


def _track(sequence: Sequence, start: float, end: float) -> LocalTrack:
    """Return the vehicle's own idea of its motion."""
    odometer, calibration = sequence.odometer, sequence.calibration
    assert odometer is not None
    lever_v = calibration.C_bv.T @ (calibration.lever_antenna_b - calibration.lever_vehicle_b)
    if odometer.yaw_rate is not None:
        return planar_track(odometer.time, odometer.speed, odometer.yaw_rate, start, end, lever_v)
    imu = sequence.inertial
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    bias = rate_at_rest(stream, odometer.time, odometer.speed, end)
    return inertial_track(
        stream, odometer.time, odometer.speed, start, end, calibration.C_bv, bias, lever_v
    )
