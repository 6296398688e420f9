"""The vehicle's own idea of its motion over a short window: velocity in local axes.

Frame w is the vehicle's axes (forward, right, down) at the beginning of the window. Attitude
within the window comes from a yaw rate (planar) or from three gyros, speed from an odometer; a
wheel rolls forward, so the velocity is the speed along the vehicle's nose, plus what the lever
arm to the antenna adds in a turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..filters.errors import AlignmentError
from ..filters.rotation import FloatArray, matrix_from_rotvec, matrix_from_rpy
from ..filters.strapdown import InertialStream

#: Wheels stand below this speed [m/s], for so long [s], if they stand.
_STANDS, _SHORTEST_REST = 0.02, 2.0


@dataclass(frozen=True, eq=False)
class LocalTrack:
    """Attitude and antenna velocity over a window, in the vehicle's axes at its beginning.

    Parameters
    ----------
    time : ndarray, shape (n,)
        GPS time [s].
    C_wv : ndarray, shape (n, 3, 3)
        ``C_wv @ x_v == x_w``; the first is the identity.
    vel_w : ndarray, shape (n, 3)
        [m/s].
    source : str
        What it was made from.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import planar_track
    >>> time = np.linspace(0.0, 10.0, 101)
    >>> speed, rate = np.full(101, 8.0), np.full(101, np.pi / 20)  # a right angle to the right
    >>> track = planar_track(time, speed, rate, start=0.0, end=10.0)
    >>> track.vel_w[[0, -1]].round(6) + 0.0  # first forward, then to where the right was
    array([[8., 0., 0.],
           [0., 8., 0.]])
    """

    time: FloatArray
    C_wv: FloatArray
    vel_w: FloatArray
    source: str

    def __repr__(self) -> str:
        span = f"{self.time[0]:.1f}…{self.time[-1]:.1f} s"
        return f"<LocalTrack from {self.source}, {self.time.size} nodes, {span}>"

    def velocity_at(self, time: ArrayLike) -> FloatArray:
        """Return the velocity interpolated to `time` [s], shape (m, 3), NaN outside the window."""
        at = np.asarray(time, dtype=float)
        return np.column_stack(
            [np.interp(at, self.time, v, left=np.nan, right=np.nan) for v in self.vel_w.T]
        )

    def moved_at(self, time: ArrayLike) -> FloatArray:
        """Return how far the antenna has come since the beginning [m], shape (m, 3); or NaN."""
        at, step = np.asarray(time, dtype=float), np.diff(self.time)[:, None]
        parts = 0.5 * (self.vel_w[1:] + self.vel_w[:-1]) * step
        moved = np.vstack([np.zeros(3), np.cumsum(parts, axis=0)])
        return np.column_stack(
            [np.interp(at, self.time, s, left=np.nan, right=np.nan) for s in moved.T]
        )


def planar_track(
    time: ArrayLike,
    speed: ArrayLike,
    yaw_rate: ArrayLike,
    start: float,
    end: float,
    lever_v: ArrayLike = (0.0, 0.0, 0.0),
) -> LocalTrack:
    """Return the track of a vehicle on level ground from odometer and yaw rate.

    Parameters
    ----------
    time : array_like, shape (n,)
        GPS time [s].
    speed : array_like, shape (n,)
        Signed forward speed [m/s].
    yaw_rate : array_like, shape (n,)
        About the down axis [rad/s].
    start, end : float
        The window [s]; both must lie within `time`.
    lever_v : array_like, shape (3,)
        From the middle of the rear axle to the antenna, vehicle axes [m].

    Raises
    ------
    AlignmentError
        If the odometer does not cover the window.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import planar_track
    >>> time = np.linspace(0.0, 10.0, 101)
    >>> speed, rate = np.full(101, 8.0), np.full(101, np.pi / 20)  # a right angle to the right
    >>> track = planar_track(time, speed, rate, start=0.0, end=10.0)
    >>> track.vel_w[[0, -1]].round(6) + 0.0  # first forward, then to where the right was
    array([[8., 0., 0.],
           [0., 8., 0.]])
    """
    time, speed, rate = (np.asarray(a, dtype=float) for a in (time, speed, yaw_rate))
    node = _nodes(time, start, end, "odometer")
    v, w = np.interp(node, time, speed), np.interp(node, time, rate)
    turn = np.concatenate([[0.0], np.cumsum(0.5 * (w[1:] + w[:-1]) * np.diff(node))])
    zero = np.zeros_like(turn)
    C_wv = matrix_from_rpy(np.column_stack([zero, zero, turn]))
    vel_v = np.column_stack([v, zero, zero])
    vel_v = vel_v + np.cross(np.column_stack([zero, zero, w]), np.asarray(lever_v, dtype=float))
    return LocalTrack(node, C_wv, np.einsum("nij,nj->ni", C_wv, vel_v), "odometer and yaw rate")


def inertial_track(
    stream: InertialStream,
    time: ArrayLike,
    speed: ArrayLike,
    start: float,
    end: float,
    C_bv: ArrayLike,
    gyro_bias: ArrayLike = (0.0, 0.0, 0.0),
    lever_v: ArrayLike = (0.0, 0.0, 0.0),
) -> LocalTrack:
    """Return the track of a vehicle from odometer and gyros, on hills as well.

    Parameters
    ----------
    stream : InertialStream
    time, speed
        The odometer, as for `planar_track`.
    start, end, lever_v
        As for `planar_track`.
    C_bv : array_like, shape (3, 3)
        Mounting, ``C_bv @ x_v == x_b``.
    gyro_bias : array_like, shape (3,)
        Taken off the gyros [rad/s]. The Earth's rate is not: 0.06° over 15 s.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import inertial_track
    >>> from certnav.filters import InertialStream
    >>> time = np.linspace(0.01, 10.0, 1000)
    >>> gyro_b = np.tile([0.0, 0.0, np.pi / 20], (1000, 1))  # 9°/s to the right
    >>> stream = InertialStream(time, gyro_b, np.tile([0.0, 0.0, -9.8], (1000, 1)))
    >>> track = inertial_track(stream, time, np.full(1000, 8.0), 0.5, 9.5, np.eye(3))
    >>> print(np.degrees(np.arctan2(track.vel_w[-1, 1], track.vel_w[-1, 0])).round(1))
    81.0
    """
    time, speed = np.asarray(time, dtype=float), np.asarray(speed, dtype=float)
    _nodes(time, start, end, "odometer")
    edges = stream.edges
    if not (edges[0] <= start and end <= edges[-1]):
        raise AlignmentError(f"the IMU does not cover the window {start:.1f}…{end:.1f} s")
    first, last = np.searchsorted(edges, [start, end])
    node = np.concatenate([[start], edges[first:last], [end]])
    node = node[np.concatenate([[True], np.diff(node) > 1e-9])]
    sample = np.clip(np.searchsorted(edges, 0.5 * (node[1:] + node[:-1])) - 1, 0, len(edges) - 2)
    C_vb = np.asarray(C_bv, dtype=float).T
    rate_v = (stream.gyro[sample] - np.asarray(gyro_bias, dtype=float)) @ C_vb.T
    steps = matrix_from_rotvec(rate_v * np.diff(node)[:, None])
    C_wv = np.empty((node.size, 3, 3))
    C_wv[0] = np.eye(3)
    for k, step in enumerate(steps):
        C_wv[k + 1] = C_wv[k] @ step
    at_node = np.vstack([rate_v[:1], 0.5 * (rate_v[1:] + rate_v[:-1]), rate_v[-1:]])
    vel_v = np.zeros((node.size, 3))
    vel_v[:, 0] = np.interp(node, time, speed)
    vel_v += np.cross(at_node, np.asarray(lever_v, dtype=float))
    return LocalTrack(node, C_wv, np.einsum("nij,nj->ni", C_wv, vel_v), "odometer and gyros")


def rate_at_rest(
    stream: InertialStream, time: ArrayLike, speed: ArrayLike, until: float
) -> FloatArray:
    """Return what the gyros show while the wheels stand: their bias, and the Earth's rate.

    Parameters
    ----------
    stream : InertialStream
    time, speed : array_like, shape (n,)
        The odometer [s], [m/s].
    until : float
        Later standstills are not known yet [s].

    Returns
    -------
    ndarray, shape (3,)
        Mean of the last standstill of two seconds or more [rad/s]; zero if there was none.
    """
    time, speed = np.asarray(time, dtype=float), np.asarray(speed, dtype=float)
    moving = np.concatenate([[-1], np.flatnonzero(np.abs(speed) > _STANDS), [time.size]])
    for last in range(len(moving) - 2, -1, -1):
        first, end = moving[last] + 1, moving[last + 1] - 1
        if end <= first or time[first] + _SHORTEST_REST > until:
            continue
        # Wheels stop turning a little after and before the car rocks on its springs.
        begin, stop = time[first] + 0.5, min(time[end], until) - 0.5
        if stop - begin < _SHORTEST_REST - 1.0:
            continue
        samples = slice(*np.searchsorted(stream.edges[:-1], [begin, stop]))
        if samples.stop - samples.start >= 10:
            return np.asarray(stream.gyro[samples].mean(axis=0))
    return np.zeros(3)


def _nodes(time: FloatArray, start: float, end: float, what: str) -> FloatArray:
    """Return the window's ends with the given times between them, or refuse the window."""
    if not start < end:
        raise AlignmentError(f"window: start {start:.1f} s is not before end {end:.1f} s")
    if time.size < 2 or time[0] > start or time[-1] < end:
        span = f"{time[0]:.1f}…{time[-1]:.1f} s" if time.size else "nothing"
        raise AlignmentError(
            f"the {what} does not cover the window {start:.1f}…{end:.1f} s (it spans {span})"
        )
    inside = time[(time > start) & (time < end)]
    return np.concatenate([[start], inside, [end]])
