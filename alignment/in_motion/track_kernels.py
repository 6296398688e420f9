"""Compiled loops over IMU samples and over the parts of a window; `track` is their face.

A part is what the IMU did between two instants, in body axes of the first, as 3 × 23 numbers:

    C  Δv  A  B  F  ω    columns 0–2, 3, 4–9, 10–15, 16–21, and the rate at its beginning, 22

with the integrals of `alignment.in_motion.track`. A window is composed of its parts, from the
anchor backwards, at biases that may differ from those the parts were integrated with.
"""

from __future__ import annotations

import numpy as np

from ...filters.compiled.jit import njit

#: Columns of a part.
PART = 23
#: A time so close to an edge is the edge [s].
_SAME = 1e-9


@njit(cache=True)
def _exponential(x, y, z, R):
    """R ← the rotation matrix of a rotation vector."""
    t2 = x * x + y * y + z * z
    t = np.sqrt(t2)
    a, b = 1.0 - t2 / 6.0, 0.5 - t2 / 24.0
    if t > 1e-4:
        a, b = np.sin(t) / t, (1.0 - np.cos(t)) / t2
    R[0, 0], R[0, 1], R[0, 2] = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    R[1, 0], R[1, 1], R[1, 2] = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    R[2, 0], R[2, 1], R[2, 2] = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)


@njit(cache=True)
def _step(part, w, f, ws, fs, h, R, dv, S):
    """Go on in place by `h` seconds of mean rate `w` and force `f`, with slopes `ws` and `fs`.

    Coning and sculling follow from the slopes (Savage 1998). R, dv and S are scratch.
    """
    x2, x3, x12 = 0.5 * h * h, h * h * h / 6.0, h * h * h / 12.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        c_i = w[j] * f[k] - w[k] * f[j]
        c_j = w[k] * f[i] - w[i] * f[k]
        c_k = w[i] * f[j] - w[j] * f[i]
        coning = w[j] * ws[k] - w[k] * ws[j]
        sculling = w[j] * fs[k] - w[k] * fs[j] + f[j] * ws[k] - f[k] * ws[j]
        S[0, i] = h * w[i] + x12 * coning
        S[1, i] = h * f[i] + x2 * c_i + x3 * (w[j] * c_k - w[k] * c_j) + x12 * sculling
    _exponential(S[0, 0], S[0, 1], S[0, 2], R)
    for i in range(3):
        dv[i] = part[i, 0] * S[1, 0] + part[i, 1] * S[1, 1] + part[i, 2] * S[1, 2]
    for j in range(4, 10):
        x, y, z = part[0, j], part[1, j], part[2, j]
        part[0, 6 + j] += dv[1] * z - dv[2] * y
        part[1, 6 + j] += dv[2] * x - dv[0] * z
        part[2, 6 + j] += dv[0] * y - dv[1] * x
    for i in range(3):
        part[i, 3] += dv[i]
        p, q, r = part[i, 0], part[i, 1], part[i, 2]
        for j in range(3):
            c = p * R[0, j] + q * R[1, j] + r * R[2, j]
            S[i, j] = 0.5 * h * (part[i, j] + c)
            part[i, j] = c
    for j in range(3):
        x, y, z = S[0, j], S[1, j], S[2, j]
        S[0, j] = 0.5 * (dv[1] * z - dv[2] * y)
        S[1, j] = 0.5 * (dv[2] * x - dv[0] * z)
        S[2, j] = 0.5 * (dv[0] * y - dv[1] * x)
        for i in range(3):
            s = x if i == 0 else (y if i == 1 else z)
            part[i, 4 + j] += s
            part[i, 7 + j] += s * w[j]
            part[i, 10 + j] += S[i, j]
            part[i, 13 + j] += S[i, j] * w[j]
            part[i, 16 + j] += s
            part[i, 19 + j] += s * f[j]


