"""What became of every satellite signal: where it stood, how strong, and what it disagreed by."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields

import numpy as np

from ..datasets.observations import GnssObservations
from ..filters.rotation import FloatArray
from ..velocity.range_rate import doppler_rows

#: Said of a row that passed every screening, and that the filter took no update from.
UNUSED = "in no update that was used"


@dataclass(frozen=True, eq=False)
class Signals:
    """One row per satellite signal and epoch, ordered by time.

    Parameters
    ----------
    time : ndarray, shape (n,)
        GPS time [s].
    sat, signal : ndarray of str, shape (n,)
        RINEX identifiers: 'G05', '1C'.
    cn0 : ndarray, shape (n,)
        [dB-Hz].
    elevation, azimuth : ndarray, shape (n,)
        [rad], azimuth clockwise from north; NaN where no position was known.
    residual : ndarray, shape (n,)
        Of the range rate, against the solution's velocity at the antenna and the median of what was
        used of the epoch, which is the receiver's clock [m/s]; NaN where fewer than two were.
    reason : ndarray of str, shape (n,)
        Why it was not used; '' where it was.
    """

    time: FloatArray
    sat: np.ndarray
    signal: np.ndarray
    cn0: FloatArray
    elevation: FloatArray
    azimuth: FloatArray
    residual: FloatArray
    reason: np.ndarray

    def __len__(self) -> int:
        return self.time.size

    def take(self, rows: slice | np.ndarray) -> Signals:
        """Return the given rows (a slice, a mask or indices)."""
        return Signals(*(getattr(self, f.name)[rows] for f in fields(self)))


def signal_log(
    observations: GnssObservations,
    used: Iterable[tuple[float, tuple[str, ...]]],
    antenna_e: FloatArray,
    vel_e: FloatArray,
) -> Signals:
    """Return what became of each row of `observations`.

    Parameters
    ----------
    observations : GnssObservations
        As screening left them.
    used : iterable of (float, tuple of str)
        Time [s] and satellites of each update that the filter used. Times are those of the
        receiver, or corrected for its clock: they belong to the nearest epoch.
    antenna_e, vel_e : ndarray, shape (n, 3)
        Antenna, ECEF position [m] and velocity [m/s] of the solution at each row; NaN where there
        is no solution.
    """
    epochs = np.unique(observations.time)
    known = {(_nearest(epochs, time), sat) for time, sats in used for sat in sats}
    pairs = zip(observations.time.tolist(), observations.sat.tolist(), strict=True)
    taken = np.array([pair in known for pair in pairs], dtype=bool)
    reason = np.where(taken | ~observations.usable, observations.rejected, UNUSED)
    # Rejected rows have residuals too: they are what shows whether the reason was a good one.
    everything = observations.with_columns(rejected=np.full(len(observations), ""))
    rows = doppler_rows(everything, antenna_e)
    residual = np.full(len(observations), np.nan)
    residual[rows.row] = rows.z - np.sum(rows.e_e * vel_e[rows.row], axis=1)
    for _, epoch in observations.epochs():
        here = residual[epoch]
        good = np.isfinite(here) & (reason[epoch] == "")
        residual[epoch] = here - np.median(here[good]) if good.sum() >= 2 else np.nan
    return Signals(
        observations.time, observations.sat, observations.signal, observations.cn0,
        observations.elevation, observations.azimuth, residual, reason,
    )  # fmt: skip


def _nearest(epochs: FloatArray, time: float) -> float:
    after = int(np.clip(np.searchsorted(epochs, time), 1, max(epochs.size - 1, 1)))
    near = epochs[max(after - 1, 0) : after + 1]
    return float(near[np.argmin(np.abs(near - time))])
