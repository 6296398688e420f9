"""What goes into a window: screened Doppler, and the local velocity at the same instants."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...alignment.local_velocity import (
    LocalTrack,
    inertial_track,
    planar_track,
    rate_at_rest,
)
from ...alignment.rows import POSITION_SIGMA, AlignmentRows
from ...datasets.observations import GnssObservations
from ...datasets.sequence import Sequence
from ...filters.errors import AlignmentError
from ...filters.rotation import FloatArray
from ...filters.strapdown import InertialStream
from ...velocity.phase_rates import phase_gate, with_phase_rates
from ...velocity.range_rate import doppler_rows, with_elevation
from .noise import WindowNoise
from .options import OWN, WindowOptions

#: As far as a vehicle gets between a fix and a window without one [m/s].
FASTEST = 40.0


def prepared_observations(
    sequence: Sequence, options: WindowOptions
) -> tuple[GnssObservations, FloatArray]:
    """Return the screened and thinned observations with their approximate positions."""
    observations, pos_e = screened_observations(sequence, options)
    keep = observations.has_range_rate & _kept(observations, options)
    return observations.take(keep), pos_e[keep]


def screened_observations(
    sequence: Sequence, options: WindowOptions
) -> tuple[GnssObservations, FloatArray]:
    """Return all observations, those not to be used marked, with their approximate positions."""
    if sequence.observations is None or not sequence.observations.has_range_rate.any():
        raise AlignmentError(f"{sequence.name}: no raw Doppler with satellite states to align with")
    observations = sequence.observations
    pos_e = _whereabouts(sequence, observations.time)
    observations = with_elevation(observations, pos_e)
    low = observations.elevation < np.radians(options.elevation_mask_deg)
    observations = observations.mark(low, "below elevation mask")
    observations = observations.mark(observations.cn0 < options.min_cn0, "weak signal")
    if options.phase != "off":
        observations = phase_gate(observations)
    if options.phase == "rates":
        observations = with_phase_rates(observations)
    if options.labels == "los":
        observations = observations.mark(observations.label == "nlos", "labelled as reflected")
    return observations, pos_e


def left_out(observations: GnssObservations, start: float, end: float) -> dict[str, int]:
    """Return how many rows with a Doppler of their own a window lost, by reason."""
    inside = (observations.time >= start) & (observations.time <= end)
    lost = inside & ~observations.usable & np.isfinite(observations.range_rate)
    reasons, counts = np.unique(observations.rejected[lost], return_counts=True)
    return dict(zip(map(str, reasons), map(int, counts), strict=True))


def _whereabouts(sequence: Sequence, time: FloatArray) -> FloatArray:
    """Return approximate antenna positions: the receiver's own, else the reference's."""
    source = sequence.fixes if sequence.fixes is not None else sequence.reference
    if source is None:
        raise AlignmentError(
            f"{sequence.name}: no position to compute lines of sight from — a kilometre would do"
        )
    return np.column_stack([np.interp(time, source.time, x) for x in source.pos_e.T])


def position_sigma(sequence: Sequence, options: WindowOptions, start: float, end: float) -> float:
    """Return 1σ per axis of the positions of a window [m]: what is stated, or what fixes state.

    Fixes are interpolated; where the nearest is far in time the vehicle may be elsewhere.
    """
    if options.position_sigma_m is not None:
        return options.position_sigma_m
    if sequence.fixes is None:
        return POSITION_SIGMA
    fixes = sequence.fixes
    inside = (fixes.time >= start) & (fixes.time <= end)
    gap = 0.0
    if not inside.any():
        away = np.maximum(np.maximum(start - fixes.time, fixes.time - end), 0.0)
        inside, gap = away == away.min(), float(away.min())
    variance = np.trace(fixes.pos_cov_e[inside], axis1=1, axis2=2) / 3.0
    return float(np.hypot(np.sqrt(np.median(variance)), FASTEST * gap))


def _kept(observations: GnssObservations, options: WindowOptions) -> NDArray[np.bool_]:
    """Return the rows left by decimation and by drawing satellites."""
    rng = np.random.default_rng(options.seed)
    keep = np.zeros(len(observations), dtype=bool)
    usable = observations.has_range_rate
    for number, (_, rows) in enumerate(observations.epochs()):
        here = np.flatnonzero(usable[rows]) + rows.start
        if number % options.decimate or not here.size:
            continue
        if options.satellites is not None:
            whole, fraction = divmod(options.satellites, 1.0)
            spread = rng.integers(-1, 2) if options.satellites == 2.0 else 0
            n = int(whole) + int(rng.random() < fraction) + int(spread)
            here = rng.permutation(here)[: max(n, 1)]
        keep[here] = True
    return keep


def local_track(sequence: Sequence, start: float, end: float) -> LocalTrack:
    """Return the local velocity of a window: gyros where there is no yaw rate."""
    odometer, calibration = sequence.odometer, sequence.calibration
    if odometer is None:
        raise AlignmentError(f"{sequence.name}: no odometer, so no local velocity")
    C_vb = calibration.C_bv.T
    lever_v = C_vb @ (calibration.lever_antenna_b - calibration.lever_vehicle_b)
    if odometer.yaw_rate is not None:
        return planar_track(odometer.time, odometer.speed, odometer.yaw_rate, start, end, lever_v)
    imu = sequence.inertial
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    bias = rate_at_rest(stream, odometer.time, odometer.speed, end)
    return inertial_track(
        stream, odometer.time, odometer.speed, start, end, calibration.C_bv, bias, lever_v
    )


def alignment_rows(
    observations: GnssObservations,
    pos_e: FloatArray,
    track: LocalTrack,
    options: WindowOptions,
    noise: WindowNoise,
    position_sigma: float,
) -> AlignmentRows:
    """Pair the Doppler of a window with the local velocity at the same instants."""
    doppler = doppler_rows(observations, pos_e, noise.doppler)
    time = observations.time[doppler.row]
    if options.method not in OWN:  # published without such unknowns
        position_sigma, options = 0.0, replace(options, speed_scale_sigma=0.0)
    return AlignmentRows.paired(
        doppler, time, track.velocity_at(time), vel_sigma=options.sigma_local_mps,
        position_sigma=position_sigma, speed_scale_sigma=options.speed_scale_sigma,
    )  # fmt: skip
