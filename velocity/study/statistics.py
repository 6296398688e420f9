"""The statistics behind the thresholds: tables and figures of the DDIA-VE paper for any drive.

All take plain arrays of pairs: k = |SDV·RMD|, C/N0 and the velocity error ‖Δv‖. Thresholds are
exceeded, not met: a pair is kept if its value is larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata

from ...filters.rotation import FloatArray
from ..ddia import SINGULAR_K


@dataclass(frozen=True, eq=False)
class Bins:
    """RMS error over bins of a quantity (Fig. 3), shape (m,) each; `low` ≤ value < `high`."""

    low: FloatArray
    high: FloatArray
    count: NDArray[np.int64]
    rms: FloatArray

    def __repr__(self) -> str:
        return f"Bins({self.count.size} bins of {int(self.count.sum())} values)"


@dataclass(frozen=True)
class Rejection:
    """The singularity rule and the outlier rule (Tables 2 and 3).

    Attributes
    ----------
    offered : int
        All pairs.
    kept_k : int
        Of them with k above the limit.
    rms : float
        Of these [m/s].
    limit : float
        3·rms: larger errors are outliers.
    kept : int
        Pairs left by both rules.
    rms_kept : float
        [m/s].
    """

    offered: int
    kept_k: int
    rms: float
    limit: float
    kept: int
    rms_kept: float

    @property
    def discarded_share(self) -> float:
        """Share the singularity rule discards."""
        return 1.0 - self.kept_k / self.offered if self.offered else np.nan


@dataclass(frozen=True, eq=False)
class HeatMap:
    """RMS and retention over thresholds of C/N0 and k (Fig. 8).

    Attributes
    ----------
    snr, k : ndarray, shape (s,), (m,)
        Thresholds [dB-Hz], [1].
    count : ndarray of int, shape (s, m)
        Pairs that exceed both.
    square : ndarray, shape (s, m)
        Σ‖Δv‖² of them [m²/s²].
    offered : int
        Pairs before the thresholds. Maps of the same thresholds add up.
    """

    snr: FloatArray
    k: FloatArray
    count: NDArray[np.int64]
    square: FloatArray
    offered: int

    def __repr__(self) -> str:
        return f"HeatMap({self.snr.size} × {self.k.size} thresholds, {self.offered} pairs offered)"

    @property
    def rms(self) -> FloatArray:
        """RMS of the kept pairs [m/s]; NaN where there are none."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(self.square / self.count)

    @property
    def kept(self) -> FloatArray:
        """Share of the offered pairs that is kept."""
        return self.count / max(self.offered, 1)

    def __add__(self, other: HeatMap) -> HeatMap:
        return HeatMap(
            self.snr, self.k, self.count + other.count, self.square + other.square,
            self.offered + other.offered,
        )  # fmt: skip

    def __sub__(self, other: HeatMap) -> HeatMap:
        return HeatMap(
            self.snr, self.k, self.count - other.count,
            np.maximum(self.square - other.square, 0.0), self.offered - other.offered,
        )  # fmt: skip


def rms(error: ArrayLike) -> float:
    """Return the root mean square; NaN of nothing."""
    error = np.asarray(error, dtype=float)
    return float(np.sqrt(np.mean(error**2))) if error.size else np.nan


def binned_rms(value: ArrayLike, error: ArrayLike, width: float = 0.05, top: float = 2.0) -> Bins:
    """Return the RMS error in bins of `value` from 0 to `top` (Fig. 3: k in bins of 0.05)."""
    value, error = np.asarray(value, dtype=float), np.asarray(error, dtype=float)
    count = round(top / width)
    # Decimal multiples of the width belong to the bin they open, whatever their binary form.
    number = np.floor(value / width + 1e-9).astype(np.int64)
    inside = (number >= 0) & (number < count) & np.isfinite(error)
    number, square = number[inside], error[inside] ** 2
    n = np.bincount(number, minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(np.bincount(number, square, count) / n)
    edges: FloatArray = width * np.arange(count + 1, dtype=float)
    return Bins(edges[:-1], edges[1:], n, root)


def rejection(k: ArrayLike, error: ArrayLike, min_k: float = SINGULAR_K) -> Rejection:
    """Return what k > `min_k` and then ‖Δv‖ ≤ 3·RMS leave, in one pass (Tables 2 and 3)."""
    k, error = np.asarray(k, dtype=float), np.asarray(error, dtype=float)
    regular = error[k > min_k]
    spread = rms(regular)
    left = regular[regular <= 3.0 * spread]
    return Rejection(k.size, regular.size, spread, 3.0 * spread, left.size, rms(left))


def heat_map(
    cn0: ArrayLike, k: ArrayLike, error: ArrayLike, snr_grid: ArrayLike, k_grid: ArrayLike
) -> HeatMap:
    """Return RMS and retention for every combination of thresholds (Fig. 8).

    One pass over the pairs, whatever the grid: each pair is counted in the cell of the largest
    thresholds it exceeds, then cells are summed up from the top.

    Parameters
    ----------
    cn0, k, error : array_like, shape (m,)
        Of the pairs offered. Unknown C/N0 (NaN) exceeds nothing.
    snr_grid, k_grid : array_like
        Ascending thresholds.
    """
    cn0, k, error = (np.asarray(v, dtype=float) for v in (cn0, k, error))
    snr_grid, k_grid = np.asarray(snr_grid, dtype=float), np.asarray(k_grid, dtype=float)
    low = np.where(np.isnan(cn0), -np.inf, cn0)
    i = np.searchsorted(snr_grid, low, side="left") - 1
    j = np.searchsorted(k_grid, k, side="left") - 1
    inside = (i >= 0) & (j >= 0)
    cell = i[inside] * k_grid.size + j[inside]
    shape = (snr_grid.size, k_grid.size)

    def above(weights: FloatArray) -> FloatArray:
        cells = np.bincount(cell, weights, snr_grid.size * k_grid.size).reshape(shape)
        return cells[::-1, ::-1].cumsum(0).cumsum(1)[::-1, ::-1]

    count = above(np.ones(cell.size)).astype(np.int64)
    return HeatMap(snr_grid, k_grid, count, above(error[inside] ** 2), k.size)


def pearson(x: ArrayLike, y: ArrayLike) -> float:
    """Return the linear correlation, eq. (23); NaN for a constant."""
    first, second = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    known = np.isfinite(first) & np.isfinite(second)
    if known.sum() < 2:
        return np.nan
    dx, dy = (v[known] - v[known].mean() for v in (first, second))
    scale = np.sqrt((dx @ dx) * (dy @ dy))
    return float(dx @ dy / scale) if scale > 0.0 else np.nan


def spearman(x: ArrayLike, y: ArrayLike) -> float:
    """Return the rank correlation: eq. (24) without ties, Pearson of average ranks with them."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    known = np.isfinite(x) & np.isfinite(y)
    return pearson(rankdata(x[known]), rankdata(y[known])) if known.sum() >= 2 else np.nan


def correlations(columns: dict[str, FloatArray], error: ArrayLike) -> dict[str, dict[str, float]]:
    """Return Pearson and Spearman of every column with the error (Fig. 5).

    A column twice as long as `error`, with a value for each satellite of a pair, meets it twice.
    """
    error = np.asarray(error, dtype=float)
    out = {}
    for name, value in columns.items():
        times = value.size // error.size if error.size else 1
        repeated = np.tile(error, times)
        out[name] = {"pearson": pearson(value, repeated), "spearman": spearman(value, repeated)}
    return out
