"""Compiled inner loop: strapdown and covariance over all IMU samples between two updates.

Written as plain loops over small arrays without allocation, because that is what numba turns
into about a microsecond per sample. The public faces are `filters.strapdown` (mechanisation) and
`filters.error_model` (transition matrix); the tests hold this module to both.

State order of P: position, velocity, attitude, gyro bias, accelerometer bias; from 21 states on,
gyro and accelerometer scale factors; any further state is a constant.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from filters.earth import EARTH_RATE, GM, J2, SEMI_MAJOR_AXIS

# Columns of a recorded row.
ROW_TIME, ROW_POS, ROW_VEL, ROW_C = 0, 1, 4, 7
ROW_BIAS, ROW_COV, ROW_STD_BIAS = 16, 22, 40
ROW_SIZE = 46

_INTERVAL_TOLERANCE = 1e-9  # [s] shorter pieces are rounding, not time


@njit(cache=True)
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def _rotate(C, a, out):
    for i in range(3):
        out[i] = C[i, 0] * a[0] + C[i, 1] * a[1] + C[i, 2] * a[2]


@njit(cache=True)
def _gravity(p, out):
    """J2 gravitation plus centrifugal acceleration, as filters.earth.gravity_e."""
    r2 = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
    z2 = p[2] * p[2] / r2
    c = 1.5 * J2 * SEMI_MAJOR_AXIS * SEMI_MAJOR_AXIS / r2
    k = -GM / (r2 * np.sqrt(r2))
    planar = k * (1.0 + c * (1.0 - 5.0 * z2)) + EARTH_RATE * EARTH_RATE
    out[0] = planar * p[0]
    out[1] = planar * p[1]
    out[2] = k * (1.0 + c * (3.0 - 5.0 * z2)) * p[2]


@njit(cache=True)
def _attitude_step(C, rotvec, dt, R, work):
    """C ← exp(−ω_ie dt) C R with R = exp(rotvec), in place; R leaves with the body's turn."""
    x, y, z = rotvec[0], rotvec[1], rotvec[2]
    n2 = x * x + y * y + z * z
    if n2 < 1e-8:
        a = 1.0 - n2 / 6.0
        b = 0.5 - n2 / 24.0
    else:
        n = np.sqrt(n2)
        a = np.sin(n) / n
        b = (1.0 - np.cos(n)) / n2
    R[0, 0], R[1, 1], R[2, 2] = (
        1.0 - b * (y * y + z * z),
        1.0 - b * (x * x + z * z),
        1.0 - b * (x * x + y * y),
    )
    R[0, 1], R[1, 0] = b * x * y - a * z, b * x * y + a * z
    R[0, 2], R[2, 0] = b * x * z + a * y, b * x * z - a * y
    R[1, 2], R[2, 1] = b * y * z - a * x, b * y * z + a * x
    for i in range(3):
        for j in range(3):
            work[i, j] = C[i, 0] * R[0, j] + C[i, 1] * R[1, j] + C[i, 2] * R[2, j]
    angle = EARTH_RATE * dt
    s, c = angle, 1.0 - 0.5 * angle * angle
    for j in range(3):
        C[0, j] = c * work[0, j] + s * work[1, j]
        C[1, j] = c * work[1, j] - s * work[0, j]
        C[2, j] = work[2, j]


@njit(cache=True)
def _orthonormalise(C, work):
    """C ← C (3I − CᵀC) / 2, in place: one step of the polar iteration removes round-off."""
    for i in range(3):
        for j in range(3):
            s = 0.0
            for k in range(3):
                s += C[k, i] * C[k, j]
            work[i, j] = -0.5 * s
        work[i, i] += 1.5
    for i in range(3):
        c0, c1, c2 = C[i, 0], C[i, 1], C[i, 2]
        for j in range(3):
            C[i, j] = c0 * work[0, j] + c1 * work[1, j] + c2 * work[2, j]


