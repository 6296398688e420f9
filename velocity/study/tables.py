"""Pairs of one drive or of many as plain columns, and everything the paper says about them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence as Listing
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...filters.rotation import FloatArray
from ..ddia import SINGULAR_K
from .samples import Samples
from .statistics import (
    binned_rms,
    correlations,
    heat_map,
    pearson,
    rejection,
    rms,
    spearman,
)

#: Thresholds of Fig. 8.
SNR_GRID = np.arange(30.0, 51.0, 1.0)
K_GRID = np.round(np.arange(0.05, 1.0001, 0.05), 10)
#: Edges of the ranges of Fig. 7 [dB-Hz].
SNR_RANGES = (30.0, 35.0, 40.0, 45.0, 50.0)


@dataclass(frozen=True, eq=False)
class PairTable:
    """Pairs with their errors, shape (m,) each.

    Attributes
    ----------
    time : ndarray
        GPS time [s].
    k, cosine : ndarray
        |SDV·RMD| as it is, and normalised.
    sat_a, sat_b : ndarray of str
        Which one is called A is an accident: nothing below depends on it.
    cn0_a, cn0_b : ndarray
        [dB-Hz].
    elevation_a, elevation_b, azimuth_a, azimuth_b : ndarray
        [rad].
    error : ndarray
        ‖Δv‖ [m/s].
    """

    time: FloatArray
    k: FloatArray
    cosine: FloatArray
    sat_a: NDArray[np.str_]
    sat_b: NDArray[np.str_]
    cn0_a: FloatArray
    cn0_b: FloatArray
    elevation_a: FloatArray
    elevation_b: FloatArray
    azimuth_a: FloatArray
    azimuth_b: FloatArray
    error: FloatArray

    def __len__(self) -> int:
        return self.k.size

    def __repr__(self) -> str:
        return f"PairTable({len(self)} pairs)"

    @property
    def cn0_mean(self) -> FloatArray:
        """Mean C/N0 of the pair [dB-Hz]."""
        return 0.5 * (self.cn0_a + self.cn0_b)

    @property
    def cn0_min(self) -> FloatArray:
        """Lower C/N0 of the pair [dB-Hz]."""
        return np.minimum(self.cn0_a, self.cn0_b)

    def take(self, rows: ArrayLike) -> PairTable:
        """Return the given pairs (a mask or indices)."""
        return PairTable(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def pair_table(samples: Samples) -> PairTable:
    """Return all pairs of a drive with their errors; pairs of k = 0 have an infinite one."""
    pairs = samples.pairs()
    error = samples.errors(pairs)
    a, b = pairs.a, pairs.b
    return PairTable(
        time=samples.time[pairs.epoch],
        k=pairs.k,
        cosine=pairs.cosine,
        sat_a=samples.rows.sat[a],
        sat_b=samples.rows.sat[b],
        cn0_a=samples.cn0[a],
        cn0_b=samples.cn0[b],
        elevation_a=samples.elevation[a],
        elevation_b=samples.elevation[b],
        azimuth_a=samples.azimuth[a],
        azimuth_b=samples.azimuth[b],
        error=np.where(np.isnan(error), np.inf, error),
    )


def concatenated(tables: Listing[PairTable]) -> PairTable:
    """Return one table of all pairs."""
    return PairTable(
        **{f.name: np.concatenate([getattr(t, f.name) for t in tables]) for f in fields(PairTable)}
    )


def describe(
    table: PairTable,
    snr_grid: ArrayLike = SNR_GRID,
    k_grid: ArrayLike = K_GRID,
    *,
    cn0_of: str = "mean",
    k_of: str = "sdv",
) -> dict[str, Any]:
    """Return the paper's tables and figures as plain numbers, ready for JSON.

    Parameters
    ----------
    table : PairTable
    snr_grid, k_grid : array_like
        Ascending thresholds of the heat map.
    cn0_of : {'mean', 'min'}
    k_of : {'sdv', 'cosine'}

    Returns
    -------
    dict
        ``pairs`` with C/N0 and ``unknown_cn0`` without, which are left out; ``k05_kept``,
        ``rms_k05_mps`` (Table 2, before the outlier rule); ``limit_mps``, ``kept_3rms``,
        ``rms_3rms_mps`` (Table 3); ``bins`` (Fig. 3, all pairs); and, over pairs after both
        rules, ``cn0`` (Table 5), ``correlation`` (Fig. 5), ``by_satellite`` (Fig. 6),
        ``within_snr`` (Fig. 7) and ``heatmap`` (Fig. 8). NaN stands for nothing to tell.
    """
    known = np.isfinite(table.cn0_mean)
    unknown = int((~known).sum())
    table = table.take(known)
    k = table.k if k_of == "sdv" else table.cosine
    rule = rejection(k, table.error)
    kept = table.take((k > SINGULAR_K) & (table.error <= rule.limit))
    kept_k = kept.k if k_of == "sdv" else kept.cosine
    kept_cn0 = kept.cn0_mean if cn0_of == "mean" else kept.cn0_min
    bins = binned_rms(k, table.error)
    grid = heat_map(kept_cn0, kept_k, kept.error, snr_grid, k_grid)
    return {
        "pairs": rule.offered,
        "unknown_cn0": unknown,
        "k05_kept": rule.kept_k,
        "k05_discarded_share": rule.discarded_share,
        "rms_k05_mps": rule.rms,
        "limit_mps": rule.limit,
        "kept_3rms": rule.kept,
        "rms_3rms_mps": rule.rms_kept,
        "discarded_shares": [
            {"k": float(limit), "share": float(np.mean(k <= limit)) if k.size else np.nan}
            for limit in (0.05, 0.1, 0.15, 0.2)
        ],
        "bins": [
            {"low": float(low), "high": float(high), "count": int(n), "rms_mps": float(value)}
            for low, high, n, value in zip(bins.low, bins.high, bins.count, bins.rms, strict=True)
            if n
        ],
        "cn0": _cn0_summary(kept.cn0_mean),
        "correlation": correlations(_factors(kept, kept_k), kept.error),
        "by_satellite": cn0_by_satellite(kept),
        "within_snr": within_snr(kept.cn0_mean, kept_k, kept.error),
        "heatmap": [
            {
                "snr": float(s),
                "k": float(limit),
                "rms_mps": float(grid.rms[i, j]),
                "kept": float(grid.kept[i, j]),
                "count": int(grid.count[i, j]),
            }
            for i, s in enumerate(grid.snr)
            for j, limit in enumerate(grid.k)
        ],
        "rms_snr40_k20_mps": rms(kept.error[(kept_cn0 > 40.0) & (kept_k > 0.2)]),
    }


def _factors(table: PairTable, k: FloatArray) -> dict[str, FloatArray]:
    """Return what may go with the error, by the names of Fig. 5.

    A factor of the pair has one value a pair. One of a single satellite has two, and both count,
    with the same error: which of them is called A changes nothing.
    """
    both = {
        "snr": (table.cn0_a, table.cn0_b),
        "elevation": (table.elevation_a, table.elevation_b),
        "azimuth": (table.azimuth_a, table.azimuth_b),
    }
    return {
        "k": k,
        "snr_mean": table.cn0_mean,
        "snr_low": table.cn0_min,
        "snr_high": np.maximum(table.cn0_a, table.cn0_b),
        "elevation_low": np.minimum(table.elevation_a, table.elevation_b),
        **{name: np.concatenate(values) for name, values in both.items()},
    }


def cn0_by_satellite(table: PairTable) -> list[dict[str, Any]]:
    """Return mean and standard deviation of the pairs' mean C/N0 by satellite (Fig. 6).

    A pair counts for both its satellites.
    """
    names, row = np.unique(np.concatenate([table.sat_a, table.sat_b]), return_inverse=True)
    level = np.tile(table.cn0_mean, 2)
    count = np.bincount(row, minlength=names.size)
    mean = np.bincount(row, level, names.size) / np.maximum(count, 1)
    spread = np.bincount(row, (level - mean[row]) ** 2, names.size) / np.maximum(count, 1)
    return [
        {"sat": str(name), "count": int(n), "mean_dbhz": float(m), "std_db": float(np.sqrt(s))}
        for name, n, m, s in zip(names, count, mean, spread, strict=True)
    ]


def within_snr(cn0: FloatArray, k: FloatArray, error: FloatArray) -> list[dict[str, Any]]:
    """Return how k goes with the error where the mean C/N0 is about the same (Fig. 7).

    Every pair lies in one range; those with nothing in them are left out.
    """
    out = []
    for low, high in itertools.pairwise((-np.inf, *SNR_RANGES, np.inf)):
        here = (cn0 > low) & (cn0 <= high)
        if here.any():
            out.append(
                {
                    "above": float(low),
                    "up_to": float(high),
                    "count": int(here.sum()),
                    "rms_mps": rms(error[here]),
                    "pearson": pearson(k[here], error[here]),
                    "spearman": spearman(k[here], error[here]),
                }
            )
    return out


def _cn0_summary(cn0: FloatArray) -> dict[str, Any]:
    """Return mean, spread and a histogram in steps of 1 dB-Hz of the pairs' mean C/N0."""
    if not cn0.size:
        return {"count": 0, "mean_dbhz": np.nan, "std_db": np.nan, "histogram": []}
    level, count = np.unique(np.floor(cn0), return_counts=True)
    return {
        "count": int(cn0.size),
        "mean_dbhz": float(cn0.mean()),
        "std_db": float(cn0.std()),
        "histogram": [
            {"dbhz": float(x), "share": float(n / cn0.size)}
            for x, n in zip(level, count, strict=True)
        ],
    }
