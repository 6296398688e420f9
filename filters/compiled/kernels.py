"""Compiled inner loop: strapdown and covariance over all IMU samples between two updates.

Plain loops over small arrays without allocation: numba makes a microsecond per sample of them.
The public faces are `filters.strapdown` and `filters.error_model`; tests hold this to both.
State order of P: position, velocity, attitude, gyro bias, accelerometer bias; then, if they are
states, gyro and accelerometer scale factors; any further state is a constant.

numba's cache watches this file alone: whoever changes `filters.compiled.rows` must touch it.
"""

from __future__ import annotations

import numpy as np

from ..earth import EARTH_RATE, GM, J2, SEMI_MAJOR_AXIS
from .jit import njit
from .rows import record

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
    if n2 < 1e-3:  # the series is exact to rounding here, and free of cancellation
        a = 1.0 - n2 / 6.0 * (1.0 - n2 / 20.0 * (1.0 - n2 / 42.0))
        b = 0.5 - n2 / 24.0 * (1.0 - n2 / 30.0 * (1.0 - n2 / 56.0))
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
def linearise(F, dt, G, dv_b, C, R, omega, force, inverse_scale, decay_gyro, decay_accel, scales):
    """Write what one step's transition matrix is made of to F, in 3×3 blocks.

    C is the attitude before the step, R the turn over it, `inverse_scale` holds 1/(1 + scale)
    of gyro and accelerometer. Blocks of F: 0 dt·∂g/∂p; 1 velocity by attitude, C[Δv×];
    2 velocity by accelerometer error, −dt·C/(1 + s); 3 attitude by attitude, Rᵀ;
    4 rows: −dt/(1 + s) of the gyro, ω, f; 5: dt, bias decay of gyro and of accelerometer, and
    below `scales`, 1 where states 15 … 20 are scale factors, else 0.
    """
    x, y, z = dv_b[0], dv_b[1], dv_b[2]
    for i in range(3):
        F[1, i, 0] = C[i, 2] * y - C[i, 1] * z
        F[1, i, 1] = C[i, 0] * z - C[i, 2] * x
        F[1, i, 2] = C[i, 1] * x - C[i, 0] * y
        for j in range(3):
            F[0, i, j] = dt * G[i, j]
            F[2, i, j] = -dt * C[i, j] * inverse_scale[3 + j]
            F[3, i, j] = R[j, i]
        F[4, 0, i] = -dt * inverse_scale[i]
        F[4, 1, i] = omega[i]
        F[4, 2, i] = force[i]
    F[5, 0, 0], F[5, 0, 1], F[5, 0, 2], F[5, 1, 0] = dt, decay_gyro, decay_accel, scales


@njit(cache=True)
def transition(F, X, Y):
    """Y ← the first nine rows of Φ X: the others of Φ are diagonal (bias decay, or 1).

    One pass over the columns, next to each other in memory: four of them fit a vector register.
    Both arrays have as many columns; X has a row per state.
    """
    dt = F[5, 0, 0]
    half, w2 = 0.5 * dt, 2.0 * EARTH_RATE * dt
    g00, g01, g02 = F[0, 0, 0], F[0, 0, 1], F[0, 0, 2]
    g11, g12, g22 = F[0, 1, 1], F[0, 1, 2], F[0, 2, 2]
    m00, m01, m02 = F[1, 0, 0], F[1, 0, 1], F[1, 0, 2]
    m10, m11, m12 = F[1, 1, 0], F[1, 1, 1], F[1, 1, 2]
    m20, m21, m22 = F[1, 2, 0], F[1, 2, 1], F[1, 2, 2]
    c00, c01, c02 = F[2, 0, 0], F[2, 0, 1], F[2, 0, 2]
    c10, c11, c12 = F[2, 1, 0], F[2, 1, 1], F[2, 1, 2]
    c20, c21, c22 = F[2, 2, 0], F[2, 2, 1], F[2, 2, 2]
    r00, r01, r02 = F[3, 0, 0], F[3, 0, 1], F[3, 0, 2]
    r10, r11, r12 = F[3, 1, 0], F[3, 1, 1], F[3, 1, 2]
    r20, r21, r22 = F[3, 2, 0], F[3, 2, 1], F[3, 2, 2]
    d0, d1, d2 = F[4, 0, 0], F[4, 0, 1], F[4, 0, 2]
    for j in range(X.shape[1]):
        p0, p1, p2 = X[0, j], X[1, j], X[2, j]
        v0, v1, v2 = X[3, j], X[4, j], X[5, j]
        f0, f1, f2 = X[6, j], X[7, j], X[8, j]
        a0, a1, a2 = X[12, j], X[13, j], X[14, j]
        n0 = v0 + w2 * v1 + g00 * p0 + g01 * p1 + g02 * p2
        n1 = v1 - w2 * v0 + g01 * p0 + g11 * p1 + g12 * p2
        n2 = v2 + g02 * p0 + g12 * p1 + g22 * p2
        # Velocity increment that is missed: C(φ × Δv − δf Δt).
        n0 += m00 * f0 + m01 * f1 + m02 * f2 + c00 * a0 + c01 * a1 + c02 * a2
        n1 += m10 * f0 + m11 * f1 + m12 * f2 + c10 * a0 + c11 * a1 + c12 * a2
        n2 += m20 * f0 + m21 * f1 + m22 * f2 + c20 * a0 + c21 * a1 + c22 * a2
        Y[3, j], Y[4, j], Y[5, j] = n0, n1, n2
        Y[0, j] = p0 + half * (v0 + n0)
        Y[1, j] = p1 + half * (v1 + n1)
        Y[2, j] = p2 + half * (v2 + n2)
        Y[6, j] = r00 * f0 + r01 * f1 + r02 * f2 + d0 * X[9, j]
        Y[7, j] = r10 * f0 + r11 * f1 + r12 * f2 + d1 * X[10, j]
        Y[8, j] = r20 * f0 + r21 * f1 + r22 * f2 + d2 * X[11, j]
    if F[5, 1, 0] > 0.0:
        _scale_part(F, X, Y)


