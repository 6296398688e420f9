"""Strapdown mechanisation in ECEF, with coning and sculling from the sample before.

ECEF rather than local level: no transport rate, no singularity, and Doppler and satellite
geometry arrive in the same axes. The arithmetic is in `filters.compiled.kernels`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .compiled import kernels
from .compiled import rows as layout
from .errors import DataError
from .rotation import FloatArray


@dataclass(frozen=True, eq=False)
class NavState:
    """Position, velocity and attitude of the IMU at one instant.

    Parameters
    ----------
    time : float
        GPS time [s].
    pos_e, vel_e : array_like, shape (3,)
        ECEF [m], [m/s].
    C_eb : array_like, shape (3, 3)
        ``C_eb @ x_b == x_e``.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import NavState, lla_to_ecef
    >>> state = NavState(0.0, lla_to_ecef(0.0, 0.0, 0.0), [0.0, 0.0, 10.0], np.eye(3))
    >>> state.vel_e  # on the equator and the prime meridian: northwards
    array([ 0.,  0., 10.])
    """

    time: float
    pos_e: FloatArray
    vel_e: FloatArray
    C_eb: FloatArray

    def __post_init__(self) -> None:
        for name, shape in (("pos_e", (3,)), ("vel_e", (3,)), ("C_eb", (3, 3))):
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape or not np.isfinite(value).all():
                raise DataError(f"state.{name}: expected finite values of shape {shape}")
            object.__setattr__(self, name, value)

    @classmethod
    def known(cls, time: float, pos_e: FloatArray, vel_e: FloatArray, C_eb: FloatArray) -> NavState:
        """Return a state of arrays that need no looking at: a filter's own, copied."""
        state = object.__new__(cls)
        state.__dict__.update(time=time, pos_e=pos_e.copy(), vel_e=vel_e.copy(), C_eb=C_eb.copy())
        return state


class InertialStream:
    """IMU samples laid out for the kernels; a live one grows (`live`, `append`).

    Parameters
    ----------
    time : array_like, shape (n,)
        End of each sample's interval, GPS time [s].
    gyro_b, accel_b : array_like, shape (n, 3)
        Mean rate [rad/s] and mean specific force [m/s²] over each interval.

    Notes
    -----
    The first sample's interval is taken as long as the median one.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import InertialStream
    >>> time = 0.01 * np.arange(1, 1001)
    >>> still = InertialStream(time, np.zeros((1000, 3)), np.tile([0.0, 0.0, -9.8], (1000, 1)))
    >>> len(still), round(still.start, 9), still.end  # the first interval begins before its stamp
    (1000, 0.0, 10.0)
    """

    def __init__(self, time: ArrayLike, gyro_b: ArrayLike, accel_b: ArrayLike) -> None:
        end = np.ascontiguousarray(time, dtype=float)
        first = end[0] - np.median(np.diff(end))
        self._hold(np.concatenate([[first], end]), gyro_b, accel_b)

    @classmethod
    def of_edges(cls, edges: ArrayLike, gyro_b: ArrayLike, accel_b: ArrayLike) -> InertialStream:
        """Return the stream of n samples between n + 1 given interval edges [s]."""
        stream = cls.__new__(cls)
        stream._hold(edges, gyro_b, accel_b)
        return stream

    @classmethod
    def live(cls, interval: float) -> InertialStream:
        """Return an empty stream; its first sample is taken to cover `interval` [s]."""
        stream = cls.of_edges(np.zeros(1), np.zeros((0, 3)), np.zeros((0, 3)))
        stream.interval = float(interval)
        return stream

    def _hold(self, edges: ArrayLike, gyro_b: ArrayLike, accel_b: ArrayLike) -> None:
        self._edges = np.ascontiguousarray(edges, dtype=float)
        self._gyro = np.ascontiguousarray(gyro_b, dtype=float)
        self._accel = np.ascontiguousarray(accel_b, dtype=float)
        self._count = self._gyro.shape[0]
        self.interval = float(np.median(np.diff(self._edges))) if self._count else float("nan")

    def append(self, time: float, gyro_b: ArrayLike, accel_b: ArrayLike) -> None:
        """Add the sample that ends at `time` [s].

        Raises
        ------
        DataError
            If time does not increase, or a value is not finite.
        """
        n = self._count
        if n == 0:
            self._edges[0] = time - self.interval
        if not time > self._edges[n]:
            raise DataError(
                f"imu: time goes backwards ({self._edges[n]:.6f} s, then {time:.6f} s)",
                remedy="sort the samples, or leave out the repeated one",
            )
        sample = np.concatenate([np.ravel(gyro_b), np.ravel(accel_b)])
        if sample.shape != (6,) or not np.isfinite(sample).all():
            raise DataError(f"imu: expected six finite values at {time:.6f} s")
        if n == self._gyro.shape[0]:
            more = max(n, 1024)
            self._edges = np.concatenate([self._edges, np.zeros(more)])
            self._gyro = np.concatenate([self._gyro, np.zeros((more, 3))])
            self._accel = np.concatenate([self._accel, np.zeros((more, 3))])
        self._edges[n + 1], self._gyro[n], self._accel[n] = time, sample[:3], sample[3:]
        self._count = n + 1

    def forget(self, before: float) -> int:
        """Let go of samples that ended before a time [s], of a live stream; return how many.

        Nothing is done until they are half of what is held, so that one sample's share is small;
        arrays handed out before stay as they were.
        """
        gone = int(np.searchsorted(self.edges, before)) - 1
        if 2 * gone < max(self._count, 1):
            return 0
        kept, room = self._count - gone, max(2 * (self._count - gone), 1024)
        edges, gyro, accel = np.zeros(room + 1), np.zeros((room, 3)), np.zeros((room, 3))
        edges[: kept + 1] = self._edges[gone : self._count + 1]
        gyro[:kept], accel[:kept] = self.gyro[gone:], self.accel[gone:]
        self._edges, self._gyro, self._accel, self._count = edges, gyro, accel, kept
        return gone

    def __len__(self) -> int:
        return self._count

    @property
    def edges(self) -> FloatArray:
        """Interval edges [s], shape (n + 1,)."""
        return self._edges[: self._count + 1]

    @property
    def gyro(self) -> FloatArray:
        """Mean rates [rad/s], shape (n, 3), read-only."""
        return self._seen(self._gyro)

    @property
    def accel(self) -> FloatArray:
        """Mean specific forces [m/s²], shape (n, 3), read-only."""
        return self._seen(self._accel)

    def _seen(self, held: FloatArray) -> FloatArray:
        """Return what there is of it; kernels are compiled for read-only samples, and only once."""
        seen = held[: self._count]
        seen.flags.writeable = False
        return seen

    @property
    def start(self) -> float:
        """Begin of the first sample's interval [s]."""
        return float(self.edges[0])

    @property
    def end(self) -> float:
        """End of the last sample's interval [s]."""
        return float(self.edges[-1])

    def index(self, time: float) -> int:
        """Return the sample whose interval begins at or holds `time`."""
        k = int(np.searchsorted(self.edges, time + 1e-9, side="right")) - 1
        return min(max(k, 0), self._count)


