"""What one wrong sensor does to the solution: the filter's response to lasting errors, and their
size as far as the data bound it.

The filter is linear about its trajectory. A bias b of a measurement, z = H δx + s b + noise, moves
the estimate by v b, and with the filter's own gains

    over a prediction by Φ:  v ← Φ v        over an update:  v ← v + K (s − H v).

For each fault (one satellite's pseudorange, its Doppler, sideslip …) b is constant for `BLOCK`
seconds, and then another. What it has moved the estimate by is

    u + v b + G ξ,

u as estimated from past blocks, G ξ what is wrong with that, ξ of unit variance. How large b and ξ
are say the measurements among themselves (`Biases`: b plus noise and what lasts, the first of the
ξ), and the filter's innovations: z + H u = (s − H v) b − H G ξ + innovation of a sound filter
(B. Friedland 1969, treatment of bias in recursive filtering). Both are least squares of a few
unknowns, θ = (b, ξ), a fault. The estimate less what it has been moved by is the solution that does
not believe the sensor, and the covariance of θ what that costs: solution separation, without a
filter for each satellite.
"""

from __future__ import annotations

import numpy as np

from ....filters.error_model import POS
from ....filters.measurements import Biases, Measurement
from ....filters.rotation import FloatArray

#: How long errors last that are gone after a while [s]: reflections. In it all fixes are one.
BLOCK = 30.0
#: Columns: v of the present block; u; those of G, the first of them what lasts.
NOW, PAST, LASTING, REST = 0, 1, 2, 3
#: Columns of G beside it: what is wrong with all past blocks together has few directions.
_DIRECTIONS = 3
#: θ by columns.
THETA = np.array([NOW, *range(LASTING, REST + _DIRECTIONS)])
#: A fault that was not offered in a block and has moved the estimate by less is forgotten [m].
_FORGOTTEN = 1e-3