@njit(cache=True)
def _scale_part(F, X, Y):
    """Add to Y what the scale factors do: a rate error of ω δs_g, a force error of f δs_a."""
    half = 0.5 * F[5, 0, 0]
    d0, d1, d2 = F[4, 0, 0] * F[4, 1, 0], F[4, 0, 1] * F[4, 1, 1], F[4, 0, 2] * F[4, 1, 2]
    f0, f1, f2 = F[4, 2, 0], F[4, 2, 1], F[4, 2, 2]
    c00, c01, c02 = F[2, 0, 0] * f0, F[2, 0, 1] * f1, F[2, 0, 2] * f2
    c10, c11, c12 = F[2, 1, 0] * f0, F[2, 1, 1] * f1, F[2, 1, 2] * f2
    c20, c21, c22 = F[2, 2, 0] * f0, F[2, 2, 1] * f1, F[2, 2, 2] * f2
    for j in range(X.shape[1]):
        s0, s1, s2 = X[18, j], X[19, j], X[20, j]
        n0 = c00 * s0 + c01 * s1 + c02 * s2
        n1 = c10 * s0 + c11 * s1 + c12 * s2
        n2 = c20 * s0 + c21 * s1 + c22 * s2
        Y[0, j] += half * n0
        Y[1, j] += half * n1
        Y[2, j] += half * n2
        Y[3, j] += n0
        Y[4, j] += n1
        Y[5, j] += n2
        Y[6, j] += d0 * X[15, j]
        Y[7, j] += d1 * X[16, j]
        Y[8, j] += d2 * X[17, j]


@njit(cache=True)
def covariance_step(P, F, Y, Z, Y9, noise):
    """P ← Φ P Φᵀ + Q in place; P symmetric with a row per state, wider by any padding.

    Φ is diagonal but for nine rows, so Y = (ΦP)₀…₈ and Y9 = (Φ Yᵀ)₀…₈ are all the work there is.
    Scratch: Y (9 × width of P), Z (n × at least 9) and Y9 (9 × width of Z). `F` is of
    `linearise`. `noise`: densities squared of gyro, accelerometer, gyro bias walk, accelerometer
    bias walk, then the inverse correlation times of both biases.
    """
    n, dt, dg, da = P.shape[0], F[5, 0, 0], F[5, 0, 1], F[5, 0, 2]
    transition(F, P, Y)
    for i in range(9):
        for j in range(n):
            Z[j, i] = Y[i, j]
    transition(F, Z, Y9)
    for i in range(9):
        for j in range(i, 9):
            P[i, j] = Y9[i, j]
            P[j, i] = Y9[i, j]
    if dg != 1.0 or da != 1.0:
        for j in range(9, 15):
            d = dg if j < 12 else da
            for i in range(9):
                Y[i, j] *= d
                Z[j, i] *= d
            for i in range(9, n):
                P[i, j] *= d
            for i in range(9, n):
                P[j, i] *= d
    for i in range(9):
        for j in range(9, n):
            P[i, j] = Y[i, j]
    for j in range(9, n):
        for i in range(9):
            P[j, i] = Z[j, i]
    for i in range(3):
        P[6 + i, 6 + i] += noise[0] * dt
        P[3 + i, 3 + i] += noise[1] * dt
        P[9 + i, 9 + i] += noise[2] * dt
        P[12 + i, 12 + i] += noise[3] * dt