@njit(cache=True)
def integrate(edges, gyro, accel, gyro_slope, accel_slope, first, time, bias, parts):
    """parts[m] ← the integrals from time[m] to time[m + 1], biases (gyro first) taken off.

    `first` is the sample that begins at or holds time[0]; rates are linear within samples.
    """
    w, f, R = np.zeros(3), np.zeros(3), np.zeros((3, 3))
    dv, S = np.zeros(3), np.zeros((3, 3))
    last, k = gyro.shape[0] - 1, first
    for m in range(time.size - 1):
        part, start, end = parts[m], time[m], time[m + 1]
        for i in range(3):
            late = start - 0.5 * (edges[k] + edges[k + 1])
            for j in range(PART):
                part[i, j] = 1.0 if i == j else 0.0
            part[i, 22] = gyro[k, i] + gyro_slope[k, i] * late - bias[i]
        while True:
            stop = end if k == last else min(edges[k + 1], end)
            late = 0.5 * (start + stop - edges[k] - edges[k + 1])
            for i in range(3):
                w[i] = gyro[k, i] + gyro_slope[k, i] * late - bias[i]
                f[i] = accel[k, i] + accel_slope[k, i] * late - bias[3 + i]
            _step(part, w, f, gyro_slope[k], accel_slope[k], stop - start, R, dv, S)
            start = stop
            if k < last and edges[k + 1] <= end + _SAME:
                k += 1
            if start >= end - _SAME:
                break


@njit(cache=True)
def _moved(part, dg, da, R, H, out):
    """out ← a part with the biases dg and da larger than those it was integrated with.

    To the second order in the turn t that dg makes over the part, and exactly in da at dg = 0: the
    turn grows evenly, half of it is there on the average, a sixth of t × (t × Δv) is what the
    square leaves in Δv, and a force −da that turns along with it makes ½ t × that.
    """
    x = -(part[0, 4] * dg[0] + part[0, 5] * dg[1] + part[0, 6] * dg[2])
    y = -(part[1, 4] * dg[0] + part[1, 5] * dg[1] + part[1, 6] * dg[2])
    z = -(part[2, 4] * dg[0] + part[2, 5] * dg[1] + part[2, 6] * dg[2])
    _exponential(x, y, z, R)
    _exponential(0.5 * x, 0.5 * y, 0.5 * z, H)
    along, square = x * part[0, 3] + y * part[1, 3] + z * part[2, 3], x * x + y * y + z * z
    for i in range(3):
        t = x if i == 0 else (y if i == 1 else z)
        out[i, 3] = part[i, 3] + (along * t - square * part[i, 3]) / 6.0
        out[i, 22] = 0.0  # the change of force, for now
        for j in range(3):
            out[i, 3] += part[i, 10 + j] * dg[j]
            out[i, 22] -= part[i, 16 + j] * da[j]
            out[i, j] = R[i, 0] * part[0, j] + R[i, 1] * part[1, j] + R[i, 2] * part[2, j]
        for j in range(4, 22):
            out[i, j] = H[i, 0] * part[0, j] + H[i, 1] * part[1, j] + H[i, 2] * part[2, j]
        for j in range(3):
            out[i, 7 + j] -= out[i, 4 + j] * dg[j]
            out[i, 19 + j] -= out[i, 16 + j] * da[j]
    p, q, r = out[0, 22], out[1, 22], out[2, 22]
    out[0, 3] += p + 0.5 * (y * r - z * q)
    out[1, 3] += q + 0.5 * (z * p - x * r)
    out[2, 3] += r + 0.5 * (x * q - y * p)
    for j in range(4, 10):
        a, b, c = out[0, j], out[1, j], out[2, j]
        out[0, 6 + j] += 0.5 * (q * c - r * b)
        out[1, 6 + j] += 0.5 * (r * a - p * c)
        out[2, 6 + j] += 0.5 * (p * b - q * a)
    for i in range(3):
        out[i, 22] = part[i, 22] - dg[i]


