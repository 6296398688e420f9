"""Covariances of a whole trajectory turned into north-east-down, compiled."""

from __future__ import annotations

from ..filters.compiled.jit import njit


@njit(cache=True, nogil=True)
def ned_covariances(upper, C_ne, C_eb, out, start):
    """Write C cov Cᵀ of every row to `out`, shape (3, m, 3, 3), from index `start` on.

    `upper` (n, 18) holds the upper triangles of the covariances of position and velocity in e,
    whose C is C_ne, and of attitude in b, whose C is C_ne C_eb.
    """
    for k in range(len(upper)):
        # As scalars: the compiler keeps them in registers.
        a00, a01, a02 = C_ne[k, 0, 0], C_ne[k, 0, 1], C_ne[k, 0, 2]
        a10, a11, a12 = C_ne[k, 1, 0], C_ne[k, 1, 1], C_ne[k, 1, 2]
        a20, a21, a22 = C_ne[k, 2, 0], C_ne[k, 2, 1], C_ne[k, 2, 2]
        for block in range(3):
            if block == 2:
                b00, b01, b02 = C_eb[k, 0, 0], C_eb[k, 0, 1], C_eb[k, 0, 2]
                b10, b11, b12 = C_eb[k, 1, 0], C_eb[k, 1, 1], C_eb[k, 1, 2]
                b20, b21, b22 = C_eb[k, 2, 0], C_eb[k, 2, 1], C_eb[k, 2, 2]
                a00, a01, a02 = (
                    a00 * b00 + a01 * b10 + a02 * b20,
                    a00 * b01 + a01 * b11 + a02 * b21,
                    a00 * b02 + a01 * b12 + a02 * b22,
                )
                a10, a11, a12 = (
                    a10 * b00 + a11 * b10 + a12 * b20,
                    a10 * b01 + a11 * b11 + a12 * b21,
                    a10 * b02 + a11 * b12 + a12 * b22,
                )
                a20, a21, a22 = (
                    a20 * b00 + a21 * b10 + a22 * b20,
                    a20 * b01 + a21 * b11 + a22 * b21,
                    a20 * b02 + a21 * b12 + a22 * b22,
                )
            at = 6 * block
            xx, xy, xz = upper[k, at], upper[k, at + 1], upper[k, at + 2]
            yy, yz, zz = upper[k, at + 3], upper[k, at + 4], upper[k, at + 5]
            x0, y0, z0 = _times(xx, xy, xz, yy, yz, zz, a00, a01, a02)
            x1, y1, z1 = _times(xx, xy, xz, yy, yz, zz, a10, a11, a12)
            x2, y2, z2 = _times(xx, xy, xz, yy, yz, zz, a20, a21, a22)
            cov = out[block, start + k]
            cov[0, 0] = a00 * x0 + a01 * y0 + a02 * z0
            cov[1, 1] = a10 * x1 + a11 * y1 + a12 * z1
            cov[2, 2] = a20 * x2 + a21 * y2 + a22 * z2
            cov[0, 1] = a00 * x1 + a01 * y1 + a02 * z1
            cov[0, 2] = a00 * x2 + a01 * y2 + a02 * z2
            cov[1, 2] = a10 * x2 + a11 * y2 + a12 * z2
            cov[1, 0], cov[2, 0], cov[2, 1] = cov[0, 1], cov[0, 2], cov[1, 2]


@njit(cache=True, nogil=True)
def _times(xx, xy, xz, yy, yz, zz, x, y, z):
    """Return a symmetric matrix times a vector."""
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
