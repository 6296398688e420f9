"""What thresholds do to position: drift over simulated spells of weak GNSS.

The drive is navigated once with everything GNSS has. Then, in every spell, the filter starts
again from that solution (its covariance included, correlations between its parts not) and gets
nothing but DDIA-VE from a few satellites drawn at random, screened with the thresholds on trial.
What counts is how far the position error has moved, horizontally, at the end of the spell.

Thresholds act only through which rows pass, so runs are shared by all combinations that let the
same rows through.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...datasets.observations import GnssObservations
from ...datasets.sequence import Sequence
from ...filters.earth import C_en_of
from ...filters.ekf import ErrorStateFilter
from ...filters.error_model import ACCEL_BIAS, GYRO_BIAS, ErrorModel
from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ...filters.sensors import imu_preset
from ...filters.strapdown import InertialStream, NavState
from ...velocity.ddia import SINGULAR_K, ddia_velocity
from ...velocity.range_rate import DopplerNoise, DopplerRows, doppler_rows, with_elevation
from ...velocity.screening import Screening, screen, usable_rows
from ...velocity.study.pairs import all_pairs
from ...velocity.vehicle_motion import ForwardMotion
from ..config import Config
from ..engine.ddia_update import filter_motion, measurement
from ..evaluation.interpolation import interpolate
from ..pipeline import navigate
from ..solution import Solution, Trajectory


@dataclass(frozen=True)
class Spells:
    """Simulated weak GNSS.

    Parameters
    ----------
    duration : float
        Of each [s].
    every : float
        From the beginning of one to the beginning of the next [s].
    settle : float
        Before the first one [s].
    satellites : int
        Left in each; which ones is drawn.
    seed : int
    """

    duration: float = 30.0
    every: float = 60.0
    settle: float = 20.0
    satellites: int = 3
    seed: int = 0


@dataclass(frozen=True, eq=False)
class SpellDrift:
    """Drift in one spell for every pair of thresholds.

    Attributes
    ----------
    start : float
        [s].
    drift : ndarray, shape (s, m)
        Horizontal [m].
    updates : ndarray of int, shape (s, m)
        Epochs with a velocity.
    epochs : int
        Epochs of the spell.
    """

    start: float
    drift: FloatArray
    updates: NDArray[np.int64]
    epochs: int


@dataclass(frozen=True, eq=False)
class _Epoch:
    time: float
    rows: DopplerRows
    cn0: FloatArray
    elevation: FloatArray


def spell_drifts(
    sequence: Sequence,
    config: Config,
    snr_grid: FloatArray,
    k_grid: FloatArray,
    *,
    screening: Screening | None = None,
    spells: Spells | None = None,
    noise: DopplerNoise | None = None,
) -> list[SpellDrift]:
    """Return the drift of every spell of a sequence.

    Parameters
    ----------
    sequence : Sequence
        With IMU and observations; drift is judged by its reference, or by the undisturbed
        solution if there is none.
    config : Config
        Of the undisturbed run.
    snr_grid, k_grid : ndarray
        Ascending thresholds.
    screening : Screening, optional
        What besides the two thresholds is to be in force.
    spells : Spells, optional
    noise : DopplerNoise, optional

    Raises
    ------
    DataError
        If the drive is too short for one spell.
    """
    spells, screening = spells or Spells(), screening or Screening()
    observations = sequence.observations
    if observations is None:
        raise DataError(f"{sequence.name}: no GNSS observations: no Doppler to screen")
    solution = navigate(sequence, config)
    trajectory = solution.trajectory
    first, last = trajectory.time[0] + spells.settle, trajectory.time[-1] - spells.duration
    starts = np.arange(first, last, spells.every)
    if not starts.size:
        raise DataError(
            f"{sequence.name}: too short for a weak-GNSS spell: needs "
            f"{spells.settle + spells.duration:g} s after alignment, "
            f"found {trajectory.time[-1] - trajectory.time[0]:.0f} s",
            remedy="take --objective velocity, or a longer drive",
        )
    rng = np.random.default_rng(spells.seed)
    out = []
    for start in starts:
        end = start + spells.duration
        epochs = _epochs(sequence, observations, trajectory, start, end, spells, noise, rng)
        out.append(_spell(sequence, config, solution, start, end, epochs, snr_grid, k_grid,
                          screening))  # fmt: skip
    return out


def _epochs(
    sequence: Sequence,
    observations: GnssObservations,
    trajectory: Trajectory,
    start: float,
    end: float,
    spells: Spells,
    noise: DopplerNoise | None,
    rng: np.random.Generator,
) -> list[_Epoch]:
    """Return the spell's Doppler of the satellites drawn, in order."""
    inside = (observations.time > start) & (observations.time < end) & observations.has_range_rate
    part = observations.take(np.flatnonzero(inside))
    if not len(part):
        return []
    at = interpolate(trajectory, part.time)
    antenna_e = at.pos_e + at.C_eb @ sequence.calibration.lever_antenna_b
    part = with_elevation(part, antenna_e)
    rows = doppler_rows(part, antenna_e, noise)
    _, first = np.unique([f"{t:.4f}{s}" for t, s in zip(part.time, part.sat, strict=True)], True)
    single = np.zeros(len(part), dtype=bool)
    single[first] = True  # one signal per satellite
    satellites = np.unique(part.sat)
    order = dict(zip(satellites, rng.permutation(satellites.size), strict=True))
    out = []
    for time, epoch in part.epochs():
        index = np.arange(epoch.start, epoch.stop)[single[epoch]]
        index = np.sort(sorted(index, key=lambda i: order[part.sat[i]])[: spells.satellites])
        out.append(_Epoch(time, rows.take(index), part.cn0[index], part.elevation[index]))
    return out


