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
def _turned(part, dv, weight):
    """B += weight · [dv ×] A."""
    for j in range(4, 10):
        x, y, z = part[0, j], part[1, j], part[2, j]
        part[0, 6 + j] += weight * (dv[1] * z - dv[2] * y)
        part[1, 6 + j] += weight * (dv[2] * x - dv[0] * z)
        part[2, 6 + j] += weight * (dv[0] * y - dv[1] * x)


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
        part[i, 3] += dv[i]
    _turned(part, dv, 0.5)
    for i in range(3):
        p, q, r = part[i, 0], part[i, 1], part[i, 2]
        for j in range(3):
            before = part[i, j]
            part[i, j] = p * R[0, j] + q * R[1, j] + r * R[2, j]
            mean = 0.5 * h * (before + part[i, j])
            part[i, 4 + j] += mean
            part[i, 7 + j] += mean * w[j]
            part[i, 16 + j] += mean
            part[i, 19 + j] += mean * f[j]
    _turned(part, dv, 0.5)


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
            stop = edges[k + 1] if k < last and edges[k + 1] < end else end
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
def _moved(part, dg, da, R, H, v, out):
    """out ← a part with the biases dg and da larger than those it was integrated with.

    dg turns it by t in the end and evenly until then: t/2 on the average. To the second order
    Δv changes by u = B dg and t × u/3, the force −da makes w = −F da and t × w/2 of it.
    """
    for i in range(3):
        v[0, i] = -(part[i, 4] * dg[0] + part[i, 5] * dg[1] + part[i, 6] * dg[2])
        u = part[i, 10] * dg[0] + part[i, 11] * dg[1] + part[i, 12] * dg[2]
        v[1, i] = -(part[i, 16] * da[0] + part[i, 17] * da[1] + part[i, 18] * da[2])
        v[2, i] = u / 3.0 + 0.5 * v[1, i]
        out[i, 3], out[i, 22] = part[i, 3] + u + v[1, i], part[i, 22] - dg[i]
    x, y, z = v[0, 0], v[0, 1], v[0, 2]
    out[0, 3] += y * v[2, 2] - z * v[2, 1]
    out[1, 3] += z * v[2, 0] - x * v[2, 2]
    out[2, 3] += x * v[2, 1] - y * v[2, 0]
    _exponential(x, y, z, R)
    _exponential(0.5 * x, 0.5 * y, 0.5 * z, H)
    for i in range(3):
        for j in range(3):
            out[i, j] = R[i, 0] * part[0, j] + R[i, 1] * part[1, j] + R[i, 2] * part[2, j]
        for j in range(4, 22):
            out[i, j] = H[i, 0] * part[0, j] + H[i, 1] * part[1, j] + H[i, 2] * part[2, j]
        for j in range(3):
            out[i, 7 + j] -= out[i, 4 + j] * dg[j]
            out[i, 19 + j] -= out[i, 16 + j] * da[j]
    _turned(out, v[1], 0.5)


@njit(cache=True)
def compose(parts, dg, da, out):
    """out ← integrals from the last part, whose length is zero, to the beginning of each.

    Columns as those of parts, axes of the last. Its biases are by dg and da larger than theirs.
    """
    n = parts.shape[0]
    R, H, v, dv = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    part = np.zeros((3, PART))
    for i in range(3):
        for j in range(PART):
            out[n - 1, i, j] = 1.0 if i == j else 0.0
        out[n - 1, i, 22] = parts[n - 1, i, 22] - dg[i]
    for k in range(n - 2, -1, -1):
        _moved(parts[k], dg, da, R, H, v, part)
        here, after = out[k], out[k + 1]
        for i in range(3):
            p, q, r = after[i, 0], after[i, 1], after[i, 2]
            for j in range(3):
                here[i, j] = p * part[j, 0] + q * part[j, 1] + r * part[j, 2]
            p, q, r = here[i, 0], here[i, 1], here[i, 2]
            for j in range(3, 22):
                here[i, j] = after[i, j] - (p * part[0, j] + q * part[1, j] + r * part[2, j])
            here[i, 22] = part[i, 22]
            dv[i] = here[i, 3] - after[i, 3]
        _turned(here, dv, 1.0)


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
            m = a if t < a else b if t > b else t
            p0, p1, p2 = dv[m, 0] - dv[b, 0], dv[m, 1] - dv[b, 1], dv[m, 2] - dv[b, 2]
            q0, q1, q2 = dv[t, 0] - dv[m, 0], dv[t, 1] - dv[m, 1], dv[t, 2] - dv[m, 2]
            for j in range(3):
                x, y, z = A[b, 0, j], A[b, 1, j], A[b, 2, j]
                u, v, w = A[m, 0, j] - x, A[m, 1, j] - y, A[m, 2, j] - z
                c = 12 + 3 * s + j
                out[t, 0, c] = B[m, 0, j] - B[b, 0, j] - (p1 * z - p2 * y) + q1 * w - q2 * v
                out[t, 1, c] = B[m, 1, j] - B[b, 1, j] - (p2 * x - p0 * z) + q2 * u - q0 * w
                out[t, 2, c] = B[m, 2, j] - B[b, 2, j] - (p0 * y - p1 * x) + q0 * v - q1 * u
