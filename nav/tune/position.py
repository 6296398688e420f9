"""What thresholds do to position: drift over simulated spells of weak GNSS.

The drive is navigated once with everything GNSS has. Then, in every spell, the filter starts
again from that solution (its covariance included, correlations between its parts not) and goes
through the loop of every run, which offers it nothing but DDIA-VE from the few satellites that the
spell leaves, screened with the thresholds on trial. What counts is how far the position error has
moved, horizontally, at the end of the spell.

Thresholds act only through which rows pass, so runs are shared by all combinations that let the
same rows through.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence as Listing
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...datasets.observations import GnssObservations
from ...datasets.sequence import Sequence
from ...filters.earth import C_en_of
from ...filters.ekf import ErrorStateFilter
from ...filters.error_model import ACCEL_BIAS, GYRO_BIAS
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ...filters.strapdown import InertialStream, NavState
from ...velocity.ddia import SINGULAR_K
from ...velocity.range_rate import DopplerRows, doppler_rows
from ...velocity.screening import Screening, screen, usable_rows
from ...velocity.study.pairs import all_pairs
from ...velocity.vehicle_motion import ForwardMotion
from ..config import Config, VehicleConfig
from ..engine import blind
from ..engine.events import GnssEvent
from ..engine.gnss import gnss_timeline
from ..engine.loop import FilterLoop
from ..engine.model import error_model
from ..engine.vehicle import VehicleConstraints
from ..evaluation.accuracy import evaluate
from ..evaluation.interpolation import interpolate
from ..pipeline import navigate, trajectory_from_rows
from ..solution import Solution, Trajectory
from ..spells.degradation import degrade
from ..spells.drift import as_reference, spell_figures
from ..spells.outages import Outages, Spell, parse_outages
from .score import Score

#: Three satellites for 30 s in every minute.
OUTAGES = parse_outages("30/60:3")
#: From alignment to the first spell [s].
SETTLE = 20.0


@dataclass(frozen=True, eq=False)
class _Drive:
    """What all runs over one drive share."""

    sequence: Sequence
    config: Config
    solution: Solution
    blind: list[blind.Spell]


@dataclass(frozen=True, eq=False)
class _Epoch:
    """What GNSS offers in one epoch, and how the undisturbed solution sees it."""

    event: GnssEvent
    observations: GnssObservations
    rows: DopplerRows
    u_e: FloatArray  # direction the vehicle points


def drift_scores(
    sequence: Sequence,
    config: Config,
    snr_grid: FloatArray,
    k_grid: FloatArray,
    *,
    screening: Screening | None = None,
    outages: Outages = OUTAGES,
    seed: int = 0,
) -> list[Score]:
    """Return for every spell of a sequence its drift [m] and the epochs that gave a velocity.

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
    outages : Outages
        The first spell begins `SETTLE` after alignment.
    seed : int
        Of the satellites that are drawn.

    Raises
    ------
    DataError
        If the drive is too short for one spell.
    """
    if sequence.observations is None:
        raise DataError(f"{sequence.name}: no GNSS observations: no Doppler to screen")
    solution = navigate(sequence, config)
    if sequence.reference is None:
        judge = as_reference(solution.trajectory, "the solution without spells")
        sequence = replace(sequence, reference=judge)
    spells = _spells(sequence, solution.trajectory, outages)
    config = _nothing_but_ddia(config)
    degraded = degrade(
        sequence, spells, outages, seed=seed, min_cn0_dbhz=config.gnss.min_cn0_dbhz,
        elevation_mask_deg=config.gnss.elevation_mask_deg,
    )  # fmt: skip
    events = [e for e in gnss_timeline(degraded, config.gnss).events if e.kind != "position"]
    imu = sequence.inertial
    blinded = blind.blind_spells(imu, blind.blind_axes(imu, events))
    drive = _Drive(sequence, config, solution, blinded)
    return [
        _score(
            drive, spell, [e for e in events if spell.start < e.time < spell.end],
            snr_grid, k_grid, screening or Screening(),
        )
        for spell in spells
    ]  # fmt: skip


def _spells(sequence: Sequence, trajectory: Trajectory, outages: Outages) -> list[Spell]:
    """Return the spells that the solution covers and the reference can judge."""
    (first, _), last = sequence.span, float(trajectory.time[-1])
    settled = float(trajectory.time[0]) + SETTLE
    shift = settled + outages.duration - first
    try:
        spells = outages.spells(first, last, settled - 1e-3, shift)
    except ConfigError:
        spells = []
    assert sequence.reference is not None
    judged = sequence.reference.time
    spells = [s for s in spells if ((judged > s.start) & (judged < s.end)).sum() > 1]
    if not spells:
        raise DataError(
            f"{sequence.name}: too short for a weak-GNSS spell: needs "
            f"{SETTLE + outages.duration:g} s after alignment, with a reference, "
            f"found {last - trajectory.time[0]:.0f} s",
            remedy="take --objective velocity, or a longer drive",
        )
    return spells


def _nothing_but_ddia(config: Config) -> Config:
    """Return the configuration in which only what is on trial screens the Doppler."""
    return replace(
        config,
        gnss=replace(
            config.gnss, position="auto", velocity="doppler", below_four="ddia",
            min_cn0_dbhz=0.0, ddia_min_cn0_dbhz=0.0, ddia_min_k=SINGULAR_K,
        ),
        vehicle=VehicleConfig(nhc="off", odometer="off", zupt=False, zaru=False),
    )  # fmt: skip


def _score(
    drive: _Drive,
    spell: Spell,
    events: list[GnssEvent],
    snr_grid: FloatArray,
    k_grid: FloatArray,
    screening: Screening,
) -> Score:
    """Run the filter once for every distinct set of rows."""
    shape = (snr_grid.size, k_grid.size)
    drift, updates = np.zeros(shape), np.zeros(shape)
    epochs = _epochs(drive, events)
    patterns = np.zeros((*shape, 0), dtype=bool)
    if epochs:
        patterns = _patterns(epochs, snr_grid, k_grid, screening)
    distinct, which = np.unique(
        patterns.reshape(-1, patterns.shape[2]), axis=0, return_inverse=True
    )
    for number, usable in enumerate(distinct):
        here = which.reshape(shape) == number
        drift[here], updates[here] = _run(drive, spell, _only(epochs, usable))
    return Score(drift**2, np.ones(shape), updates, len(events))


def _epochs(drive: _Drive, events: Listing[GnssEvent]) -> list[_Epoch]:
    at = interpolate(drive.solution.trajectory, np.array([e.time for e in events]))
    antenna_e = at.pos_e + at.C_eb @ drive.sequence.calibration.lever_antenna_b
    u_e = at.C_eb @ drive.sequence.calibration.C_bv[:, 0]
    return [
        _Epoch(event, event.observations, doppler_rows(event.observations, pos_e), ahead_e)
        for event, pos_e, ahead_e in zip(events, antenna_e, u_e, strict=True)
        if event.observations is not None
    ]


def _patterns(
    epochs: list[_Epoch],
    snr_grid: FloatArray,
    k_grid: FloatArray,
    screening: Screening,
) -> NDArray[np.bool_]:
    """Return which of the spell's rows each pair of thresholds lets through, shape (s, m, n)."""
    rows = _joined([e.rows for e in epochs])
    u_e = np.array([e.u_e for e in epochs])
    pairs = all_pairs(
        rows, np.repeat(np.arange(len(epochs)), [len(e.rows) for e in epochs]),
        ForwardMotion(u_e, np.zeros_like(u_e), np.zeros((3, 3))),
        np.concatenate([e.observations.cn0[e.rows.row] for e in epochs]),
        np.concatenate([e.observations.elevation[e.rows.row] for e in epochs]),
    )  # fmt: skip
    out = np.zeros((snr_grid.size, k_grid.size, len(rows)), dtype=bool)
    for i, snr in enumerate(snr_grid):
        for j, k in enumerate(k_grid):
            trial = replace(screening, min_cn0_dbhz=float(snr), min_k=float(k))
            out[i, j] = usable_rows(pairs, screen(pairs, trial), len(rows))
    return out


