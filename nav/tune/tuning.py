"""Thresholds for pairs of satellites from data, as the paper has them: their cost, their use.

The trade-off is one of error against retention. Taken is the pair of thresholds with the least RMS
among those that retain enough of every drive. So that nothing is judged by what it was tuned on,
the choice is made over again without each part of the data (a sequence, or a block of time) and
its error and retention are taken from the part left out; the figures of the choice from all data
are optimistic and are given beside.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
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
from ..sweep.drives import Source, drive
from ..sweep.parallel import in_parallel
from .score import (
    Fold,
    Part,
    Score,
    by_sequence,
    choose,
    cross_validate,
    decided,
    knee,
    pareto_front,
    total,
)


@dataclass(frozen=True, eq=False)
class Tuning:
    """Outcome of `tune`.

    Attributes
    ----------
    snr, k : ndarray, shape (s,), (m,)
        The grid.
    score : Score
        All data; errors in m/s.
    alone : dict of str to Score
        Each sequence.
    thresholds : Screening
        Of the pairs.
    decided : str
        Which constraint decided, in a sentence.
    knee : (float, float) or None
        Thresholds after which less error costs retention fastest.
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

    snr: FloatArray
    k: FloatArray
    score: Score
    alone: dict[str, Score]
    thresholds: Screening
    decided: str
    knee: tuple[float, float] | None
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
            f"<Tuning on {len(self.alone)} sequences: C/N0 > {t.min_cn0_dbhz:g} dB-Hz, k > "
            f"{t.min_k:g}, cross-validated RMS {self.cv_rms:.3g} m/s, {self.cv_retention:.0%} "
            "retained>"
        )

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
    """What a worker is to do with a sequence."""

    snr: FloatArray
    k: FloatArray
    screening: Screening
    direction: str
    systems: str
    blocks: int


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
    screening : Screening, optional
        Which C/N0 and which k are meant, and further tests to apply.
    min_kept : float
        Share of the pairs that has to be retained in every drive.
    direction : {'motion', 'attitude'}
        Direction of motion, see `velocity.study.samples`.
    systems : str
        Constellation letters.
    blocks : int
        Time blocks of each sequence; they are the folds of fewer than three sequences.
    config : Config, optional
        Its options of readers.
    jobs : int
        Processes on this machine; −1: as many as processors.
    scheduler : str, optional
        Address of a Dask scheduler; the sequences are spread over its workers.

    Raises
    ------
    DataError
        A drive without Doppler or reference, or too little data.
    ConfigError
        Grids that do not ascend, an impossible share.
    """
    config, screening = config or Config(), screening or Screening()
    snr_grid, k_grid = _grid("snr", snr), _grid("k", k)
    if not 0.0 <= min_kept < 1.0:
        raise ConfigError(f"min_kept: expected a share from 0 to below 1, found {min_kept!r}")
    if blocks < 2:
        raise ConfigError(f"blocks: expected 2 or more, found {blocks}")
    job = _Job(snr_grid, k_grid, screening, direction, systems, blocks)
    calls = [(drive(source, config.data), job) for source in sources]
    if not calls:
        raise ConfigError("tune: no sequence given")
    found = _distinct(list(in_parallel(_run, calls, jobs=jobs, scheduler=scheduler)))
    parts = [part for report in found for part in report.parts]
    alone = by_sequence(parts)
    score = total(list(alone.values()))
    bend = knee(score)
    best = choose(list(alone.values()), min_kept)
    folds, folds_by, cv_rms, cv_retention = cross_validate(parts, snr_grid, k_grid, min_kept)
    notes = [note for report in found for note in report.notes]
    for name, one in alone.items():
        if one.retention[best] < min_kept:
            notes.append(
                f"{name}: {one.retention[best]:.0%} retained; no thresholds keep {min_kept:.0%} of "
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
        snr=snr_grid,
        k=k_grid,
        score=score,
        alone=alone,
        thresholds=_with_thresholds(screening, snr_grid[best[0]], k_grid[best[1]]),
        decided=decided(list(alone.values()), snr_grid, k_grid, min_kept),
        knee=bend and (float(snr_grid[bend[0]]), float(k_grid[bend[1]])),
        pareto=pareto_front(score),
        folds=tuple(folds),
        folds_by=folds_by,
        cv_rms=cv_rms,
        cv_retention=cv_retention,
        min_kept=min_kept,
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


def _run(sequence: Sequence, job: _Job) -> _Report:
    """Score the pairs of one sequence against the reference: the unit of work of a sweep."""
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
