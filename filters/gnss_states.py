"""Errors of GNSS that outlast an epoch: their estimates, and how they change by themselves.

The receiver's clock drift walks; the error that successive positions share fades with its
correlation time, and at once where a position comes from other satellites than the one before.
Where they stand in the error state says `filters.error_model.ErrorModel`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .rotation import FloatArray

if TYPE_CHECKING:
    from .error_model import ErrorModel

#: Initial 1σ of a receiver's clock drift [m/s]: 3 ppm, what any quartz keeps.
CLOCK_DRIFT_SIGMA = 1000.0


def shared_root(shared_cov_e: ArrayLike) -> FloatArray:
    """Return B with BBᵀ = the covariance of what positions share: their error is B b + noise.

    The symmetric root, so that a slowly changing covariance means a slowly changing error.
    """
    values, axes = np.linalg.eigh(np.asarray(shared_cov_e, dtype=float))
    root: FloatArray = (axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T
    return root


class GnssStates:
    """The GNSS errors of one filter.

    Parameters
    ----------
    model : ErrorModel

    Attributes
    ----------
    clock_drift : float
        Of the receiver [m/s]; 0 where it is no state.
    fix_bias : ndarray, shape (3,)
        Shared error of positions, in units of the root of its covariance (`shared_root`).
    """

    def __init__(self, model: ErrorModel) -> None:
        self.model = model
        self.clock_drift = 0.0
        self.fix_bias = np.zeros(3)

    def age(self, P: FloatArray, dt: float) -> FloatArray | None:
        """Let `dt` [s] pass: change P in place, return the transition matrix if it is not 1."""
        model = self.model
        if model.clock is not None:
            P[model.clock, model.clock] += model.clock_walk**2 * dt
        if model.fix_bias is None:
            return None
        return self._fade(P, float(np.exp(-dt / model.fix_correlation)))

    def other_satellites(self, P: FloatArray, overlap: float) -> tuple[FloatArray, FloatArray]:
        """Return P and the transition for a position that has little in common with the last.

        Parameters
        ----------
        P : ndarray, shape (n, n)
        overlap : float
            What the two have in common, 0 … 1, by satellites.
        """
        P = P.copy()
        return P, self._fade(P, overlap)

    def clock_forgotten(self, P: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return P and the transition for a clock that has jumped: its drift is unknown."""
        P, phi = P.copy(), np.eye(self.model.size)
        clock = self.model.clock
        if clock is not None:
            phi[clock, clock] = 0.0
            P[clock], P[:, clock] = 0.0, 0.0
            P[clock, clock] = CLOCK_DRIFT_SIGMA**2
        return P, phi

    def as_known(self, before: FloatArray, P: FloatArray) -> FloatArray:
        """Return P, enlarged for doubt, with the errors of fixes as well known as before.

        It is the solution that is doubted: a lasting error of positions that grew with it would
        take in whatever the solution is off by, and keep it for as long as it lasts.
        """
        bias = self.model.fix_bias
        if bias is None:
            return P
        scale = np.ones(len(P))
        was, now = np.diag(before)[bias], np.diag(P)[bias]
        scale[bias] = np.sqrt(np.divide(was, now, out=np.ones(len(now)), where=now > was))
        return np.asarray(P * scale[:, None] * scale)

    def feed_back(self, x: FloatArray) -> None:
        """Add the estimated errors, ordered as in the error model."""
        if self.model.clock is not None:
            self.clock_drift += float(x[self.model.clock])
        if self.model.fix_bias is not None:
            self.fix_bias += x[self.model.fix_bias]

    def _fade(self, P: FloatArray, factor: float) -> FloatArray:
        """Make the shared error `factor` of itself; its variance stays 1."""
        shared, phi = self.model.fix_bias, np.eye(self.model.size)
        if shared is None:
            return phi
        phi[shared] *= factor
        self.fix_bias *= factor
        P[shared] *= factor
        P[:, shared] *= factor
        P[shared, shared] += (1.0 - factor**2) * np.eye(3)
        return phi
