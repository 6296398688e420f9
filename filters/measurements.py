"""Measurement models: each returns z, H, R with z = measured − predicted = H δx + noise.

δx is ordered and signed as in `filters.error_model` (true − estimated).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from .earth import OMEGA_IE_SKEW
from .error_model import ATT, GYRO_BIAS, POS, VEL
from .gnss_states import shared_root
from .levers import AntennaPoint, antenna_point, lever_velocity, rate_over_earth
from .rotation import FloatArray, crossed, skew
from .strapdown import NavState

#: A reflected signal's Doppler is off by twice the speed at most, 1σ [m/s]: 50 km/h.
_DOPPLER_LARGEST = 30.0
_IDENTITY = np.eye(3)


@dataclass(frozen=True, eq=False)
class Biases:
    """What a measurement may be wrong by beyond its noise, and what is known of it already.

    Parameters
    ----------
    names : tuple of str, length q
        One fault each: one satellite's pseudorange, its Doppler, sideslip …
    dz : ndarray, shape (m, q)
        Derivative of z with respect to each.
    largest : float
        What physics lets each be at most, as 1σ before any data.
    estimate, noise, lasting : ndarray, shape (q,), optional
        What measurements say of each among themselves, before the filter is asked: the value, and
        the 1σ of its error, of the part that is gone after a while and of the part that stays;
        infinite where they say nothing.
    """

    names: tuple[str, ...]
    dz: FloatArray
    largest: float
    estimate: FloatArray | None = None
    noise: FloatArray | None = None
    lasting: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Measurement:
    """A linearised measurement.

    Parameters
    ----------
    z : ndarray, shape (m,)
        Measured − predicted.
    H : ndarray, shape (m, n)
        Derivative with respect to the error state.
    R : ndarray, shape (m, m)
        Covariance of the measurement noise.
    biases : Biases, optional
        What may be wrong with it; the update does not look at it.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import C_en_of, Measurement, NavState, lla_to_ecef
    >>> from certnav.filters.measurements import position
    >>> pos_e = lla_to_ecef(0.5, 2.0, 30.0)
    >>> state = NavState(0.0, pos_e, np.zeros(3), C_en_of(pos_e))
    >>> m = position(state, 15, pos_e + [1.0, 0.0, 0.0], 4.0 * np.eye(3), lever_b=[0.0, 0.0, 0.0])
    >>> m.z.round(6), m.H.shape
    (array([1., 0., 0.]), (3, 15))
    >>> by_hand = Measurement(np.array([0.1]), np.eye(1, 15), np.array([[0.01]]))
    """

    z: FloatArray
    H: FloatArray
    R: FloatArray
    biases: Biases | None = None

    def __post_init__(self) -> None:
        for name in ("z", "H", "R"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))

    def __repr__(self) -> str:
        m, n = self.H.shape
        return f"Measurement({m} rows, {n} states)"


def antenna_position(state: NavState, lever_b: ArrayLike) -> FloatArray:
    """Return the ECEF position [m] of a point at `lever_b` [m] from the IMU."""
    return state.pos_e + state.C_eb @ np.asarray(lever_b, dtype=float)


def antenna_velocity(state: NavState, omega_b: ArrayLike, lever_b: ArrayLike) -> FloatArray:
    """Return the ECEF velocity [m/s] of a point at `lever_b` [m] from the IMU.

    `omega_b` is ω_ib^b [rad/s], corrected; the lever turns with ω_eb^b = ω_ib^b − C_be ω_ie.
    """
    rate_b = rate_over_earth(state.C_eb, omega_b)
    return state.vel_e + lever_velocity(state.C_eb, rate_b, lever_b)


def position(
    state: NavState,
    states: int,
    pos_e: ArrayLike,
    cov_e: ArrayLike,
    lever_b: ArrayLike | AntennaPoint,
    omega_b: ArrayLike = (0.0, 0.0, 0.0),
) -> Measurement:
    """Antenna position in ECEF.

    Parameters
    ----------
    state : NavState
        Predicted state of the IMU.
    states : int
        Length of the error state.
    pos_e : array_like, shape (3,)
        Measured antenna position [m].
    cov_e : array_like, shape (3, 3)
        [m²].
    lever_b : array_like, shape (3,), or AntennaPoint
        IMU to antenna, body axes [m].
    omega_b : array_like, shape (3,)
        ω_ib^b [rad/s], corrected; of use where the point has a delay.
    """
    point = antenna_point(lever_b)
    H = np.zeros((3, states))
    H[:, POS] = _IDENTITY
    H[:, ATT] = -state.C_eb @ skew(point.lever_b)
    z = np.asarray(pos_e, dtype=float) - antenna_position(state, point.lever_b)
    if point.lever is not None:
        H[:, point.lever] = state.C_eb
    if point.delay is not None:
        there = AntennaPoint(point.lever_b, point.lever, rate_b=point.rate_b)
        moving = velocity(state, states, np.zeros(3), np.eye(3), there, omega_b)
        H += point.delay_s * moving.H
        H[:, point.delay] = -moving.z
        z = z + point.delay_s * moving.z
    return Measurement(z, H, np.asarray(cov_e, dtype=float))


def with_shared_error(
    position: Measurement, shared_cov_e: ArrayLike, shared: slice, estimate: ArrayLike
) -> Measurement:
    """Return a position part of whose error is that of the positions around it.

    Parameters
    ----------
    position : Measurement
        See `position`; its R is the covariance of the whole error.
    shared_cov_e : array_like, shape (3, 3)
        Covariance of the part that is in common [m²].
    shared : slice
        `ErrorModel.fix_bias`.
    estimate : array_like, shape (3,)
        Present estimate of those states.
    """
    root = shared_root(shared_cov_e)
    H = position.H.copy()
    H[:, shared] = root
    R = position.R - np.asarray(shared_cov_e, dtype=float)
    return replace(position, z=position.z - root @ np.asarray(estimate, dtype=float), H=H, R=R)


def velocity(
    state: NavState,
    states: int,
    vel_e: ArrayLike,
    cov_e: ArrayLike,
    lever_b: ArrayLike | AntennaPoint,
    omega_b: ArrayLike,
) -> Measurement:
    """Antenna velocity in ECEF.

    Parameters
    ----------
    state, states, cov_e, lever_b
        As for `position`; `cov_e` in m²/s².
    vel_e : array_like, shape (3,)
        Measured antenna velocity [m/s].
    omega_b : array_like, shape (3,)
        ω_ib^b [rad/s], corrected for bias and scale.
    """
    point, omega = antenna_point(lever_b), np.asarray(omega_b, dtype=float)
    lever = point.lever_b
    H = np.zeros((3, states))
    H[:, VEL] = _IDENTITY
    # C(ω×l) turns with the attitude; so does Cl in the Earth-rate part ω_ie × Cl.
    C_lever = state.C_eb @ skew(lever)
    H[:, ATT] = OMEGA_IE_SKEW @ C_lever - state.C_eb @ skew(crossed(omega, lever))
    H[:, GYRO_BIAS] = C_lever
    z = np.asarray(vel_e, dtype=float) - antenna_velocity(state, omega, lever)
    if point.lever is not None:
        H[:, point.lever] = state.C_eb @ skew(point.rate_b)
    if point.delay is not None:
        H[:, point.delay] = point.accel_e
        z = z - point.delay_s * point.accel_e
    return Measurement(z, H, np.asarray(cov_e, dtype=float))


def range_rates(
    antenna: Measurement,
    e_e: ArrayLike,
    z: ArrayLike,
    sigma: ArrayLike,
    clock: int | None = None,
    clock_drift: float = 0.0,
    z_by_pos: ArrayLike | None = None,
    satellites: tuple[str, ...] = (),
) -> Measurement:
    """Doppler of satellites of one epoch.

    Each row says z = e·v_antenna − cδṫ_r + noise (DDIA-VE eq. 5). Where the receiver's clock drift
    is a state, that is the measurement, whitened. Where it is not, it is eliminated: the whitened
    rows are turned so that the clock stands in one of them, which is dropped. n ≥ 2 rows become
    n − 1 of unit variance, without a choice of reference satellite; for two this is eq. (14),
    v_AB = e_AB·v, as a scalar measurement: no division by k, and nothing assumed about where the
    vehicle points.

    Parameters
    ----------
    antenna : Measurement
        `velocity` of a measured velocity of zero: what the filter says of the antenna's.
    e_e : array_like, shape (n, 3)
        Lines of sight from receiver to satellite.
    z, sigma : array_like, shape (n,)
        [m/s].
    clock : int, optional
        Index of the clock drift in the error state.
    clock_drift : float
        Its present estimate [m/s].
    z_by_pos : array_like, shape (n, 3), optional
        ∂z/∂p at the position that `z` was computed for, the present estimate [1/s]. Default: it
        is exact.
    satellites : tuple of str, length n, optional
        Where they are named, `Measurement.biases` is that of each one's z [m/s].
    """
    e, sigma = np.asarray(e_e, dtype=float), np.asarray(sigma, dtype=float)
    predicted = -antenna.z
    weight = 1.0 / sigma
    residual = weight * (np.asarray(z, dtype=float) - e @ predicted)
    H = e @ antenna.H
    if z_by_pos is not None:
        H[:, POS] -= np.asarray(z_by_pos, dtype=float)
    H *= weight[:, None]
    if clock is not None:
        H[:, clock] = -weight
        biases = _of_each(satellites, np.diag(weight))
        return Measurement(residual + weight * clock_drift, H, np.eye(len(sigma)), biases)
    # Complement of the clock's direction: the last columns of a full QR of it.
    free = np.linalg.qr(weight[:, None], mode="complete")[0][:, 1:].T
    H = free @ H
    biases = _of_each(satellites, free * weight)
    return Measurement(free @ residual, H, np.eye(len(sigma) - 1), biases)


def _of_each(satellites: tuple[str, ...], dz: FloatArray) -> Biases | None:
    names = tuple(f"Doppler of {name}" for name in satellites)
    return Biases(names, dz, _DOPPLER_LARGEST) if names else None