@njit(cache=True)
def strapdown_step(pos, vel, C, omega, force, omega_slope, force_slope, dt, v, R, work):
    """Advance position, velocity and attitude in place by `dt`.

    `omega` and `force` are means over the step, corrected for bias and scale; the slopes are
    their rates of change, from which coning and sculling follow (Savage 1998, two-sample form:
    φ = α + α₋×α/12 with α₋ = α − slope·dt²). `v[0]` leaves with the velocity increment in body
    axes at the start of the step, R with the rotation over it.
    """
    dv_b, rotvec, dv_e, tmp, g = v[0], v[1], v[2], v[3], v[4]
    twelfth = dt * dt * dt / 12.0
    _cross(omega, omega_slope, tmp)
    for i in range(3):
        rotvec[i] = omega[i] * dt + twelfth * tmp[i]
    # Rotation of the specific force during the step, to second order in the angle.
    _cross(omega, force, tmp)
    _cross(omega, tmp, g)
    for i in range(3):
        dv_b[i] = force[i] * dt + 0.5 * dt * dt * tmp[i] + dt * dt * dt / 6.0 * g[i]
    _cross(force, omega_slope, tmp)
    for i in range(3):
        dv_b[i] += twelfth * tmp[i]
    _cross(omega, force_slope, tmp)
    for i in range(3):
        dv_b[i] += twelfth * tmp[i]
    _rotate(C, dv_b, dv_e)
    # The e axes themselves turn during the step: half the Earth's angle on average.
    half = 0.5 * EARTH_RATE * dt
    x, y = dv_e[0], dv_e[1]
    dv_e[0], dv_e[1] = x + half * y, y - half * x
    for i in range(3):
        tmp[i] = pos[i] + 0.5 * dt * vel[i]
    _gravity(tmp, g)
    mid_x = vel[0] + 0.5 * (dv_e[0] + dt * (g[0] + 2.0 * EARTH_RATE * vel[1]))
    mid_y = vel[1] + 0.5 * (dv_e[1] + dt * (g[1] - 2.0 * EARTH_RATE * vel[0]))
    new_x = vel[0] + dv_e[0] + dt * (g[0] + 2.0 * EARTH_RATE * mid_y)
    new_y = vel[1] + dv_e[1] + dt * (g[1] - 2.0 * EARTH_RATE * mid_x)
    new_z = vel[2] + dv_e[2] + dt * g[2]
    pos[0] += 0.5 * dt * (vel[0] + new_x)
    pos[1] += 0.5 * dt * (vel[1] + new_y)
    pos[2] += 0.5 * dt * (vel[2] + new_z)
    vel[0], vel[1], vel[2] = new_x, new_y, new_z
    _attitude_step(C, rotvec, dt, R, work)


@njit(cache=True)
def _gravity_gradient(p, G):
    r2 = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
    k = GM / (r2 * np.sqrt(r2))
    for i in range(3):
        for j in range(3):
            G[i, j] = 3.0 * k * p[i] * p[j] / r2
        G[i, i] -= k
    G[0, 0] += EARTH_RATE * EARTH_RATE
    G[1, 1] += EARTH_RATE * EARTH_RATE


