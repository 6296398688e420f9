"""The filter loop: from a `Sequence` to a `Solution`.

Align, then for each GNSS event propagate exactly to its time, test the innovation, update, log.
"""

from __future__ import annotations

import dataclasses
import time as clock
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from alignment.initial import InitialAttitude, VelocityTrack, given_attitude, level_and_course
from datasets.sequence import Sequence
from filters import _kernels, measurements
from filters.earth import OMEGA_IE_E, C_en_of
from filters.ekf import ErrorStateFilter, Outcome
from filters.error_model import GYRO_BIAS, ErrorModel
from filters.errors import AlignmentError, DataError
from filters.rotation import FloatArray
from filters.sensors import imu_preset
from filters.smoother import smooth
from filters.strapdown import InertialStream, NavState
from nav.config import AlignmentConfig, Config
from nav.doppler_update import apply_ddia, apply_rows
from nav.gnss import GnssEvent, GnssTimeline, gnss_timeline
from nav.solution import UPDATE_KINDS, AlignmentReport, Solution, Trajectory, Update
from nav.vehicle import VehicleConstraints
from velocity.range_rate import DopplerRows

Progress = Callable[[float, str], None]

#: A velocity can start the filter if a position lies this close to it [s].
_POSITION_NEAR = 2.5


@dataclass(frozen=True, eq=False)
class _Start:
    """Where and how the filter starts."""

    attitude: InitialAttitude
    pos_e: FloatArray  # antenna
    pos_cov_e: FloatArray
    vel_e: FloatArray  # antenna
    vel_cov_e: FloatArray


def navigate(sequence: Sequence, config: Config, progress: Progress | None = None) -> Solution:
    """Run loosely coupled GNSS/INS over a sequence.

    Parameters
    ----------
    sequence : Sequence
    config : Config
    progress : callable, optional
        Called with the fraction done and what is being done.

    Returns
    -------
    Solution
        The trajectory of the IMU, from the moment it is aligned, and the log of every update.

    Raises
    ------
    AlignmentError
        If no initial attitude was found.
    DataError
        If the sequence has no IMU data.
    """
    report: Progress = progress or (lambda fraction, what: None)
    imu = sequence.inertial
    began = clock.perf_counter()
    report(0.0, "GNSS")
    timeline = gnss_timeline(sequence, config.gnss)
    spent_gnss = clock.perf_counter() - began
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    spec = imu_preset(config.filter.imu) if config.filter.imu else sequence.calibration.imu
    vehicle = VehicleConstraints(sequence, config.vehicle)
    model = ErrorModel(
        spec, config.filter.states, config.filter.bias_model, vehicle.odometer is not None
    )
    report(0.0, "alignment")
    start = _align(sequence, stream, timeline, config.alignment, model)
    began = clock.perf_counter()
    kalman = _start_filter(sequence, stream, model, start, config)
    updates = _filter(sequence, kalman, timeline, vehicle, config, report)
    rows = kalman.rows
    if kalman.tape is not None:
        report(1.0, "smoother")
        rows = smooth(kalman.tape, kalman.P)
    spent_filter = clock.perf_counter() - began
    attitude = start.attitude
    return Solution(
        name=sequence.name,
        trajectory=trajectory_from_rows(rows),
        updates=tuple(updates),
        alignment=AlignmentReport(
            "given" if attitude.method == "given" else "aligned", attitude.method, attitude.time,
            attitude.time - float(imu.time[0]), attitude.sigma_heading, attitude.message,
        ),
        epochs=timeline.epochs,
        notes=(*sequence.notes, *timeline.notes, *_imu_gaps(sequence)),
        timing={"gnss_s": spent_gnss, "filter_s": spent_filter},
    )  # fmt: skip


def _align(
    sequence: Sequence,
    stream: InertialStream,
    timeline: GnssTimeline,
    config: AlignmentConfig,
    model: ErrorModel,
) -> _Start:
    """Find the initial attitude, and position and velocity at its time."""
    positions = [e for e in timeline.events if e.kind == "position" and not e.reason]
    velocities = [e for e in timeline.events if e.kind == "velocity" and not e.reason]
    if not positions or not velocities:
        what = "position" if not positions else "velocity"
        raise AlignmentError(
            f"{sequence.name}: no usable GNSS {what}, so there is nothing to start from"
        )
    position_time = np.array([e.time for e in positions])
    nearest = [int(np.argmin(np.abs(position_time - e.time))) for e in velocities]
    pairs = [
        (v, positions[k])
        for v, k in zip(velocities, nearest, strict=True)
        if abs(positions[k].time - v.time) <= _POSITION_NEAR and stream.start < v.time < stream.end
    ]
    if not pairs:
        raise AlignmentError(
            f"{sequence.name}: no GNSS velocity with a position within {_POSITION_NEAR} s inside "
            "the IMU data"
        )
    attitude = _attitude(sequence, stream, pairs, config, model)
    v, p = min(pairs, key=lambda pair: abs(pair[0].time - attitude.time))
    pos_e = p.value_e + v.value_e * (attitude.time - p.time)
    return _Start(attitude, pos_e, p.cov_e, v.value_e, v.cov_e)


