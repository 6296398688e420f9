"""A whole run: from a `Sequence` to a `Solution`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from ..datasets.sequence import Sequence
from ..filters import smoother as filtered
from ..filters.compiled import rows as layout
from ..filters.earth import C_en_of
from ..filters.errors import AlignmentError
from ..filters.rotation import FloatArray
from ..filters.strapdown import InertialStream
from ._frames import ned_covariances
from .config import Config
from .engine.blind import blind_axes, blind_notes, blind_spells
from .engine.events import GnssEvent
from .engine.fix_noise.fitted import with_fitted_noise
from .engine.gnss import gnss_timeline
from .engine.integrity.placed import meaning, of_smoothed, with_protection
from .engine.legs import Course, Leg, legs, told
from .engine.model import error_model
from .engine.vehicle import VehicleConstraints
from .engine.watch.doubts import doubts, outages
from .notes import Note, clock, plain
from .solution import Separation, Solution, Trajectory
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
        shared=any(e.shared for e in timeline.events), nhc=vehicle.nhc,
    )  # fmt: skip
    blind = blind_axes(imu, timeline.events)
    spells = blind_spells(imu, blind)
    course = Course(
        timeline.events, stream, sequence.calibration, vehicle, model, tuple(spells), config
    )
    began = time.perf_counter()
    course, errors, fit_notes = with_fitted_noise(course, timeline.misfit, report)
    made: list[Leg] = []
    why = ""
    try:
        for leg in legs(course, report):
            made.append(leg)
    except AlignmentError as error:
        if not made:
            raise
        why = str(error)
    status, said = told(made, stream.end, why)
    updates = tuple(update for leg in made for update in leg.updates)
    installed = made[-1].installation
    notes = [
        *said,
        *plain(sequence.notes),
        *plain([str(installed), *installed.antenna.lines()]),
        *timeline.notes,
        *fit_notes,
        *_imu_gaps(sequence),
        *blind_notes(spells, blind),
        *outages(updates, made[-1].until),
        *doubts(updates, config.filter.gate_probability),
    ]  # fmt: skip
    if status == "ok" and any(note.doubtful for note in notes):
        status = "doubtful"
    bare = trajectory_from_rows(np.vstack([leg.rows for leg in made if len(leg.rows)]))
    trajectory = with_lasting(bare, timeline.events)
    levels = np.vstack(
        [leg.levels if leg.separation is None else of_smoothed(leg.levels) for leg in made]
    )
    trajectory = with_protection(trajectory, levels, config.filter.protection_risk, bare)
    aligning = sum(leg.aligning for leg in made)
    spent = time.perf_counter() - began
    return Solution(
        name=sequence.name,
        trajectory=trajectory,
        updates=updates,
        alignment=made[0].start.report(float(imu.time[0])),
        epochs=timeline.epochs,
        notes=tuple(notes),
        timing={"gnss_s": spent_gnss, "alignment_s": aligning, "filter_s": spent - aligning},
        status=status,
        installation=installed,
        fix_errors=errors,
        protection=meaning(course.events, vehicle, config),
        separation=_separation(made[-1].separation),
    )


def _separation(found: filtered.Separation | None) -> Separation | None:
    """Return the separation in north, east, down."""
    if found is None:
        return None
    C_ne = np.swapaxes(C_en_of(found.pos_e), 1, 2)
    forward_n, backward_n = (
        np.einsum("nij,nj->ni", C_ne, part) for part in (found.forward_e, found.backward_e)
    )
    return Separation(found.time, forward_n, backward_n, found.chi2)


def trajectory_from_rows(rows: FloatArray) -> Trajectory:
    """Turn recorded filter rows into a `Trajectory`, covariances rotated to north-east-down."""
    pos_e = rows[:, layout.ROW_POS : layout.ROW_POS + 3]
    bias = rows[:, layout.ROW_BIAS : layout.ROW_BIAS + 6]
    std_bias = rows[:, layout.ROW_STD_BIAS : layout.ROW_STD_BIAS + 6]
    C_eb = rows[:, layout.ROW_C : layout.ROW_C + 9].reshape(-1, 3, 3)
    blocks = np.empty((3, len(rows), 3, 3))

    def turn(start: int) -> None:
        piece = slice(start, start + _ROWS_AT_ONCE)
        C_ne = np.swapaxes(C_en_of(pos_e[piece]), 1, 2)
        upper = np.ascontiguousarray(rows[piece, layout.ROW_COV : layout.ROW_COV + 18])
        ned_covariances(upper, C_ne, C_eb[piece], blocks, start)

    list(in_order(turn, range(0, len(rows), _ROWS_AT_ONCE)))
    return Trajectory(
        time=rows[:, layout.ROW_TIME],
        pos_e=pos_e,
        vel_e=rows[:, layout.ROW_VEL : layout.ROW_VEL + 3],
        C_eb=C_eb,
        gyro_bias=bias[:, :3],
        accel_bias=bias[:, 3:],
        cov_pos_n=blocks[0],
        cov_vel_n=blocks[1],
        cov_att_n=blocks[2],
        std_gyro_bias=std_bias[:, :3],
        std_accel_bias=std_bias[:, 3:],
    )


def with_lasting(trajectory: Trajectory, events: Iterable[GnssEvent]) -> Trajectory:
    """Return a trajectory whose covariance contains what residuals of minutes say it lacks.

    Every position is off by it alike, and so is the solution, however many there are: the filter,
    for which errors fade, has averaged it away.
    """
    fixes = [e for e in events if e.kind == "position" and not e.reason]
    if not any(e.lasting_e is not None for e in fixes):
        return trajectory
    none = np.zeros((3, 3))
    lasting_e = np.array([none if e.lasting_e is None else e.lasting_e for e in fixes])
    last = np.searchsorted([e.time for e in fixes], trajectory.time, side="right") - 1
    C_en = C_en_of(trajectory.pos_e)
    lasting_n = np.swapaxes(C_en, 1, 2) @ lasting_e[np.maximum(last, 0)] @ C_en
    return replace(trajectory, cov_pos_n=trajectory.cov_pos_n + lasting_n)


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
