"""Noise of range rates and of velocities that explains their innovations best.

The most probable one under a wide prior around what is declared: of few data little is learnt, and
little is changed. Innovations have the covariance S = A + R, A the filter's share, which the pass
over the data has used R for as well; so the pass is repeated with what was found (`fitted`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from ....filters.rotation import FloatArray
from ....velocity.range_rate import DopplerNoise
from .collected import Epoch

#: Degrees of freedom of an epoch's innovations: reflections make tails (`fix_noise.likelihood`).
_TAILS = 15.0
#: ln of the noise: receivers differ by a factor of three, seldom of ten.
_SIGMA = 1.1
#: Innovations beyond so many σ are drawn in to it; the longest correlation that is believed.
_FAR, _LONG = 4.0, 0.95
#: More epochs than this say no more about three numbers.
_ENOUGH = 600
_OPTIONS = {"xatol": 0.01, "fatol": 0.05, "maxfev": 300}
#: Errors that all satellites share are no noise, and no residual shows them: time stamps (3 mm/s a
#: millisecond, braking), the antenna's lever (10 cm turning at 0.1 rad/s), orbits and atmosphere
#: (mm/s). Together a centimetre per second, and no σ is believed below.
LEAST = 0.01
#: The steadiest clock that is believed [m/s/√s]: a good quartz moved and warmed.
STEADIEST = 0.02
#: How many times the declared walk is looked at: it stands for any quartz.
WILDEST = 20.0


def range_rate_noise(
    epochs: Sequence[Epoch], declared: DopplerNoise, walk: float, in_force: float
) -> tuple[DopplerNoise, float]:
    """Return the noise of range rates, and the walk of the receiver's clock [m/s/√s].

    Parameters
    ----------
    epochs : sequence of Epoch
    declared : DopplerNoise
        The middle of the prior.
    walk : float
        Of the clock as declared, the middle of the prior [m/s/√s].
    in_force : float
        Walk of the clock during the pass [m/s/√s].
    """
    some = _thinned([e for e in epochs if e.z.size])
    z, A, real = _stacked(some)
    cn0 = np.full(z.shape, np.nan)
    for row, epoch in zip(cn0, some, strict=True):
        row[: epoch.cn0.size] = epoch.cn0
    since = np.array([e.since for e in some])

    least, steadiest = min(LEAST, declared.floor), min(STEADIEST, walk)

    def noise(x: FloatArray) -> DopplerNoise:
        return dataclasses.replace(
            declared,
            sigma_45=float(declared.sigma_45 * np.exp(x[0])),
            floor=float(max(declared.floor * np.exp(x[1]), least)),
        )

    def walked(x: FloatArray) -> float:
        return float(np.clip(walk * np.exp(x[2]), steadiest, WILDEST * walk))

    def cost(x: FloatArray) -> float:
        S = A + ((walked(x) ** 2 - in_force**2) * since)[:, None, None]
        variance = np.where(real, noise(x).sigma(cn0) ** 2, 0.0)
        return _cost(z, S, variance, real) + 0.5 * float(x @ x) / _SIGMA**2

    x = _minimum(cost, 3)
    return noise(x), walked(x)


def velocity_scale(epochs: Sequence[Epoch], in_force: float = 1.0) -> float:
    """Return true over declared σ of velocities that come ready-made.

    Parameters
    ----------
    epochs : sequence of Epoch
    in_force : float
        Scale during the pass.
    """
    some = _thinned(list(epochs))
    z, A, real = _stacked(some)
    R = np.array([e.noise_cov for e in some])

    def cost(x: FloatArray) -> float:
        S = A + np.exp(2.0 * x[0]) / in_force**2 * R
        return _cost(z, S, np.zeros(z.shape), real) + 0.5 * float(x @ x) / _SIGMA**2

    return float(np.exp(_minimum(cost, 1)[0]))


def lasts(epochs: Sequence[Epoch], scale: float) -> float:
    """Return how many successive velocities say what one with an error of its own would, ≥ 1.

    (1 + ρ)/(1 − ρ) of errors that fade with the correlation ρ from one to the next; so much more
    is the variance of their mean. Innovations that a filter has followed correlate less than the
    errors do: it is the least.
    """
    z = np.array(
        [
            np.linalg.solve(np.linalg.cholesky(e.filter_cov + scale**2 * e.noise_cov), e.z)
            for e in epochs
        ]
    )
    z = np.clip(z, -_FAR, _FAR)
    rho = float(np.sum(z[1:] * z[:-1]) / max(np.sum(z**2), 1e-300))
    return float((1.0 + max(rho, 0.0)) / (1.0 - min(rho, _LONG)))


def _thinned(epochs: list[Epoch]) -> list[Epoch]:
    return epochs[:: max(1, -(-len(epochs) // _ENOUGH))]


def _stacked(epochs: list[Epoch]) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Return innovations and the filter's share, filled up to one size, and which are real."""
    size = max(e.z.size for e in epochs)
    z, A = np.zeros((len(epochs), size)), np.zeros((len(epochs), size, size))
    real = np.zeros(z.shape, dtype=bool)
    for k, epoch in enumerate(epochs):
        n = epoch.z.size
        z[k, :n], A[k, :n, :n], real[k, :n] = epoch.z, epoch.filter_cov, True
    return z, A, real


def _cost(z: FloatArray, S: FloatArray, variance: FloatArray, real: np.ndarray) -> float:
    """Return −ln of the likelihood of a Student distribution, up to a constant."""
    both = real[:, :, None] & real[:, None, :]
    S = np.where(both, S, 0.0) + np.eye(z.shape[1]) * np.where(real, variance, 1.0)[:, None, :]
    sign, log_det = np.linalg.slogdet(S)
    if (sign <= 0.0).any():
        return np.inf
    nis = np.sum(z * np.linalg.solve(S, z[..., None])[..., 0], axis=1)
    n = real.sum(axis=1)
    return float(0.5 * np.sum((_TAILS + n) * np.log1p(nis / (_TAILS - 2.0)) + log_det))


def _minimum(cost: Callable[[FloatArray], float], size: int) -> FloatArray:
    from scipy.optimize import minimize  # slow to import

    begin = np.vstack([np.zeros(size), -0.5 * np.eye(size)])
    options = _OPTIONS | {"initial_simplex": begin}
    found: FloatArray = minimize(cost, begin[0], method="Nelder-Mead", options=options).x
    return found