def _attitude(
    sequence: Sequence,
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
        stream, track, sequence.calibration.C_bv, model.imu,
        min_speed=config.min_speed_mps, sigma_level=level, sigma_heading=heading,
    )  # fmt: skip


def _start_filter(
    sequence: Sequence, stream: InertialStream, model: ErrorModel, start: _Start, config: Config
) -> ErrorStateFilter:
    """Move the start from antenna to IMU and hand it to the filter."""
    attitude, lever = start.attitude, sequence.calibration.lever_antenna_b
    k = min(stream.index(attitude.time), stream.gyro.shape[0] - 1)
    omega_eb = stream.gyro[k] - attitude.gyro_bias - attitude.C_eb.T @ OMEGA_IE_E
    state = NavState(
        attitude.time,
        start.pos_e - attitude.C_eb @ lever,
        start.vel_e - attitude.C_eb @ np.cross(omega_eb, lever),
        attitude.C_eb,
    )
    pos_cov = start.pos_cov_e + np.eye(3) * sequence.calibration.lever_antenna_sigma**2
    att_cov_b = attitude.C_eb.T @ attitude.cov_e @ attitude.C_eb
    P = model.initial_covariance(pos_cov, start.vel_cov_e, att_cov_b)
    if attitude.sigma_gyro_bias is not None:
        P[GYRO_BIAS, GYRO_BIAS] = np.eye(3) * attitude.sigma_gyro_bias**2
    rate = config.filter.output_rate_hz
    interval = 1.0 / rate if rate > 0 else 0.0
    return ErrorStateFilter(
        model, stream, state, P, interval, attitude.gyro_bias, config.filter.smooth
    )


def _filter(
    sequence: Sequence,
    kalman: ErrorStateFilter,
    timeline: GnssTimeline,
    vehicle: VehicleConstraints,
    config: Config,
    report: Progress,
) -> list[Update]:
    """Run the loop over all events and return the log."""
    begin, end = kalman.time, kalman.stream.end
    updates: list[Update] = []
    refused = dict.fromkeys(UPDATE_KINDS, 0)
    constraint_times = iter([*vehicle.times(begin, end), float("inf")])
    next_constraint = next(constraint_times)
    for number, event in enumerate([*timeline.events, None]):
        if number % 50 == 0 and event is not None:
            report(min(max((event.time - begin) / (end - begin), 0.0), 1.0), "filter")
        until = end if event is None else min(event.time, end)
        while next_constraint < until:
            kalman.propagate(next_constraint)
            updates += _constrain(kalman, vehicle, config)
            next_constraint = next(constraint_times)
        if event is None:
            break
        why = event.reason
        if event.time <= begin:
            why = why or "before alignment"
        elif event.time > end:
            why = why or "after the IMU data"
        if why:
            updates.append(Update(event.time, event.kind, event.satellites, reason=why))
            continue
        kalman.propagate(event.time)
        patience = config.filter.gate_patience
        insist = 0 < patience <= refused[event.kind]
        update = _apply(sequence, kalman, event, config, insist)
        refused[event.kind] = 0 if update.accepted or insist else refused[event.kind] + 1
        updates.append(update)
        if not np.isfinite(kalman.pos_e).all():
            raise DataError(
                f"{sequence.name}: the solution diverged at {event.time:.1f} s",
                remedy="check units and axes of the IMU, and the IMU preset",
            )
    kalman.propagate(end)
    report(1.0, "filter")
    return updates


def _constrain(
    kalman: ErrorStateFilter, vehicle: VehicleConstraints, config: Config
) -> list[Update]:
    """Offer the vehicle constraints that hold now."""
    return [
        _update(kalman.time, kind, (), kalman.update(m, config.filter.gate_probability))
        for kind, m in vehicle.offered(kalman)
    ]


