"""Doppler noise as a function of C/N0, fitted to what one receiver really did.

Weights that follow from it are the "adaptive weighting" the DDIA-VE paper leaves to future work.
Through the spread within bins of C/N0 goes the model of `DopplerNoise`. Two spreads answer two
questions. 1.48 MAD is the noise of undisturbed signals: reflections do not pass for noise, and a
residual test can find them. The RMS is what occurs, reflections included: with two or three
satellites no test finds anything, and weights have to expect them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..datasets.observations import GnssObservations
from ..filters.errors import ConfigError, DataError
from ..filters.rotation import FloatArray
from .least_squares import doppler_velocities
from .range_rate import DopplerNoise, doppler_rows, low_share
from .study.samples import Samples

#: MAD of a normal distribution times this is its σ.
_MAD = 1.4826
_MIN_RANGE_DB = 6.0
#: ln floor, ln sigma_45, decade_db: wider than any receiver's.
_BOUNDS = ([np.log(1e-4), np.log(1e-3), 5.0], [np.log(10.0), np.log(10.0), 40.0])


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """A fitted noise model and what it was fitted to.

    Attributes
    ----------
    noise : DopplerNoise
    cn0, spread : ndarray, shape (bins,)
        Median C/N0 [dB-Hz] and spread of the residuals [m/s] of each bin.
    count : ndarray of int, shape (bins,)
    misfit : float
        RMS of ln(spread / σ) over the bins: 0.1 is 10 %.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import DopplerNoise, fit_doppler_noise
    >>> rng = np.random.default_rng(1)
    >>> cn0 = rng.uniform(25.0, 50.0, 20000)
    >>> residual = rng.normal(0.0, DopplerNoise(sigma_45=0.05, floor=0.02).sigma(cn0))
    >>> fit = fit_doppler_noise(cn0, residual)
    >>> round(fit.noise.sigma_45, 2), round(fit.noise.floor, 2), fit.misfit < 0.05
    (0.05, 0.02, True)
    """

    noise: DopplerNoise
    cn0: FloatArray
    spread: FloatArray
    count: NDArray[np.int64]
    misfit: float

    def __repr__(self) -> str:
        noise = self.noise
        return (
            f"NoiseFit({noise.sigma_45:.3g} m/s at 45 dB-Hz over a floor of {noise.floor:.3g} m/s, "
            f"tenfold in {noise.decade_db:.3g} dB; {int(self.count.sum())} rows in "
            f"{self.count.size} bins, misfit {self.misfit:.2g})"
        )


def fit_doppler_noise(
    cn0: ArrayLike,
    residual: ArrayLike,
    *,
    spread: str = "mad",
    bins: int = 12,
    unknown_cn0: float | None = None,
    decade_db: float | None = None,
) -> NoiseFit:
    """Return the noise model that explains the residuals.

    Parameters
    ----------
    cn0 : array_like, shape (n,)
        [dB-Hz]; rows without are left out.
    residual : array_like, shape (n,)
        Range-rate residuals of unit leverage, such as `reference_residuals` [m/s].
    spread : {'mad', 'rms'}
        See the module.
    bins : int
        Bins of equal count, at most; every bin has 30 rows or more.
    unknown_cn0 : float, optional
        Default: the 10 % quantile of `cn0`.
    decade_db : float, optional
        Not fitted but given, as the filter's configuration has 20 for thermal noise [dB].

    Raises
    ------
    DataError
        Fewer than 60 rows.

    Notes
    -----
    Where the C/N0 of the bins differ by less than 6 dB, nothing shows how noise depends on it, and
    the thermal 20 dB per decade are taken.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import DopplerNoise, fit_doppler_noise
    >>> rng = np.random.default_rng(1)
    >>> cn0 = rng.uniform(25.0, 50.0, 20000)
    >>> residual = rng.normal(0.0, DopplerNoise(sigma_45=0.05, floor=0.02).sigma(cn0))
    >>> fit = fit_doppler_noise(cn0, residual)
    >>> round(fit.noise.sigma_45, 2), round(fit.noise.floor, 2), fit.misfit < 0.05
    (0.05, 0.02, True)
    """
    if spread not in ("mad", "rms"):
        raise ConfigError(f"spread: expected 'mad' or 'rms', found {spread!r}")
    level, left = np.asarray(cn0, dtype=float), np.asarray(residual, dtype=float)
    known = np.isfinite(level) & np.isfinite(left)
    level, left = level[known], left[known]
    if level.size < 60:
        raise DataError(f"Doppler noise: expected 60 rows with C/N0 or more, found {level.size}")
    order = np.argsort(level, kind="stable")
    groups = np.array_split(order, min(bins, level.size // 30))
    middle = np.array([np.median(level[g]) for g in groups])
    if spread == "mad":
        found = [_MAD * np.median(np.abs(left[g])) for g in groups]
    else:
        found = [np.sqrt(np.mean(left[g] ** 2)) for g in groups]
    seen = np.maximum(np.array(found), 1e-4)
    count = np.array([g.size for g in groups])

    def model(p: FloatArray) -> FloatArray:
        return np.hypot(np.exp(p[0]), np.exp(p[1]) * 10.0 ** ((45.0 - middle) / p[2]))

    def misfit(p: FloatArray) -> FloatArray:  # bins of equal count weigh the same
        return np.log(seen / model(p))

    start = np.array([np.log(seen.min()), np.log(np.median(seen)), 20.0])
    low, high = (np.array(bound) for bound in _BOUNDS)
    if decade_db is None and np.ptp(middle) < _MIN_RANGE_DB:
        decade_db = 20.0
    if decade_db is not None:
        low[2], high[2] = decade_db - 1e-3, decade_db + 1e-3
        start[2] = decade_db
    start = np.clip(start, low + 1e-6, high - 1e-6)
    from scipy.optimize import least_squares  # slow to import

    fit = least_squares(misfit, start, bounds=(low, high), loss="soft_l1", f_scale=0.1)
    floor, sigma_45, decade = np.exp(fit.x[0]), np.exp(fit.x[1]), fit.x[2]
    weakest = float(np.quantile(level, 0.1)) if unknown_cn0 is None else unknown_cn0
    return NoiseFit(
        DopplerNoise(float(sigma_45), float(floor), weakest, float(decade)),
        middle, seen, count, float(np.sqrt(np.mean(misfit(fit.x) ** 2))),
    )  # fmt: skip


def fit_low_elevation(elevation: ArrayLike, normal: ArrayLike, *, bins: int = 8) -> float:
    """Return `DopplerNoise.low`: how much wider residuals spread towards the horizon.

    Parameters
    ----------
    elevation : array_like, shape (n,)
        [rad]; rows without are left out.
    normal : array_like, shape (n,)
        Residuals divided by the σ of their C/N0.
    bins : int
        Of equal count, at most; every bin has 30 rows or more.

    Where the elevations of the bins tell nothing (less than 10° apart), 0.
    """
    up, left = np.asarray(elevation, dtype=float), np.asarray(normal, dtype=float)
    known = np.isfinite(up) & np.isfinite(left)
    up, left = up[known], left[known]
    if up.size < 60:
        return 0.0
    groups = np.array_split(np.argsort(up, kind="stable"), min(bins, up.size // 30))
    middle = np.array([np.median(up[g]) for g in groups])
    if np.ptp(middle) < np.radians(10.0):
        return 0.0
    spread = np.array([_MAD * np.median(np.abs(left[g])) for g in groups])
    share, seen = low_share(middle), np.log(np.maximum(spread, 1e-4))

    def misfit(p: FloatArray) -> FloatArray:
        return seen - p[0] - np.log1p(p[1] * share)

    start = [float(seen.min()), 0.5]
    from scipy.optimize import least_squares  # slow to import

    fit = least_squares(misfit, start, bounds=([-20.0, 0.0], [20.0, 20.0]), loss="soft_l1",
                        f_scale=0.1)  # fmt: skip
    return float(fit.x[1])


def correlated_epochs(
    time: ArrayLike, sat: ArrayLike, residual: ArrayLike, *, longest: float = 5.0
) -> float:
    """Return how many successive errors of a satellite say what one independent error would.

    1 + 2Σρₖ, the factor by which the variance of a mean exceeds that of independent errors; ρₖ is
    the autocorrelation over k epochs, all satellites together, up to the lag `longest`: a small
    one that lasts weighs as much as a large one that does not. Reflections last for seconds, and
    ten errors of one reflection are not ten witnesses.

    Parameters
    ----------
    time : array_like, shape (n,)
        At a constant interval, with gaps [s].
    sat : array_like of str, shape (n,)
    residual : array_like, shape (n,)
        Divided by its σ; NaN where there is none.
    longest : float
        Lag at which the sum ends [s].
    """
    time, sat = np.asarray(time, dtype=float), np.asarray(sat)
    residual = np.asarray(residual, dtype=float)
    steps = np.diff(np.unique(time))
    if not steps.size:
        return 1.0
    interval = float(np.median(steps))
    index = np.rint((time - time.min()) / interval).astype(np.int64)
    names, row = np.unique(sat, return_inverse=True)
    grid = np.full((names.size, int(index.max()) + 1), np.nan)
    grid[row, index] = residual
    total = 1.0
    for k in range(1, min(int(longest / interval), grid.shape[1] - 1) + 1):
        before, after = grid[:, :-k], grid[:, k:]
        both = np.isfinite(before) & np.isfinite(after)
        a, b = before[both], after[both]
        if a.size < 30:
            break
        rho = float(a @ b / max(np.sqrt((a @ a) * (b @ b)), 1e-300))
        total += 2.0 * rho
    return max(total, 1.0)


def reference_residuals(samples: Samples) -> FloatArray:
    """Return range-rate residuals against the reference, receiver drift removed [m/s].

    The drift of an epoch is the median of its rows. Epochs of n rows are scaled by √(n/(n − 1)),
    to first order what estimating the drift took from the spread; below three rows: NaN.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> from certnav.velocity import reference_residuals
    >>> from certnav.velocity.study import reference_samples
    >>> config = SimulationConfig(duration=60.0, density="open", moving_start=True, noise=False)
    >>> residual = reference_residuals(reference_samples(simulate(config).sequence()))
    >>> bool(np.nanmax(np.abs(residual)) < 0.05)  # [m/s]: the signals are exact
    True
    """
    left = samples.rows.z - np.einsum("ij,ij->i", samples.rows.e_e, samples.vel_e[samples.epoch])
    out = np.full(left.size, np.nan)
    edges = np.flatnonzero(np.diff(samples.epoch, prepend=-1, append=samples.epoch[-1] + 1))
    for start, stop in itertools.pairwise(edges):
        n = stop - start
        if n >= 3:
            part = left[start:stop]
            out[start:stop] = (part - np.median(part)) * np.sqrt(n / (n - 1.0))
    return out


def own_residuals(
    observations: GnssObservations, pos_e: ArrayLike, noise: DopplerNoise | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return C/N0 and residuals without any reference, from least squares of ≥ 6 satellites.

    Residuals are divided by √(1 − leverage), which restores their own noise; rows that hardly
    check themselves (leverage above 0.8) and rows the residual test excluded are left out.

    Parameters
    ----------
    observations : GnssObservations
    pos_e : array_like, shape (3,) or (n, 3)
        Antenna [m].
    noise : DopplerNoise, optional
        First guess, for the weights.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> from certnav.velocity import own_residuals
    >>> drive = simulate(SimulationConfig(duration=20.0, density="open", noise=False))
    >>> observations, pos_e = drive.observations, drive.reference.pos_e[0]
    >>> cn0, residual = own_residuals(observations, pos_e)
    >>> cn0.size == residual.size, bool(abs(residual).max() < 0.05)  # [m/s]: the signals are exact
    (True, True)
    """
    all_rows = doppler_rows(observations, pos_e, noise)
    where = np.full(len(observations), -1)
    where[all_rows.row] = np.arange(len(all_rows))
    cn0: list[FloatArray] = []
    residual: list[FloatArray] = []
    for velocity in doppler_velocities(observations, pos_e, noise=noise):
        if not velocity.ok or velocity.dof < 2:
            continue
        rows = all_rows.take(where[velocity.row])
        H = np.column_stack([rows.e_e, -np.ones(len(rows))]) / rows.sigma[:, None]
        q, _ = np.linalg.qr(H)
        free = 1.0 - np.sum(q**2, axis=1)
        checked = free > 0.2
        residual.append(velocity.residuals[checked] / np.sqrt(free[checked]))
        cn0.append(observations.cn0[velocity.row[checked]])
    if not cn0:
        return np.zeros(0), np.zeros(0)
    return np.concatenate(cn0), np.concatenate(residual)
