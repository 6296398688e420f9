"""All satellite pairs of all epochs at once, and the n-satellite speed of all epochs at once.

What `ddia` does for one epoch with everything needed to judge it, this does for millions of pairs
with only the numbers that thresholds and statistics look at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...filters.rotation import FloatArray
from ..range_rate import DopplerRows
from ..vehicle_motion import ForwardMotion

IntArray = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs i < j of rows of the same epoch, shape (m,) each unless said otherwise.

    Attributes
    ----------
    epoch : ndarray of int
        Number of the epoch, ascending.
    a, b : ndarray of int
        The pair's rows.
    k : ndarray
        |SDV·RMD|, un-normalised: √2σ/k is the speed's 1σ.
    cosine : ndarray
        k divided by the length of the SDV.
    cn0_mean, cn0_min : ndarray
        [dB-Hz].
    elevation_min : ndarray
        [rad].
    speed : ndarray
        Eq. (20) [m/s]; not finite for k = 0.
    sigma : ndarray
        Its 1σ from the range rates [m/s].
    residual : ndarray
        Disagreement with the n-satellite solution of the epoch, in units of its own σ; NaN
        where there are only two satellites and nothing to disagree with.
    counts : ndarray of int, shape (epochs,)
        Rows of every epoch, those without pairs included.
    """

    epoch: IntArray
    a: IntArray
    b: IntArray
    k: FloatArray
    cosine: FloatArray
    cn0_mean: FloatArray
    cn0_min: FloatArray
    elevation_min: FloatArray
    speed: FloatArray
    sigma: FloatArray
    residual: FloatArray
    counts: IntArray

    def __len__(self) -> int:
        return self.k.size

    def __repr__(self) -> str:
        return f"Pairs({len(self)} pairs, {self.counts.size} epochs)"


@dataclass(frozen=True, eq=False)
class EpochSpeeds:
    """n-satellite speeds (module `ddia`) of all epochs, shape (epochs,) each.

    Attributes
    ----------
    speed, clock_drift : ndarray
        [m/s]; NaN where fewer than two rows or no geometry.
    sigma : ndarray
        1σ of `speed` from the range rates [m/s].
    k : ndarray
        Equivalent |SDV·RMD|; 0 where there is no geometry.
    """

    speed: FloatArray
    clock_drift: FloatArray
    sigma: FloatArray
    k: FloatArray

    def __repr__(self) -> str:
        known = int(np.isfinite(self.speed).sum())
        return f"EpochSpeeds({self.speed.size} epochs, {known} with a speed)"


def pair_indices(counts: ArrayLike) -> tuple[IntArray, IntArray, IntArray]:
    """Return epoch, first and second row of all pairs i < j, rows being sorted by epoch.

    Parameters
    ----------
    counts : array_like of int, shape (epochs,)
        Rows of each epoch.
    """
    counts = np.asarray(counts, dtype=np.int64)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    size = counts * (counts - 1) // 2
    begin = np.concatenate([[0], np.cumsum(size)])
    a, b = np.empty(begin[-1], dtype=np.int64), np.empty(begin[-1], dtype=np.int64)
    for n in np.unique(counts[counts > 1]):
        i, j = np.triu_indices(n, 1)
        which = np.flatnonzero(counts == n)
        where = begin[which, None] + np.arange(i.size)
        a[where], b[where] = first[which, None] + i, first[which, None] + j
    return np.repeat(np.arange(counts.size), size), a, b


def projected(
    rows: DopplerRows, epoch: ArrayLike, motion: ForwardMotion
) -> tuple[FloatArray, FloatArray]:
    """Return h and y of ``y = h·s − cδṫ_r``, shape (n,) each.

    Parameters
    ----------
    rows : DopplerRows
    epoch : array_like of int, shape (n,)
        Entry of `motion` that belongs to each row.
    motion : ForwardMotion
        One entry per epoch.
    """
    epoch = np.asarray(epoch, dtype=np.int64)
    h = np.einsum("ij,ij->i", rows.e_e, motion.u_e[epoch])
    return h, rows.z - np.einsum("ij,ij->i", rows.e_e, motion.swing_e[epoch])


