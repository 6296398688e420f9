"""Satellites whose pseudoranges are wrong by the same amount all the time.

A single epoch's test has to allow for multipath and passes an error of tens of metres in one
satellite: a stale ephemeris, a wrong channel. Averaged over a minute and more, what is left is
what the models leave, a few metres, and the same error stands out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...filters.fault_exclusion import consistent_rows
from ...filters.rotation import FloatArray

#: What broadcast orbits, clocks and atmosphere leave of a range near the zenith, 1σ [m].
_SYSTEMATIC = 2.0
#: Probability of accusing satellites of which none is at fault.
_SIGNIFICANCE = 1e-5
#: Fixes with a satellite that are averaged at least, and biases worth naming [m].
_FIXES, _LEAST = 60, 10.0


@dataclass(frozen=True)
class Persistent:
    """A satellite that contradicts the others all the time.

    Attributes
    ----------
    satellite : str
    bias : float
        By how much its pseudoranges are too long [m].
    fixes : int
        In how many fixes.
    """

    satellite: str
    bias: float
    fixes: int


def persistent_faults(
    satellites: Sequence[tuple[str, ...]],
    H: Sequence[FloatArray],
    residuals: Sequence[FloatArray],
    sigma: Sequence[FloatArray],
) -> tuple[Persistent, ...]:
    """Return the satellites that the others, on the average of many fixes, contradict.

    Parameters
    ----------
    satellites : sequence of tuple of str
        Satellites of each fix.
    H, residuals, sigma : sequence of ndarray, shape (n, p), (n,), (n,)
        Of each fix: ``residuals = H δx + ε`` [m] and the 1σ assumed; only the ratio of the
        latter matters here.
    """
    row: dict[str, list[tuple[FloatArray, float, float]]] = {}
    systems = max((h.shape[1] for h in H), default=0)
    for names, h, r, s in zip(satellites, H, residuals, sigma, strict=True):
        if h.shape[1] == systems:  # fixes with all clocks: columns then mean the same
            for k, name in enumerate(names):
                row.setdefault(name, []).append((h[k], float(r[k]), float(s[k])))
    row = {name: found for name, found in row.items() if len(found) >= _FIXES}
    if len(row) <= systems:
        return ()
    names = tuple(row)
    design = np.array([np.mean([h for h, _, _ in row[name]], axis=0) for name in names])
    mean = np.array([np.mean([r for _, r, _ in row[name]]) for name in names])
    allowed = np.array([np.mean([s for _, _, s in row[name]]) for name in names])
    allowed *= _SYSTEMATIC / allowed.min()
    keep = consistent_rows(design, mean, allowed, _SIGNIFICANCE)
    if keep is None or keep.all():
        return ()
    weight = 1.0 / allowed[keep, None]
    x = np.linalg.lstsq(design[keep] * weight, mean[keep] * weight[:, 0], rcond=None)[0]
    bias = mean - design @ x
    return tuple(
        Persistent(names[k], float(bias[k]), len(row[names[k]]))
        for k in np.flatnonzero(~keep)
        if abs(bias[k]) >= _LEAST
    )
