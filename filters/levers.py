"""Points beside the IMU: how they move, and what is known of the one that the wheels constrain.

A point's velocity less the IMU's is C_eb (ω_eb × lever). Where the point of the wheels is, and how
the IMU is turned in the vehicle, are constants that a filter estimates where they are not declared
as exact. Errors are true − estimated; the mounting's error μ = (0, pitch, yaw) is a small rotation
about the vehicle's own axes, the point's is a vector in them:

    C_bv(true) = C_bv(estimated) (I + [μ×]),    l_b(true) = l_b(estimated) + C_bv (forward, 0, down)

Rotation about the direction of motion is in no velocity, and where the point lies to the side
changes its forward velocity alone: neither is a state.

The antenna's place and the time by which GNSS is stamped early or late are constants, too: with
what is declared of them comes a σ. A fix stamped t is of t + delay.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .earth import EARTH_RATE
from .rotation import FloatArray, crossed, matrix_from_rotvec

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
    axis_b = np.asarray(C_eb, dtype=float)[..., 2, :]  # the Earth's
    rate: FloatArray = np.asarray(omega_b, dtype=float) - EARTH_RATE * axis_b
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
    C_eb = np.asarray(C_eb, dtype=float)
    rate_b, lever = np.asarray(omega_eb_b, dtype=float), np.asarray(lever_b, dtype=float)
    if C_eb.ndim == 2 and rate_b.ndim == 1:
        return np.asarray(C_eb @ crossed(rate_b, lever))
    return np.einsum("...ij,...j->...i", C_eb, np.cross(rate_b, lever))


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
            pitch, yaw = x[self.model.mounting].tolist()
            self.turn = self.turn @ matrix_from_rotvec([0.0, pitch, yaw])

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


@dataclass(frozen=True)
class AntennaPrior:
    """How well the antenna's place and the time stamps of GNSS are known before any data.

    Parameters
    ----------
    sigma_lever : float
        1σ of each component of the lever from the IMU [m]; 0: exactly, no states.
    sigma_delay : float
        1σ of the time stamps against the IMU's [s]; 0: exactly, no state.
    """

    sigma_lever: float = 0.0
    sigma_delay: float = 0.0


@dataclass(frozen=True, eq=False)
class AntennaPoint:
    """The antenna that a measurement is of.

    Parameters
    ----------
    lever_b : array_like, shape (3,)
        From the IMU, body axes [m].
    lever : slice, optional
        Where its error is in the error state; default: it is exact.
    delay : int, optional
        Where that of the time stamps is; default: they are exact.
    delay_s : float
        By how much later than stamped a measurement is [s].
    accel_e : array_like, shape (3,)
        Acceleration over the Earth [m/s²], of use where there is a delay.
    rate_b : array_like, shape (3,)
        Rate over the Earth that has lasted [rad/s], by which a velocity shows the lever: vibration
        is faster than a receiver's Doppler.
    """

    lever_b: FloatArray
    lever: slice | None = None
    delay: int | None = None
    delay_s: float = 0.0
    accel_e: FloatArray = field(default_factory=lambda: np.zeros(3))
    rate_b: FloatArray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        for name in ("lever_b", "accel_e", "rate_b"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))


def antenna_point(lever_b: ArrayLike | AntennaPoint) -> AntennaPoint:
    """Return the antenna at a lever that is exact [m], or the one that is given."""
    if isinstance(lever_b, AntennaPoint):
        return lever_b
    return AntennaPoint(np.asarray(lever_b, dtype=float))


class AntennaStates:
    """Lever and delay of one filter, as corrections of what is declared.

    Parameters
    ----------
    model : ErrorModel

    Attributes
    ----------
    lever_b : ndarray, shape (3,)
        What is added to the declared lever [m].
    delay_s : float
        What GNSS is late beyond its stamps [s].
    """

    def __init__(self, model: ErrorModel) -> None:
        self.model = model
        self.lever_b = np.zeros(3)
        self.delay_s = 0.0

    def point(
        self,
        lever_b: ArrayLike,
        accel_e: ArrayLike = (0.0, 0.0, 0.0),
        rate_b: ArrayLike = (0.0, 0.0, 0.0),
    ) -> AntennaPoint:
        """Return the antenna as estimated, from the lever as declared [m] and how it moves."""
        lever = np.asarray(lever_b, dtype=float) + self.lever_b
        model = self.model
        return AntennaPoint(
            lever, model.antenna, model.delay, self.delay_s,
            np.asarray(accel_e, dtype=float), np.asarray(rate_b, dtype=float),
        )  # fmt: skip

    def feed_back(self, x: FloatArray) -> None:
        """Add the estimated errors, ordered as in the error model."""
        if self.model.antenna is not None:
            self.lever_b += x[self.model.antenna]
        if self.model.delay is not None:
            self.delay_s += float(x[self.model.delay])
