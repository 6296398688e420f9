"""Candidates judged by the filter: whole runs, on the recording as it is and with GNSS made weak.

Both halves of the judgement are against the reference, at the epochs the default has a solution
for: the horizontal error block by block of the recording as it is, and the drift of every spell
in which a few satellites are left. Weights are never judged on what they were fitted to: in the
first half of a recording they are those fitted to the second, and the other way round; where there
are three recordings or more, those fitted to the others.

Every run is what `certnav run` would do, to the last digit; what is the same for several of them is
computed once (`nav.engine.prepared`).
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...datasets.sequence import Sequence
from ...datasets.series import Reference
from ...filters.errors import AlignmentError, ConfigError, DataError, NavError
from ...filters.rotation import FloatArray
from ...velocity.doppler_noise import NoiseFit, fit_doppler_noise, reference_residuals
from ...velocity.range_rate import DopplerNoise
from ...velocity.study.samples import reference_samples
from ..config import Config
from ..engine.events import doppler_noise
from ..engine.prepared import Prepared as Common
from ..evaluation.accuracy import Evaluation, evaluate
from ..pipeline import navigate
from ..solution import Solution
from ..spells.degradation import degrade
from ..spells.drift import as_reference, spell_figures
from ..spells.outages import Outages, Spell
from .candidates import Weights

#: Errors of positions last for seconds to a minute: blocks are as long, or one twelfth of the
#: recording, whichever is longer; a recording of a minute has three.
_BLOCK, _BLOCKS = 15.0, 12
#: After the default's alignment, before anything is judged [s]: a filter needs to settle.
SETTLE = 10.0
#: Parts of a recording that take turns in being left out.
FOLDS = 5


@dataclass(frozen=True, eq=False)
class Prepared:
    """What all candidates on one recording share.

    Parameters
    ----------
    name : str
    time : ndarray, shape (n,)
        Judged epochs [s].
    block : ndarray of int, shape (n,)
        Each epoch's block.
    spells : tuple of Spell
        Empty where none fits, or the recording has no observations.
    outages : Outages
        Which satellites they leave.
    judge : Reference or None
        Takes the place of a reference that is missing: the default's own smoothed solution.
    fits : dict
        By (spread, which): Doppler noise fitted to 'all', to the 'first' and the 'second' half.
    shown : tuple of float
        σ of range rates that the recording shows by itself at 35 and 45 dB-Hz [m/s]; empty where
        too few.
    declared : DopplerNoise
        As the user's settings have it.
    least_cn0, least_elevation : float
        Satellites weaker or lower no candidate uses [dB-Hz], [deg].
    notes : tuple of str
    key : str
        What tells it from others.
    """

    name: str
    time: FloatArray
    block: NDArray[np.int64]
    spells: tuple[Spell, ...]
    outages: Outages
    judge: Reference | None
    fits: Mapping[tuple[str, str], NoiseFit]
    shown: tuple[float, ...]
    declared: DopplerNoise
    least_cn0: float
    least_elevation: float
    notes: tuple[str, ...] = ()
    key: str = field(default_factory=lambda: uuid.uuid4().hex)

    @property
    def middle(self) -> float:
        """Where the first half ends [s]."""
        return 0.5 * float(self.time[0] + self.time[-1])


@dataclass(frozen=True, eq=False)
class Trial:
    """One candidate on one recording.

    Parameters
    ----------
    square : dict of str to ndarray
        By part: mean squared error of every block, squared drift of every spell [m²].
    held : float
        Share of the epochs within spells that gave the filter something; NaN without spells.
    reason : str
        Why there is no judgement: the run failed, or has no solution where the default has one.
    """

    square: dict[str, FloatArray] = field(default_factory=dict)
    held: float = float("nan")
    reason: str = ""


class _Last(threading.local):
    """What the runs over the last recording of this thread have in common, as it is and weak."""

    key: str = ""
    plain: Common | None = None
    weak: Common | None = None


_LAST = _Last()


def forget() -> None:
    """Let go of what runs over the last recording had in common."""
    _LAST.key, _LAST.plain, _LAST.weak = "", None, None


def prepare(
    sequence: Sequence, config: Config, outages: Outages, least_cn0: float, least_elevation: float
) -> Prepared:
    """Navigate with the user's own settings, fix what is judged, and fit the Doppler noise.

    Raises
    ------
    DataError
        If the recording has no Doppler, or too little to divide.
    """
    observations = sequence.observations
    if observations is None or not observations.has_range_rate.any():
        raise DataError(
            f"{sequence.name}: no Doppler: nothing of what is tuned would be used",
            remedy="its settings are the defaults, or see certnav run's options for positions",
        )
    common, config = Common(sequence, own_noise=True), _unprotected(config)
    try:
        solution = navigate(sequence, config, prepared=common)
    except AlignmentError as error:  # of several recordings, this one
        raise DataError(f"{sequence.name}: cannot be navigated: {error}") from None
    notes, judge = [], None
    if sequence.reference is None:
        smooth = replace(config, filter=replace(config.filter, smooth=True))
        made = navigate(sequence, smooth).trajectory
        judge = as_reference(made, "the default's own smoothed solution: NOT independent")
        sequence = replace(sequence, reference=judge)
        notes.append(
            f"{sequence.name}: no reference; judged by the default's own smoothed solution, which "
            "favours the default, and in spells of weak GNSS only"
        )
    time = evaluate(solution, sequence).time
    if time.size:  # which settings begin a second earlier is not the question
        time = time[time >= time[0] + min(SETTLE, (time[-1] - time[0]) / 6.0)]
    if time.size < 4:
        raise DataError(f"{sequence.name}: {time.size} epochs with a reference are too few to tune")
    duration = float(time[-1] - time[0])
    count = max(int(min(duration / _BLOCK, _BLOCKS)), 1)
    block = np.minimum((count * (time - time[0]) / duration).astype(np.int64), count - 1)
    spells = _spells(sequence, solution, outages, time)
    if not spells:
        notes.append(f"{sequence.name}: too short for a spell of weak GNSS ({outages.text})")
    fits, more = _fits(sequence, 0.5 * float(time[0] + time[-1]))
    own = replace(config, gnss=replace(config.gnss, velocity_noise="fitted", doppler_known_mps=()))
    velocities, _, _ = common.noise(own)
    prepared = Prepared(
        sequence.name, time, block, tuple(spells), outages, judge, fits,
        velocities.shown if velocities else (), doppler_noise(config.gnss), least_cn0,
        least_elevation, (*notes, *more),
    )  # fmt: skip
    forget()
    if judge is None:
        _LAST.key, _LAST.plain = prepared.key, common
    return prepared


def _spells(
    sequence: Sequence, solution: Solution, outages: Outages, time: FloatArray
) -> list[Spell]:
    first, last = sequence.span
    try:
        found = outages.spells(
            first, min(last, float(time[-1])), float(solution.trajectory.time[0]) + SETTLE
        )
    except ConfigError:
        return []
    return [s for s in found if ((time > s.start) & (time < s.end)).sum() > 1]


def _fits(
    sequence: Sequence, middle: float
) -> tuple[dict[tuple[str, str], NoiseFit], tuple[str, ...]]:
    """Return the Doppler noise of the receiver, tenfold in 20 dB as the filter has it."""
    assert sequence.observations is not None
    systems = "".join(sorted(set(sequence.observations.sat.astype("U1"))))
    out = {}
    try:
        samples = reference_samples(sequence, systems=systems)
        residual = reference_residuals(samples)
        early = samples.time[samples.epoch] < middle
        for spread in ("mad", "rms"):
            for name, rows in (("all", early | ~early), ("first", early), ("second", ~early)):
                out[spread, name] = fit_doppler_noise(
                    samples.cn0[rows], residual[rows], spread=spread, decade_db=20.0
                )
    except DataError as error:
        return {}, (f"{sequence.name}: no weights fitted: {error}",)
    return out, ()


def try_out(sequence: Sequence, prepared: Prepared, configs: tuple[Config, ...]) -> Trial:
    """Return what one candidate does on one recording: the unit of work of a sweep.

    Parameters
    ----------
    sequence : Sequence
    prepared : Prepared
    configs : tuple of Config
        One; or two, for the first half of the recording and for the second.
    """
    plain, weak = _in_common(sequence, prepared)
    parts = [_judged(plain, weak, prepared, config) for config in configs]
    if reasons := [part.reason for part in parts if part.reason]:
        return Trial(reason=reasons[0])
    if len(parts) == 1:
        return parts[0]
    first, second = parts
    square = {}
    for part, centre in centres(prepared).items():
        if part in first.square:
            early = centre < prepared.middle
            square[part] = np.where(early, first.square[part], second.square[part])
    return Trial(square, 0.5 * (first.held + second.held))


def centres(prepared: Prepared) -> dict[str, FloatArray]:
    """Return when the blocks and spells are, by part [s]."""
    out = {}
    if prepared.judge is None:
        count = np.bincount(prepared.block)
        out["as recorded"] = np.bincount(prepared.block, prepared.time) / np.maximum(count, 1)
    if prepared.spells:
        out["weak GNSS"] = np.array([0.5 * (s.start + s.end) for s in prepared.spells])
    return out


def _in_common(sequence: Sequence, prepared: Prepared) -> tuple[Common, Common | None]:
    """Return what all runs have in common over a recording as it is, and with its spells."""
    if _LAST.key != prepared.key or _LAST.plain is None:
        forget()
        if prepared.judge is not None:
            sequence = replace(sequence, reference=prepared.judge)
        _LAST.plain, _LAST.key = Common(sequence, own_noise=True), prepared.key
    if prepared.spells and _LAST.weak is None:
        weak = degrade(
            _LAST.plain.sequence, prepared.spells, prepared.outages,
            min_cn0_dbhz=prepared.least_cn0, elevation_mask_deg=prepared.least_elevation,
        )  # fmt: skip
        _LAST.weak = Common(weak, own_noise=True)
    return _LAST.plain, _LAST.weak


def _judged(plain: Common, weak: Common | None, prepared: Prepared, config: Config) -> Trial:
    square: dict[str, FloatArray] = {}
    held = float("nan")
    config = _unprotected(config)
    try:
        if prepared.judge is None:
            error = _horizontal_square(_run(plain, config)[1], prepared)
            count = np.bincount(prepared.block)
            square["as recorded"] = np.bincount(prepared.block, error) / np.maximum(count, 1)
        if weak is not None:
            square["weak GNSS"], held = _drifts(weak, prepared, config)
    except NavError as error:
        return Trial(reason=str(error))
    return Trial(square, held)


def _unprotected(config: Config) -> Config:
    """Return a configuration without protection levels: they change nothing of what is judged."""
    return replace(config, filter=replace(config.filter, protection_risk=0.0))


def _run(common: Common, config: Config) -> tuple[Solution, Evaluation]:
    solution = navigate(common.sequence, config, prepared=common)
    return solution, evaluate(solution, common.sequence)


def _horizontal_square(evaluation: Evaluation, prepared: Prepared) -> FloatArray:
    """Return squared horizontal errors at the judged epochs.

    Raises
    ------
    DataError
        If there is no solution at some of them.
    """
    there = np.isin(evaluation.time, prepared.time)
    if there.sum() < prepared.time.size:
        missing = prepared.time.size - int(there.sum())
        raise DataError(f"no solution at {missing} epochs where the default has one")
    return np.sum(evaluation.error_pos_n[there, :2] ** 2, axis=1)


def _drifts(weak: Common, prepared: Prepared, config: Config) -> tuple[FloatArray, float]:
    """Return squared drifts of the spells [m²], and the share of their epochs with an update."""
    solution, evaluation = _run(weak, config)
    figures = [spell_figures(evaluation, spell) for spell in prepared.spells]
    if any(f is None for f in figures):
        raise DataError("no solution in a spell where the default has one")
    epochs = np.array([u.time for u in solution.updates if u.kind in ("doppler", "velocity")])
    used = np.array([u.accepted for u in solution.updates if u.kind in ("doppler", "velocity")])
    inside = np.zeros(epochs.size, dtype=bool)
    for spell in prepared.spells:
        inside |= (epochs >= spell.start) & (epochs < spell.end)
    offered = np.unique(epochs[inside]).size
    held = np.unique(epochs[inside & used]).size / offered if offered else float("nan")
    return np.array([f.drift**2 for f in figures if f is not None]), held


def weights_for(
    prepared: Prepared, others: list[Prepared], spread: str
) -> tuple[Weights, ...] | None:
    """Return the weights this recording may be judged with: none of them fitted to that part."""
    if len(others) >= 2:
        found = pooled(others, spread)
        return None if found is None else (found,)
    if spread == "declared":
        alone = pooled([prepared], spread)
        return None if alone is None else (alone,)
    if not prepared.shown or (spread, "first") not in prepared.fits:
        return None
    halves = (prepared.fits[spread, which].noise for which in ("second", "first"))
    return tuple(Weights(noise, prepared.shown) for noise in halves)


def pooled(recordings: list[Prepared], spread: str) -> Weights | None:
    """Return the geometric mean of what recordings have shown, each counting once."""
    noise, shown = [], []
    for one in recordings:
        fit = one.fits.get((spread, "all"))
        if one.shown and (fit is not None or spread == "declared"):
            noise.append(one.declared if fit is None else fit.noise)
            shown.append(one.shown)
    if not noise:
        return None
    numbers = [(n.sigma_45, n.floor, *own) for n, own in zip(noise, shown, strict=True)]
    sigma, floor, *both = np.exp(np.mean(np.log(numbers), axis=0)).tolist()
    return Weights(DopplerNoise(sigma, floor), tuple(both))