class Responses:
    """Goes along with a filter (`filters.ekf.ErrorStateFilter.follow`).

    Parameters
    ----------
    time : float
        Of the filter's start [s].
    states : int
        Length of its error state.

    Attributes
    ----------
    names : list of str
        Faults followed.
    columns : ndarray, shape (6, states, len(names))
        See `NOW`, `PAST`, `LASTING`, `REST`.
    """

    def __init__(self, time: float, states: int) -> None:
        self.names: list[str] = []
        self.columns = np.zeros((REST + _DIRECTIONS, states, 0))
        self._index: dict[str, int] = {}
        self._begin = self._time = time
        size = THETA.size
        self._known = _Known(
            np.zeros((0, size, size)), np.zeros((0, size)), np.zeros((4, 0)), np.zeros((3, 0))
        )

    def begin(self, biases: Biases) -> None:
        """Take the position that the filter starts with."""
        at = self._at(biases)
        self.columns[NOW, POS, at] = biases.dz.T
        self._known.hear(at, biases)

    def predict(self, time: float, phi: FloatArray, P: FloatArray) -> None:
        """See `filters.ekf.Follower`."""
        self.columns = phi @ self.columns
        self._time = time

    def correct(self, P: FloatArray, measurement: Measurement) -> None:
        """See `filters.ekf.Follower`."""
        # Here, for how far a prediction goes at a time is the smoother's choice, too.
        if self._time - self._begin >= BLOCK:
            self._close(np.sqrt(np.diag(P)))
            self._begin = self._time
        H, biases = measurement.H, measurement.biases
        at = self._at(biases) if biases is not None else None
        HP, change = H @ P, -(H @ self.columns)
        S = HP @ H.T + measurement.R
        if biases is None or at is None:
            self.columns += np.linalg.solve(S, HP).T @ change
            return
        change[NOW][:, at] += biases.dz
        theirs = change[:, :, at]
        rows = theirs[THETA].transpose(1, 2, 0)  # (m, faults, t)
        weighted = np.linalg.solve(S, np.hstack([HP, rows.reshape(len(S), -1)]))
        gain, weighted = weighted[:, : len(P)].T, weighted[:, len(P) :].reshape(rows.shape)
        innovation = measurement.z[:, None] - theirs[PAST]
        self._known.innovated(at, rows, weighted, innovation)
        self._known.hear(at, biases)
        self.columns += gain @ change

    def moved(self, states: slice = slice(None)) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return by how much each fault has moved some of the states.

        Returns
        -------
        moved : ndarray, shape (faults, n)
        W : ndarray, shape (faults, t, n)
            What θ moves.
        cov : ndarray, shape (faults, t, t)
            Covariance of θ: what is not known of `moved` has the covariance Wᵀ cov W.
        """
        theta, cov = self._known.solved()
        W = self.columns[THETA, states].transpose(2, 0, 1)
        return self.columns[PAST, states].T + (theta[:, None] @ W)[:, 0], W, cov

    def _at(self, biases: Biases) -> np.ndarray:
        """Return the columns of some faults, new ones for those not known yet."""
        new = [name for name in biases.names if name not in self._index]
        if new:
            self._index.update({name: len(self.names) + k for k, name in enumerate(new)})
            self.names += new
            empty = np.zeros((*self.columns.shape[:2], len(new)))
            self.columns = np.concatenate([self.columns, empty], axis=2)
            self._known.more(len(new), biases.largest)
        return np.array([self._index[name] for name in biases.names], dtype=int)

    def _close(self, sigma: FloatArray) -> None:
        """End a block: its biases are known as far as they will be, and the next are others."""
        columns = self.columns
        moved, W, cov = self.moved()
        lasts = cov[:, 1, 1]
        with_lasting = cov[:, :, 1] / lasts[:, None]
        apart = cov - lasts[:, None, None] * np.einsum("qa,qb->qab", with_lasting, with_lasting)
        columns[PAST] = moved.T
        columns[LASTING] = np.einsum("qt,qtn->nq", with_lasting, W)
        columns[REST:] = _fewer(W, apart, sigma).transpose(1, 2, 0)
        columns[NOW] = 0.0
        offered = self._known.next_block()
        alive = offered | (np.abs(columns[:, POS]).max(axis=(0, 1)) > _FORGOTTEN)
        if not alive.all():
            self.columns = columns[:, :, alive]
            self._known.keep(alive)
            self.names = [name for name, keep in zip(self.names, alive, strict=True) if keep]
            self._index = {name: k for k, name in enumerate(self.names)}


class _Known:
    """Least squares of θ for all faults.

    Parameters
    ----------
    J : ndarray, shape (q, t, t)
        Information of this block's innovations.
    j : ndarray, shape (q, t)
        The same times θ.
    heard : ndarray, shape (4, q)
        Of what measurements say among themselves: sum of weights, weighted sums of the biases, of
        their noise and of what lasts.
    prior : ndarray, shape (3, q)
        Largest b; mean and variance of what lasts, as known before this block.
    """

    def __init__(self, J: FloatArray, j: FloatArray, heard: FloatArray, prior: FloatArray) -> None:
        self.J, self.j, self.heard, self.prior = J, j, heard, prior

    def more(self, count: int, largest: float) -> None:
        """Begin to follow more faults."""
        size = THETA.size
        new = np.array([largest, 0.0, 1.0])[:, None].repeat(count, axis=1)
        self.J = np.concatenate([self.J, np.zeros((count, size, size))])
        self.j = np.concatenate([self.j, np.zeros((count, size))])
        self.heard = np.concatenate([self.heard, np.zeros((4, count))], axis=1)
        self.prior = np.concatenate([self.prior, new], axis=1)

    def keep(self, alive: np.ndarray) -> None:
        """Follow these alone."""
        self.J, self.j = self.J[alive], self.j[alive]
        self.heard, self.prior = self.heard[:, alive], self.prior[:, alive]

    def innovated(
        self, at: np.ndarray, rows: FloatArray, weighted: FloatArray, innovation: FloatArray
    ) -> None:
        """Hear an innovation (m, q): its derivative by θ (m, q, t), and S⁻¹ times that."""
        self.J[at] += rows.transpose(1, 2, 0) @ weighted.transpose(1, 0, 2)
        self.j[at] += np.einsum("mqa,mq->qa", weighted, innovation)

    def hear(self, at: np.ndarray, biases: Biases) -> None:
        """Hear what measurements say among themselves."""
        if biases.estimate is None or biases.noise is None or biases.lasting is None:
            return
        known = np.isfinite(biases.noise)
        noise, lasting = biases.noise[known], biases.lasting[known]
        weight = 1.0 / (noise**2 + lasting**2)
        self.heard[:, at[known]] += weight * [
            np.ones(weight.size), biases.estimate[known], noise, lasting
        ]  # fmt: skip

    def solved(self) -> tuple[FloatArray, FloatArray]:
        """Return θ and its covariance."""
        weight, bias, noise, lasting = self.heard
        largest, mean, variance = self.prior
        total = np.where(weight > 0.0, weight, 1.0)
        # Within a block noise is no smaller on the average than once.
        row = np.zeros((len(self.J), THETA.size))
        row[:, 0], row[:, 1] = 1.0, lasting / total
        once = np.where(weight > 0.0, 1.0 / np.maximum(noise / total, 1e-3) ** 2, 0.0)
        J = self.J + once[:, None, None] * row[:, :, None] * row[:, None, :]
        j = self.j + (once * (bias - lasting * mean) / total)[:, None] * row
        least = np.ones_like(row)
        least[:, 0], least[:, 1] = largest**-2, 1.0 / variance
        cov: FloatArray = np.linalg.inv(J + least[:, :, None] * np.eye(THETA.size)).astype(float)
        return np.einsum("qab,qb->qa", cov, j), cov

    def next_block(self) -> np.ndarray:
        """Begin a block; return which faults were offered in the last."""
        offered = self.J.any(axis=(1, 2)) | self.heard.any(axis=0)
        theta, cov = self.solved()
        self.prior[1] += theta[:, 1]
        self.prior[2] = cov[:, 1, 1]
        self.J[:], self.j[:], self.heard[:] = 0.0, 0.0, 0.0
        return np.asarray(offered)


def _fewer(W: FloatArray, cov: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return `_DIRECTIONS` columns for W θ, whose products are about its covariance.

    The largest of their principal axes in units of σ of the filter's states, in size for all.

    Parameters
    ----------
    W : ndarray, shape (q, t, n)
    cov : ndarray, shape (q, t, t)
        Of θ.
    sigma : ndarray, shape (n,)
    """
    value, vector = np.linalg.eigh(cov)
    root = vector * np.sqrt(np.maximum(value, 0.0))[:, None, :]
    columns = np.einsum("qta,qtn->qan", root, W)
    scaled = columns / sigma
    value, vector = np.linalg.eigh(scaled @ np.swapaxes(scaled, 1, 2))
    value = np.maximum(value, 0.0)
    kept = value[:, -_DIRECTIONS:].sum(axis=1)
    more = np.sqrt(np.where(kept > 0.0, value.sum(axis=1) / np.where(kept > 0.0, kept, 1.0), 1.0))
    largest = np.einsum("qab,qan->qbn", vector[:, :, -_DIRECTIONS:], columns)
    return np.asarray(largest * more[:, None, None])
