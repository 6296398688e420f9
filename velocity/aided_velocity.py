"""The velocity of an epoch by Doppler and an attitude, with all that is needed to judge it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..filters.rotation import FloatArray
from .least_squares import _no_matrix, _no_rows, _no_vector


@dataclass(frozen=True, eq=False)
class AidedVelocity:
    """Velocity of one epoch from Doppler and attitude, with everything needed to judge it.

    Attributes
    ----------
    time : float
        GPS time [s].
    status : {'ok', 'too few satellites', 'singular geometry', 'inconsistent'}
        Numbers below are NaN unless 'ok'.
    speed : float
        Signed forward speed at the point the wheels constrain [m/s].
    sigma_doppler, sigma_attitude : float
        1σ of `speed` from range rates (and a known drift), and from the attitude [m/s]. For a
        pair the former is √2·λσ_D/k.
    clock_drift, sigma_clock_drift : float
        c·δṫ_r [m/s] and its 1σ from the range rates.
    vel_e : ndarray, shape (3,)
        Antenna velocity, ECEF [m/s]: eq. (20) with the lever arm's share.
    noise_cov_e : ndarray, shape (3, 3)
        Its covariance from range rates and `sigma_cross`, without the attitude [m²/s²].
    cov_e : ndarray, shape (3, 3)
        Its covariance, attitude included.
    attitude_e : ndarray, shape (3, 3)
        d(vel_e)/dφ', φ' the error of the attitude used (module docstring). A filter whose own
        attitude was used takes `noise_cov_e` and this, not `cov_e`.
    swing_e : ndarray, shape (3, 3)
        d(vel_e)/d(swing_e), `swing_e` of the motion used: I − u gᵀE.
    k : float
        |SDV·RMD| of a pair; for more satellites that of a pair as good, √2·σ_rms/σ_s; for one
        satellite |e·u|.
    satellites : tuple of str
        Used satellites.
    row : ndarray of int
        Used rows of the observations.
    residuals : ndarray
        z − model of the used rows [m/s].
    rejected : tuple of int
        Rows of the observations excluded by the residual test.
    dof : int
        Used rows − 2. With 0 nothing has checked the solution.
    chi2, variance_factor : float
        Σ(residual/σ)², and max(1, chi2/dof), which is in all covariances.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import DopplerRows, ForwardMotion, ddia_velocity
    >>> e_e = np.array([[0.8, 0.0, 0.6], [-0.6, 0.0, 0.8]])  # two satellites, ahead and behind
    >>> motion = ForwardMotion([1.0, 0.0, 0.0], [0.0, 0.0, 0.0], 1e-5 * np.eye(3))
    >>> z = e_e @ [10.0, 0.0, 0.0] - 30.0  # 10 m/s forward, clock drift 30 m/s
    >>> rows = DopplerRows(np.arange(2), np.array(["G01", "G02"]), e_e, z, np.full(2, 0.05))
    >>> found = ddia_velocity(rows, motion, time=0.0)
    >>> found.vel_e.round(6), found.dof  # nothing has checked it
    (array([10.,  0.,  0.]), 0)
    >>> ddia_velocity(rows, motion, time=0.0, min_k=2.0).status
    'singular geometry'
    """

    time: float
    status: str
    speed: float = np.nan
    sigma_doppler: float = np.nan
    sigma_attitude: float = np.nan
    clock_drift: float = np.nan
    sigma_clock_drift: float = np.nan
    vel_e: FloatArray = field(default_factory=_no_vector)
    noise_cov_e: FloatArray = field(default_factory=_no_matrix)
    cov_e: FloatArray = field(default_factory=_no_matrix)
    attitude_e: FloatArray = field(default_factory=_no_matrix)
    swing_e: FloatArray = field(default_factory=_no_matrix)
    k: float = np.nan
    satellites: tuple[str, ...] = ()
    row: NDArray[np.int64] = field(default_factory=_no_rows)
    residuals: FloatArray = field(default_factory=lambda: np.zeros(0))
    rejected: tuple[int, ...] = ()
    dof: int = 0
    chi2: float = np.nan
    variance_factor: float = np.nan

    def __repr__(self) -> str:
        if not self.ok:
            return f"AidedVelocity(t = {self.time:.3f} s, {self.status})"
        sigma = np.hypot(self.sigma_doppler, self.sigma_attitude)
        return (
            f"AidedVelocity(t = {self.time:.3f} s, {self.speed:.2f} ± {sigma:.2f} m/s forward, "
            f"k = {self.k:.2f}, {len(self.satellites)} satellites, {len(self.rejected)} rejected)"
        )

    @property
    def ok(self) -> bool:
        """True if there is a velocity."""
        return self.status == "ok"
