"""Roll and pitch from specific force: at rest, carried on by the gyros, or in motion."""

from __future__ import annotations

import numpy as np

from ...filters.earth import C_en_of, gravity_e
from ...filters.errors import AlignmentError
from ...filters.rotation import FloatArray, matrix_from_rotvec, matrix_from_rpy, rpy_from_matrix
from ...filters.strapdown import InertialStream
from .attitude import VelocityTrack

#: Longest window used for levelling [s].
LEVEL_WINDOW = 20.0


def samples(stream: InertialStream, start: float, end: float) -> slice:
    """Return the samples whose intervals lie within the two times."""
    first = int(np.searchsorted(stream.edges, start - 1e-6))
    last = int(np.searchsorted(stream.edges, end + 1e-6, side="right")) - 1
    return slice(first, max(last, first))


def _level(force_v: FloatArray, force_h: FloatArray) -> FloatArray:
    """Return C_hv, without turn about the vertical, that takes force_v to force_h (directions)."""
    a = force_v / np.linalg.norm(force_v)
    b = force_h / np.linalg.norm(force_h)
    C = np.eye(3)
    for _ in range(20):
        step = np.cross(C @ a, b)
        step[2] = 0.0
        C = matrix_from_rotvec(step) @ C
        if np.linalg.norm(step) < 1e-12:
            break
    roll, pitch, _ = rpy_from_matrix(C)
    return matrix_from_rpy([roll, pitch, 0.0])


def level_at_rest(
    stream: InertialStream, rest: tuple[float, float], C_bv: FloatArray
) -> FloatArray:
    """Return C_hb from the mean specific force of a standstill; h is level, azimuth arbitrary."""
    force_v = C_bv.T @ stream.accel[samples(stream, *rest)].mean(axis=0)
    return _level(force_v, np.array([0.0, 0.0, -1.0])) @ C_bv.T


def carry_from_rest(
    stream: InertialStream, rest: tuple[float, float], time: float, C_bv: FloatArray
) -> tuple[FloatArray, FloatArray, float, float]:
    """Level at rest, then follow the gyros to `time`.

    Returns C_hb, the mean rate at rest (bias and Earth rate together), the time since, and the
    speed change along the nose that the accelerometers saw (its sign tells reversing).
    """
    still = samples(stream, *rest)
    mean_rate = stream.gyro[still].mean(axis=0)
    after = samples(stream, rest[1], time)
    gravity = np.array([0.0, 0.0, np.linalg.norm(stream.accel[still].mean(axis=0))])
    dt = np.diff(stream.edges)[after]
    C_hb = np.empty((len(dt) + 1, 3, 3))
    C_hb[0] = level_at_rest(stream, rest, C_bv)
    for k, turn in enumerate(matrix_from_rotvec((stream.gyro[after] - mean_rate) * dt[:, None])):
        np.matmul(C_hb[k], turn, out=C_hb[k + 1])
    felt_h = np.einsum("kij,kj->ki", C_hb[:-1], stream.accel[after]) + gravity
    moved = float(dt @ np.sum((C_hb[:-1] @ C_bv[:, 0]) * felt_h, axis=1))
    return C_hb[-1], mean_rate, time - rest[1], moved


def level_in_motion(
    stream: InertialStream, track: VelocityTrack, k: int, course: float, C_bv: FloatArray
) -> FloatArray:
    """Return C_hb at epoch k from specific force and GNSS velocity change around it.

    Over the window the attitude is carried by the gyros, so that turning does not smear it.
    """
    near = np.flatnonzero(np.abs(track.time - track.time[k]) <= 0.5 * LEVEL_WINDOW)
    near = near[(track.time[near] >= stream.start) & (track.time[near] <= stream.end)]
    start, end = float(track.time[near[0]]), float(track.time[near[-1]])
    within = samples(stream, start, end)
    if end - start < 1.0 or within.stop - within.start < 10:
        raise AlignmentError("cannot level in motion: less than 1 s of IMU data with GNSS velocity")
    C_en = C_en_of(track.pos_e[k])
    dt = np.diff(stream.edges)[within]
    C_wb = [np.eye(3)]
    for turn in matrix_from_rotvec(stream.gyro[within] * dt[:, None])[:-1]:
        C_wb.append(C_wb[-1] @ turn)
    at_k = int(np.searchsorted(stream.edges[within], track.time[k])) - 1
    C_bw = C_wb[max(min(at_k, len(C_wb) - 1), 0)].T
    dv_w = np.einsum("kij,kj,k->i", np.array(C_wb), stream.accel[within], dt)
    force_b = C_bw @ dv_w / dt.sum()
    accel_n = C_en.T @ (track.vel_e[near[-1]] - track.vel_e[near[0]]) / (end - start)
    force_n = accel_n - C_en.T @ gravity_e(track.pos_e[k])
    force_h = matrix_from_rpy([0.0, 0.0, course]).T @ force_n
    return _level(C_bv.T @ force_b, force_h) @ C_bv.T
