"""Points beside the IMU: how they move, and what is known of the one that the wheels constrain.

A point's velocity less the IMU's is C_eb (ω_eb × lever). Where the point of the wheels is, and how
the IMU is turned in the vehicle, are constants that a filter estimates where they are not declared
as exact. Errors are true − estimated; the mounting's error μ = (0, pitch, yaw) is a small rotation
about the vehicle's own axes, the point's is a vector in them:

    C_bv(true) = C_bv(estimated) (I + [μ×]),    l_b(true) = l_b(estimated) + C_bv (forward, 0, down)

Rotation about the direction of motion is in no velocity, and where the point lies to the side
changes its forward velocity alone: neither is a state.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .earth import OMEGA_IE_E
from .rotation import FloatArray, matrix_from_rotvec

if TYPE_CHECKING:
    from .error_model import ErrorModel


def rate_over_earth(C_eb: ArrayLike, omega_b: ArrayLike) -> FloatArray:
    """Return ω_eb^b = ω_ib^b − C_be ω_ie [rad/s], shape (..., 3).

    Parameters
    ----------
    C_eb : array_like, shape (..., 3, 3)
    omega_b : array_like, shape (..., 3)
        ω_ib^b, corrected [rad/s].
    """
    C_be = np.swapaxes(np.asarray(C_eb, dtype=float), -1, -2)
    rate: FloatArray = np.asarray(omega_b, dtype=float) - C_be @ OMEGA_IE_E
    return rate


def lever_velocity(C_eb: ArrayLike, omega_eb_b: ArrayLike, lever_b: ArrayLike) -> FloatArray:
    """Return the ECEF velocity of a point at `lever_b` less the IMU's [m/s], shape (..., 3).

    Parameters
    ----------
    C_eb : array_like, shape (..., 3, 3)
    omega_eb_b : array_like, shape (..., 3)
        Rate with respect to the Earth (`rate_over_earth`) [rad/s].
    lever_b : array_like, shape (3,)
        IMU to point, body axes [m].
    """
    swing_b = np.cross(np.asarray(omega_eb_b, dtype=float), np.asarray(lever_b, dtype=float))
    return np.einsum("...ij,...j->...i", np.asarray(C_eb, dtype=float), swing_b)


@dataclass(frozen=True)
class VehiclePrior:
    """How well mounting and wheel point are known before any data.

    Parameters
    ----------
    sigma_mounting : float
        1σ of pitch and yaw of the mounting [rad]; 0: exactly, no states.
    sigma_wheel : float
        1σ of the constrained point, forward and down [m]; 0: exactly, no states.
    """

    sigma_mounting: float = 0.0
    sigma_wheel: float = 0.0


@dataclass(frozen=True, eq=False)
class VehiclePoint:
    """The point that the wheels constrain, and the vehicle's axes there.

    Parameters
    ----------
    C_bv : array_like, shape (3, 3)
        Mounting, ``C_bv @ x_v == x_b``.
    lever_b : array_like, shape (3,)
        From the IMU to the point, body axes [m].
    mounting, wheel : slice, optional
        Where the errors of both are in the error state; default: they are exact.
    """

    C_bv: FloatArray
    lever_b: FloatArray
    mounting: slice | None = None
    wheel: slice | None = None

    def __post_init__(self) -> None:
        for name in ("C_bv", "lever_b"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))


class VehicleStates:
    """Mounting and wheel point of one filter, as corrections of what is declared.

    Parameters
    ----------
    model : ErrorModel

    Attributes
    ----------
    turn : ndarray, shape (3, 3)
        Declared vehicle axes from the estimated ones.
    wheel_v : ndarray, shape (3,)
        What is added to the declared lever, in the declared vehicle axes [m].
    """

    def __init__(self, model: ErrorModel) -> None:
        self.model = model
        self.turn = np.eye(3)
        self.wheel_v = np.zeros(3)

    def point(self, C_bv: ArrayLike, lever_b: ArrayLike) -> VehiclePoint:
        """Return the constrained point as estimated, from mounting and lever as declared [m]."""
        declared = np.asarray(C_bv, dtype=float)
        lever = np.asarray(lever_b, dtype=float) + declared @ self.wheel_v
        return VehiclePoint(declared @ self.turn, lever, self.model.mounting, self.model.wheel)

    def feed_back(self, x: FloatArray) -> None:
        """Add the estimated errors, ordered as in the error model."""
        if self.model.wheel is not None:
            forward, down = x[self.model.wheel]
            self.wheel_v += self.turn @ np.array([forward, 0.0, down])
        if self.model.mounting is not None:
            pitch, yaw = x[self.model.mounting]
            self.turn = self.turn @ matrix_from_rotvec(np.array([0.0, pitch, yaw]))

    def forgotten(self, P: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return P and the transition for a mounting that has changed: as unknown as before."""
        P, phi = P.copy(), np.eye(self.model.size)
        prior = self.model.vehicle
        for part, sigma in (
            (self.model.mounting, prior.sigma_mounting), (self.model.wheel, prior.sigma_wheel)
        ):  # fmt: skip
            if part is not None:
                phi[part] = 0.0
                P[part], P[:, part] = 0.0, 0.0
                P[part, part] = np.eye(2) * sigma**2
        return P, phi
