"""Where the filter starts: initial attitude, and position and velocity at its time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alignment.initial import InitialAttitude, VelocityTrack, given_attitude, level_and_course
from datasets.sequence import Calibration
from filters.earth import OMEGA_IE_E
from filters.ekf import ErrorStateFilter
from filters.error_model import GYRO_BIAS, ErrorModel
from filters.errors import AlignmentError
from filters.rotation import FloatArray
from filters.strapdown import InertialStream, NavState
from nav.config import AlignmentConfig, FilterConfig
from nav.gnss import GnssEvent

#: A velocity can start the filter if a position lies this close to it [s].
_POSITION_NEAR = 2.5


@dataclass(frozen=True, eq=False)
class Start:
    """Attitude, and antenna position and velocity with covariances, at one instant."""

    attitude: InitialAttitude
    pos_e: FloatArray  # antenna
    pos_cov_e: FloatArray
    vel_e: FloatArray  # antenna
    vel_cov_e: FloatArray


def find_start(
    events: tuple[GnssEvent, ...],
    stream: InertialStream,
    calibration: Calibration,
    config: AlignmentConfig,
    model: ErrorModel,
) -> Start:
    """Find the initial attitude, and position and velocity at its time.

    Raises
    ------
    AlignmentError
        Why there is no attitude yet.
    """
    positions = [e for e in events if e.kind == "position" and not e.reason]
    velocities = [e for e in events if e.kind == "velocity" and not e.reason]
    if not positions or not velocities:
        what = "position" if not positions else "velocity"
        raise AlignmentError(f"no usable GNSS {what}, so there is nothing to start from")
    position_time = np.array([e.time for e in positions])
    nearest = [int(np.argmin(np.abs(position_time - e.time))) for e in velocities]
    pairs = [
        (v, positions[k])
        for v, k in zip(velocities, nearest, strict=True)
        if abs(positions[k].time - v.time) <= _POSITION_NEAR and stream.start < v.time < stream.end
    ]
    if not pairs:
        raise AlignmentError(
            f"no GNSS velocity with a position within {_POSITION_NEAR} s inside the IMU data"
        )
    attitude = _attitude(calibration, stream, pairs, config, model)
    v, p = min(pairs, key=lambda pair: abs(pair[0].time - attitude.time))
    pos_e = p.value_e + v.value_e * (attitude.time - p.time)
    return Start(attitude, pos_e, p.cov_e, v.value_e, v.cov_e)


def _attitude(
    calibration: Calibration,
    stream: InertialStream,
    pairs: list[tuple[GnssEvent, GnssEvent]],
    config: AlignmentConfig,
    model: ErrorModel,
) -> InitialAttitude:
    """The seam for aligners: velocities with positions in, an `InitialAttitude` out."""
    level, heading = np.radians([config.sigma_level_deg, config.sigma_heading_deg])
    given = (config.roll_deg, config.pitch_deg, config.heading_deg)
    if config.method == "given" or (config.method == "auto" and None not in given):
        velocity, position = pairs[0]
        rpy = np.radians(np.array(given, dtype=float))
        return given_attitude(velocity.time, position.value_e, rpy, level, heading)
    track = VelocityTrack(
        np.array([v.time for v, _ in pairs]),
        np.array([v.value_e for v, _ in pairs]),
        np.array([np.sqrt(np.trace(v.cov_e) / 3.0) for v, _ in pairs]),
        np.array([p.value_e for _, p in pairs]),
    )
    return level_and_course(
        stream, track, calibration.C_bv, model.imu,
        min_speed=config.min_speed_mps, sigma_level=level, sigma_heading=heading,
    )  # fmt: skip


def start_filter(
    start: Start,
    stream: InertialStream,
    calibration: Calibration,
    model: ErrorModel,
    config: FilterConfig,
) -> ErrorStateFilter:
    """Move the start from antenna to IMU and hand it to the filter."""
    attitude, lever = start.attitude, calibration.lever_antenna_b
    k = min(stream.index(attitude.time), stream.gyro.shape[0] - 1)
    omega_eb = stream.gyro[k] - attitude.gyro_bias - attitude.C_eb.T @ OMEGA_IE_E
    state = NavState(
        attitude.time,
        start.pos_e - attitude.C_eb @ lever,
        start.vel_e - attitude.C_eb @ np.cross(omega_eb, lever),
        attitude.C_eb,
    )
    pos_cov = start.pos_cov_e + np.eye(3) * calibration.lever_antenna_sigma**2
    att_cov_b = attitude.C_eb.T @ attitude.cov_e @ attitude.C_eb
    P = model.initial_covariance(pos_cov, start.vel_cov_e, att_cov_b)
    if attitude.sigma_gyro_bias is not None:
        P[GYRO_BIAS, GYRO_BIAS] = np.eye(3) * attitude.sigma_gyro_bias**2
    rate = config.output_rate_hz
    interval = 1.0 / rate if rate > 0 else 0.0
    return ErrorStateFilter(model, stream, state, P, interval, attitude.gyro_bias, config.smooth)
