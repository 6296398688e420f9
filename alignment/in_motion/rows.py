"""Rows of an alignment from an IMU alone: no odometer, no start velocity, moving from the start.

The ECEF axes of one instant t₁, the anchor, are kept: they are inertial axes. With w the body axes
at t₁, C_wb and Δv_w the integrals of the gyros and of C_wb f from t₁ (forwards or backwards), and
G that of gravitation, the antenna's inertial velocity is exactly

    v_i(t) = v_i(t₁) + C_ew (Δv_w(t) + C_wb ω × l) + G(t),

Earth rotation and Coriolis acceleration included. A Doppler row turned into the kept axes is

    z = e·C_ew (Δv_w + C_wb ω × l) + e·v_e(t₁) − cδṫ

after what is known has gone to the left side; v_e(t₁) is three unknowns more that enter linearly.
The anchor is the window's *end* unless told otherwise: C_ew is then C_eb of the instant at which
a filter is to start, and its covariance and bound hold there without being carried anywhere.

What biases and scale factors do to Δv_w is linear in them as long as the rotation they make is
small. With A = ∫C_wb [I, diag ω] dt and B = ∫[C_wb f ×] A dt, errors δ of the gyros, six to be
subtracted, turn C_wb by −Aδ (w axes) and change Δv_w by Bδ; those of the accelerometers change it
by −Fδ, F = ∫C_wb [I, diag f] dt. Integrals over any part of the window follow from those over the
whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...datasets.observations import GnssObservations
from ...filters.earth import EARTH_RATE, OMEGA_IE_SKEW, gravitation_e
from ...filters.errors import AlignmentError, DataError
from ...filters.rotation import FloatArray, matrix_from_rotvec, skew
from ...filters.strapdown import InertialStream
from ...velocity.range_rate import DopplerNoise, DopplerRows, doppler_rows
from ..problem import AlignmentRows


@dataclass(frozen=True, eq=False)
class InertialTrack:
    """Integrals of the IMU at n instants, in body axes w of the anchor.

    Attributes
    ----------
    time : ndarray, shape (n,)
        GPS time [s].
    anchor : int
        Index of the instant at which C_wb is the identity and the integrals are zero.
    C_wb : ndarray, shape (n, 3, 3)
        ``C_wb @ x_b == x_w``.
    dv_w : ndarray, shape (n, 3)
        ∫ C_wb f dt [m/s].
    A : ndarray, shape (n, 3, 6)
        ∫ C_wb [I, diag ω] dt [s], [rad].
    B : ndarray, shape (n, 3, 6)
        ∫ [C_wb f ×] A dt [m], [m/s].
    F : ndarray, shape (n, 3, 6)
        ∫ C_wb [I, diag f] dt [s], [m/s].
    omega_b : ndarray, shape (n, 3)
        ω_ib [rad/s].
    """

    time: FloatArray
    anchor: int
    C_wb: FloatArray
    dv_w: FloatArray
    A: FloatArray
    B: FloatArray
    F: FloatArray
    omega_b: FloatArray

    def __len__(self) -> int:
        return self.time.size

    def part(self, first: int, last: int, anchor: int | None = None) -> InertialTrack:
        """Return the instants first … last with the anchor at one of them (default: the last)."""
        k = last if anchor is None else anchor
        W, here = self.C_wb[k].T, slice(first, last + 1)
        dv = self.dv_w[here] - self.dv_w[k]
        A, B = self.A[here] - self.A[k], self.B[here] - self.B[k]
        B = B - skew(dv) @ self.A[k]
        # The integrals over w axes of the old anchor, δ in body axes: W on the left only.
        return InertialTrack(
            self.time[here], k - first, W @ self.C_wb[here], dv @ W.T, W @ A, W @ B,
            W @ (self.F[here] - self.F[k]), self.omega_b[here],
        )  # fmt: skip

    def attitude(self, C_ew: ArrayLike, k: int) -> FloatArray:
        """Return C_eb at instant k from that at the anchor, the Earth having turned."""
        elapsed = self.time[k] - self.time[self.anchor]
        return _turn([elapsed])[0].T @ np.asarray(C_ew, dtype=float) @ self.C_wb[k]

    def response(self, start: int, end: int) -> tuple[FloatArray, FloatArray]:
        """Return what a gyro bias that is there between two of the instants only does.

        Returns
        -------
        turn, change : ndarray, shape (n, 3, 3)
            A δ of it turns C_wb by −turn·δ (w axes) and changes dv_w by change·δ.
        """
        at = np.clip(np.arange(len(self)), start, end)
        A, B = self.A[:, :, :3], self.B[:, :, :3]
        turn = A[at] - A[start]
        change = B[at] - B[start] - skew(self.dv_w[at] - self.dv_w[start]) @ A[start]
        change = change + skew(self.dv_w - self.dv_w[at]) @ turn
        # Nothing has happened yet at the anchor, whichever side of it the part is on.
        k = self.anchor
        change = change - change[k] - skew(self.dv_w - self.dv_w[k]) @ turn[k]
        return turn - turn[k], change


def inertial_track(
    stream: InertialStream,
    time: ArrayLike,
    gyro_bias: ArrayLike = (0.0, 0.0, 0.0),
    accel_bias: ArrayLike = (0.0, 0.0, 0.0),
) -> InertialTrack:
    """Integrate gyros and accelerometers, anchored at the first of the instants.

    Rates are linear within a sample with the slope of the samples around it, from which coning
    and sculling follow (Savage 1998); across a gap they are constant.

    Parameters
    ----------
    stream : InertialStream
    time : array_like, shape (n,)
        Ascending, within the stream [s].
    gyro_bias, accel_bias : array_like, shape (3,)
        Subtracted [rad/s], [m/s²].

    Raises
    ------
    AlignmentError
        If the IMU data do not cover the instants.
    """
    time = np.asarray(time, dtype=float)
    if time.ndim != 1 or not time.size or np.any(np.diff(time) <= 0.0):
        raise DataError("inertial track: expected ascending times")
    if time[0] < stream.start - 1e-9 or time[-1] > stream.end + 1e-9:
        raise AlignmentError(
            f"the IMU data ({stream.start:.1f}…{stream.end:.1f} s) do not cover the window "
            f"{time[0]:.1f}…{time[-1]:.1f} s"
        )
    first = max(stream.index(time[0]) - 1, 0)
    last = int(np.searchsorted(stream.edges, time[-1] + 1e-9)) + 1
    edges = stream.edges[first : last + 1]
    gyro = stream.gyro[first:last] - np.asarray(gyro_bias, dtype=float)
    force = stream.accel[first:last] - np.asarray(accel_bias, dtype=float)
    width = np.diff(edges)
    gyro_slope, force_slope = _slopes(edges, gyro), _slopes(edges, force)
    turn, dv_b = _increments(gyro, force, gyro_slope, force_slope, width)
    C = _chained(matrix_from_rotvec(turn))
    dv = _summed(np.einsum("kij,kj->ki", C[:-1], dv_b))
    A = _summed(_trapezium(C[:-1], C[1:], gyro, width))
    F = _summed(_trapezium(C[:-1], C[1:], force, width))
    B = _summed(skew(np.diff(dv, axis=0)) @ (0.5 * (A[:-1] + A[1:])))

    # From the edge before to each instant, with the mean rates of the part of the sample.
    k = np.clip(np.searchsorted(edges, time + 1e-9, side="right") - 1, 0, width.size - 1)
    h = time - edges[k]
    middle = (0.5 * (h - width[k]))[:, None]
    turn, dv_b = _increments(
        gyro[k] + gyro_slope[k] * middle, force[k] + force_slope[k] * middle,
        gyro_slope[k], force_slope[k], h,
    )  # fmt: skip
    C_here = C[k] @ matrix_from_rotvec(turn)
    step = np.einsum("kij,kj->ki", C[k], dv_b)
    A_here = A[k] + _trapezium(C[k], C_here, gyro[k], h)
    F_here = F[k] + _trapezium(C[k], C_here, force[k], h)
    B_here = B[k] + skew(step) @ (0.5 * (A[k] + A_here))
    omega = gyro[k] + gyro_slope[k] * (h - 0.5 * width[k])[:, None]
    track = InertialTrack(time, 0, C_here, dv[k] + step, A_here, B_here, F_here, omega)
    return track.part(0, time.size - 1, 0)


def _slopes(edges: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the rates of change within samples; zero next to a gap and at the ends."""
    width = np.diff(edges)
    slope = np.zeros_like(rate)
    middle = 0.5 * (edges[1:] + edges[:-1])
    usual = np.abs(width - np.median(width)) < 0.5 * np.median(width)
    fine = usual[:-2] & usual[1:-1] & usual[2:]
    central = (rate[2:] - rate[:-2]) / (middle[2:] - middle[:-2])[:, None]
    slope[1:-1] = np.where(fine[:, None], central, 0.0)
    return slope


