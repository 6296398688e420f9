"""Results of other programs as methods: the same reference, the same epochs, their own σ.

A solution is carried to the IMU with its own attitude; where it has none, with the reference's; and
where that has none either, level and along the course. What a file does not state is not judged:
no heading error without attitude, no NEES without σ.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from collections.abc import Sequence as Listing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...datasets.sequence import Sequence
from ...datasets.series import ImuData, Reference
from ...datasets.solutions.reading import read_solution
from ...datasets.solutions.solution import POINTS, ForeignSolution
from ...filters.earth import C_en_of
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray, matrix_from_rpy
from ..evaluation.accuracy import Evaluation, against, attitude_vector_from_rpy, errors_of
from ..evaluation.interpolation import covered
from ..solution import AlignmentReport, Epochs, Solution, Trajectory
from .runs import Comparison, Run, reduced, thin_track

#: Below this speed the course is no heading; the last one is held [m/s].
_MIN_SPEED = 2.0


@dataclass(frozen=True, eq=False)
class Judge:
    """What solutions are held against.

    Parameters
    ----------
    name : str
        Of the recording.
    reference : Reference
    C_bv : ndarray, shape (3, 3)
        Mounting.
    lever_b : ndarray, shape (3,)
        IMU to antenna [m].
    imu : ImuData, optional
    """

    name: str
    reference: Reference
    C_bv: FloatArray
    lever_b: FloatArray
    imu: ImuData | None = None

    @classmethod
    def of(cls, sequence: Sequence) -> Judge:
        """Return the judge of a recording with a reference."""
        assert sequence.reference is not None
        calibration = sequence.calibration
        return cls(
            sequence.name, sequence.reference, calibration.C_bv, calibration.lever_antenna_b,
            sequence.imu,
        )  # fmt: skip

    @classmethod
    def from_file(cls, path: Path, week: int | None = None) -> Judge:
        """Return the judge that is a truth in a file of its own, of the IMU."""
        truth = read_solution(path, week=week)
        reference = Reference(
            truth.time, truth.pos_e, truth.vel_e, truth.rpy, np.zeros(3), truth.point, truth.source
        )
        name = path.name.removesuffix(".gz").rsplit(".", 1)[0]
        return cls(name, reference, np.eye(3), np.zeros(3))


@dataclass(frozen=True, eq=False)
class Other:
    """A result of another program under the name of a method."""

    name: str
    solution: ForeignSolution

    @property
    def sentence(self) -> str:
        """What it is."""
        s = self.solution
        stated = [
            what
            for what, value in (
                ("velocity", s.vel_e), ("attitude", s.rpy), ("σ of position", s.cov_pos_n),
                ("σ of velocity", s.cov_vel_n), ("σ of attitude", s.sigma_rpy),
            )
            if np.isfinite(value).any()
        ]  # fmt: skip
        states = ", ".join(stated) or "positions alone"
        where = "IMU" if s.point == "imu" else "antenna"
        return f"{s.source}, of the {where}, states {states}; not degraded in spells."


def read_others(texts: Iterable[str], week: int | None = None) -> list[Other]:
    """Return the results named as ``NAME=FILE``, or ``NAME=FILE@antenna`` (or ``@imu``).

    Raises
    ------
    ConfigError
        Not so written, or a name twice.
    DataError
        What the reader says.
    """
    out: list[Other] = []
    for text in texts:
        name, equals, rest = text.partition("=")
        if not equals or not name.strip() or not rest.strip():
            raise ConfigError(f"--result {text}: expected NAME=FILE, for example rtklib=rover.pos")
        file, at, point = rest.rpartition("@")
        if not at or (point not in POINTS and Path(rest).exists()):
            file, point = rest, ""
        if point and point not in POINTS:
            raise ConfigError(f"--result {text}: after @ expected imu or antenna, found {point}")
        if name in {other.name for other in out}:
            raise ConfigError(f"--result {text}: '{name}' is named twice")
        solution = read_solution(file, week=week)
        if point:
            solution = dataclasses.replace(solution, point=point)
        out.append(Other(name.strip(), solution))
    return out


def judged(other: Other, judge: Judge, settle: float = 0.0) -> Run:
    """Return the figures of another program's result.

    Parameters
    ----------
    other : Other
    judge : Judge
    settle : float
        What lies so long after its first epoch is not judged [s].

    Raises
    ------
    DataError
        If it covers no epoch of the reference.
    """
    found, evaluation = held_against(other.solution, judge, settle)
    return reduced(
        other.name, judge.name, "", found, evaluation, (),
        availability=evaluation.time.size / (evaluation.time.size + evaluation.left_out),
    )  # fmt: skip


def side_by_side(others: Listing[Other], judge: Judge, settle: float = 0.0) -> Comparison:
    """Return the comparison of others' results alone.

    Raises
    ------
    DataError
        If one of them covers no epoch of the reference.
    """
    runs = tuple(judged(other, judge, settle) for other in others)
    return Comparison(
        runs, {judge.name: thin_track(judge.reference.pos_e)}, "",
        (f"judged by {judge.reference.source}", *notes_of(others, settle)),
        {other.name: other.sentence for other in others},
    )  # fmt: skip


def notes_of(others: Iterable[Other], settle: float) -> list[str]:
    """Return what there is to say of how others' results were read and judged."""
    notes = [f"{o.name}: {note}" for o in others for note in o.solution.notes]
    if settle > 0.0:
        notes.append(f"results of others are judged from {settle:g} s after their beginning on")
    return notes


