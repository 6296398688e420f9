"""Rows of an alignment from an IMU alone: no odometer, no start velocity, moving from the start.

The ECEF axes of one instant t₁, the anchor, are kept: they are inertial axes. With w the body axes
at t₁, C_wb and Δv_w the integrals of the gyros and of C_wb f from t₁ (forwards or backwards;
`alignment.in_motion.track`), and G that of gravitation, the antenna's inertial velocity is exactly

    v_i(t) = v_i(t₁) + C_ew (Δv_w(t) + C_wb ω × l) + G(t),

Earth rotation and Coriolis acceleration included. A Doppler row turned into the kept axes is

    z = e·C_ew (Δv_w + C_wb ω × l) + e·v_e(t₁) − cδṫ

after what is known has gone to the left side; v_e(t₁) is three unknowns more that enter linearly.
The anchor is the window's *end* unless told otherwise: C_ew is then C_eb of the instant at which
a filter is to start, and its covariance and bound hold there without being carried anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...datasets.observations import GnssObservations
from ...filters.earth import GM, OMEGA_IE_SKEW, gravitation_e
from ...filters.rotation import FloatArray
from ...velocity.range_rate import DopplerNoise, DopplerRows, doppler_rows
from ..rows import POSITION_SIGMA
from .track import InertialTrack, earth_turn, summed


@dataclass(frozen=True, eq=False)
class InertialDoppler:
    """Doppler rows of a stretch of time, not yet tied to an anchor.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Epochs, GPS time [s].
    pos_e : ndarray, shape (n, 3)
        Antenna at the epochs [m].
    gravity_dv : ndarray, shape (n, 3)
        ∫ gravitation dt from the first epoch, ECEF axes of the first epoch [m/s].
    epoch : ndarray of int, shape (k,)
        Of each row, ascending.
    source : ndarray of int, shape (k,)
        Index of the observation a row came from.
    sat : ndarray of str, shape (k,)
    e_e : ndarray, shape (k, 3)
        Line of sight over κ, ECEF axes of its own epoch.
    z : ndarray, shape (k,)
        e·v_i − cδṫ with the inertial velocity in those axes [m/s].
    sigma : ndarray, shape (k,)
        [m/s].
    z_by_pos : ndarray, shape (k, 3)
        What an error of the position does to `z` at a given velocity relative to the Earth [1/s].
    position_sigma : float
        1σ per axis of that error, the same at all epochs [m].
    """

    time: FloatArray
    pos_e: FloatArray
    gravity_dv: FloatArray
    epoch: np.ndarray
    source: np.ndarray
    sat: np.ndarray
    e_e: FloatArray
    z: FloatArray
    sigma: FloatArray
    z_by_pos: FloatArray
    position_sigma: float

    def __repr__(self) -> str:
        return f"<InertialDoppler of {len(self)} rows at {self.time.size} epochs>"

    def __len__(self) -> int:
        return self.z.size


def inertial_doppler(
    observations: GnssObservations,
    pos_e: ArrayLike,
    noise: DopplerNoise | None = None,
    *,
    time: ArrayLike | None = None,
    interval: float = 0.0,
    position_sigma: float = POSITION_SIGMA,
) -> InertialDoppler:
    """Prepare the Doppler of any number of epochs.

    Parameters
    ----------
    observations : GnssObservations
    pos_e : array_like, shape (3,) or (n, 3)
        Antenna, one for all or one per row of `observations` [m].
    noise : DopplerNoise, optional
    time : array_like, shape (n,), optional
        GPS time of each row where the receiver's clock is known to be off [s].
    interval : float
        Epochs closer than this to the one before are left out [s].
    position_sigma : float
        1σ per axis of the positions [m].
    """
    when = observations.time if time is None else np.asarray(time, dtype=float)
    position = np.broadcast_to(np.asarray(pos_e, dtype=float), (len(observations), 3))
    rows = doppler_rows(observations, position, noise)
    epochs, start, which = np.unique(when[rows.row], return_index=True, return_inverse=True)
    chosen = _spaced(epochs, interval)
    keep = chosen[which]
    at = position[rows.row[start[chosen]]]
    number = (np.cumsum(chosen) - 1)[which[keep]]
    return _assembled(epochs[chosen], at, number, rows.take(keep), position_sigma)


@dataclass(frozen=True, eq=False)
class DopplerEpoch:
    """What one epoch gives to alignment in motion.

    Parameters
    ----------
    time : float
        GPS time, not the receiver's [s].
    pos_e : ndarray, shape (3,)
        Antenna, as it was taken for the rows [m].
    rows : DopplerRows
        One or more.
    position_sigma : float
        1σ per axis of the position [m].
    given : (float, float), optional
        Where the position is none of the receiver's, which has none: the time [s] at which it
        holds, and how well it is known then, 1σ per axis [m].
    """

    time: float
    pos_e: FloatArray
    rows: DopplerRows
    position_sigma: float = POSITION_SIGMA
    given: tuple[float, float] | None = None

    def __repr__(self) -> str:
        return f"<DopplerEpoch at {self.time:.2f} s, {len(self.rows)} rows>"


def joined(epochs: Sequence[DopplerEpoch]) -> InertialDoppler:
    """Return the rows of ascending epochs as one stretch."""
    count = [len(e.rows) for e in epochs]
    row, sat, e_e, z, sigma = (
        np.concatenate([getattr(e.rows, name) for e in epochs])
        for name in ("row", "sat", "e_e", "z", "sigma")
    )
    by_pos = np.concatenate([_by_position(e.rows) for e in epochs])
    return _assembled(
        np.array([e.time for e in epochs]), np.array([e.pos_e for e in epochs]),
        np.repeat(np.arange(len(epochs)), count), DopplerRows(row, sat, e_e, z, sigma, by_pos),
        max(e.position_sigma for e in epochs),
    )  # fmt: skip


def _by_position(rows: DopplerRows) -> FloatArray:
    """Return ∂z/∂p of rows, zero of those made by hand."""
    return np.zeros((len(rows), 3)) if rows.z_by_pos is None else rows.z_by_pos


def _assembled(
    time: FloatArray, pos_e: FloatArray, epoch: NDArray[np.int64], rows: DopplerRows,
    position_sigma: float,
) -> InertialDoppler:  # fmt: skip
    """Turn to inertial velocity, and sum up gravitation."""
    z = rows.z + np.sum(rows.e_e * (pos_e @ OMEGA_IE_SKEW.T)[epoch], axis=1)
    gravitation = np.einsum("nij,nj->ni", earth_turn(time - time[:1]), gravitation_e(pos_e))
    mean = 0.5 * (gravitation[1:] + gravitation[:-1]) if time.size else gravitation
    dv = summed(np.diff(time)[:, None] * mean)[: time.size]
    return InertialDoppler(
        time, pos_e, dv, epoch, rows.row, rows.sat, rows.e_e, z, rows.sigma, _by_position(rows),
        position_sigma,
    )  # fmt: skip


def _spaced(time: FloatArray, interval: float) -> np.ndarray:
    """Return which times to keep so that they are `interval` apart."""
    keep, last = np.zeros(time.size, dtype=bool), -np.inf
    for k, t in enumerate(time):
        if t - last >= interval - 1e-6:
            keep[k], last = True, t
    return keep


@dataclass(frozen=True, eq=False)
class InertialRows:
    """Rows of one window in the axes of its last epoch, the anchor: z = e·(C_ew·vel_w + v_e) − cδṫ.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Of the epochs [s].
    first : ndarray of int, shape (n + 1,)
        First row of each epoch, and the number of rows.
    e_e : ndarray, shape (k, 3)
        Axes e of the anchor, as all that follows.
    z, sigma : ndarray, shape (k,)
        [m/s].
    gravity_dv : ndarray, shape (n, 3)
        ∫ gravitation dt from the anchor [m/s].
    source : ndarray of int, shape (k,)
        Index of the observation a row came from.
    sat : ndarray of str, shape (k,)
    common : ndarray, shape (k, 3) or (k, 0)
        What 1σ of the position's error, along ECEF axes, does to `z` [m/s].
    """

    time: FloatArray
    first: NDArray[np.int64]
    e_e: FloatArray
    z: FloatArray
    sigma: FloatArray
    gravity_dv: FloatArray
    source: np.ndarray
    sat: np.ndarray
    common: FloatArray

    def __repr__(self) -> str:
        return f"<InertialRows, {len(self)} at {self.time.size} epochs>"

    def __len__(self) -> int:
        return self.z.size

    @property
    def epoch(self) -> NDArray[np.int64]:
        """Of each row, shape (k,)."""
        return np.repeat(np.arange(self.time.size), np.diff(self.first))


def inertial_rows(doppler: InertialDoppler) -> InertialRows:
    """Return the rows of a window, tied to its last epoch."""
    time, epoch = doppler.time, doppler.epoch
    # From the axes of the first epoch, in which gravitation was summed, to those of the anchor.
    to_anchor = earth_turn(time[0] - time[-1])
    gravity = (doppler.gravity_dv - doppler.gravity_dv[-1]) @ to_anchor.T
    carried = gravity + OMEGA_IE_SKEW @ doppler.pos_e[-1]
    turn = earth_turn(time - time[-1])[epoch]
    e_e = np.ascontiguousarray(np.sum(turn * doppler.e_e[:, None, :], axis=2))
    z = doppler.z - np.sum(e_e * carried[epoch], axis=1)
    first = np.searchsorted(epoch, np.arange(time.size + 1))
    return InertialRows(
        time, first, e_e, z, doppler.sigma, gravity, doppler.source, doppler.sat,
        _common(doppler, e_e),
    )  # fmt: skip


def _common(doppler: InertialDoppler, e_e: FloatArray) -> FloatArray:
    """Return what 1σ of the position does to rows: by lines of sight, and by gravitation.

    ∂g/∂p = (GM/r³)(3 r̂ r̂ᵀ − I): 1.5 µm/s² a metre, 9 m/s of Δv in a minute 100 km away.
    """
    if not doppler.position_sigma > 0.0:
        return np.zeros((len(doppler), 0))
    time, last = doppler.time, doppler.pos_e[-1]
    distance = float(np.sqrt(last @ last))
    up = last / distance
    gradient = GM / distance**3 * (3.0 * np.outer(up, up) - np.eye(3))
    late = (time - time[-1])[doppler.epoch]
    by_pos = doppler.z_by_pos - (e_e @ gradient) * late[:, None]
    return np.ascontiguousarray(doppler.position_sigma * by_pos)


def antenna_velocity(track: InertialTrack, lever_b: FloatArray) -> FloatArray:
    """Return vel_w = Δv_w + C_wb ω × l at the track's instants, shape (n, 3).

    Parameters
    ----------
    track : InertialTrack
    lever_b : ndarray, shape (3,)
        IMU to antenna, body axes [m].
    """
    x, y, z = lever_b.tolist()
    p, q, r = track.omega_b.T
    across = np.stack([q * z - r * y, r * x - p * z, p * y - q * x], axis=1)
    return track.dv_w + np.sum(track.C_wb * across[:, None, :], axis=2)
