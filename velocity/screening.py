"""Which satellite pairs to trust: pairs are marked, not dropped, and each knows why."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..filters.errors import ConfigError
from .study.pairs import Pairs

#: Reasons by bit of a mark, in the order they are reported.
REASONS = ("C/N0 unknown", "weak signal", "singular geometry", "low elevation", "pair residual")
_UNKNOWN, _WEAK, _SINGULAR, _LOW, _RESIDUAL = (np.uint8(1 << bit) for bit in range(5))

Marks = NDArray[np.uint8]


@dataclass(frozen=True)
class Screening:
    """Thresholds for pairs; defaults are the operating point the paper recommends.

    Parameters
    ----------
    min_cn0_dbhz : float
        C/N0 has to be larger; 0: no test.
    cn0_of : {'mean', 'min'}
        Which C/N0 of the pair.
    min_k : float
        |SDV·RMD| has to be larger.
    k_of : {'sdv', 'cosine'}
        SDV as it is, which makes 1σ = √2·λσ_D/k, or normalised, the cosine of its angle to the
        direction of motion.
    min_elevation_deg : float
        Of the lower satellite; pairs of unknown elevation pass.
    max_residual : float
        Largest disagreement with the n-satellite solution, in σ; pairs with nothing to disagree
        with pass.

    Examples
    --------
    >>> from certnav.velocity import Screening
    >>> paper = Screening()
    >>> paper.min_cn0_dbhz, paper.min_k
    (40.0, 0.2)
    """

    min_cn0_dbhz: float = 40.0
    cn0_of: str = "mean"
    min_k: float = 0.2
    k_of: str = "sdv"
    min_elevation_deg: float = -90.0
    max_residual: float = np.inf

    def __post_init__(self) -> None:
        for key, allowed in (("cn0_of", ("mean", "min")), ("k_of", ("sdv", "cosine"))):
            if getattr(self, key) not in allowed:
                raise ConfigError(
                    f"{key}: expected {' or '.join(allowed)}, found {getattr(self, key)!r}"
                )
        if not 0.0 <= self.min_cn0_dbhz < 70.0:
            raise ConfigError(f"min_cn0_dbhz: expected 0 … 70, found {self.min_cn0_dbhz!r}")
        if not 0.0 <= self.min_k < 2.0:
            raise ConfigError(f"min_k: expected 0 ≤ k < 2, found {self.min_k!r}")
        if not self.max_residual > 0.0:
            raise ConfigError(f"max_residual: expected > 0, found {self.max_residual!r}")


def screen(pairs: Pairs, screening: Screening) -> Marks:
    """Return one mark per pair: 0 is usable, otherwise the bits of `REASONS`, shape (m,).

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import Screening, screen
    >>> from certnav.velocity.screening import reasons
    >>> from certnav.velocity.study.pairs import Pairs
    >>> one, k, cn0 = np.ones(3), np.array([0.9, 0.1, 0.5]), np.array([45.0, 45.0, 35.0])
    >>> a, b = np.array([0, 0, 1]), np.array([1, 2, 2])  # three satellites of one epoch
    >>> pairs = Pairs(0 * a, a, b, k, k, cn0, cn0, one, 10.0 * one, one, 0.0 * one, np.array([3]))
    >>> reasons(screen(pairs, Screening()))
    array(['', 'singular geometry', 'weak signal'], dtype='<U86')
    """
    marks = np.zeros(len(pairs), dtype=np.uint8)
    if screening.min_cn0_dbhz > 0.0:
        cn0 = pairs.cn0_mean if screening.cn0_of == "mean" else pairs.cn0_min
        unknown = np.isnan(cn0)
        marks |= _UNKNOWN * unknown
        marks |= _WEAK * (~(cn0 > screening.min_cn0_dbhz) & ~unknown)
    k = pairs.k if screening.k_of == "sdv" else pairs.cosine
    marks |= _SINGULAR * ~(k > screening.min_k)
    marks |= _LOW * (pairs.elevation_min < np.radians(screening.min_elevation_deg))
    marks |= _RESIDUAL * (np.abs(pairs.residual) > screening.max_residual)
    return marks


def reasons(marks: Marks) -> NDArray[np.str_]:
    """Return the reasons in words, joined by ' and '; '' for usable pairs, shape (m,)."""
    words = [
        " and ".join(reason for bit, reason in enumerate(REASONS) if mark >> bit & 1)
        for mark in range(1 << len(REASONS))
    ]
    return np.array(words)[marks]


def reason_counts(marks: Marks) -> dict[str, int]:
    """Return how many pairs each reason refused; one pair may count under several."""
    return {reason: int((marks >> bit & 1).sum()) for bit, reason in enumerate(REASONS)}


def usable_pairs(pairs: Pairs, marks: Marks) -> NDArray[np.int64]:
    """Return the number of usable pairs of every epoch, shape (epochs,)."""
    return np.bincount(pairs.epoch[marks == 0], minlength=pairs.counts.size)


def epoch_reasons(pairs: Pairs, marks: Marks) -> list[str]:
    """Return why each epoch has no usable pair; '' for those that have one.

    'no satellites', 'only one satellite', or the pairs' reasons with their counts:
    'weak signal 2, singular geometry 1'.
    """
    left = usable_pairs(pairs, marks)
    per_reason = [
        np.bincount(pairs.epoch[marks >> bit & 1 == 1], minlength=left.size)
        for bit in range(len(REASONS))
    ]
    out = []
    for number, usable in enumerate(left):
        if usable:
            out.append("")
        elif pairs.counts[number] < 2:
            out.append("only one satellite" if pairs.counts[number] else "no satellites")
        else:
            counted = zip(REASONS, (int(c[number]) for c in per_reason), strict=True)
            out.append(", ".join(f"{reason} {count}" for reason, count in counted if count))
    return out


def usable_rows(pairs: Pairs, marks: Marks, count: int) -> NDArray[np.bool_]:
    """Return which of `count` rows belong to at least one usable pair."""
    rows = np.zeros(count, dtype=bool)
    rows[pairs.a[marks == 0]] = True
    rows[pairs.b[marks == 0]] = True
    return rows