@njit(cache=True)
def _transition(x, out, n, dt, G, dv_b, C, R, omega, force, scale, decay_gyro, decay_accel):
    """Apply the transition matrix to one error vector: out = Φ x.

    C is the attitude before the step, R the turn over it; `scale` holds the scale factors.
    """
    w = EARTH_RATE * dt
    p0, p1, p2, v0, v1, v2, f0, f1, f2 = x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8]
    g0, g1, g2, a0, a1, a2 = x[9], x[10], x[11], x[12], x[13], x[14]
    out[9], out[10], out[11] = decay_gyro * g0, decay_gyro * g1, decay_gyro * g2
    out[12], out[13], out[14] = decay_accel * a0, decay_accel * a1, decay_accel * a2
    for i in range(15, n):  # scale factors and whatever else is constant
        out[i] = x[i]
    if n >= 21:
        g0 += omega[0] * x[15]
        g1 += omega[1] * x[16]
        g2 += omega[2] * x[17]
        a0 += force[0] * x[18]
        a1 += force[1] * x[19]
        a2 += force[2] * x[20]
    # Velocity increment that is missed, in body axes: φ × Δv − δf Δt.
    a0 = f1 * dv_b[2] - f2 * dv_b[1] - dt * a0 / (1.0 + scale[3])
    a1 = f2 * dv_b[0] - f0 * dv_b[2] - dt * a1 / (1.0 + scale[4])
    a2 = f0 * dv_b[1] - f1 * dv_b[0] - dt * a2 / (1.0 + scale[5])
    n0 = v0 + 2.0 * w * v1 + C[0, 0] * a0 + C[0, 1] * a1 + C[0, 2] * a2
    n1 = v1 - 2.0 * w * v0 + C[1, 0] * a0 + C[1, 1] * a1 + C[1, 2] * a2
    n2 = v2 + C[2, 0] * a0 + C[2, 1] * a1 + C[2, 2] * a2
    n0 += dt * (G[0, 0] * p0 + G[0, 1] * p1 + G[0, 2] * p2)
    n1 += dt * (G[1, 0] * p0 + G[1, 1] * p1 + G[1, 2] * p2)
    n2 += dt * (G[2, 0] * p0 + G[2, 1] * p1 + G[2, 2] * p2)
    out[0] = p0 + 0.5 * dt * (v0 + n0)
    out[1] = p1 + 0.5 * dt * (v1 + n1)
    out[2] = p2 + 0.5 * dt * (v2 + n2)
    out[3], out[4], out[5] = n0, n1, n2
    out[6] = R[0, 0] * f0 + R[1, 0] * f1 + R[2, 0] * f2 - dt * g0 / (1.0 + scale[0])
    out[7] = R[0, 1] * f0 + R[1, 1] * f1 + R[2, 1] * f2 - dt * g1 / (1.0 + scale[1])
    out[8] = R[0, 2] * f0 + R[1, 2] * f1 + R[2, 2] * f2 - dt * g2 / (1.0 + scale[2])


@njit(cache=True)
def covariance_step(P, A, dt, G, dv_b, C, R, omega, force, scale, noise):
    """P ← Φ P Φᵀ + Q in place; P symmetric, A scratch of the same shape.

    `noise`: densities squared of gyro, accelerometer, gyro bias walk, accelerometer bias walk,
    then the inverse correlation times of both biases.
    """
    n = P.shape[0]
    dg, da = np.exp(-dt * noise[4]), np.exp(-dt * noise[5])
    for j in range(n):  # rows of A are Φ applied to the columns of P: A = (Φ P)ᵀ
        _transition(P[j], A[j], n, dt, G, dv_b, C, R, omega, force, scale, dg, da)
    for i in range(n):
        for j in range(i):
            A[i, j], A[j, i] = A[j, i], A[i, j]
    for i in range(n):
        _transition(A[i], P[i], n, dt, G, dv_b, C, R, omega, force, scale, dg, da)
    for i in range(n):
        for j in range(i):
            P[i, j] = P[j, i]
    for i in range(3):
        P[6 + i, 6 + i] += noise[0] * dt
        P[3 + i, 3 + i] += noise[1] * dt
        P[9 + i, 9 + i] += noise[2] * dt
        P[12 + i, 12 + i] += noise[3] * dt


@njit(cache=True)
def record(row, t, pos, vel, C, bias, P):
    """Write time, state, the three 3×3 covariance blocks (upper triangles) and bias σ to `row`."""
    row[ROW_TIME] = t
    for i in range(3):
        row[ROW_POS + i] = pos[i]
        row[ROW_VEL + i] = vel[i]
        for j in range(3):
            row[ROW_C + 3 * i + j] = C[i, j]
    for i in range(6):
        row[ROW_BIAS + i] = bias[i]
    if P.shape[0] == 0:
        return
    for i in range(6):
        row[ROW_STD_BIAS + i] = np.sqrt(P[9 + i, 9 + i])
    k = ROW_COV
    for block in range(3):
        for i in range(3):
            for j in range(i, 3):
                row[k] = P[3 * block + i, 3 * block + j]
                k += 1


