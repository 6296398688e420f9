"""Scores over a grid of thresholds, the choice among them, and its cross-validation.

Scores add up: a part of the data is one array over the grid, whatever the number of its pairs.
"""

from __future__ import annotations

from collections.abc import Sequence as Listing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...filters.errors import DataError
from ...filters.rotation import FloatArray


@dataclass(frozen=True, eq=False)
class Score:
    """Error and retention of one part of the data over the grid, shape (s, m) each.

    Attributes
    ----------
    square, count : ndarray
        Sum of squared errors, and how many.
    kept : ndarray
        Pairs (or epochs) that the thresholds let through.
    offered : int
        Out of so many.
    """

    square: FloatArray
    count: FloatArray
    kept: FloatArray
    offered: int

    def __repr__(self) -> str:
        snr, k = self.square.shape
        return f"<Score of {self.offered} over {snr} × {k} thresholds>"

    @property
    def rms(self) -> FloatArray:
        """RMS error; NaN where nothing is left."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(self.square / self.count)

    @property
    def retention(self) -> FloatArray:
        """Share let through."""
        return self.kept / max(self.offered, 1)


@dataclass(frozen=True)
class Part:
    """A part of the data that is judged on its own: a sequence, or a block of time of it."""

    sequence: str
    block: int
    score: Score


@dataclass(frozen=True)
class Fold:
    """Thresholds chosen without one part, and what they did on it."""

    left_out: str
    snr: float
    k: float
    rms: float
    retention: float


def choose(sequences: Listing[Score], min_kept: float) -> tuple[int, int]:
    """Return the grid cell of least RMS among those that retain `min_kept` of *every* sequence.

    If none does, the one that retains most of the sequence it leaves least of: a drive with
    strong signals must not set thresholds that leave nothing of the others.
    """
    rms = total(sequences).rms
    rms = np.where(np.isnan(rms), np.inf, rms)
    retention = np.min([s.retention for s in sequences], axis=0)
    enough = (retention >= min_kept) & np.isfinite(rms)
    if not enough.any():
        flat = int(np.argmax(retention))
    else:
        flat = int(np.argmin(np.where(enough, rms, np.inf)))
    row, column = np.unravel_index(flat, rms.shape)
    return int(row), int(column)


def decided(sequences: Listing[Score], snr: FloatArray, k: FloatArray, min_kept: float) -> str:
    """Return which constraint decided a choice, in a sentence."""
    best, free = choose(sequences, min_kept), choose(sequences, 0.0)
    kept = np.min([s.retention for s in sequences], axis=0)
    score = total(sequences)

    def words(cell: tuple[int, int]) -> str:
        return f"C/N0 > {snr[cell[0]]:g} dB-Hz, k > {k[cell[1]]:g}"

    if kept[best] < min_kept:
        return f"nothing keeps {min_kept:.0%} of every drive: what keeps most decided"
    if free != best:
        return (
            f"the floor of {min_kept:.0%} kept decided: without it {words(free)} has "
            f"{score.rms[free]:.3g} m/s with {kept[free]:.0%} kept"
        )
    at_edge = best[0] in (0, snr.size - 1) or best[1] in (0, k.size - 1)
    if at_edge and snr.size * k.size > 1:
        return "the edge of the grid decided: further thresholds may do better"
    return "the error decided: no floor and no edge of the grid stood in its way"


def knee(score: Score) -> tuple[int, int] | None:
    """Return the cell at which the Pareto front bends: farthest from the chord of its ends.

    ln(RMS) over the share kept, each scaled to its range; None for a front of fewer than three.
    """
    cells = np.argwhere(pareto_front(score) & (score.rms > 0.0))
    if len(cells) < 3:
        return None
    where = tuple(cells.T)
    kept, error = score.retention[where], np.log(score.rms[where])
    order = np.argsort(kept)
    x, y = kept[order], error[order]
    if x[0] == x[-1] or y[0] == y[-1]:
        return None
    x, y = (x - x[0]) / (x[-1] - x[0]), (y - y[0]) / (y[-1] - y[0])
    row, column = cells[order[np.argmax(x - y)]]
    return int(row), int(column)


def pareto_front(score: Score) -> NDArray[np.bool_]:
    """Return the cells that no other beats in RMS and retention at once, shape (s, m)."""
    rms = np.where(np.isnan(score.rms), np.inf, score.rms).ravel()
    kept = score.retention.ravel()
    order = np.lexsort((rms, -kept))
    best = np.minimum.accumulate(np.concatenate([[np.inf], rms[order][:-1]]))
    front = np.zeros(rms.size, dtype=bool)
    front[order] = rms[order] < best
    return front.reshape(score.square.shape)


def total(scores: Listing[Score]) -> Score:
    """Return the score of several parts together."""
    return Score(
        np.sum([s.square for s in scores], axis=0),
        np.sum([s.count for s in scores], axis=0),
        np.sum([s.kept for s in scores], axis=0),
        sum(s.offered for s in scores),
    )


def by_sequence(parts: Listing[Part]) -> dict[str, Score]:
    """Return the score of each sequence."""
    names = dict.fromkeys(part.sequence for part in parts)
    return {name: total([p.score for p in parts if p.sequence == name]) for name in names}


def cross_validate(
    parts: Listing[Part], snr: FloatArray, k: FloatArray, min_kept: float
) -> tuple[list[Fold], str, float, float]:
    """Choose without each fold and judge on it.

    Returns
    -------
    folds : list of Fold
    over : str
        'sequences' if there are three or more, else 'time blocks'.
    rms, retention : float
        Over all folds.
    """
    over = "sequences" if len(by_sequence(parts)) >= 3 else "time blocks"

    def fold_of(part: Part) -> str:
        block = "" if over == "sequences" else f", block {part.block + 1}"
        return part.sequence + block

    names = list(dict.fromkeys(map(fold_of, parts)))
    if len(names) < 2:
        raise DataError(
            "cross-validation: expected two parts or more",
            remedy="give a longer drive, or several",
        )
    folds, square, count, kept, offered = [], 0.0, 0.0, 0.0, 0
    for name in names:
        test = total([p.score for p in parts if fold_of(p) == name])
        others = by_sequence([p for p in parts if fold_of(p) != name])
        row, column = choose(list(others.values()), min_kept)
        folds.append(
            Fold(
                name,
                float(snr[row]),
                float(k[column]),
                float(test.rms[row, column]),
                float(test.retention[row, column]),
            )
        )
        square, count = square + test.square[row, column], count + test.count[row, column]
        kept, offered = kept + test.kept[row, column], offered + test.offered
    rms = float(np.sqrt(square / count)) if count else float("nan")
    return folds, over, rms, float(kept / max(offered, 1))