@njit(cache=True)
def compose(parts, dg, da, C, dv, A, B, F, omega):
    """Integrals at the beginnings of all parts, anchored at the last, whose length is zero.

    The biases are by dg and da larger than those of the parts.
    """
    n = parts.shape[0]
    R, H, part = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, PART))
    for k in range(n - 1, -1, -1):
        _moved(parts[k], dg, da, R, H, part)
        after = min(k + 1, n - 1)
        if k == n - 1:
            for i in range(3):
                dv[k, i] = 0.0
                for j in range(6):
                    A[k, i, j], B[k, i, j], F[k, i, j] = 0.0, 0.0, 0.0
                for j in range(3):
                    C[k, i, j] = 1.0 if i == j else 0.0
        for i in range(3):
            p, q, r = C[after, i, 0], C[after, i, 1], C[after, i, 2]
            for j in range(3):
                C[k, i, j] = p * part[j, 0] + q * part[j, 1] + r * part[j, 2]
            omega[k, i] = part[i, 22]
        for i in range(3):
            p, q, r = C[k, i, 0], C[k, i, 1], C[k, i, 2]
            # What the part adds to Δv, kept for B.
            H[0, i] = p * part[0, 3] + q * part[1, 3] + r * part[2, 3]
            dv[k, i] = dv[after, i] - H[0, i]
            for j in range(6):
                A[k, i, j] = A[after, i, j] - (
                    p * part[0, 4 + j] + q * part[1, 4 + j] + r * part[2, 4 + j]
                )
                B[k, i, j] = B[after, i, j] - (
                    p * part[0, 10 + j] + q * part[1, 10 + j] + r * part[2, 10 + j]
                )
                F[k, i, j] = F[after, i, j] - (
                    p * part[0, 16 + j] + q * part[1, 16 + j] + r * part[2, 16 + j]
                )
        for j in range(6):
            x, y, z = A[k, 0, j], A[k, 1, j], A[k, 2, j]
            B[k, 0, j] -= H[0, 1] * z - H[0, 2] * y
            B[k, 1, j] -= H[0, 2] * x - H[0, 0] * z
            B[k, 2, j] -= H[0, 0] * y - H[0, 1] * x


@njit(cache=True)
def responses(dv, A, B, F, ends, out):
    """out ← what biases, scale factors and a rate in each part of the window do to Δv_w.

    For integrals anchored at the last instant; `ends` are the bounds of the parts, ascending.
    """
    n = dv.shape[0]
    for t in range(n):
        for i in range(3):
            for j in range(3):
                out[t, i, j], out[t, i, 3 + j] = B[t, i, j], -F[t, i, j]
                out[t, i, 6 + j], out[t, i, 9 + j] = B[t, i, 3 + j], -F[t, i, 3 + j]
        for s in range(ends.size - 1):
            # From the anchor back: nothing until b, the rate until m, then what it has turned.
            a, b = ends[s], ends[s + 1]
            m = min(max(t, a), b)
            p0, p1, p2 = dv[m, 0] - dv[b, 0], dv[m, 1] - dv[b, 1], dv[m, 2] - dv[b, 2]
            q0, q1, q2 = dv[t, 0] - dv[m, 0], dv[t, 1] - dv[m, 1], dv[t, 2] - dv[m, 2]
            for j in range(3):
                x, y, z = A[b, 0, j], A[b, 1, j], A[b, 2, j]
                u, v, w = A[m, 0, j] - x, A[m, 1, j] - y, A[m, 2, j] - z
                c = 12 + 3 * s + j
                out[t, 0, c] = B[m, 0, j] - B[b, 0, j] - (p1 * z - p2 * y) + q1 * w - q2 * v
                out[t, 1, c] = B[m, 1, j] - B[b, 1, j] - (p2 * x - p0 * z) + q2 * u - q0 * w
                out[t, 2, c] = B[m, 2, j] - B[b, 2, j] - (p0 * y - p1 * x) + q0 * v - q1 * u
