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
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...datasets.observations import GnssObservations
from ...filters.earth import OMEGA_IE_SKEW, gravitation_e
from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ...velocity.range_rate import DopplerNoise, DopplerRows, doppler_rows
from ..problem import AlignmentRows
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
) -> InertialDoppler:
    """Prepare the Doppler of any number of epochs.

    Parameters
    ----------
    observations : GnssObservations
    pos_e : array_like, shape (3,) or (n, 3)
        Antenna, one for all or one per row of `observations` [m]. Good to a kilometre for
        gravitation, to 10 m for lines of sight (2 mm/s).
    noise : DopplerNoise, optional
    time : array_like, shape (n,), optional
        GPS time of each row where the receiver's clock is known to be off [s].
    interval : float
        Epochs closer than this to the one before are left out [s].
    """
    when = observations.time if time is None else np.asarray(time, dtype=float)
    position = np.broadcast_to(np.asarray(pos_e, dtype=float), (len(observations), 3))
    rows = doppler_rows(observations, position, noise)
    epochs, start, which = np.unique(when[rows.row], return_index=True, return_inverse=True)
    chosen = _spaced(epochs, interval)
    keep = chosen[which]
    at = position[rows.row[start[chosen]]]
    return _assembled(epochs[chosen], at, (np.cumsum(chosen) - 1)[which[keep]], rows.take(keep))


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
    """

    time: float
    pos_e: FloatArray
    rows: DopplerRows

    def __repr__(self) -> str:
        return f"<DopplerEpoch at {self.time:.2f} s, {len(self.rows)} rows>"


def joined(epochs: Sequence[DopplerEpoch]) -> InertialDoppler:
    """Return the rows of ascending epochs as one stretch."""
    count = [len(e.rows) for e in epochs]
    names = [field.name for field in fields(DopplerRows)]
    together = [np.concatenate([getattr(e.rows, name) for e in epochs]) for name in names]
    return _assembled(
        np.array([e.time for e in epochs]), np.array([e.pos_e for e in epochs]),
        np.repeat(np.arange(len(epochs)), count), DopplerRows(*together),
    )  # fmt: skip


def _assembled(
    time: FloatArray, pos_e: FloatArray, epoch: NDArray[np.int64], rows: DopplerRows
) -> InertialDoppler:
    """Turn to inertial velocity, and sum up gravitation."""
    z = rows.z + np.sum(rows.e_e * (pos_e @ OMEGA_IE_SKEW.T)[epoch], axis=1)
    gravitation = np.einsum("nij,nj->ni", earth_turn(time - time[:1]), gravitation_e(pos_e))
    mean = 0.5 * (gravitation[1:] + gravitation[:-1]) if time.size else gravitation
    dv = summed(np.diff(time)[:, None] * mean)[: time.size]
    return InertialDoppler(time, pos_e, dv, epoch, rows.row, rows.sat, rows.e_e, z, rows.sigma)


def _spaced(time: FloatArray, interval: float) -> np.ndarray:
    """Return which times to keep so that they are `interval` apart."""
    keep, last = np.zeros(time.size, dtype=bool), -np.inf
    for k, t in enumerate(time):
        if t - last >= interval - 1e-6:
            keep[k], last = True, t
    return keep


@dataclass(frozen=True, eq=False)
class InertialRows:
    """Rows of one window, tied to its anchor.

    Attributes
    ----------
    rows : AlignmentRows
        z = e·C_ew·vel_w + e·v_e − cδṫ, axes e of the anchor's instant; `vel_w` is Δv_w with the
        lever arm's part.
    track : InertialTrack
    source : ndarray of int, shape (k,)
        Index of the observation a row came from.
    sat : ndarray of str, shape (k,)
    gravity_dv : ndarray, shape (n, 3)
        ∫ gravitation dt from the anchor at the track's instants, axes e of the anchor [m/s].
    """

    rows: AlignmentRows
    track: InertialTrack
    source: np.ndarray
    sat: np.ndarray
    gravity_dv: FloatArray

    def __repr__(self) -> str:
        return f"<InertialRows, {len(self.rows)} on {self.track!r}>"

    @property
    def nuisance(self) -> FloatArray:
        """Columns of v_e, the IMU's velocity at the anchor, for `build_problem`, shape (k, 3)."""
        return self.rows.e_e

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.track.time[-1] - self.track.time[0])

    def columns(self, C_ew: ArrayLike, response_w: ArrayLike) -> FloatArray:
        """Return e·C_ew·response, what a change of Δv_w does to the rows, shape (k, m).

        Parameters
        ----------
        C_ew : array_like, shape (3, 3)
        response_w : array_like, shape (n, 3, m)
            Change of Δv_w at the track's instants by m unknowns.
        """
        e_w = self.rows.e_e @ np.asarray(C_ew, dtype=float)
        return np.einsum("ki,kim->km", e_w, np.asarray(response_w)[self.rows.epoch])


def inertial_rows(
    doppler: InertialDoppler,
    track: InertialTrack,
    lever_b: ArrayLike = (0.0, 0.0, 0.0),
    *,
    anchor: int | None = None,
) -> InertialRows:
    """Return the rows of a window, tied to an anchor.

    Parameters
    ----------
    doppler : InertialDoppler
    track : InertialTrack
        At `doppler.time`.
    lever_b : array_like, shape (3,)
        IMU to antenna, body axes [m].
    anchor : int, optional
        Epoch whose axes are kept; default: the last.
    """
    if not np.array_equal(track.time, doppler.time):
        raise DataError("inertial rows: the track must be at the Doppler's epochs")
    part = track.part(0, len(track) - 1, anchor)
    k = part.anchor
    lever = np.cross(part.omega_b, np.asarray(lever_b, dtype=float))
    vel_w = part.dv_w + np.einsum("nij,nj->ni", part.C_wb, lever)
    # From the axes of the first epoch, in which gravitation was summed, to those of the anchor.
    to_anchor = earth_turn(doppler.time[:1] - doppler.time[k])[0]
    gravity = (doppler.gravity_dv - doppler.gravity_dv[k]) @ to_anchor.T
    carried = gravity + OMEGA_IE_SKEW @ doppler.pos_e[k]
    epoch = doppler.epoch
    e_e = np.einsum("kij,kj->ki", earth_turn(part.time - part.time[k])[epoch], doppler.e_e)
    z = doppler.z - np.sum(e_e * carried[epoch], axis=1)
    rows = AlignmentRows(e_e, vel_w[epoch], z, doppler.sigma, epoch, part.time[epoch])
    return InertialRows(rows, part, doppler.source, doppler.sat, gravity)
