"""A whole run: from a `Sequence` to a `Solution`."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

import numpy as np

from ..datasets.sequence import Sequence
from ..filters import _kernels
from ..filters.earth import C_en_of
from ..filters.rotation import FloatArray
from ..filters.smoother import smooth
from ..filters.strapdown import InertialStream
from ._frames import ned_covariances
from .config import Config
from .engine.blind import blind_axes, blind_notes, blind_spells
from .engine.doubts import doubts
from .engine.gnss import gnss_timeline
from .engine.loop import Diverged, FilterLoop
from .engine.model import error_model
from .engine.start.finder import find_start
from .engine.start.state import start_filter
from .engine.vehicle import VehicleConstraints
from .notes import Note, clock, plain
from .solution import Solution, Trajectory
from .sweep import in_order

Progress = Callable[[float, str], None]

#: A few megabytes at a time stay in the processor's cache.
_ROWS_AT_ONCE = 8192


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
        If the sequence has no IMU data, or the solution diverged at once. Diverging later, it
        is cut there, and the notes say so.
    """
    report: Progress = progress or (lambda fraction, what: None)
    imu = sequence.inertial
    began = time.perf_counter()
    report(0.0, "GNSS")
    timeline = gnss_timeline(sequence, config.gnss)
    spent_gnss = time.perf_counter() - began
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    vehicle = VehicleConstraints(sequence.calibration, config.vehicle, sequence.odometer)
    model = error_model(
        sequence.calibration, config, odometer=vehicle.odometer is not None,
        doppler=any(e.observations is not None for e in timeline.events),
        shared=any(e.shared for e in timeline.events),
    )  # fmt: skip
    report(0.0, "alignment")
    began = time.perf_counter()
    start = find_start(timeline.events, stream, sequence.calibration, config.alignment, model)
    spent_alignment = time.perf_counter() - began
    began = time.perf_counter()
    kalman = start_filter(start, stream, sequence.calibration, model, config.filter)
    blind = blind_axes(imu, timeline.events)
    spells = blind_spells(imu, blind)
    loop = FilterLoop(kalman, sequence.calibration, vehicle, config, deque(spells))
    begin, end = kalman.time, stream.end
    notes = [
        *plain(sequence.notes),
        *timeline.notes,
        *_imu_gaps(sequence),
        *blind_notes(spells, blind),
    ]
    try:
        for number, event in enumerate(timeline.events):
            if number % 50 == 0:
                report(min(max((event.time - begin) / (end - begin), 0.0), 1.0), "filter")
            loop.offer(event)
        loop.advance(end)
    except Diverged as error:
        rows = _kept(kalman.rows)
        if len(rows) < 2:
            raise
        cut = float(rows[-1, _kernels.ROW_TIME])
        text = (
            f"{error}; this solution ends at {clock(cut)}, {end - cut:.1f} s before the data, "
            "and is not smoothed"
        )
        notes.append(Note("doubtful", text))
    else:
        report(1.0, "filter")
        rows = kalman.rows
        if kalman.tape is not None:
            report(1.0, "smoother")
            rows = smooth(kalman.tape, kalman.P)
    notes += doubts(loop.updates, config.filter.gate_probability)
    spent_filter = time.perf_counter() - began
    return Solution(
        name=sequence.name,
        trajectory=trajectory_from_rows(rows),
        updates=tuple(loop.updates),
        alignment=start.report(float(imu.time[0])),
        epochs=timeline.epochs,
        notes=tuple(notes),
        timing={"gnss_s": spent_gnss, "alignment_s": spent_alignment, "filter_s": spent_filter},
    )


def trajectory_from_rows(rows: FloatArray) -> Trajectory:
    """Turn recorded filter rows into a `Trajectory`, covariances rotated to north-east-down."""
    pos_e = rows[:, _kernels.ROW_POS : _kernels.ROW_POS + 3]
    bias = rows[:, _kernels.ROW_BIAS : _kernels.ROW_BIAS + 6]
    std_bias = rows[:, _kernels.ROW_STD_BIAS : _kernels.ROW_STD_BIAS + 6]
    C_eb = rows[:, _kernels.ROW_C : _kernels.ROW_C + 9].reshape(-1, 3, 3)
    blocks = np.empty((3, len(rows), 3, 3))

    def turn(start: int) -> None:
        piece = slice(start, start + _ROWS_AT_ONCE)
        C_ne = np.swapaxes(C_en_of(pos_e[piece]), 1, 2)
        upper = np.ascontiguousarray(rows[piece, _kernels.ROW_COV : _kernels.ROW_COV + 18])
        ned_covariances(upper, C_ne, C_eb[piece], blocks, start)

    list(in_order(turn, range(0, len(rows), _ROWS_AT_ONCE)))
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


def _kept(rows: FloatArray) -> FloatArray:
    """Return the rows before the first that is not finite, or whose covariance is none."""
    bad = ~np.isfinite(rows).all(axis=1) | (np.abs(rows[:, _kernels.ROW_VEL]) > 1e4)
    return rows[: int(np.argmax(bad))] if bad.any() else rows


def _imu_gaps(sequence: Sequence) -> tuple[Note, ...]:
    """Name gaps in the IMU data: the mechanisation bridges them with the sample that follows."""
    stamps = sequence.inertial.time
    step = np.diff(stamps)
    gaps = np.flatnonzero(step > 1.5 * sequence.inertial.interval)
    if not gaps.size:
        return ()
    worst = int(gaps[np.argmax(step[gaps])])
    text = (
        f"IMU: {gaps.size} gaps, the longest {step[worst]:.3f} s from {clock(stamps[worst])}; "
        "each is bridged with the mean rate of the sample after it"
    )
    return (Note("note", text),)