def _patterns(
    epochs: list[_Epoch],
    sequence: Sequence,
    trajectory: Trajectory,
    snr_grid: FloatArray,
    k_grid: FloatArray,
    screening: Screening,
) -> NDArray[np.bool_]:
    """Return which of the spell's rows each pair of thresholds lets through, shape (s, m, n)."""
    rows = _joined([e.rows for e in epochs])
    number = np.repeat(np.arange(len(epochs)), [len(e.rows) for e in epochs])
    at = interpolate(trajectory, np.array([e.time for e in epochs]))
    u_e = at.C_eb @ sequence.calibration.C_bv[:, 0]
    pairs = all_pairs(
        rows, number, ForwardMotion(u_e, np.zeros_like(u_e), np.zeros((3, 3))),
        np.concatenate([e.cn0 for e in epochs]), np.concatenate([e.elevation for e in epochs]),
    )  # fmt: skip
    out = np.zeros((snr_grid.size, k_grid.size, len(rows)), dtype=bool)
    for i, snr in enumerate(snr_grid):
        for j, k in enumerate(k_grid):
            trial = Screening(
                float(snr), screening.cn0_of, float(k), screening.k_of,
                screening.min_elevation_deg,
            )  # fmt: skip
            out[i, j] = usable_rows(pairs, screen(pairs, trial), len(rows))
    return out


def _joined(parts: list[DopplerRows]) -> DopplerRows:
    return DopplerRows(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("row", "sat", "e_e", "z", "sigma")
        )
    )


def _spell(
    sequence: Sequence,
    config: Config,
    solution: Solution,
    start: float,
    end: float,
    epochs: list[_Epoch],
    snr_grid: FloatArray,
    k_grid: FloatArray,
    screening: Screening,
) -> SpellDrift:
    """Run the filter once for every distinct set of rows."""
    shape = (snr_grid.size, k_grid.size)
    drift, updates = np.zeros(shape), np.zeros(shape, dtype=np.int64)
    if epochs:
        patterns = _patterns(epochs, sequence, solution.trajectory, snr_grid, k_grid, screening)
    else:
        patterns = np.zeros((*shape, 0), dtype=bool)
    distinct, which = np.unique(patterns.reshape(-1, patterns.shape[2]), axis=0,
                                return_inverse=True)  # fmt: skip
    for number, usable in enumerate(distinct):
        here = (which.reshape(shape)) == number
        error, count = _drift(sequence, config, solution, start, end, epochs, usable)
        drift[here], updates[here] = error, count
    return SpellDrift(float(start), drift, updates, len(epochs))


