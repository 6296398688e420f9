"""Integrals of an IMU over a window, and what errors of its sensors do to them.

With w the body axes of one instant, the anchor, these are C_wb and Δv_w = ∫C_wb f dt from there,
forwards or backwards. What biases and scale factors do to Δv_w is linear in them as long as the
rotation they make is small. With A = ∫C_wb [I, diag ω] dt and B = ∫[C_wb f ×] A dt, errors δ of the
gyros, six to be subtracted, turn C_wb by −Aδ (w axes) and change Δv_w by Bδ; those of the
accelerometers change it by −Fδ, F = ∫C_wb [I, diag f] dt. Integrals over any part of the window
follow from those over the whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...filters.earth import EARTH_RATE
from ...filters.errors import AlignmentError, DataError
from ...filters.rotation import FloatArray, matrix_from_rotvec, skew
from ...filters.strapdown import InertialStream


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

    def __repr__(self) -> str:
        return f"<InertialTrack of {_span(self.time)}, anchor {self.anchor}>"

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
        return earth_turn([elapsed])[0].T @ np.asarray(C_ew, dtype=float) @ self.C_wb[k]

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
    dv = summed(np.einsum("kij,kj->ki", C[:-1], dv_b))
    A = summed(_trapezium(C[:-1], C[1:], gyro, width))
    F = summed(_trapezium(C[:-1], C[1:], force, width))
    B = summed(skew(np.diff(dv, axis=0)) @ (0.5 * (A[:-1] + A[1:])))

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


def _span(time: FloatArray) -> str:
    if not time.size:
        return "0 epochs"
    return f"{time.size} epochs, {time[0]:.1f}…{time[-1]:.1f} s"


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


def summed(increments: FloatArray) -> FloatArray:
    """Return the sums of the first 0, 1 … n increments, shape (n + 1, …)."""
    return np.concatenate([np.zeros((1, *increments.shape[1:])), np.cumsum(increments, axis=0)])


def earth_turn(elapsed: ArrayLike) -> FloatArray:
    """Return the rotation from ECEF axes `elapsed` seconds later to those kept."""
    angle = EARTH_RATE * np.asarray(elapsed, dtype=float)
    return matrix_from_rotvec(np.stack([0.0 * angle, 0.0 * angle, angle], axis=-1))
