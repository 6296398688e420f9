"""A whole run: from a `Sequence` to a `Solution`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..datasets.observations import GnssObservations
from ..datasets.sequence import Sequence
from ..filters import smoother as filtered
from ..filters.compiled import rows as layout
from ..filters.earth import C_en_of
from ..filters.errors import AlignmentError
from ..filters.rotation import FloatArray
from ..filters.strapdown import InertialStream
from ._frames import ned_covariances
from .config import Config
from .engine.blind import blind_notes
from .engine.events import GnssEvent
from .engine.fix_noise.fitted import with_fitted_noise
from .engine.gnss import GnssTimeline, gnss_timeline
from .engine.integrity.placed import meaning, of_smoothed, with_protection
from .engine.legs import Course, Leg, legs, told
from .engine.prepared import Prepared, course_over
from .engine.velocity_noise.fitted import with_fitted_velocities
from .engine.watch.doubts import doubts, outages
from .notes import Note, clock, counted_from, plain
from .signals import Signals, signal_log
from .solution import FixErrors, Separation, Solution, Trajectory, Update
from .sweep.parallel import in_order

Progress = Callable[[float, str], None]

#: A few megabytes at a time stay in the processor's cache.
_ROWS_AT_ONCE = 8192


def navigate(
    sequence: Sequence,
    config: Config,
    progress: Progress | None = None,
    *,
    prepared: Prepared | None = None,
    until: float | None = None,
) -> Solution:
    """Run loosely coupled GNSS/INS over a sequence.

    Parameters
    ----------
    sequence : Sequence
    config : Config
    progress : callable, optional
        Called with the fraction done and what is being done.
    prepared : Prepared, optional
        What several runs over `sequence` have in common, so that it is computed once.
    until : float, optional
        With `prepared`: the start is used as it is known, and GNSS after this time is not [s].

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

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, load
    >>> from certnav.datasets.great.writer import simulate_folder
    >>> from certnav.nav import Config, navigate
    >>> folder = simulate_folder(SimulationConfig("city", duration=90.0, density="open"), "city")
    >>> sequence = load(folder)
    >>> solution = navigate(sequence, Config())
    >>> solution.status, len(solution.trajectory) > 500
    ('ok', True)
    """
    with counted_from(float(sequence.inertial.time[0])):
        ran = _run(sequence, config, progress or _silent, prepared, until)
        return ran.solution(smoothed=True)


def navigate_twice(
    sequence: Sequence, config: Config, prepared: Prepared | None = None
) -> tuple[Solution, Solution]:
    """Return the solution as it happens, and the smoothed one, of one pass through the filter.

    `config` asks for smoothing; parameters and errors are those of `navigate`.
    """
    with counted_from(float(sequence.inertial.time[0])):
        ran = _run(sequence, config, _silent, prepared, None)
        return ran.solution(smoothed=False), ran.solution(smoothed=True)


@dataclass(frozen=True, eq=False)
class _Ran:
    """All legs of a run, and what it was made of."""

    sequence: Sequence
    course: Course
    timeline: GnssTimeline
    made: list[Leg]
    errors: FixErrors | None
    notes: tuple[Note, ...]
    why: str
    spent_gnss: float
    spent: float
    alone: bool

    def solution(self, *, smoothed: bool) -> Solution:
        """Return what came out, as it happened or smoothed."""
        made, sequence, course = self.made, self.sequence, self.course
        status, said = told(made, course.stream.end, self.why)
        updates = tuple(update for leg in made for update in leg.updates)
        installed = made[-1].installation
        notes = [
            *said,
            *plain(sequence.notes),
            *plain([str(installed), *installed.antenna.lines()]),
            *course.vehicle.notes,
            *self.timeline.notes,
            *self.notes,
            *_imu_gaps(sequence),
            *blind_notes(course.spells, course.blind),
            *outages(updates, made[-1].until),
            *doubts(updates, course.config.filter.gate_probability),
        ]  # fmt: skip
        if status == "ok" and any(note.doubtful for note in notes):
            status = "doubtful"
        aligning = sum(leg.aligning for leg in made)
        rows = [leg.rows if smoothed else leg.causal for leg in made]
        kept = [part for part in rows if len(part)]
        bare = trajectory_from_rows(kept[0] if len(kept) == 1 else np.vstack(kept))
        levels = [
            of_smoothed(leg.levels) if smoothed and leg.separation is not None else leg.levels
            for leg in made
        ]
        trajectory = with_protection(
            with_lasting(bare, self.timeline.events), np.vstack(levels),
            course.config.filter.protection_risk, bare,
        )  # fmt: skip
        # Of many runs over the same signals nobody asks for each what became of them.
        observations = self.timeline.observations if self.alone else None
        return Solution(
            name=sequence.name,
            trajectory=trajectory,
            updates=updates,
            alignment=made[0].start.report(float(sequence.inertial.time[0])),
            epochs=self.timeline.epochs,
            notes=tuple(notes),
            timing={
                "gnss_s": self.spent_gnss,
                "alignment_s": aligning,
                "filter_s": self.spent - aligning,
            },
            status=status,
            installation=installed,
            fix_errors=self.errors,
            resolution=self.timeline.resolution,
            signals=_signals(observations, sequence, trajectory, updates),
            protection=meaning(course.events, course.vehicle, course.config),
            separation=_separation(made[-1].separation) if smoothed else None,
        )


def _run(
    sequence: Sequence,
    config: Config,
    report: Progress,
    prepared: Prepared | None,
    until: float | None,
) -> _Ran:
    began = time.perf_counter()
    report(0.0, "GNSS")
    if prepared is None:
        imu = sequence.inertial
        timeline = gnss_timeline(sequence, config.gnss)
        spent_gnss = time.perf_counter() - began
        stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
        course = course_over(sequence, stream, timeline, config)
        began = time.perf_counter()
        course, _, said = with_fitted_velocities(course, report)
        course, errors, notes = with_fitted_noise(course, timeline.misfit, report)
        notes = (*said, *notes)
    else:
        course, timeline, errors, notes = prepared.course(config, until)
        spent_gnss, began = time.perf_counter() - began, time.perf_counter()
    made: list[Leg] = []
    why = ""
    try:
        for leg in legs(course, report):
            made.append(leg)
    except AlignmentError as error:
        if not made:
            raise
        why = str(error)
    spent = time.perf_counter() - began
    return _Ran(
        sequence, course, timeline, made, errors, notes, why, spent_gnss, spent, prepared is None
    )


def _signals(
    observations: GnssObservations | None,
    sequence: Sequence,
    trajectory: Trajectory,
    updates: Iterable[Update],
) -> Signals | None:
    """Return what became of the satellite signals, seen from the antenna of the solution."""
    if observations is None or not len(observations):
        return None
    used = [(u.time, u.satellites) for u in updates if u.accepted and u.satellites]
    lever_b, imu = sequence.calibration.lever_antenna_b, sequence.inertial
    rate_e = (trajectory.C_eb @ at_times(imu.time, imu.gyro_b, trajectory.time)[:, :, None])[
        :, :, 0
    ]
    lever_e = trajectory.C_eb @ lever_b
    vel_e = trajectory.vel_e + np.cross(rate_e, lever_e)
    place = at_times(trajectory.time, trajectory.pos_e + lever_e, observations.time)
    return signal_log(
        observations, used, place, at_times(trajectory.time, vel_e, observations.time)
    )


def at_times(t: FloatArray, values: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return vectors interpolated, shape (n, 3); NaN outside of `t`."""
    columns = [np.interp(wanted, t, v, left=np.nan, right=np.nan) for v in values.T]
    return np.stack(columns, axis=-1)


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
        C_ne = np.ascontiguousarray(np.swapaxes(C_en_of(pos_e[piece]), 1, 2))
        upper = np.ascontiguousarray(rows[piece, layout.ROW_COV : layout.ROW_COV + 18])
        ned_covariances(upper, C_ne, np.ascontiguousarray(C_eb[piece]), blocks, start)

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


def _silent(fraction: float, what: str) -> None:
    pass


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
