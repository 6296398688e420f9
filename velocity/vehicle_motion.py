"""What the attitude says about the velocity: a road vehicle moves where it points.

The antenna's velocity then has one unknown, the signed forward speed s at the point the wheels
constrain:

    v_e = s·u_e + swing_e,    u_e = C_eb C_bv (1, 0, 0)ᵀ,    swing_e = C_eb (ω_eb^b × l_b)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..filters.levers import lever_velocity
from ..filters.rotation import FloatArray


@dataclass(frozen=True, eq=False)
class ForwardMotion:
    """What the attitude says about the antenna's velocity, for one epoch or for many.

    Parameters
    ----------
    u_e : array_like, shape (..., 3)
        Unit vector of the vehicle's forward axis, ECEF.
    swing_e : array_like, shape (..., 3)
        Velocity of the antenna around the point the wheels constrain [m/s].
    att_cov_e : array_like, shape (3, 3) or (..., 3, 3)
        Covariance of the attitude error as a small rotation in ECEF axes [rad²].
    sigma_cross : float
        1σ, per axis, of the velocity across `u_e` that the vehicle has in spite of the
        constraint (sideslip, suspension) [m/s].

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import ForwardMotion
    >>> level = np.diag(np.radians([0.5, 0.5, 2.0]) ** 2)
    >>> motion = ForwardMotion([1.0, 0.0, 0.0], [0.0, 0.1, 0.0], level, sigma_cross=0.1)
    >>> motion.u_e
    array([1., 0., 0.])
    """

    u_e: FloatArray
    swing_e: FloatArray
    att_cov_e: FloatArray
    sigma_cross: float = 0.0

    def __post_init__(self) -> None:
        for name in ("u_e", "swing_e", "att_cov_e"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))

    def __repr__(self) -> str:
        cross = f"sigma_cross {self.sigma_cross:g} m/s"
        if self.u_e.ndim == 1:
            return f"ForwardMotion(one epoch, {cross})"
        return f"ForwardMotion({self.u_e.size // 3} epochs, {cross})"

    def take(self, rows: int | slice | NDArray) -> ForwardMotion:
        """Return the given epochs (a mask, indices, or one index)."""
        cov = self.att_cov_e if self.att_cov_e.ndim == 2 else self.att_cov_e[rows]
        return ForwardMotion(self.u_e[rows], self.swing_e[rows], cov, self.sigma_cross)


def forward_motion(
    C_eb: ArrayLike,
    omega_eb_b: ArrayLike,
    lever_antenna_b: ArrayLike,
    *,
    C_bv: ArrayLike | None = None,
    lever_vehicle_b: ArrayLike = (0.0, 0.0, 0.0),
    att_cov_e: ArrayLike | None = None,
    sigma_cross: float = 0.0,
) -> ForwardMotion:
    """Return direction and lever-arm velocity from the attitude (eqs. (15)–(19)).

    Parameters
    ----------
    C_eb : array_like, shape (..., 3, 3)
        IMU to ECEF.
    omega_eb_b : array_like, shape (..., 3)
        Angular rate with respect to the Earth, ω_ib^b − C_be ω_ie [rad/s].
    lever_antenna_b, lever_vehicle_b : array_like, shape (3,)
        From the IMU to the antenna, and to the point the wheels constrain [m].
    C_bv : array_like, shape (3, 3), optional
        Mounting, ``C_bv @ x_v == x_b``; default: IMU and vehicle axes coincide.
    att_cov_e : array_like, optional
        See `ForwardMotion`; default: attitude exact.
    sigma_cross : float

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import forward_motion
    >>> motion = forward_motion(np.eye(3), [0.0, 0.0, 0.1], lever_antenna_b=[2.0, 0.0, -1.0])
    >>> motion.u_e, motion.swing_e  # 2 m ahead of the axle, turning right at 0.1 rad/s
    (array([1., 0., 0.]), array([0. , 0.2, 0. ]))
    """
    C_eb = np.asarray(C_eb, dtype=float)
    forward_b = np.eye(3)[:, 0] if C_bv is None else np.asarray(C_bv, dtype=float)[:, 0]
    u_e = C_eb @ forward_b
    arm_b = np.asarray(lever_antenna_b, dtype=float) - np.asarray(lever_vehicle_b, dtype=float)
    return ForwardMotion(
        u_e / np.linalg.norm(u_e, axis=-1, keepdims=True),  # (19)
        lever_velocity(C_eb, omega_eb_b, arm_b),
        np.zeros((3, 3)) if att_cov_e is None else np.asarray(att_cov_e, dtype=float),
        sigma_cross,
    )