def _increments(
    rate: FloatArray, force: FloatArray, rate_slope: FloatArray, force_slope: FloatArray,
    width: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Return rotation vector and velocity increment, axes of the beginning, shape (n, 3) each."""
    h = width[:, None]
    twelfth = h**3 / 12.0
    turned = np.cross(rate, force)
    dv_b = h * force + 0.5 * h**2 * turned + h**3 / 6.0 * np.cross(rate, turned)
    dv_b = dv_b + twelfth * (np.cross(rate, force_slope) + np.cross(force, rate_slope))
    return h * rate + twelfth * np.cross(rate, rate_slope), dv_b


def _trapezium(
    before: FloatArray, after: FloatArray, rate: FloatArray, width: FloatArray
) -> FloatArray:
    """Return ∫C [I, diag rate] dt over intervals, shape (n, 3, 6)."""
    C = 0.5 * width[:, None, None] * (before + after)
    return np.concatenate([C, C * rate[:, None, :]], axis=2)


def _chained(steps: FloatArray) -> FloatArray:
    """Return all products 1, S₀, S₀S₁ … of n rotations, shape (n + 1, 3, 3), in log₂ n passes."""
    out = np.concatenate([np.eye(3)[None], steps])
    reach = 1
    while reach < len(out):
        out[reach:] = out[:-reach] @ out[reach:]
        reach *= 2
    return out


def _summed(increments: FloatArray) -> FloatArray:
    return np.concatenate([np.zeros((1, *increments.shape[1:])), np.cumsum(increments, axis=0)])


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
    gravitation = np.einsum("nij,nj->ni", _turn(time - time[:1]), gravitation_e(pos_e))
    mean = 0.5 * (gravitation[1:] + gravitation[:-1]) if time.size else gravitation
    dv = _summed(np.diff(time)[:, None] * mean)[: time.size]
    return InertialDoppler(time, pos_e, dv, epoch, rows.row, rows.sat, rows.e_e, z, rows.sigma)


def _spaced(time: FloatArray, interval: float) -> np.ndarray:
    """Return which times to keep so that they are `interval` apart."""
    keep, last = np.zeros(time.size, dtype=bool), -np.inf
    for k, t in enumerate(time):
        if t - last >= interval - 1e-6:
            keep[k], last = True, t
    return keep


def _turn(elapsed: ArrayLike) -> FloatArray:
    """Return the rotation from ECEF axes `elapsed` seconds later to those kept."""
    angle = EARTH_RATE * np.asarray(elapsed, dtype=float)
    return matrix_from_rotvec(np.stack([0.0 * angle, 0.0 * angle, angle], axis=-1))


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
    to_anchor = _turn(doppler.time[:1] - doppler.time[k])[0]
    gravity = (doppler.gravity_dv - doppler.gravity_dv[k]) @ to_anchor.T
    carried = gravity + OMEGA_IE_SKEW @ doppler.pos_e[k]
    epoch = doppler.epoch
    e_e = np.einsum("kij,kj->ki", _turn(part.time - part.time[k])[epoch], doppler.e_e)
    z = doppler.z - np.sum(e_e * carried[epoch], axis=1)
    rows = AlignmentRows(e_e, vel_w[epoch], z, doppler.sigma, epoch, part.time[epoch])
    return InertialRows(rows, part, doppler.source, doppler.sat, gravity)
