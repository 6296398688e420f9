"""A trajectory at times between its epochs; never beyond them."""

from __future__ import annotations

import numpy as np

from ...filters.errors import DataError
from ...filters.rotation import FloatArray, matrix_from_rotvec
from ..solution import Epochs, Trajectory


def covered(node_time: FloatArray, time: FloatArray, max_gap: float) -> np.ndarray:
    """Return True where `time` is on a node, or between two close enough to interpolate.

    Close enough is `max_gap` [s], or 1.5 times the median step of the nodes if that is longer.
    """
    if node_time.size == 0:
        return np.zeros(time.shape, dtype=bool)
    step = np.diff(node_time)
    limit = max(max_gap, 1.5 * float(np.median(step))) if step.size else 0.0
    before = np.searchsorted(node_time, time, side="right") - 1
    inside = (before >= 0) & (time <= node_time[-1])
    before = np.clip(before, 0, None)
    after = np.minimum(before + 1, node_time.size - 1)
    close = node_time[after] - node_time[before] <= limit
    mask: np.ndarray = inside & ((node_time[before] == time) | close)
    return mask


def interpolate(trajectory: Trajectory, time: FloatArray) -> Trajectory:
    """Return the trajectory at `time`, which must lie in its span.

    Position by the cubic Hermite polynomial of the positions and velocities at both ends,
    attitude along the shortest rotation at constant rate, everything else linearly.

    Parameters
    ----------
    trajectory : Trajectory
    time : ndarray, shape (m,)
        GPS time [s].

    Raises
    ------
    DataError
        If a time is outside the trajectory's span.
    """
    node = trajectory.time
    if node.size == 0 or (time.size and (time.min() < node[0] or time.max() > node[-1])):
        raise DataError("interpolation asked for outside the solution's time span")
    k0 = np.clip(np.searchsorted(node, time, side="right") - 1, 0, max(node.size - 2, 0))
    k1 = np.minimum(k0 + 1, node.size - 1)
    step = node[k1] - node[k0]
    s = np.divide(time - node[k0], step, out=np.zeros(time.size), where=step > 0)

    def linear(values: FloatArray) -> FloatArray:
        weight = s.reshape(-1, *[1] * (values.ndim - 1))
        blend: FloatArray = (1.0 - weight) * values[k0] + weight * values[k1]
        return blend

    # Hermite as the straight line plus a correction that vanishes at both ends, so that the
    # millions of metres of an ECEF coordinate are not multiplied by the cubic's coefficients.
    w, h = s[:, None], step[:, None]
    pos, vel = trajectory.pos_e, trajectory.vel_e
    chord = pos[k1] - pos[k0]
    bend = (1.0 - w) * (vel[k0] * h - chord) - w * (vel[k1] * h - chord)
    pos_e = pos[k0] + w * chord + w * (1.0 - w) * bend

    from scipy.spatial.transform import Rotation  # slow to import

    turn = np.swapaxes(trajectory.C_eb[k0], 1, 2) @ trajectory.C_eb[k1]
    rotvec = Rotation.from_matrix(turn).as_rotvec() if time.size else np.zeros((0, 3))
    return Trajectory(
        time=time,
        pos_e=pos_e,
        vel_e=linear(vel),
        C_eb=trajectory.C_eb[k0] @ matrix_from_rotvec(w * rotvec),
        gyro_bias=linear(trajectory.gyro_bias),
        accel_bias=linear(trajectory.accel_bias),
        cov_pos_n=linear(trajectory.cov_pos_n),
        cov_vel_n=linear(trajectory.cov_vel_n),
        cov_att_n=linear(trajectory.cov_att_n),
        std_gyro_bias=linear(trajectory.std_gyro_bias),
        std_accel_bias=linear(trajectory.std_accel_bias),
        protection=linear(trajectory.protection),
    )


def usable_at(epochs: Epochs, time: FloatArray) -> np.ndarray:
    """Return the usable satellites in force at `time`: those of the last GNSS epoch.

    An epoch stays in force for 2.5 median epoch intervals; after that, and before the first
    epoch, 0. Where there are no epochs at all (a set of fixes) the count is unknown: −1.
    """
    if epochs.time.size == 0:
        return np.full(time.shape, -1)
    step = float(np.median(np.diff(epochs.time))) if epochs.time.size > 1 else np.inf
    last = np.searchsorted(epochs.time, time + 1e-6, side="right") - 1
    held = (last >= 0) & (time - epochs.time[np.clip(last, 0, None)] <= 2.5 * step)
    return np.where(held, epochs.usable[np.clip(last, 0, None)], 0)