def _joined(parts: list[DopplerRows]) -> DopplerRows:
    return DopplerRows(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("row", "sat", "e_e", "z", "sigma")
        )
    )


def _only(epochs: list[_Epoch], usable: NDArray[np.bool_]) -> list[GnssEvent]:
    """Return the events with the usable rows alone; those with less than two are left out."""
    out, begin = [], 0
    for epoch in epochs:
        keep = usable[begin : begin + len(epoch.rows)]
        begin += len(epoch.rows)
        if keep.sum() >= 2:
            names = tuple(map(str, epoch.rows.sat[keep]))
            left = epoch.observations.take(epoch.rows.row[keep])
            out.append(replace(epoch.event, satellites=names, observations=left))
    return out


def _run(drive: _Drive, spell: Spell, events: Listing[GnssEvent]) -> tuple[float, int]:
    """Return the horizontal drift at the spell's end [m] and the number of velocities used."""
    calibration, config = drive.sequence.calibration, drive.config
    kalman = _restarted(drive, spell.start)
    loop = FilterLoop(
        kalman, calibration, VehicleConstraints(calibration, config.vehicle), config,
        deque(drive.blind),
    )  # fmt: skip
    for event in events:
        loop.offer(event)
    loop.advance(spell.end)
    solution = replace(
        drive.solution, trajectory=trajectory_from_rows(kalman.rows), updates=tuple(loop.updates)
    )
    figures = spell_figures(evaluate(solution, drive.sequence), spell)
    assert figures is not None  # spells without a reference have been left out
    return figures.final_drift, sum(update.accepted for update in loop.updates)


def _restarted(drive: _Drive, start: float) -> ErrorStateFilter:
    """Return a filter that stands where the undisturbed solution stood."""
    imu, config = drive.sequence.inertial, drive.config
    at = interpolate(drive.solution.trajectory, np.array([start]))
    C_en, C_eb = C_en_of(at.pos_e[0]), at.C_eb[0]
    model = error_model(drive.sequence.calibration, config, doppler=False, shared=False)
    C_bn = C_eb.T @ C_en
    P = model.initial_covariance(
        C_en @ at.cov_pos_n[0] @ C_en.T,
        C_en @ at.cov_vel_n[0] @ C_en.T,
        C_bn @ at.cov_att_n[0] @ C_bn.T,
    )
    P[GYRO_BIAS, GYRO_BIAS] = np.diag(at.std_gyro_bias[0] ** 2)
    P[ACCEL_BIAS, ACCEL_BIAS] = np.diag(at.std_accel_bias[0] ** 2)
    rate = config.filter.output_rate_hz
    return ErrorStateFilter(
        model,
        InertialStream(imu.time, imu.gyro_b, imu.accel_b),
        NavState(start, at.pos_e[0], at.vel_e[0], C_eb),
        P,
        output_interval=1.0 / rate if rate > 0 else 0.0,
        gyro_bias=at.gyro_bias[0],
        accel_bias=at.accel_bias[0],
    )