def _update(
    time: float, kind: str, satellites: tuple[str, ...], outcome: Outcome, reason: str = ""
) -> Update:
    if not outcome.accepted and not reason:
        reason = f"innovation test (NIS > {outcome.limit:.1f})"
    whitened = tuple(map(float, outcome.whitened))
    return Update(time, kind, satellites, whitened, outcome.nis, outcome.accepted, reason)


def _apply(
    sequence: Sequence, kalman: ErrorStateFilter, event: GnssEvent, config: Config, insist: bool
) -> Update:
    """Offer one event to the filter; with `insist`, enlarge the covariance until it fits."""
    calibration, n = sequence.calibration, kalman.model.size
    lever, gate = calibration.lever_antenna_b, config.filter.gate_probability
    if event.rows is not None:
        return _apply_doppler(sequence, kalman, event, event.rows, config)
    if event.kind == "position":
        cov = event.cov_e + np.eye(3) * calibration.lever_antenna_sigma**2
        m = measurements.position(kalman.state, n, event.value_e, cov, lever)
    else:
        m = measurements.velocity(
            kalman.state, n, event.value_e, event.cov_e, lever, kalman.omega_b
        )
    outcome, reason = kalman.update(m, gate), ""
    if insist and not outcome.accepted:
        kalman.enlarge(m)
        if kalman.update(m, gate).accepted:
            outcome = dataclasses.replace(outcome, accepted=True)
            reason = "covariance enlarged after repeated refusal"
    return _update(event.time, event.kind, event.satellites, outcome, reason)


def _apply_doppler(
    sequence: Sequence,
    kalman: ErrorStateFilter,
    event: GnssEvent,
    rows: DopplerRows,
    config: Config,
) -> Update:
    """Offer Doppler of an epoch without a least-squares velocity."""
    gate = config.filter.gate_probability
    outcome: Outcome | None
    if config.gnss.below_four == "rows":
        outcome, names, reason = apply_rows(kalman, sequence.calibration, rows, gate)
    else:
        outcome, names, reason = apply_ddia(
            kalman, sequence.calibration, rows, event.time, config.gnss, gate
        )
    if outcome is None:
        return Update(event.time, event.kind, names, reason=reason)
    return _update(event.time, event.kind, names, outcome, reason)


def trajectory_from_rows(rows: FloatArray) -> Trajectory:
    """Turn recorded filter rows into a `Trajectory`, covariances rotated to north-east-down."""
    pos_e = rows[:, _kernels.ROW_POS : _kernels.ROW_POS + 3]
    bias = rows[:, _kernels.ROW_BIAS : _kernels.ROW_BIAS + 6]
    std_bias = rows[:, _kernels.ROW_STD_BIAS : _kernels.ROW_STD_BIAS + 6]
    C_eb = rows[:, _kernels.ROW_C : _kernels.ROW_C + 9].reshape(-1, 3, 3)
    C_ne = np.swapaxes(C_en_of(pos_e), 1, 2)
    to_ned = (C_ne, C_ne, C_ne @ C_eb)  # position and velocity errors in e, attitude error in b
    upper = np.triu_indices(3)
    blocks = []
    for block, C in enumerate(to_ned):
        start = _kernels.ROW_COV + 6 * block
        cov = np.empty((len(rows), 3, 3))
        cov[:, upper[0], upper[1]] = rows[:, start : start + 6]
        cov[:, upper[1], upper[0]] = rows[:, start : start + 6]
        blocks.append(C @ cov @ np.swapaxes(C, 1, 2))
    return Trajectory(
        time=rows[:, _kernels.ROW_TIME],
        pos_e=pos_e,
        vel_e=rows[:, _kernels.ROW_VEL : _kernels.ROW_VEL + 3],
        C_eb=C_eb,
        gyro_bias=bias[:, :3],
        accel_bias=bias[:, 3:],
        cov_pos_n=blocks[0],
        cov_vel_n=blocks[1],
        cov_att_n=blocks[2],
        std_gyro_bias=std_bias[:, :3],
        std_accel_bias=std_bias[:, 3:],
    )


def _imu_gaps(sequence: Sequence) -> tuple[str, ...]:
    """Name gaps in the IMU data: the mechanisation bridges them with the sample that follows."""
    time = sequence.inertial.time
    step = np.diff(time)
    gaps = np.flatnonzero(step > 1.5 * sequence.inertial.interval)
    if not gaps.size:
        return ()
    worst = int(gaps[np.argmax(step[gaps])])
    return (
        f"IMU: {gaps.size} gaps, the longest {step[worst]:.3f} s at {time[worst]:.3f} s; each is "
        "bridged with the mean rate of the sample after it",
    )
