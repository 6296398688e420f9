"""Protection levels: how far the position may be off at a stated risk, whichever sensor is wrong.

If fault i is the case, the estimate less what the fault has moved it by, m̂_i, is unbiased with a
covariance P_i (`responses`), and by the triangle inequality the error of the estimate exceeds

    |m̂_i| + k σ_i

at most with the probability that a Gaussian error exceeds k σ_i. The level is the largest of these
and of k σ for no fault at all. One of the cases is the case: however likely each is, the level is
exceeded with the risk that k stands for at most. No probability of faults has to be known; two at a
time are not covered.
"""

from __future__ import annotations

import numpy as np

from ....filters.earth import C_en_of
from ....filters.ekf import ErrorStateFilter
from ....filters.error_model import POS
from ....filters.measurements import Measurement
from ....filters.rotation import FloatArray
from .responses import Responses

#: Spacing of levels in time [s]; what changes them is updates, and without them they grow.
_SPACING, _WITHOUT = 1.0, 2.0
#: North, east and down are kept so far [m]: they turn by 0.01°.
_SAME_AXES = 1000.0


def factors(risk: float) -> tuple[float, float]:
    """Return k, horizontal and vertical, that an error exceeds in units of σ at a risk.

    Horizontally of the larger semi-axis, for equal ones: exp(−k²/2); of a smaller one less.
    """
    from scipy.special import ndtri  # slow to import

    return float(np.sqrt(-2.0 * np.log(risk))), float(-ndtri(0.5 * risk))


def semi_major(cov: FloatArray) -> FloatArray:
    """Return 1σ along the worst horizontal direction of covariances (…, ≥ 2, ≥ 2) [m]."""
    a, b, c = cov[..., 0, 0], cov[..., 1, 1], cov[..., 0, 1]
    worst = 0.5 * (a + b) + np.hypot(0.5 * (a - b), c)
    return np.asarray(np.sqrt(np.maximum(worst, 0.0)))


class Levels(Responses):
    """Responses of a filter, and the levels that follow, once a second before the updates.

    Parameters
    ----------
    kalman : ErrorStateFilter
        Just started.
    risk : float
        Probability of an error beyond the level, horizontally and vertically each.
    """

    def __init__(self, kalman: ErrorStateFilter, risk: float) -> None:
        super().__init__(kalman.time, kalman.model.size)
        self._kalman, self._factors, self._due = kalman, factors(risk), kalman.time
        self._place_e, self._C_ne = kalman.pos_e.copy(), C_en_of(kalman.pos_e).T
        self._made: list[tuple[float, float, float]] = []

    def predict(self, time: float, phi: FloatArray, P: FloatArray) -> None:
        """See `filters.ekf.Follower`."""
        super().predict(time, phi, P)
        if time >= self._due + _WITHOUT - _SPACING - 1e-3:
            self._make(P)

    def correct(self, P: FloatArray, measurement: Measurement) -> None:
        """See `filters.ekf.Follower`."""
        if self._time >= self._due - 1e-3:
            self._make(P)
        super().correct(P, measurement)

    def _make(self, P: FloatArray) -> None:
        self._made.append((self._time, *self.level(P)))
        self._due = self._time + _SPACING

    @property
    def made(self) -> FloatArray:
        """Time [s], horizontal and vertical level [m], shape (m, 3)."""
        return np.array(self._made).reshape(-1, 3)

    def level(self, P: FloatArray) -> tuple[float, float]:
        """Return the horizontal and the vertical level [m] for a covariance of the filter."""
        k_h, k_v = self._factors
        C_ne = self._axes()
        cov = C_ne @ P[POS, POS] @ C_ne.T
        horizontal, vertical = k_h * float(semi_major(cov)), k_v * float(np.sqrt(cov[2, 2]))
        if not self.names:
            return horizontal, vertical
        moved, W, cov_theta = self.moved(POS)
        away, W = moved @ C_ne.T, W @ C_ne.T
        covs = cov + np.swapaxes(W, 1, 2) @ cov_theta @ W
        of_each_h = np.hypot(away[:, 0], away[:, 1]) + k_h * semi_major(covs)
        of_each_v = np.abs(away[:, 2]) + k_v * np.sqrt(covs[:, 2, 2])
        return max(horizontal, float(of_each_h.max())), max(vertical, float(of_each_v.max()))

    def _axes(self) -> FloatArray:
        """Return C_ne where the filter is."""
        pos_e = self._kalman.pos_e
        if np.abs(pos_e - self._place_e).max() > _SAME_AXES:
            self._place_e, self._C_ne = pos_e.copy(), C_en_of(pos_e).T
        return self._C_ne
