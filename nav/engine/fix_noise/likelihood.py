"""How well a scale, a share and a correlation time explain the innovations of positions.

A filter that is not given its positions goes by velocities: it drifts, slowly and as its
covariance says, away from where it began, and what positions differ from it by is, per axis,

    z_k = o_k + h_k b_k + v_k

with o a random walk whose steps have the variance by which the filter's own grew, b the error that
positions share (unit variance, fading by exp(−Δt/τ), and by what satellites change) and v what is
each position's own:

    h²    = a² s W + C
    var v = a² (1 − s) U + D

U, W, C and D come from the declared variance (`estimate`).

Two states, so a Kalman filter of two states gives the likelihood. The first position is where the
filter began: o = z − h b − v.
"""

from __future__ import annotations

import numpy as np

from ....filters.compiled.jit import njit

#: Degrees of freedom of the innovations: reflections make tails. Fewer inflate the scale of white
#: errors (6 by 10 %).
_TAILS = 15.0
#: Innovations beyond so many σ are drawn in to it before they are believed.
_FAR = 5.0
#: The least a filter drifts [m²/s], and the least noise of a position [m²].
_LEAST = 1e-6


@njit(cache=True)
def log_likelihood(dt, kept, z, drift, shape, scale, share, correlation, nis, log_det):
    """Return ln p(z | scale a, share s, correlation time τ), up to a constant.

    Parameters
    ----------
    dt, kept : ndarray, shape (n,)
        Time since the position before [s], and how much of its shared error is left whatever time
        has passed, 0 … 1.
    z, drift : ndarray, shape (n, 3)
        Innovations, north-east-down [m]; variance of the filter's drift since the one before [m²].
    shape : ndarray, shape (4, n, 3)
        W, U, C and D [m²].
    scale, share, correlation : float
        a, s, τ [s].
    nis, log_det : ndarray, shape (n,)
        Written over: normalised innovation squared and ln det of each position.
    """
    n = len(dt)
    for k in range(n):
        nis[k] = 0.0
        log_det[k] = 0.0
    W, U, C, D = shape
    shared, own = scale * scale * share, scale * scale * (1.0 - share)
    for i in range(3):
        h = np.sqrt(shared * W[0, i] + C[0, i])
        r = own * U[0, i] + D[0, i]
        o, b = z[0, i], 0.0
        poo, pob, pbb = h * h + r + _LEAST, -h, 1.0
        for k in range(1, n):
            fade = kept[k] * np.exp(-dt[k] / correlation)
            poo += drift[k, i] + _LEAST * dt[k]
            b *= fade
            pob *= fade
            pbb = fade * fade * pbb + 1.0 - fade * fade
            h = np.sqrt(shared * W[k, i] + C[k, i])
            go, gb = poo + h * pob, pob + h * pbb
            S = go + h * gb + own * U[k, i] + D[k, i] + _LEAST
            y = z[k, i] - o - h * b
            nis[k] += y * y / S
            log_det[k] += np.log(S)
            if y * y > _FAR * _FAR * S:
                S = y * y / (_FAR * _FAR)
            o += go / S * y
            b += gb / S * y
            poo -= go * go / S
            pob -= go * gb / S
            pbb -= gb * gb / S
    total = 0.0
    for k in range(1, n):
        total -= 0.5 * ((_TAILS + 3.0) * np.log1p(nis[k] / (_TAILS - 2.0)) + log_det[k])
    return total
