"""Time offset between two sensors that feel the same motion, with its uncertainty.

Increments y over intervals of one sensor are regressed on the increments of the other's
integral, shifted by a lag, with all its axes at once: the fit finds the lag whatever the axes,
signs and units are. Best is the lag with the smallest residual; delete-one-block jackknife gives
its σ, which then contains whatever makes the parts of a drive disagree.

A drive round the block looks alike one round later, and then a single stretch of bad data decides
between none and a whole round. So a large lag is claimed only where no other, zero included,
explains the motion as well, and no single block of the drive makes the difference.

One convention of sign everywhere: a positive lag says that the stamps of the sensor whose integral
is taken, the one a finding names first, are *late*.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...filters.rotation import FloatArray

#: Lags searched [s]: twice the leap seconds and some.
SEARCH = 40.0
_COARSE, _FINE, _FINE_SPAN = 0.2, 0.02, 0.5
#: The integral is put on a grid of this step, so that shifting it needs no search [s].
_GRID = 0.02
#: Blocks of the drive, and how many in a row are left out for a σ: what makes the parts of a drive
#: disagree lasts for a while.
_BLOCKS, _IN_JACKKNIFE = 16, 2
_LAGS_AT_ONCE = 32  # what they need stays in the processor's cache
_MIN_ROWS = 24
_MAX_ROWS = 500
#: Shorter stretches in common are explained by chance [s].
_MIN_COMMON = 15.0
#: A lag beyond this is believed only if it leaves less than half of what a small one leaves …
_NEAR = 1.0
#: … and is ahead of any other, so far apart [s], whichever blocks in a row are left out: by so much
#: of what it is ahead with all of them.
_APART, _LEFT_OUT, _AHEAD = 1.5, 3, 0.3
#: A lag expected beforehand, to so much [s], need only be ahead of small ones.
_EXPECTED = 0.3


@dataclass(frozen=True)
class Lag:
    """Result of `find_lag`.

    Attributes
    ----------
    lag : float
        ``y(t)`` agrees with the other sensor's stamps ``t + lag``: positive where those are
        late [s].
    sigma : float
        1σ [s].
    explained : float
        Share of the variance of y explained at that lag, 0…1.
    """

    lag: float
    sigma: float
    explained: float

    @property
    def conclusive(self) -> bool:
        """Whether there was enough common motion to tell."""
        return self.explained > 0.5 and self.sigma < 0.5


def find_lag(
    time: FloatArray,
    integral: FloatArray,
    start: FloatArray,
    end: FloatArray,
    y: FloatArray,
    search: float = SEARCH,
    expected: Iterable[float] = (),
) -> Lag | None:
    """Return the lag at which increments of `integral` explain `y` best.

    Parameters
    ----------
    time, integral : ndarray, shape (n,), (n, p)
        The other sensor: integrals of its axes at its stamps.
    start, end : ndarray, shape (m,)
        The intervals of y [s], increasing.
    y : ndarray, shape (m, q)
        Increments over them.
    search : float
        Lags of up to ± this are tried [s]; less where the recording is short.
    expected : iterable of float
        Large lags that would not surprise, of either sign [s]: the leap seconds.

    Returns
    -------
    Lag or None
        None where there are too few intervals.
    """
    good = np.isfinite(y).all(1)
    if good.sum() < _MIN_ROWS:
        return None
    first, last = float(start[good][0]), float(end[good][-1])
    common = max(_MIN_COMMON, 0.3 * min(last - first, float(time[-1] - time[0])))
    lowest = max(-search, time[0] - last + common)
    highest = min(search, time[-1] - first - common)
    if lowest >= highest:
        return None
    thin = slice(None, None, -(-start.size // _MAX_ROWS))
    start, end, y = start[thin], end[thin], y[thin]
    grams = _Grams(time, integral, start, end, y)
    steps = np.arange(np.ceil(lowest / _COARSE), np.floor(highest / _COARSE) + 1)
    coarse = _COARSE * steps
    best = _peak(grams.explained_by_part(coarse, _LEFT_OUT), coarse, tuple(expected))
    if best is None:
        return None
    fine = best + np.arange(-_FINE_SPAN, _FINE_SPAN + _FINE / 2, _FINE)
    per_part = grams.explained_by_part(fine, _IN_JACKKNIFE, _IN_JACKKNIFE)
    if np.argmax(per_part[:, 0]) in (0, fine.size - 1):
        return None  # no peak but a slope: the true one lies outside the search
    lag = _vertex(fine, per_part[:, 0])
    parts = np.array([_vertex(fine, per_part[:, k]) for k in range(1, per_part.shape[1])])
    sigma = float(_jackknife(parts))
    return Lag(lag, max(sigma, 1e-3), float(np.max(per_part[:, 0])))


class Fit(NamedTuple):
    """Regression of increments without a lag.

    Attributes
    ----------
    coefficients, sigma : ndarray, shape (p,)
        y ≈ x @ coefficients, and their 1σ by the jackknife.
    response, response_sigma : ndarray, shape (p,)
        x ≈ y · response, likewise: meaningful also where some x have hardly moved.
    explained : float
        Share of the variance explained.
    """

    coefficients: FloatArray
    sigma: FloatArray
    response: FloatArray
    response_sigma: FloatArray
    explained: float


def fit_increments(
    time: FloatArray, integral: FloatArray, start: FloatArray, end: FloatArray, y: FloatArray
) -> Fit:
    """Return the regression of y, shape (m,), on increments of `integral`; see `find_lag`.

    Too few intervals explain nothing.
    """
    grams = _Grams(time, integral, start, end, y[:, None])
    blocks = grams.at([0.0])[0]
    blocks = blocks.reshape(-1, _IN_JACKKNIFE, *blocks.shape[1:]).sum(axis=1)
    total = blocks.sum(axis=0)
    p = integral.shape[1]
    if total[0, 0] < _MIN_ROWS:
        return Fit(*(np.zeros(p), np.full(p, np.inf)) * 2, 0.0)
    solution, response = _solve(total)[1:], _response(total)
    without = total - blocks
    sigma = _jackknife(np.array([_solve(gram)[1:] for gram in without]))
    response_sigma = _jackknife(np.array([_response(gram) for gram in without]))
    return Fit(solution, sigma, response, response_sigma, float(grams.share(total[None])[0]))


def _solve(gram: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(gram[:-1, :-1], gram[:-1, -1], rcond=None)[0], dtype=float)


def _response(gram: FloatArray) -> FloatArray:
    """Return cov(x, y) / var(y)."""
    centred = gram[1:, 1:] - np.outer(gram[0, 1:], gram[0, 1:]) / max(gram[0, 0], 1.0)
    variance = float(centred[-1, -1])
    return centred[:-1, -1] / variance if variance > 0.0 else np.zeros(len(centred) - 1)


def _jackknife(parts: FloatArray) -> FloatArray:
    """Return 1σ from the results with one block left out each, along the first axis."""
    n = len(parts)
    spread = ((parts - parts.mean(axis=0)) ** 2).sum(axis=0)
    return np.asarray(np.sqrt((n - 1) / n * spread))


class _Grams:
    """Sums of products of (1, x(lag), y), per block of the drive, for many lags at a time."""

    def __init__(self, time, integral, start, end, y) -> None:
        self.time = time
        grid = np.arange(time[0], time[-1] + _GRID, _GRID)
        self.integral = np.column_stack([np.interp(grid, time, c) for c in integral.T])
        self.p, self.q = integral.shape[1], y.shape[1]
        good = np.isfinite(y).all(1)
        self.start, self.end, self.y = start[good], end[good], y[good]
        # Neighbours make a block.
        self.edges = -(-np.arange(_BLOCKS + 1) * len(self.y) // _BLOCKS)

    def at(self, lags: ArrayLike) -> FloatArray:
        """Return the sums per lag and block, shape (lags, blocks, 1 + p + q, 1 + p + q)."""
        lags = np.asarray(lags, dtype=float)
        pieces = np.array_split(lags, -(-lags.size // _LAGS_AT_ONCE))
        return np.concatenate([self._at_once(piece[:, None]) for piece in pieces])

    def _at_once(self, lag: FloatArray) -> FloatArray:
        a, b = self.start + lag, self.end + lag
        rows = np.empty((*a.shape, 1 + self.p + self.q))
        rows[..., 0] = 1.0
        rows[..., 1 : 1 + self.p] = self._integral_at(b) - self._integral_at(a)
        rows[..., 1 + self.p :] = self.y
        # Only intervals that lie inside the other sensor's data.
        rows *= ((a >= self.time[0]) & (b <= self.time[-1]))[..., None]
        parts = [rows[:, i:j] for i, j in zip(self.edges[:-1], self.edges[1:], strict=True)]
        return np.stack([np.swapaxes(part, 1, 2) @ part for part in parts], axis=1)

    def _integral_at(self, time: FloatArray) -> FloatArray:
        position = (time - self.time[0]) / _GRID
        k = np.clip(position.astype(int), 0, len(self.integral) - 2)
        before = self.integral[k]
        return before + (position - k)[..., None] * (self.integral[k + 1] - before)

    def explained_by_part(self, lags: FloatArray, together: int, step: int = 1) -> FloatArray:
        """Return the share explained with all blocks (column 0) and with some left out each.

        So many blocks `together` at a time, beginning at every `step`-th.
        """
        blocks = self.at(lags)
        total = blocks.sum(axis=1)
        first = range(0, _BLOCKS + 1 - together, step)
        without = [total - blocks[:, k : k + together].sum(axis=1) for k in first]
        return np.column_stack([self.share(total), *(self.share(gram) for gram in without)])

    def share(self, gram: FloatArray) -> FloatArray:
        """Return 1 − residual/variance, both summed over the columns of y."""
        k = 1 + self.p
        regressors = gram[:, :k, :k] + np.eye(k) * 1e-12 * np.trace(
            gram[:, :k, :k], axis1=1, axis2=2
        )[:, None, None].clip(1e-12)
        cross = gram[:, :k, k:]
        fitted = np.einsum("nij,nij->n", cross, np.linalg.solve(regressors, cross))
        mean = np.einsum("ni,ni->n", gram[:, 0, k:], gram[:, 0, k:]) / gram[:, 0, 0].clip(1.0)
        square = np.trace(gram[:, k:, k:], axis1=1, axis2=2)
        enough = gram[:, 0, 0] >= _MIN_ROWS / 2
        variance = square - mean
        share = (fitted - mean) / np.where(variance > 0.0, variance, np.inf)
        return np.where(enough, share, 0.0)


def _peak(shares: FloatArray, lags: FloatArray, expected: tuple[float, ...]) -> float | None:
    """Return the lag with the largest share; a small one unless a large one is beyond doubt.

    `shares` as of `_Grams.explained_by_part`.
    """
    share = shares[:, 0]
    if not np.isfinite(share).any() or np.nanmax(share) <= 0.0:
        return None
    best = int(np.nanargmax(share))
    near = np.abs(lags) <= _NEAR
    if not near.any():
        return float(lags[best]) if _alone(shares, lags, best, ()) else None
    small = int(np.flatnonzero(near)[np.nanargmax(share[near])])
    if best == small:
        return float(lags[best])
    far_better = 1.0 - share[best] < 0.5 * (1.0 - share[small])
    return float(lags[best if far_better and _alone(shares, lags, best, expected) else small])


def _alone(shares: FloatArray, lags: FloatArray, best: int, expected: tuple[float, ...]) -> bool:
    """Tell whether no other lag explains as much, whichever part of the drive is left out."""
    others = np.abs(lags - lags[best]) > _APART
    if any(abs(abs(lags[best]) - lag) < _EXPECTED for lag in expected):
        others &= np.abs(lags) <= _NEAR
    if not others.any():
        return True
    ahead = shares[best] - shares[others].max(axis=0)
    return bool((ahead[1:] > _AHEAD * ahead[0]).all())


def _vertex(lags: FloatArray, share: FloatArray) -> float:
    """Return the lag of the largest share, refined by the parabola through its neighbours."""
    k = int(np.clip(np.argmax(share), 1, lags.size - 2))
    left, middle, right = share[k - 1 : k + 2]
    curve = left - 2.0 * middle + right
    if curve >= 0.0:
        return float(lags[k])
    return float(lags[k] + 0.5 * (lags[1] - lags[0]) * np.clip((left - right) / curve, -1, 1))