def integrate(stream: InertialStream, start: NavState, until: float | None = None) -> FloatArray:
    """Integrate inertially, without aiding, from `start` on.

    Parameters
    ----------
    stream : InertialStream
    start : NavState
        Its time must lie inside the stream.
    until : float, optional
        GPS time [s]; default the end of the stream.

    Returns
    -------
    ndarray, shape (m, 16)
        One row per IMU sample: time, pos_e, vel_e, C_eb row by row.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import C_en_of, gravity_e, integrate, lla_to_ecef
    >>> from certnav.filters import InertialStream, NavState
    >>> pos_e, still = lla_to_ecef(0.5, 2.0, 30.0), np.ones((1001, 1))
    >>> C_eb = C_en_of(pos_e)  # level, heading north, at rest on a turning Earth
    >>> gyro_b, accel_b = C_eb.T @ [0.0, 0.0, 7.292115e-5], -C_eb.T @ gravity_e(pos_e)
    >>> stream = InertialStream(0.01 * np.arange(1001), still * gyro_b, still * accel_b)
    >>> rows = integrate(stream, NavState(0.0, pos_e, np.zeros(3), C_eb))
    >>> rows.shape, bool(np.linalg.norm(rows[-1, 1:4] - pos_e) < 1e-4)  # [m], after ten seconds
    ((1000, 16), True)
    """
    until = stream.end if until is None else until
    if not stream.start <= start.time <= until <= stream.end:
        raise DataError(
            f"integrate: {start.time:.3f}…{until:.3f} s is not inside the IMU data "
            f"{stream.start:.3f}…{stream.end:.3f} s"
        )
    k = stream.index(start.time)
    rows = np.zeros((stream.gyro.shape[0] - k, layout.ROW_SIZE))
    cursor = np.array([0.0, start.time])
    kernels.advance(
        stream.edges, stream.gyro, stream.accel, k, start.time, until,
        start.pos_e.copy(), start.vel_e.copy(), start.C_eb.copy(), np.zeros(12),
        np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(7), rows, cursor, 0.0,
    )  # fmt: skip
    return rows[: int(cursor[0]), : layout.ROW_BIAS]