def epoch_speeds(
    h: FloatArray, y: FloatArray, sigma: FloatArray, epoch: IntArray, epochs: int
) -> EpochSpeeds:
    """Return the `EpochSpeeds` of weighted least squares in [s, cδṫ_r], no row excluded."""

    def total(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(epoch, values, epochs), dtype=float)

    weight = sigma**-2
    with np.errstate(invalid="ignore", divide="ignore"):
        h_mean, y_mean = total(weight * h) / total(weight), total(weight * y) / total(weight)
        centred = h - h_mean[epoch]
        spread = total(weight * centred**2)
        count = total(np.ones(h.size))
        k = np.sqrt(2.0 * total(sigma**2) / count * spread)
        solvable = (count >= 2) & (spread > 0.0)
        speed = np.where(solvable, total(weight * centred * (y - y_mean[epoch])) / spread, np.nan)
        return EpochSpeeds(
            speed,
            h_mean * speed - y_mean,
            np.where(solvable, spread**-0.5, np.nan),
            np.where(solvable, k, 0.0),
        )


def all_pairs(
    rows: DopplerRows,
    epoch: ArrayLike,
    motion: ForwardMotion,
    cn0: ArrayLike,
    elevation: ArrayLike,
) -> Pairs:
    """Return every pair of satellites observed together.

    Parameters
    ----------
    rows : DopplerRows
        Sorted by epoch, one signal per satellite.
    epoch : array_like of int, shape (n,)
        Number of each row's epoch, ascending; epochs are numbered as in `motion`.
    motion : ForwardMotion
        One entry per epoch.
    cn0, elevation : array_like, shape (n,)
        Of each row [dB-Hz], [rad]; NaN where unknown.
    """
    epoch = np.asarray(epoch, dtype=np.int64)
    cn0, elevation = np.asarray(cn0, dtype=float), np.asarray(elevation, dtype=float)
    epochs = motion.u_e.shape[0]
    counts = np.bincount(epoch, minlength=epochs)
    number, a, b = pair_indices(counts)
    h, y = projected(rows, epoch, motion)
    joint = epoch_speeds(h, y, rows.sigma, epoch, epochs)
    left = y - h * joint.speed[epoch] + joint.clock_drift[epoch]
    left[counts[epoch] < 3] = np.nan
    along = h[a] - h[b]
    k = np.abs(along)
    variance = rows.sigma**2
    sigma = np.sqrt(variance[a] + variance[b])
    # |e_A − e_B|² = e_A² + e_B² − 2 e_A·e_B; the scale κ in e_e is 1 to a few 1e-6.
    square = np.einsum("ij,ij->i", rows.e_e, rows.e_e)
    sdv = np.sqrt(square[a] + square[b] - 2.0 * np.einsum("ij,ij->i", rows.e_e[a], rows.e_e[b]))
    with np.errstate(invalid="ignore", divide="ignore"):
        return Pairs(
            epoch=number,
            a=a,
            b=b,
            k=k,
            cosine=np.where(sdv > 0.0, k / sdv, 0.0),
            cn0_mean=0.5 * (cn0[a] + cn0[b]),
            cn0_min=np.minimum(cn0[a], cn0[b]),
            elevation_min=np.minimum(elevation[a], elevation[b]),
            speed=(y[a] - y[b]) / along,
            sigma=sigma / k,
            residual=(left[a] - left[b]) / sigma,
            counts=counts,
        )


def velocity_errors(
    speed: ArrayLike, epoch: ArrayLike, motion: ForwardMotion, ref_vel_e: ArrayLike
) -> FloatArray:
    """Return ‖Δv‖ of eqs. (21), (22) [m/s], shape of `speed`.

    Parameters
    ----------
    speed : array_like, shape (m,)
        Forward speeds [m/s].
    epoch : array_like of int, shape (m,)
        Their epochs.
    motion : ForwardMotion
        One entry per epoch.
    ref_vel_e : array_like, shape (epochs, 3)
        True antenna velocity [m/s].
    """
    speed, epoch = np.asarray(speed, dtype=float), np.asarray(epoch, dtype=np.int64)
    true_e = np.asarray(ref_vel_e, dtype=float) - motion.swing_e
    along = np.einsum("ij,ij->i", true_e, motion.u_e)
    across = np.sum((true_e - along[:, None] * motion.u_e) ** 2, axis=1)
    return np.sqrt((speed - along[epoch]) ** 2 + across[epoch])