@njit(cache=True)
def _sample(rates, k, edges, offset, bias, scale, mean, slope):
    """Mean rate at `offset` from the middle of sample k and its slope, corrected.

    The rate is taken as linear within a sample, with the slope to the sample before: pieces of
    a split interval then add up to the whole. Across a gap the slope is unknown and left at 0.
    """
    width = edges[k + 1] - edges[k]
    before = edges[k] - edges[k - 1] if k > 0 else width
    usable = k > 0 and 0.5 * width < before < 2.0 * width
    for i in range(3):
        s = (rates[k, i] - rates[k - 1, i]) / (0.5 * (width + before)) if usable else 0.0
        slope[i] = s / (1.0 + scale[i])
        mean[i] = (rates[k, i] + s * offset - bias[i]) / (1.0 + scale[i])


@njit(cache=True)
def advance(
    edges, gyro, accel, k, now, until, pos, vel, C, bias, P, phi, noise, rows, next_row, period
):
    """Propagate in place from `now` to `until`, splitting IMU intervals at both ends.

    Parameters
    ----------
    edges : (m+1,) interval edges: sample k is the mean over edges[k] … edges[k+1]
    gyro, accel : (m, 3)
    k : sample that contains `now`
    bias : (12,) gyro bias, accelerometer bias, gyro scale, accelerometer scale
    P : (n, n) covariance; an empty array propagates the state alone
    phi : (n, n) columns of the transition matrix so far, as rows; empty: not wanted
    noise : (6,) see covariance_step
    rows : (r, ROW_SIZE) output; next_row : (2,) next free row, next time to record
    period : [s] spacing of recorded rows; ≤ 0 records every sample

    Returns
    -------
    k : sample that contains `until`
    rate : (3,) angular rate at `until`, corrected for bias and scale
    """
    n = P.shape[0]
    with_covariance = n > 0
    A = np.empty((n, n))
    G = np.zeros((3, 3))
    C_before = np.empty((3, 3))
    R = np.empty((3, 3))
    v = np.empty((5, 3))
    work = np.empty((3, 3))
    omega, force = np.zeros(3), np.zeros(3)
    omega_slope, force_slope = np.zeros(3), np.zeros(3)
    bg, ba, sg, sa = bias[0:3], bias[3:6], bias[6:9], bias[9:12]
    scale = bias[6:12]
    last = gyro.shape[0]
    steps = 0
    if with_covariance:
        _gravity_gradient(pos, G)
    while k < last:
        end = edges[k + 1]
        b = until if until < end else end
        dt = b - now
        if dt > _INTERVAL_TOLERANCE:
            offset = 0.5 * (now + b) - 0.5 * (edges[k] + end)
            _sample(gyro, k, edges, offset, bg, sg, omega, omega_slope)
            _sample(accel, k, edges, offset, ba, sa, force, force_slope)
            for i in range(3):
                for j in range(3):
                    C_before[i, j] = C[i, j]
            strapdown_step(pos, vel, C, omega, force, omega_slope, force_slope, dt, v, R, work)
            if with_covariance:
                covariance_step(P, A, dt, G, v[0], C_before, R, omega, force, scale, noise)
            if phi.shape[0] > 0:
                dg, da = np.exp(-dt * noise[4]), np.exp(-dt * noise[5])
                for j in range(n):
                    for i in range(n):
                        A[0, i] = phi[j, i]
                    _transition(
                        A[0], phi[j], n, dt, G, v[0], C_before, R, omega, force, scale, dg, da
                    )
            for i in range(3):
                omega[i] += 0.5 * dt * omega_slope[i]
                bg[i] *= np.exp(-dt * noise[4])
                ba[i] *= np.exp(-dt * noise[5])
            now = b
            steps += 1
            if steps % 500 == 0:
                _orthonormalise(C, work)
        if end > until + _INTERVAL_TOLERANCE:
            break
        r = int(next_row[0])
        if r < rows.shape[0] and end >= next_row[1] - _INTERVAL_TOLERANCE:
            record(rows[r], end, pos, vel, C, bias, P)
            next_row[0] += 1.0
            if period > 0.0:
                next_row[1] += period * np.ceil((end - next_row[1] + 1e-6) / period)
        k += 1
        if end >= until - _INTERVAL_TOLERANCE:
            break
    _orthonormalise(C, work)
    return k, omega