def _drift(
    sequence: Sequence,
    config: Config,
    solution: Solution,
    start: float,
    end: float,
    epochs: list[_Epoch],
    usable: NDArray[np.bool_],
) -> tuple[float, int]:
    """Return the horizontal drift over the spell [m] and the number of velocities used."""
    kalman = _restarted(sequence, config, solution.trajectory, start)
    begin, count = 0, 0
    before = _position_error(sequence, solution.trajectory, start, kalman)
    for epoch in epochs:
        keep = usable[begin : begin + len(epoch.rows)]
        begin += len(epoch.rows)
        if keep.sum() < 2 or epoch.time <= kalman.time:
            continue
        kalman.propagate(epoch.time)
        aided = ddia_velocity(
            epoch.rows.take(keep), filter_motion(kalman, sequence.calibration), epoch.time,
            min_k=SINGULAR_K,
        )  # fmt: skip
        if aided.ok:
            update = measurement(kalman, aided, sequence.calibration)
            count += kalman.update(update, config.filter.gate_probability).accepted
    kalman.propagate(end)
    after = _position_error(sequence, solution.trajectory, end, kalman)
    return float(np.hypot(*(after - before)[:2])), count


def _restarted(
    sequence: Sequence, config: Config, trajectory: Trajectory, start: float
) -> ErrorStateFilter:
    """Return a filter that stands where the undisturbed solution stood."""
    imu = sequence.inertial
    at = interpolate(trajectory, np.array([start]))
    C_en = C_en_of(at.pos_e[0])
    C_eb = at.C_eb[0]
    spec = imu_preset(config.filter.imu) if config.filter.imu else sequence.calibration.imu
    model = ErrorModel(spec, config.filter.states, config.filter.bias_model)
    C_bn = C_eb.T @ C_en
    P = model.initial_covariance(
        C_en @ at.cov_pos_n[0] @ C_en.T,
        C_en @ at.cov_vel_n[0] @ C_en.T,
        C_bn @ at.cov_att_n[0] @ C_bn.T,
    )
    P[GYRO_BIAS, GYRO_BIAS] = np.diag(at.std_gyro_bias[0] ** 2)
    P[ACCEL_BIAS, ACCEL_BIAS] = np.diag(at.std_accel_bias[0] ** 2)
    kalman = ErrorStateFilter(
        model,
        InertialStream(imu.time, imu.gyro_b, imu.accel_b),
        NavState(start, at.pos_e[0], at.vel_e[0], C_eb),
        P,
        output_interval=1e9,
    )
    kalman.bias[0:3], kalman.bias[3:6] = at.gyro_bias[0], at.accel_bias[0]
    return kalman


def _position_error(
    sequence: Sequence, trajectory: Trajectory, time: float, kalman: ErrorStateFilter
) -> FloatArray:
    """Return the position error of the filter, north-east-down [m]."""
    reference = sequence.reference
    C_en = C_en_of(kalman.pos_e)
    if reference is None or not reference.time[0] <= time <= reference.time[-1]:
        at = interpolate(trajectory, np.array([min(time, trajectory.time[-1])]))
        return C_en.T @ (kalman.pos_e - at.pos_e[0])
    k = int(np.clip(np.searchsorted(reference.time, time), 1, reference.time.size - 1))
    step = reference.time[k] - reference.time[k - 1]
    share = (time - reference.time[k - 1]) / step
    truth = (1.0 - share) * reference.pos_e[k - 1] + share * reference.pos_e[k]
    return C_en.T @ (kalman.pos_e + kalman.C_eb @ reference.lever_b - truth)
