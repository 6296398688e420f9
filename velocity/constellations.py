"""Constellations against each other: does the Doppler of each agree, and how noisy is it?

One receiver has one clock drift, whatever it listens to. In every epoch each constellation but the
largest is given a drift of its own,

    z = e·v_e − cδṫ_r − b_s,

and b_s has to vanish over the recording: with a wrong carrier frequency (GLONASS channels), wrong
ephemerides of a whole constellation, or a wrong sign it does not. What is left of the rows tells
how noisy each constellation is beside the largest, at the C/N0 it has.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..filters.rotation import FloatArray
from .range_rate import DopplerRows

#: Epochs looked at, evenly over the recording: an offset is then known to a tenth of one epoch's.
_EPOCHS = 300
#: Fewer epochs, or rows, say nothing about a constellation.
_FEWEST, _FEWEST_ROWS = 20, 60
#: An offset counts beyond so many σ of its own …
_SIGNIFICANT = 5.0
#: … and this share of the noise of its rows: less does no harm.
_HARMFUL = 0.5
_PASSES = 3
#: Residuals below this share of σ are a simulator's: they tell of no noise.
_NOISELESS = 1e-3
#: MAD of a normal distribution times this is its σ.
_MAD = 1.4826
#: No constellation's noise is that many times the other's: it is wrong instead.
_LARGEST = 10.0


@dataclass(frozen=True)
class Constellation:
    """One constellation beside the largest.

    Attributes
    ----------
    letter : str
    rows, epochs : int
        Looked at.
    offset, offset_sigma : float
        Its own clock drift less the others', and 1σ [m/s].
    noise : float
        σ of its range rates over σ of the largest constellation's, C/N0 allowed for.
    disagrees : bool
        Whether its Doppler is not that of the same receiver.
    """

    letter: str
    rows: int
    epochs: int
    offset: float
    offset_sigma: float
    noise: float
    disagrees: bool


def compare_constellations(rows: DopplerRows, epoch: NDArray[np.int64]) -> list[Constellation]:
    """Return each constellation but the largest, held against it.

    Parameters
    ----------
    rows : DopplerRows
        Of a recording, in order of time.
    epoch : ndarray of int, shape (n,)
        Number of each row's epoch.
    """
    letters = rows.sat.astype("U1")
    names, count = np.unique(letters, return_counts=True)
    if names.size < 2:
        return []
    largest = str(names[np.argmax(count)])
    factor = dict.fromkeys((str(name) for name in names), 1.0)
    for _ in range(_PASSES):  # who is noisy spoils the residuals of the others until it is known
        sigma = rows.sigma * np.array([factor[str(name)] for name in letters])
        offsets: dict[str, list[float]] = {name: [] for name in factor}
        left: dict[str, list[float]] = {name: [] for name in factor}
        for here in _some(epoch):
            found = _solved(rows, sigma, letters, here, largest)
            if found is None:
                continue
            for name, offset in found[0].items():
                offsets[name].append(offset)
            for name, residual in zip(letters[here], found[1], strict=True):
                left[str(name)].append(float(residual))
        spread = {name: _MAD * float(np.median(np.abs(r))) for name, r in left.items() if r}
        if len(left[largest]) < _FEWEST_ROWS:
            return []
        for name, size in spread.items():
            if min(size, spread[largest]) > _NOISELESS:
                factor[name] = float(
                    np.clip(factor[name] * size / spread[largest], 1 / _LARGEST, _LARGEST)
                )
    out = []
    for name in (str(n) for n in names if n != largest):
        n = len(offsets[name])
        if n < _FEWEST or len(left[name]) < _FEWEST_ROWS:
            continue
        values = np.array(offsets[name])
        offset = float(np.median(values))
        known = 1.25 * _MAD * float(np.median(np.abs(values - offset))) / np.sqrt(n)
        size = float(np.median(rows.sigma[letters == name]))
        noise = max(factor[name], 1.0)
        wrong = abs(offset) > max(_SIGNIFICANT * known, _HARMFUL * size)
        out.append(
            Constellation(name, len(left[name]), n, offset, float(known), noise, bool(wrong))
        )
    return out


def _some(epoch: NDArray[np.int64]) -> Iterator[slice]:
    """Yield the rows of some hundred epochs."""
    starts = np.flatnonzero(np.diff(epoch, prepend=-1))
    stops = np.append(starts[1:], epoch.size)
    step = max(1, starts.size // _EPOCHS)
    for a, b in zip(starts[::step], stops[::step], strict=True):
        yield slice(int(a), int(b))


def _solved(
    rows: DopplerRows, sigma: FloatArray, letters: NDArray, here: slice, largest: str
) -> tuple[dict[str, float], FloatArray] | None:
    """Return the drifts of the other constellations, and residuals of unit variance over σ."""
    names = [str(n) for n in np.unique(letters[here]) if n != largest]
    drifts = [np.ones(len(rows.z[here])), *(letters[here] == n for n in names)]
    H = np.column_stack([rows.e_e[here], *(-np.asarray(d, dtype=float) for d in drifts)])
    if largest not in letters[here] or len(H) < H.shape[1] + 1:
        return None
    weight = 1.0 / sigma[here]
    A = H * weight[:, None]
    Q, R = np.linalg.qr(A)
    if np.abs(np.diag(R)).min() < 1e-6 * np.abs(np.diag(R)).max():
        return None
    x = np.linalg.solve(R, Q.T @ (rows.z[here] * weight))
    redundant = 1.0 - np.sum(Q**2, axis=1)
    residual = (rows.z[here] * weight - A @ x) / np.sqrt(np.maximum(redundant, 0.05))
    return dict(zip(names, (float(v) for v in x[4:]), strict=True)), residual
