"""Rotations as 3×3 matrices and rotation vectors, vectorised over leading axes.

For batches and edges scipy's `Rotation` serves; these few functions are the ones the
filter needs per update, where a `Rotation` object costs more than the arithmetic.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


def skew(vector: ArrayLike) -> FloatArray:
    """Return the matrix with ``skew(a) @ b == cross(a, b)``.

    Parameters
    ----------
    vector : array_like, shape (..., 3)

    Returns
    -------
    ndarray, shape (..., 3, 3)
    """
    v = np.asarray(vector, dtype=float)
    if v.ndim == 1:  # as the filter calls it, thousands of times a run
        x, y, z = v.tolist()
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def crossed(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a × b of one pair of vectors, shape (3,), at a tenth of the time of `numpy.cross`."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def matrix_from_rotvec(rotvec: ArrayLike) -> FloatArray:
    """Return the rotation matrix of a rotation vector [rad] (Rodrigues), shape (..., 3, 3)."""
    v = np.asarray(rotvec, dtype=float)
    if v.ndim == 1:  # as the filter calls it
        return _one_matrix(*v.tolist())
    angle2 = np.sum(v * v, axis=-1)[..., None, None]
    angle = np.sqrt(angle2)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - angle2 / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(safe)) / (safe * safe))
    s = skew(v)
    return np.eye(3) + a * s + b * (s @ s)


def _one_matrix(x: float, y: float, z: float) -> FloatArray:
    n2 = x * x + y * y + z * z
    n = math.sqrt(n2)
    if not n < math.inf:
        return np.full((3, 3), np.nan)
    if n < 1e-4:
        a, b = 1.0 - n2 / 6.0, 0.5 - n2 / 24.0
    else:
        a, b = math.sin(n) / n, (1.0 - math.cos(n)) / (n * n)
    ax, ay, az, xy, xz, yz = a * x, a * y, a * z, b * x * y, b * x * z, b * y * z
    return np.array(
        [
            [1.0 - b * (y * y + z * z), xy - az, xz + ay],
            [xy + az, 1.0 - b * (x * x + z * z), yz - ax],
            [xz - ay, yz + ax, 1.0 - b * (x * x + y * y)],
        ]
    )


def matrix_from_rpy(rpy: ArrayLike) -> FloatArray:
    """Return C_nb from roll, pitch and heading.

    Parameters
    ----------
    rpy : array_like, shape (..., 3)
        Roll (right side down +), pitch (nose up +), heading (clockwise from north) [rad].

    Returns
    -------
    ndarray, shape (..., 3, 3)
        ``C_nb @ x_b == x_n`` with n = NED and b = forward-right-down.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import matrix_from_rpy
    >>> C_nb = matrix_from_rpy([0.0, 0.0, np.pi / 2])  # level, heading east
    >>> (C_nb @ [1.0, 0.0, 0.0]).round(12) + 0.0  # forward is east
    array([0., 1., 0.])
    """
    angles = np.asarray(rpy, dtype=float)
    sr, sp, sy = np.moveaxis(np.sin(angles), -1, 0)
    cr, cp, cy = np.moveaxis(np.cos(angles), -1, 0)
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rpy_from_matrix(C_nb: ArrayLike) -> FloatArray:
    """Return roll, pitch and heading [rad] of C_nb, shape (..., 3); heading in (−π, π].

    At |pitch| = 90° roll and heading are not separable; heading is then reported with
    whatever roll the arctangent gives, and their composition still equals `C_nb`.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import matrix_from_rpy, rpy_from_matrix
    >>> rpy = np.radians([2.0, -5.0, 170.0])
    >>> np.degrees(rpy_from_matrix(matrix_from_rpy(rpy))).round(9)
    array([  2.,  -5., 170.])
    """
    C = np.asarray(C_nb, dtype=float)
    roll = np.arctan2(C[..., 2, 1], C[..., 2, 2])
    pitch = np.arcsin(np.clip(-C[..., 2, 0], -1.0, 1.0))
    heading = np.arctan2(C[..., 1, 0], C[..., 0, 0])
    return np.stack([roll, pitch, heading], axis=-1)


def wrap_angle(angle: ArrayLike) -> FloatArray:
    """Return `angle` [rad] wrapped to [−π, π)."""
    return (np.asarray(angle, dtype=float) + np.pi) % (2.0 * np.pi) - np.pi


def orthonormalise(matrix: ArrayLike) -> FloatArray:
    """Return the nearest rotation matrix in the Frobenius norm (SVD), shape (..., 3, 3)."""
    u, _, vt = np.linalg.svd(np.asarray(matrix, dtype=float))
    u[..., :, 2] *= np.linalg.det(u @ vt)[..., None]
    return u @ vt
