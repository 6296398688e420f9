"""Thresholds for DDIA-VE from data: what they cost, what they buy, and which to take.

The trade-off is one of error against retention. Taken is the pair of thresholds with the least RMS
among those that retain enough of every drive. So that nothing is judged by what it was tuned on,
the choice is made over again without each part of the data (a sequence, or a block of time) and
its error and retention are taken from the part left out; the figures of the choice from all data
are optimistic and are given beside.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...datasets.sequence import Sequence
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ...velocity.doppler_noise import NoiseFit, fit_doppler_noise, reference_residuals
from ...velocity.screening import Screening
from ...velocity.study.samples import reference_samples
from ...velocity.study.statistics import heat_map
from ...velocity.study.tables import PairTable, concatenated, describe, pair_table
from ..config import Config
from ..sweep import in_parallel
from .score import Fold, Part, Score, by_sequence, choose, cross_validate, pareto_front, total

#: What the paper recommends; every result says how it compares.
PAPER = (40.0, 0.2)
Source = str | Path | Sequence


@dataclass(frozen=True, eq=False)
class Tuning:
    """Outcome of `tune`.

    Attributes
    ----------
    objective : {'velocity', 'position'}
    snr, k : ndarray, shape (s,), (m,)
        The grid.
    score : Score
        All data; errors in m/s, or m of drift for 'position'.
    alone : dict of str to Score
        Each sequence.
    thresholds : Screening
        Recommended.
    pareto : ndarray of bool, shape (s, m)
        Combinations that no other beats in both RMS and retention.
    folds : tuple of Fold
    folds_by : {'sequences', 'time blocks'}
    cv_rms, cv_retention : float
        Over the parts left out: the honest figures.
    min_kept : float
        Retention asked for.
    statistics : dict
        Of 'pooled' and every sequence; see `velocity.study.tables.describe`.
    noise : dict of str to NoiseFit
        Doppler noise of every sequence's receiver.
    notes : tuple of str
    """

    objective: str
    snr: FloatArray
    k: FloatArray
    score: Score
    alone: dict[str, Score]
    thresholds: Screening
    pareto: NDArray[np.bool_]
    folds: tuple[Fold, ...]
    folds_by: str
    cv_rms: float
    cv_retention: float
    min_kept: float
    statistics: dict[str, dict[str, Any]]
    noise: dict[str, NoiseFit]
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        t = self.thresholds
        return (
            f"<Tuning for {self.objective} on {len(self.alone)} sequences: C/N0 > "
            f"{t.min_cn0_dbhz:g} dB-Hz, k > {t.min_k:g}, cross-validated RMS {self.cv_rms:.3g} "
            f"{self.unit}, {self.cv_retention:.0%} retained>"
        )

    @property
    def unit(self) -> str:
        """Of the errors."""
        return "m/s" if self.objective == "velocity" else "m"

    def at(self, snr: float, k: float, score: Score | None = None) -> tuple[float, float] | None:
        """Return RMS and retention at grid thresholds; None off the grid."""
        score = score or self.score
        i = np.flatnonzero(np.isclose(self.snr, snr))
        j = np.flatnonzero(np.isclose(self.k, k))
        if not (i.size and j.size):
            return None
        return float(score.rms[i[0], j[0]]), float(score.retention[i[0], j[0]])


@dataclass(frozen=True)
class _Job:
    """What one worker is to do with one sequence."""

    source: Source
    objective: str
    snr: FloatArray
    k: FloatArray
    screening: Screening
    direction: str
    systems: str
    blocks: int
    config: Config


@dataclass(frozen=True)
class _Report:
    """What it found."""

    name: str
    parts: list[Part]
    table: PairTable | None
    noise: NoiseFit | None
    notes: list[str] = field(default_factory=list)


def tune(
    sources: Iterable[Source],
    *,
    snr: ArrayLike,
    k: ArrayLike,
    objective: str = "velocity",
    screening: Screening | None = None,
    min_kept: float = 0.4,
    direction: str = "motion",
    systems: str = "G",
    blocks: int = 5,
    config: Config | None = None,
    jobs: int = -1,
    scheduler: str | None = None,
) -> Tuning:
    """Return recommended thresholds of C/N0 and |SDV·RMD| with all that is behind them.

    Parameters
    ----------
    sources : iterable of path or Sequence
        Drives with raw Doppler and a reference.
    snr, k : array_like
        Ascending thresholds to try [dB-Hz], [1].
    objective : {'velocity', 'position'}
        RMS of pairs' velocity errors, or of the drift over simulated weak-GNSS spells.
    screening : Screening, optional
        Which C/N0 and which k are meant, and further tests to apply.
    min_kept : float
        Share of the pairs that has to be retained in every drive; 'position' does without, since
        epochs without a velocity already drift.
    direction : {'motion', 'attitude'}
        Direction of motion for 'velocity', see `velocity.study.samples`.
    systems : str
        Constellation letters for 'velocity'.
    blocks : int
        Time blocks of each sequence; they are the folds of fewer than three sequences.
    config : Config, optional
        Of the filter, for 'position'.
    jobs : int
        Processes on this machine; −1: as many as processors.
    scheduler : str, optional
        Address of a Dask scheduler; the sequences are spread over its workers.

    Raises
    ------
    DataError
        A drive without Doppler or reference, or too little data.
    ConfigError
        Grids that do not ascend, unknown objective.
    """
    config, screening = config or Config(), screening or Screening()
    snr_grid, k_grid = _grid("snr", snr), _grid("k", k)
    if objective not in ("velocity", "position"):
        raise ConfigError(f"objective: expected velocity or position, found '{objective}'")
    if not 0.0 <= min_kept < 1.0:
        raise ConfigError(f"min_kept: expected a share from 0 to below 1, found {min_kept!r}")
    if blocks < 2:
        raise ConfigError(f"blocks: expected 2 or more, found {blocks}")
    work = [
        _Job(source, objective, snr_grid, k_grid, screening, direction, systems, blocks, config)
        for source in sources
    ]
    if not work:
        raise ConfigError("tune: no sequence given")
    calls = [(job,) for job in work]
    found = _distinct(list(in_parallel(_run, calls, jobs=jobs, scheduler=scheduler)))
    parts = [part for report in found for part in report.parts]
    alone = by_sequence(parts)
    score = total(list(alone.values()))
    required = min_kept if objective == "velocity" else 0.0
    best = choose(list(alone.values()), required)
    folds, folds_by, cv_rms, cv_retention = cross_validate(parts, snr_grid, k_grid, required)
    notes = [note for report in found for note in report.notes]
    for name, one in alone.items():
        if one.retention[best] < required:
            notes.append(
                f"{name}: {one.retention[best]:.0%} retained; no thresholds keep {required:.0%} of "
                "every sequence"
            )
    statistics = {}
    tables = {r.name: r.table for r in found if r.table is not None}
    options = {"cn0_of": screening.cn0_of, "k_of": screening.k_of}
    if tables:
        pooled = concatenated(list(tables.values()))
        statistics["pooled"] = describe(pooled, snr_grid, k_grid, **options)
        statistics |= {name: describe(t, snr_grid, k_grid, **options) for name, t in tables.items()}
    return Tuning(
        objective=objective,
        snr=snr_grid,
        k=k_grid,
        score=score,
        alone=alone,
        thresholds=_with_thresholds(screening, snr_grid[best[0]], k_grid[best[1]]),
        pareto=pareto_front(score),
        folds=tuple(folds),
        folds_by=folds_by,
        cv_rms=cv_rms,
        cv_retention=cv_retention,
        min_kept=required,
        statistics=statistics,
        noise={r.name: r.noise for r in found if r.noise is not None},
        notes=tuple(notes),
    )


def _with_thresholds(screening: Screening, snr: float, k: float) -> Screening:
    return replace(screening, min_cn0_dbhz=float(snr), min_k=float(k))


def _grid(name: str, values: ArrayLike) -> FloatArray:
    grid = np.atleast_1d(np.asarray(values, dtype=float))
    if grid.ndim != 1 or not grid.size or (np.diff(grid) <= 0.0).any():
        raise ConfigError(f"{name}: expected ascending thresholds, found {grid}")
    return grid


def _distinct(found: list[_Report]) -> list[_Report]:
    """Return the reports with names made unique: two drives may share a folder name."""
    seen: dict[str, int] = {}
    out = []
    for report in found:
        seen[report.name] = seen.get(report.name, 0) + 1
        number = seen[report.name]
        name = report.name if number == 1 else f"{report.name} ({number})"
        parts = [replace(part, sequence=name) for part in report.parts]
        out.append(replace(report, name=name, parts=parts))
    return out


def _run(job: _Job) -> _Report:
    """Load one sequence and score it: the unit of work of a sweep."""
    sequence = job.source
    if not isinstance(sequence, Sequence):
        from ...datasets.loading import load

        sequence = load(sequence, **job.config.data)
    return _velocity(job, sequence) if job.objective == "velocity" else _position(job, sequence)


def _velocity(job: _Job, sequence: Sequence) -> _Report:
    """Score pairs against the reference."""
    samples = reference_samples(sequence, direction=job.direction, systems=job.systems)
    table = pair_table(samples)
    passed = _other_tests(job.screening, table)
    usable = table.take(passed & np.isfinite(table.error))
    block = _blocks(usable.time, job.blocks)
    cn0 = usable.cn0_mean if job.screening.cn0_of == "mean" else usable.cn0_min
    k = usable.k if job.screening.k_of == "sdv" else usable.cosine
    parts = []
    for number in range(job.blocks):
        here = block == number
        if here.any():
            grid = heat_map(cn0[here], k[here], usable.error[here], job.snr, job.k)
            score = Score(grid.square, grid.count.astype(float), grid.count.astype(float),
                          grid.offered)  # fmt: skip
            parts.append(Part(sequence.name, number, score))
    residual = reference_residuals(samples)
    notes = [f"{sequence.name}: {n} epochs {why}" for why, n in samples.left_out.items()]
    try:
        noise = fit_doppler_noise(samples.cn0, residual)
    except DataError as error:
        noise = None
        notes.append(f"{sequence.name}: {error}")
    return _Report(sequence.name, parts, table, noise, notes)


def _other_tests(screening: Screening, table: PairTable) -> NDArray[np.bool_]:
    """Return the pairs that pass what is not on the grid."""
    low = np.minimum(table.elevation_a, table.elevation_b)
    return ~(low < np.radians(screening.min_elevation_deg))


def _blocks(time: FloatArray, blocks: int) -> NDArray[np.int64]:
    """Return the number of the equally long time block each instant lies in."""
    if not time.size:
        return np.zeros(0, dtype=np.int64)
    start, length = time.min(), max(float(np.ptp(time)), 1e-9)
    return np.minimum((blocks * (time - start) / length).astype(np.int64), blocks - 1)


def _position(job: _Job, sequence: Sequence) -> _Report:
    """Score drift over weak-GNSS spells; each spell is a block."""
    from .position import drift_scores

    scores = drift_scores(sequence, job.config, job.snr, job.k, screening=job.screening)
    parts = [Part(sequence.name, number, score) for number, score in enumerate(scores)]
    note = f"{sequence.name}: {len(scores)} weak-GNSS spells"
    return _Report(sequence.name, parts, None, None, [note])
