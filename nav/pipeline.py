"""A whole run: from a `Sequence` to a `Solution`."""

from __future__ import annotations

import time as clock
from collections.abc import Callable

import numpy as np

from datasets.sequence import Sequence
from filters import _kernels
from filters.earth import C_en_of
from filters.error_model import ErrorModel
from filters.rotation import FloatArray
from filters.sensors import imu_preset
from filters.smoother import smooth
from filters.strapdown import InertialStream
from nav.config import Config
from nav.gnss import gnss_timeline
from nav.loop import FilterLoop
from nav.solution import AlignmentReport, Solution, Trajectory
from nav.start import find_start, start_filter
from nav.vehicle import VehicleConstraints

Progress = Callable[[float, str], None]

#: A few megabytes at a time stay in the processor's cache.
_ROWS_AT_ONCE = 8192
_FROM_UPPER = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


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
    vehicle = VehicleConstraints(sequence.calibration, config.vehicle, sequence.odometer)
    model = ErrorModel(
        spec, config.filter.states, config.filter.bias_model, vehicle.odometer is not None
    )
    report(0.0, "alignment")
    start = find_start(timeline.events, stream, sequence.calibration, config.alignment, model)
    began = clock.perf_counter()
    kalman = start_filter(start, stream, sequence.calibration, model, config.filter)
    loop = FilterLoop(kalman, sequence.calibration, vehicle, config)
    begin, end = kalman.time, stream.end
    for number, event in enumerate(timeline.events):
        if number % 50 == 0:
            report(min(max((event.time - begin) / (end - begin), 0.0), 1.0), "filter")
        loop.offer(event)
    loop.advance(end)
    report(1.0, "filter")
    rows = kalman.rows
    if kalman.tape is not None:
        report(1.0, "smoother")
        rows = smooth(kalman.tape, kalman.P)
    spent_filter = clock.perf_counter() - began
    attitude = start.attitude
    return Solution(
        name=sequence.name,
        trajectory=trajectory_from_rows(rows),
        updates=tuple(loop.updates),
        alignment=AlignmentReport(
            "given" if attitude.method == "given" else "aligned", attitude.method, attitude.time,
            attitude.time - float(imu.time[0]), attitude.sigma_heading, attitude.message,
        ),
        epochs=timeline.epochs,
        notes=(*sequence.notes, *timeline.notes, *_imu_gaps(sequence)),
        timing={"gnss_s": spent_gnss, "filter_s": spent_filter},
    )  # fmt: skip


def trajectory_from_rows(rows: FloatArray) -> Trajectory:
    """Turn recorded filter rows into a `Trajectory`, covariances rotated to north-east-down."""
    pos_e = rows[:, _kernels.ROW_POS : _kernels.ROW_POS + 3]
    bias = rows[:, _kernels.ROW_BIAS : _kernels.ROW_BIAS + 6]
    std_bias = rows[:, _kernels.ROW_STD_BIAS : _kernels.ROW_STD_BIAS + 6]
    C_eb = rows[:, _kernels.ROW_C : _kernels.ROW_C + 9].reshape(-1, 3, 3)
    blocks = np.empty((3, len(rows), 3, 3))
    for start in range(0, len(rows), _ROWS_AT_ONCE):
        piece = slice(start, start + _ROWS_AT_ONCE)
        C_ne = np.swapaxes(C_en_of(pos_e[piece]), 1, 2)
        # Position and velocity errors are in e, the attitude error in b.
        for block, C in enumerate((C_ne, C_ne, C_ne @ C_eb[piece])):
            upper = rows[piece, _kernels.ROW_COV + 6 * block : _kernels.ROW_COV + 6 * block + 6]
            cov = upper[:, _FROM_UPPER]
            blocks[block, piece] = C @ cov @ np.swapaxes(C, 1, 2)
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
