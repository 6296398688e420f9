"""Which settings are better, by how much, and how sure that is.

Errors come in groups: the blocks of time of one recording as it is, or its spells of weak GNSS.
The figure of a group is the RMS F over its blocks, and what counts is ln(F / F of the default),
the mean of it over groups: a recording with large errors does not outvote the others. Its interval
is Student's over jackknife pseudo-values, the blocks left out one by one; over three recordings or
more it is that over the recordings, where this is wider: what holds for others has to hold for each
of these. Signed numbers below zero are improvements.

The best of many looks better than it is: of twenty candidates that differ by chance alone, the
interval of the best excludes zero in one draw of five, and that of a choice made without the data
it is judged by, which is asked for too, in one of fifteen (`tests/nav/tune/test_choice.py`).
"""

from __future__ import annotations

from collections.abc import Sequence as Listing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from ...filters.rotation import FloatArray

#: Confidence of every interval.
LEVEL = 0.95


@dataclass(frozen=True, eq=False)
class Group:
    """Errors of all candidates in the blocks of one part of one recording.

    Parameters
    ----------
    recording : str
    part : str
        'as recorded' or 'weak GNSS'.
    square : ndarray, shape (candidates, blocks)
        Mean squared error [m²]; the default comes first. Infinite where a candidate has none.
    weight : ndarray, shape (blocks,)
        Epochs of each block.
    fold : ndarray of int, shape (blocks,)
        Which fold of the recording a block is in.
    """

    recording: str
    part: str
    square: FloatArray
    weight: FloatArray
    fold: NDArray[np.int64]

    def __repr__(self) -> str:
        return f"<Group {self.recording}, {self.part}: {self.weight.size} blocks>"

    def rms(self, candidate: int) -> float:
        """Return the RMS error of a candidate [m]."""
        return float(np.sqrt(self.weight @ self.square[candidate] / self.weight.sum()))


@dataclass(frozen=True)
class Change:
    """A relative change of the error, −0.1 being a tenth less, with its interval."""

    value: float
    low: float
    high: float

    @property
    def better(self) -> bool:
        """Whether the interval excludes zero on the good side."""
        return self.high < 0.0

    @property
    def worse(self) -> bool:
        """Whether it does on the bad side."""
        return self.low > 0.0


def change(groups: Listing[Group], squares: Listing[FloatArray]) -> Change:
    """Return how much larger errors are than the default's.

    Parameters
    ----------
    groups : list of Group
    squares : list of ndarray, shape (blocks,)
        For each group, the errors on trial.
    """
    kept = [
        (g, s) for g, s in zip(groups, squares, strict=True) if s.size > 1 and g.square[0].any()
    ]
    if not kept:
        return Change(0.0, -np.inf, np.inf)
    if not all(np.isfinite(s).all() for _, s in kept):
        return Change(np.inf, np.inf, np.inf)
    mean, variance, dof = [], [], []
    for group, square in kept:
        value, spread = _jackknife(square, group.square[0], group.weight)
        mean.append(value)
        variance.append(spread)
        dof.append(square.size - 1)
    total, var, n = float(np.mean(mean)), np.array(variance), len(kept)
    half = 0.0
    if var.sum() > 0.0:
        freedom = var.sum() ** 2 / np.sum(var**2 / np.array(dof))  # Welch–Satterthwaite
        half = float(_quantile(freedom) * np.sqrt(var.sum()) / n)
    half = max(half, _between([g.recording for g, _ in kept], mean))
    low, high = np.expm1(total - half), np.expm1(total + half)
    return Change(float(np.expm1(total)), float(low), float(high))


def _quantile(freedom: float) -> float:
    return float(student.ppf(0.5 + LEVEL / 2.0, freedom))


def _jackknife(square: FloatArray, before: FloatArray, weight: FloatArray) -> tuple[float, float]:
    """Return ln of the ratio of two RMS and its variance, leaving out block by block."""

    def ratio(a: FloatArray, b: FloatArray) -> FloatArray:
        tiny = 1e-300
        return 0.5 * np.log(np.maximum(a, tiny) / np.maximum(b, tiny))

    a, b = weight * square, weight * before
    left = ratio(a.sum() - a, b.sum() - b)
    count = square.size
    variance = (count - 1) / count * float(np.sum((left - left.mean()) ** 2))
    return float(ratio(np.array(a.sum()), np.array(b.sum()))), variance


def _between(recordings: list[str], values: list[float]) -> float:
    """Return half of the interval over recordings; 0 for fewer than three."""
    names = list(dict.fromkeys(recordings))
    if len(names) < 3:
        return 0.0
    each = [
        np.mean([v for v, r in zip(values, recordings, strict=True) if r == name]) for name in names
    ]
    return float(_quantile(len(names) - 1) * np.std(each, ddof=1) / np.sqrt(len(names)))


def of_candidate(groups: Listing[Group], candidate: int) -> Change:
    """Return the change a candidate makes over all groups."""
    return change(groups, [g.square[candidate] for g in groups])


def best(groups: Listing[Group]) -> int:
    """Return the candidate of least error; the first of equals."""
    count = groups[0].square.shape[0]
    return int(np.argmin([of_candidate(groups, k).value for k in range(count)]))


def by_time(groups: Listing[Group]) -> bool:
    """Tell whether folds are blocks of time: there are fewer than three recordings."""
    return len({g.recording for g in groups}) < 3


def cross_validated(groups: Listing[Group]) -> tuple[Change, list[tuple[str, int]]]:
    """Choose without each fold, and judge on it.

    Returns
    -------
    Change
        What the choice changes where it had not been made.
    folds : list of (str, int)
        What was left out, and the candidate chosen without it.
    """
    time = by_time(groups)

    def names(group: Group) -> list[str]:
        if time:
            return [f"{group.recording}, part {fold + 1}" for fold in group.fold]
        return [group.recording] * group.fold.size

    labels = [np.array(names(group)) for group in groups]
    folds = list(dict.fromkeys(name for label in labels for name in sorted(label.tolist())))
    squares = [group.square[0].copy() for group in groups]
    chosen = []
    for name in folds:
        rest = [_without(g, label != name) for g, label in zip(groups, labels, strict=True)]
        rest = [g for g in rest if g.weight.size]
        pick = best(rest) if rest else 0
        chosen.append((name, pick))
        for square, group, label in zip(squares, groups, labels, strict=True):
            square[label == name] = group.square[pick][label == name]
    return change(groups, squares), chosen


def _without(group: Group, keep: NDArray[np.bool_]) -> Group:
    return Group(
        group.recording, group.part, group.square[:, keep], group.weight[keep], group.fold[keep]
    )