def held_against(
    solution: ForeignSolution, judge: Judge, settle: float = 0.0
) -> tuple[Solution, Evaluation]:
    """Return a solution as certnav has its own, and its errors; see `judged`."""
    begin = solution.time[0] + settle
    reference = judge.reference
    keep = reference.time >= begin
    if keep.sum() < 2:
        raise DataError(
            f"{solution.source}: nothing is left {settle:g} s after its beginning that "
            f"{judge.name} could judge",
            remedy="check the reference's GPS week, time scale and leap seconds",
        )
    reference = dataclasses.replace(
        reference, time=reference.time[keep], pos_e=reference.pos_e[keep],
        vel_e=reference.vel_e[keep], rpy=reference.rpy[keep],
    )  # fmt: skip
    made = Solution(
        judge.name, _trajectory(solution, judge), (),
        AlignmentReport("given", solution.source, float(solution.time[0]), 0.0, np.nan),
        Epochs(np.zeros(0), np.zeros(0, dtype=int), np.zeros(0, dtype=int)),
    )  # fmt: skip
    evaluation = against(made, reference, judge.C_bv, judge.imu)
    return made, _only_what_is_stated(solution, evaluation)


def _trajectory(solution: ForeignSolution, judge: Judge) -> Trajectory:
    """Return the trajectory of the IMU."""
    time, n = solution.time, solution.time.size
    vel_e = np.where(
        np.isfinite(solution.vel_e), solution.vel_e, np.gradient(solution.pos_e, time, axis=0)
    )  # for what lies between epochs; what is not stated is not judged
    C_en = C_en_of(solution.pos_e)
    vel_n = np.einsum("nji,nj->ni", C_en, vel_e)
    rpy = np.where(np.isfinite(solution.rpy), solution.rpy, _assumed(time, vel_n, judge))
    C_eb = C_en @ matrix_from_rpy(rpy)
    lever_b = judge.lever_b if solution.point == "antenna" else np.zeros(3)
    turn = attitude_vector_from_rpy(rpy)
    nothing = np.zeros((n, 3))
    return Trajectory(
        time=time, pos_e=solution.pos_e - C_eb @ lever_b, vel_e=vel_e, C_eb=C_eb,
        gyro_bias=nothing, accel_bias=nothing, cov_pos_n=solution.cov_pos_n,
        cov_vel_n=solution.cov_vel_n,
        cov_att_n=turn @ (solution.sigma_rpy[:, :, None] ** 2 * np.eye(3)) @ turn.swapaxes(1, 2),
        std_gyro_bias=nothing, std_accel_bias=nothing,
    )  # fmt: skip


def _assumed(time: FloatArray, vel_n: FloatArray, judge: Judge) -> FloatArray:
    """Return the attitude to carry a lever with: the reference's, else level along the course."""
    reference = judge.reference
    moving = np.hypot(vel_n[:, 0], vel_n[:, 1]) >= _MIN_SPEED
    last = np.maximum.accumulate(np.where(moving, np.arange(moving.size), -1))
    course = np.arctan2(vel_n[:, 1], vel_n[:, 0])
    out = np.zeros((time.size, 3))
    out[:, 2] = np.where(last >= 0, course[np.maximum(last, 0)], 0.0)
    known = np.isfinite(reference.rpy).all(axis=1)
    if known.any():
        at = reference.time[known]
        nearest = np.clip(np.searchsorted(at, time), 0, at.size - 1)
        inside = covered(at, time, 1.0)
        out[inside] = reference.rpy[known][nearest][inside]
    return out


def _only_what_is_stated(solution: ForeignSolution, evaluation: Evaluation) -> Evaluation:
    """Return the errors without those of what was filled in."""
    vel, rpy = evaluation.error_vel_n, evaluation.error_rpy
    aligned = evaluation.error_rpy_aligned
    misalignment = evaluation.misalignment_rpy
    if not np.isfinite(solution.vel_e).all(axis=1).all():
        vel = np.full_like(vel, np.nan)
    if not np.isfinite(solution.rpy[:, 2]).all():
        rpy, aligned = np.full_like(rpy, np.nan), np.full_like(aligned, np.nan)
        misalignment = np.full(3, np.nan)
    return dataclasses.replace(
        evaluation,
        metrics=errors_of(evaluation.error_pos_n, vel, rpy, aligned),
        error_vel_n=vel, error_rpy=rpy, error_rpy_aligned=aligned, misalignment_rpy=misalignment,
    )  # fmt: skip
