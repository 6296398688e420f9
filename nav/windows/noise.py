"""Doppler noise and its correlation as one recording shows them, for alignment windows.

Robust alignments over the whole recording leave residuals of every row, rejected ones too; their
spread by C/N0 and elevation is the receiver's noise, and their correlation from epoch to epoch
says how many of them count as one. How the clock's drift wanders is read off the growth of its
differences with time. Rows at rest do not count where there are others. What goes in is Doppler,
odometer, yaw rate (or gyros) and positions good to a kilometre: the attitude is the alignment's
own. The reference is not asked.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from ...alignment.problem import ClockModel
from ...alignment.robust import robust_residuals
from ...alignment.rows import AlignmentRows
from ...datasets.observations import GnssObservations
from ...filters.errors import AlignmentError
from ...filters.rotation import FloatArray
from ...velocity.doppler_noise import correlated_epochs, fit_doppler_noise, fit_low_elevation
from ...velocity.range_rate import DopplerNoise

#: Alignment and fit by turns; the third changes σ by less than 5 %.
_ROUNDS = 2
#: Residuals further out than this many σ are outliers, not noise with a correlation.
_CUTOFF = 3.5
#: Rows of a vehicle slower than this [m/s] say nothing about the noise of alignment, if there are
#: so many others: at rest reflections stand still, and the local velocity is exact.
_MOVING, _MANY = 1.0, 300
#: The share of windows for which σ is to be enough, of those with so many rows.
_SHARE, _FEW = 0.9, 30
#: Clock walk of an oscillator nothing is known of, the least that is believed, and the most: what
#: wanders by more is no clock, and leaves nothing between satellites to align with [m/s/√s].
_UNKNOWN_WALK, _STEADIEST, _WILDEST = 0.1, 0.02, 1.0


@dataclass(frozen=True)
class WindowNoise:
    """Noise of the rows of a window.

    Parameters
    ----------
    doppler : DopplerNoise
    correlated : float
        So many successive rows of a satellite count as one.
    clock_walk : float or None
        Random walk of the receiver's clock drift [m/s/√s]; None where it was not fitted.
    source : str
        'assumed' or 'fitted'.
    """

    doppler: DopplerNoise = field(default_factory=DopplerNoise)
    correlated: float = 1.0
    clock_walk: float | None = None
    source: str = "assumed"

    def __str__(self) -> str:
        sigma = self.doppler.sigma(np.array([35.0, 45.0]))
        low = f", times {1.0 + self.doppler.low:.1f} at the horizon" if self.doppler.low else ""
        return (
            f"Doppler σ {self.source}: {sigma[0]:.2f} m/s at 35 dB-Hz, {sigma[1]:.2f} at 45{low}; "
            f"{self.correlated:.1f} successive rows count as one"
            + ("" if self.clock_walk is None else f"; clock walk {self.clock_walk:.3f} m/s/√s")
        )


def fit_window_noise(
    windows: Iterable[tuple[AlignmentRows, GnssObservations]], clock: ClockModel
) -> WindowNoise:
    """Return the noise that the windows of one recording show.

    Parameters
    ----------
    windows : iterable of (AlignmentRows, GnssObservations)
        Rows and the observations they were made from, one for one. σ is replaced here.
    clock : ClockModel

    Raises
    ------
    AlignmentError
        If no window has rows that agree on anything.
    """
    windows = list(windows)
    noise = WindowNoise()
    for _ in range(_ROUNDS):
        cn0, up, left, moving, time, sat, drifts = [], [], [], [], [], [], []
        for number, (rows, observations) in enumerate(windows):
            sigma = noise.doppler.sigma(observations.cn0, observations.elevation)
            rows = replace(rows, sigma=sigma)
            try:
                C_ew, residual = robust_residuals(rows, clock, correlated=noise.correlated)
            except AlignmentError:
                continue
            cn0.append(observations.cn0)
            up.append(observations.elevation)
            left.append(residual)
            moving.append(np.linalg.norm(rows.vel_w, axis=1) > _MOVING)
            time.append(observations.time)
            drifts.append(_drift(rows, C_ew))
            sat.append(np.char.add(observations.sat, f"/{number}"))
        if not left:
            raise AlignmentError("no window shows how noisy the Doppler is — use --noise assumed")
        level, elevation, residual = map(np.concatenate, (cn0, up, left))
        drives = np.concatenate(moving)
        if drives.sum() >= _MANY:
            residual = np.where(drives, residual, np.nan)
        doppler = fit_doppler_noise(level, residual).noise
        low = fit_low_elevation(elevation, residual / doppler.sigma(level))
        doppler = replace(doppler, low=low)
        sigma = doppler.sigma(level, elevation)
        doppler, normal = _scaled(doppler, sigma, residual, [part.size for part in left])
        # One after the other, so that windows that overlap stay apart.
        correlated = correlated_epochs(np.concatenate(time), np.concatenate(sat), normal)
        noise = WindowNoise(doppler, correlated, _walk(drifts), "fitted")
    return noise


def _scaled(
    doppler: DopplerNoise, sigma: FloatArray, residual: FloatArray, sizes: list[int]
) -> tuple[DopplerNoise, FloatArray]:
    """Return the noise whose σ holds in nine windows of ten, and residuals divided by it.

    The spread of a fit is a median, and heavy tails below the cutoff add to χ² what no median
    sees. And streets differ: the RMS of all windows would be too little for half of them, and
    χ² would refuse what reflections have only made noisier. Residuals beyond the cutoff are NaN.
    """
    normal = residual / sigma
    kept = np.where(np.abs(normal) <= _CUTOFF, normal, np.nan)
    squares = [np.nanmean(w**2) for w in np.split(kept, np.cumsum(sizes)[:-1])
               if np.isfinite(w).sum() >= _FEW]  # fmt: skip
    mean = float(np.nanmean(kept**2))
    factor = float(np.sqrt(max(mean, np.quantile(squares, _SHARE) if squares else mean)))
    scaled = replace(doppler, sigma_45=factor * doppler.sigma_45, floor=factor * doppler.floor)
    return scaled, np.where(np.abs(normal) <= _CUTOFF * factor, normal / factor, np.nan)


def _drift(rows: AlignmentRows, C_ew: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the times of the epochs and their clock drift, a weighted median [s], [m/s]."""
    each = np.sum(rows.e_e * (rows.vel_w @ C_ew.T), axis=1) - rows.z
    time, epoch = np.unique(rows.time, return_inverse=True)
    order = np.lexsort((each, epoch))
    weight = np.cumsum(1.0 / rows.sigma[order])
    last = np.searchsorted(epoch[order], np.arange(time.size), side="right") - 1
    before = np.concatenate([[0.0], weight[last[:-1]]])
    return time, each[order][np.searchsorted(weight, 0.5 * (before + weight[last]))]


def _walk(drifts: list[tuple[FloatArray, FloatArray]]) -> float:
    """Return the growth of the drift's differences with time [m/s/√s].

    Their variance over T seconds is twice that of the errors of the drift plus q²T; it is taken
    from medians, so that epochs full of reflections do not pass for a clock.
    """
    seconds, variance = [], []
    interval = float(np.median(np.concatenate([np.diff(time) for time, _ in drifts])))
    longest = max(float(time[-1] - time[0]) for time, _ in drifts)
    for lag in np.arange(1.0, 0.7 * longest):
        steps = max(round(lag / interval), 1)
        apart = []
        for time, drift in drifts:
            near = np.abs(time[steps:] - time[:-steps] - lag) < 0.6 * interval
            apart.append((drift[steps:] - drift[:-steps])[near])
        found = np.concatenate(apart)
        if found.size >= 30:
            seconds.append(lag)
            variance.append((1.4826 * float(np.median(np.abs(found)))) ** 2)
    if len(seconds) < 3:
        return _UNKNOWN_WALK
    slope = float(np.polyfit(seconds, variance, 1)[0])
    return float(np.clip(np.sqrt(max(slope, 0.0)), _STEADIEST, _WILDEST))
