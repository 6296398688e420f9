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
from . import track_kernels as kernels

#: Biases between which integrals are carried by their derivatives, half of these at most, over
#: parts no longer than `_LONGEST` [rad/s], [m/s²], [s]. In a turn of 0.5 rad/s what is left out,
#: (dT)²ωT/12 of attitude and products of the third order of Δv, is 1e-9 rad and 1e-7 m/s a part.
_GRID: FloatArray = np.array([2e-3] * 3 + [0.4] * 3)
_LONGEST = 0.24
#: Points of the grid for which parts are kept: an estimate near the edge of a cell has eight around
#: it, and the next window begins at what is known beforehand again.
_CELLS = 16
#: Of a part: C, Δv, A, B, F and ω.
_COLUMNS = (slice(0, 3), 3, slice(4, 10), slice(10, 16), slice(16, 22), 22)


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

    def responses(self, ends: ArrayLike) -> FloatArray:
        """Return what errors of the sensors do to dv_w, anchored at the last instant.

        Parameters
        ----------
        ends : array_like of int, shape (p + 1,)
            Instants, ascending, that bound p parts of the track.

        Returns
        -------
        ndarray, shape (n, 3, 12 + 3p)
            Change of dv_w by biases (gyro, accelerometer) and scale factors (likewise), and by a
            gyro bias that is there in each of the parts only.
        """
        if self.anchor != len(self) - 1:
            raise ValueError("responses: the anchor must be the last instant")
        ends = np.asarray(ends, dtype=np.int64)
        out = np.empty((len(self), 3, 9 + 3 * ends.size))
        contiguous = (np.ascontiguousarray(each) for each in (self.dv_w, self.A, self.B, self.F))
        kernels.responses(*contiguous, ends, out)
        return out


class ImuParts:
    """What an IMU did between instants, integrated once and kept for the next window.

    A window that slides by an epoch needs one part more, and its integrals at other biases follow
    from those at hand (`track_kernels`) as long as they are near. Biases that parts are integrated
    with lie on a grid: what comes out depends on data and biases alone, not on what was asked
    before.

    Parameters
    ----------
    stream : InertialStream
        May grow.
    """

    def __init__(self, stream: InertialStream) -> None:
        self.stream = stream
        self._kept: dict[tuple[float, ...], tuple[FloatArray, FloatArray, int]] = {}

    def track(self, time: ArrayLike, biases: ArrayLike) -> InertialTrack:
        """Return the integrals at the instants, anchored at the last of them.

        Parameters
        ----------
        time : array_like, shape (n,)
            Ascending, within the stream [s].
        biases : array_like, shape (6,)
            Of gyro [rad/s] and accelerometer [m/s²], subtracted.

        Raises
        ------
        AlignmentError
            If the IMU data do not cover the instants.
        """
        time, biases = np.asarray(time, dtype=float), np.asarray(biases, dtype=float)
        self._refuse(time)
        fine = _cut(time)
        near = _GRID * np.round(biases / _GRID)
        parts, off = self._at(fine, near), biases - near
        out = np.empty_like(parts)
        kernels.compose(parts, off[:3], off[3:], out)
        if fine.size > time.size:
            out = out[np.searchsorted(fine, time)]
        C, dv, A, B, F, omega = (out[:, :, columns] for columns in _COLUMNS)
        return InertialTrack(time, time.size - 1, C, dv, A, B, F, omega)

    def _refuse(self, time: FloatArray) -> None:
        stream = self.stream
        if time.ndim != 1 or not time.size or np.any(time[1:] <= time[:-1]):
            raise DataError("inertial track: expected ascending times")
        if time[0] < stream.start - 1e-9 or time[-1] > stream.end + 1e-9:
            raise AlignmentError(
                f"the IMU data ({stream.start:.1f}…{stream.end:.1f} s) do not cover the window "
                f"{time[0]:.1f}…{time[-1]:.1f} s"
            )

    def _at(self, time: FloatArray, near: FloatArray) -> FloatArray:
        """Return the parts between the instants, and one of no length at the last.

        They are integrated with biases of the grid.
        """
        key, n = tuple(near.tolist()), time.size
        known, kept, whole = self._kept.pop(key, (time[:0], np.empty((0, 3, kernels.PART)), 0))
        if not np.array_equal(known, time):
            begin = int(np.searchsorted(known, time[0]))
            same = max(min(whole - begin, n), 0)
            if not np.array_equal(known[begin : begin + same], time[:same]):
                same = 0
            same = max(same - 1, 0)
            parts = np.empty((n, 3, kernels.PART))
            parts[:same] = kept[begin : begin + same]
            self._integrate(np.append(time[same:], time[-1]), near, parts[same:])
            # Slopes within a sample wait for the one after it.
            after = self.stream.edges[max(len(self.stream) - 2, 0)]
            known, kept, whole = time, parts, int(np.searchsorted(time, after))
        self._kept[key] = known, kept, whole
        if len(self._kept) > _CELLS:
            del self._kept[next(iter(self._kept))]
        return kept

    def _integrate(self, time: FloatArray, biases: FloatArray, parts: FloatArray) -> None:
        stream = self.stream
        first = max(stream.index(float(time[0])) - 1, 0)
        last = int(np.searchsorted(stream.edges, time[-1] + 1e-9)) + 2
        edges, gyro = stream.edges[first : last + 1], stream.gyro[first:last]
        accel = stream.accel[first:last]
        begin = int(np.searchsorted(edges, time[0] + 1e-9, side="right")) - 1
        kernels.integrate(
            edges, gyro, accel, _slopes(edges, gyro), _slopes(edges, accel),
            min(max(begin, 0), len(gyro) - 1), time, biases, parts,
        )  # fmt: skip


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
    track = ImuParts(stream).track(time, np.concatenate([gyro_bias, accel_bias]))
    return track.part(0, len(track) - 1, 0)


def _cut(time: FloatArray) -> FloatArray:
    """Return the instants with others between them where they are far apart."""
    width = np.diff(time)
    count = np.ceil(width / _LONGEST).astype(np.int64)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    fine = np.repeat(time[:-1], count) + within * np.repeat(width / count, count)
    return np.append(fine, time[-1])


def _slopes(edges: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the rates of change within samples; zero next to a gap and at the ends.

    At a gap one of three samples is half as long again as the middle one of them, or half as long.
    """
    slope = np.zeros_like(rate)
    if len(rate) < 3:
        return slope
    width = edges[1:] - edges[:-1]
    a, b, c = width[:-2], width[1:-1], width[2:]
    least, most = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    middle = a + b + c - least - most
    fine = (most < 1.5 * middle) & (least > 0.5 * middle)
    slope[1:-1] = ((rate[2:] - rate[:-2]) / (0.5 * (a + c) + b)[:, None]) * fine[:, None]
    return slope


def _span(time: FloatArray) -> str:
    if not time.size:
        return "0 epochs"
    return f"{time.size} epochs, {time[0]:.1f}…{time[-1]:.1f} s"


def summed(increments: FloatArray) -> FloatArray:
    """Return the sums of the first 0, 1 … n increments, shape (n + 1, …)."""
    return np.concatenate([np.zeros((1, *increments.shape[1:])), np.cumsum(increments, axis=0)])


def earth_turn(elapsed: ArrayLike) -> FloatArray:
    """Return the rotation from ECEF axes `elapsed` seconds later to those kept."""
    angle = EARTH_RATE * np.asarray(elapsed, dtype=float)
    return matrix_from_rotvec(np.stack([0.0 * angle, 0.0 * angle, angle], axis=-1))
