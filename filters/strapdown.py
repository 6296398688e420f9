"""Strapdown mechanisation in ECEF, with coning and sculling from the sample before.

ECEF rather than local level: no transport rate, no singularity, and Doppler and satellite
geometry arrive in the same axes. The arithmetic is in `filters._kernels`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from . import _kernels
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


class InertialStream:
    """IMU samples laid out for the kernels, with a cursor that only moves forward.

    Parameters
    ----------
    time : array_like, shape (n,)
        End of each sample's interval, GPS time [s].
    gyro_b, accel_b : array_like, shape (n, 3)
        Mean rate [rad/s] and mean specific force [m/s²] over each interval.

    The first sample's interval is taken as long as the median one.
    """

    def __init__(self, time: ArrayLike, gyro_b: ArrayLike, accel_b: ArrayLike) -> None:
        end = np.ascontiguousarray(time, dtype=float)
        first = end[0] - np.median(np.diff(end))
        self.edges = np.concatenate([[first], end])
        self.gyro = np.ascontiguousarray(gyro_b, dtype=float)
        self.accel = np.ascontiguousarray(accel_b, dtype=float)

    @classmethod
    def of_edges(cls, edges: ArrayLike, gyro_b: ArrayLike, accel_b: ArrayLike) -> InertialStream:
        """Return the stream of n samples between n + 1 given interval edges [s]."""
        stream = cls.__new__(cls)
        stream.edges = np.ascontiguousarray(edges, dtype=float)
        stream.gyro = np.ascontiguousarray(gyro_b, dtype=float)
        stream.accel = np.ascontiguousarray(accel_b, dtype=float)
        return stream

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
        return min(max(k, 0), self.gyro.shape[0])


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
    """
    until = stream.end if until is None else until
    if not stream.start <= start.time <= until <= stream.end:
        raise DataError(
            f"integrate: {start.time:.3f}…{until:.3f} s is not inside the IMU data "
            f"{stream.start:.3f}…{stream.end:.3f} s"
        )
    k = stream.index(start.time)
    rows = np.zeros((stream.gyro.shape[0] - k, _kernels.ROW_SIZE))
    cursor = np.array([0.0, start.time])
    _kernels.advance(
        stream.edges, stream.gyro, stream.accel, k, start.time, until,
        start.pos_e.copy(), start.vel_e.copy(), start.C_eb.copy(), np.zeros(12),
        np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(6), rows, cursor, 0.0,
    )  # fmt: skip
    return rows[: int(cursor[0]), : _kernels.ROW_BIAS]