@njit(cache=True)
def _sample(gyro, accel, k, edges, offset, bias, inverse, out):
    """Fill mean rate, mean force and their slopes at `offset` from the middle of sample k.

    They are corrected. Rates are taken as linear within a sample, with the slope to the sample
    before: pieces of a split interval then add up to the whole. Across a gap it is left at 0.
    """
    width = edges[k + 1] - edges[k]
    before = edges[k] - edges[k - 1] if k > 0 else width
    usable = k > 0 and 0.5 * width < before < 2.0 * width
    per_second = 2.0 / (width + before) if usable else 0.0
    for i in range(3):
        w = (gyro[k, i] - gyro[k - 1, i]) * per_second if usable else 0.0
        f = (accel[k, i] - accel[k - 1, i]) * per_second if usable else 0.0
        out[0, i] = (gyro[k, i] + w * offset - bias[i]) * inverse[i]
        out[1, i] = (accel[k, i] + f * offset - bias[3 + i]) * inverse[3 + i]
        out[2, i], out[3, i] = w * inverse[i], f * inverse[3 + i]


@njit(cache=True)
def _padded(P, W):
    """W ← P as far as W goes, zeros where it is wider."""
    for i in range(P.shape[0]):
        for j in range(W.shape[1]):
            W[i, j] = P[i, j] if j < P.shape[1] else 0.0


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
    phi : (n, n) transition matrix so far; an empty array: not wanted
    noise : (7,) see covariance_step, and at last `scales` of linearise
    rows : (r, ROW_SIZE) output; next_row : (2,) next free row, next time to record
    period : [s] spacing of recorded rows; ≤ 0 records every sample

    Returns
    -------
    k : sample that contains `until`
    rate : (3,) angular rate at `until`, corrected for bias and scale
    """
    n, with_covariance, with_phi = P.shape[0], P.shape[0] > 0, phi.shape[0] > 0
    # Rows padded to whole vector registers: no remainder to treat one by one.
    width = 4 * ((n + 3) // 4)
    W, T = np.empty((n, width)), np.empty((n if with_phi else 0, width))
    Y, Z, Y9 = np.empty((9, width)), np.empty((n, 12)), np.empty((9, 12))
    _padded(P, W)
    _padded(phi, T)
    F, G = np.empty((6, 3, 3)), np.empty((3, 3))
    C_before, R, work, v = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((5, 3))
    rates, inverse = np.empty((4, 3)), np.empty(6)
    omega, force, omega_slope, force_slope = rates[0], rates[1], rates[2], rates[3]
    for i in range(3):
        omega[i] = 0.0
        inverse[i], inverse[3 + i] = 1.0 / (1.0 + bias[6 + i]), 1.0 / (1.0 + bias[9 + i])
    dg, da, steps, last = 1.0, 1.0, 0, gyro.shape[0]
    if with_covariance:
        _gravity_gradient(pos, G)
    while k < last:
        end = edges[k + 1]
        b = until if until < end else end
        dt = b - now
        if dt > _INTERVAL_TOLERANCE:
            offset = 0.5 * (now + b) - 0.5 * (edges[k] + end)
            _sample(gyro, accel, k, edges, offset, bias, inverse, rates)
            if noise[4] > 0.0:
                dg = np.exp(-dt * noise[4])
            if noise[5] > 0.0:
                da = np.exp(-dt * noise[5])
            for i in range(3):
                for j in range(3):
                    C_before[i, j] = C[i, j]
            strapdown_step(pos, vel, C, omega, force, omega_slope, force_slope, dt, v, R, work)
            if with_covariance:
                linearise(F, dt, G, v[0], C_before, R, omega, force, inverse, dg, da, noise[6])
                covariance_step(W, F, Y, Z, Y9, noise)
            if with_phi:
                transition(F, T, Y)
                for i in range(15):
                    for j in range(n):
                        T[i, j] = Y[i, j] if i < 9 else T[i, j] * (dg if i < 12 else da)
            for i in range(3):
                omega[i] += 0.5 * dt * omega_slope[i]
                bias[i] *= dg
                bias[3 + i] *= da
            now = b
            steps += 1
            if steps % 500 == 0:
                _orthonormalise(C, work)
        if end > until + _INTERVAL_TOLERANCE:
            break
        r = int(next_row[0])
        if r < rows.shape[0] and end >= next_row[1] - _INTERVAL_TOLERANCE:
            record(rows[r], end, pos, vel, C, bias, W)
            next_row[0] += 1.0
            if period > 0.0:
                next_row[1] += period * np.ceil((end - next_row[1] + 1e-6) / period)
        k += 1
        if end >= until - _INTERVAL_TOLERANCE:
            break
    _orthonormalise(C, work)
    _padded(W, P)
    _padded(T, phi)
    return k, omega
