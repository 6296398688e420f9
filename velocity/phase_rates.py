"""Range rates from the carrier's phase, and whether Doppler agrees with them.

Between two epochs of unbroken tracking the phase says how far the range grew, to millimetres:

    λ(φₖ − φₖ₋₁)/(tₖ − tₖ₋₁)  =  mean of ρ̇ over the interval,

clocks included, as in Doppler. A receiver measures both in loops of their own. Of a signal that
comes straight, the mean of the two Dopplers differs from it by their noise; where the loops no
longer hold one signal (weak, reflected, changing between paths), by metres per second. That is a
test a single satellite can be put to, without a position, an attitude or another satellite.

An interval counts if tracking is unbroken as far as the receiver knows: no loss of lock (bit 0 of
the indicator), no change of the half-cycle ambiguity (bit 1), not too long. A slip that nobody
noticed shows as disagreement: half a cycle of L1 in 0.2 s is 0.48 m/s.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..datasets.observations import GnssObservations
from ..filters.rotation import FloatArray

#: Largest disagreement of phase and Doppler [m/s]: five times what a u-blox in a moving car shows
#: at 45 dB-Hz (`range_rate.DopplerNoise`, 0.06 m/s), and less than half a cycle in 0.2 s.
LIMIT = 0.3
#: Longest interval [s]. Over one second the mean of the ends misses the mean of the rate by a
#: twelfth of the jerk in m/s³: 0.17 m/s for a car that brakes hard within half a second.
LONGEST = 1.05
#: Reasons given to rows that fail.
DISAGREES, UNTRACKED = "phase contradicts Doppler", "no unbroken phase"
_LOST, _HALF = 1, 2
_SOME = 0.2


class PhaseIntervals(NamedTuple):
    """Pairs of successive rows of one signal between which the phase is unbroken.

    Attributes
    ----------
    before, after : ndarray of int, shape (m,)
        Rows of the observations.
    rate : ndarray, shape (m,)
        Mean range rate by the phase [m/s].
    misfit : ndarray, shape (m,)
        Mean of the rows' own range rates minus `rate` [m/s]; NaN where one is missing.
    """

    before: NDArray[np.int64]
    after: NDArray[np.int64]
    rate: FloatArray
    misfit: FloatArray

    def __repr__(self) -> str:
        return f"PhaseIntervals({self.rate.size} intervals)"


def phase_intervals(observations: GnssObservations, longest: float = LONGEST) -> PhaseIntervals:
    """Return all intervals of unbroken phase.

    Parameters
    ----------
    observations : GnssObservations
        Of any number of epochs and signals.
    longest : float
        [s].

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> from certnav.velocity import phase_intervals
    >>> drive = simulate(SimulationConfig(duration=20.0, density="open", noise=False))
    >>> observations, pos_e = drive.observations, drive.reference.pos_e[0]
    >>> intervals = phase_intervals(observations)
    >>> bool(abs(intervals.misfit).max() < 0.05)  # Doppler and phase agree [m/s]
    True
    """
    signal = np.char.add(observations.sat, np.char.add("/", observations.signal))
    order = np.lexsort((observations.time, signal))
    before, after = order[:-1], order[1:]
    lock = observations.loss_of_lock
    elapsed = observations.time[after] - observations.time[before]
    unbroken = (signal[before] == signal[after]) & (elapsed > 0.0) & (elapsed <= longest)
    unbroken &= (lock[after] & _LOST) == 0
    unbroken &= (lock[after] & _HALF) == (lock[before] & _HALF)
    unbroken &= np.isfinite(observations.carrier[before] + observations.carrier[after])
    before, after, elapsed = before[unbroken], after[unbroken], elapsed[unbroken]
    cycles = observations.carrier[after] - observations.carrier[before]
    rate = observations.wavelength[after] * cycles / elapsed
    own = 0.5 * (observations.range_rate[before] + observations.range_rate[after])
    return PhaseIntervals(before, after, rate, own - rate)


def phase_gate(
    observations: GnssObservations, limit: float = LIMIT, *, causal: bool = False
) -> GnssObservations:
    """Return the observations with the rows marked that their carrier's phase does not bear out.

    A row stands if the interval that ends or the one that begins with it agrees: a slip speaks
    against an interval, not against the Doppler on both sides of it.

    Parameters
    ----------
    observations : GnssObservations
        Without any carrier phase nothing is marked: there is nothing to ask.
    limit : float
        [m/s].
    causal : bool
        Ask the interval that ends with a row alone, as one must while driving.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> from certnav.velocity import phase_gate
    >>> drive = simulate(SimulationConfig(duration=20.0, density="open", noise=False))
    >>> observations, pos_e = drive.observations, drive.reference.pos_e[0]
    >>> gated = phase_gate(observations)
    >>> int((gated.rejected != observations.rejected).sum())  # rows marked: nothing contradicts
    0
    """
    if not has_phase(observations):
        return observations
    intervals = phase_intervals(observations)
    tested, agrees = (np.zeros(len(observations), dtype=bool) for _ in range(2))
    known, good = np.isfinite(intervals.misfit), np.abs(intervals.misfit) <= limit
    for rows in (intervals.after,) if causal else (intervals.after, intervals.before):
        tested[rows[known]] = True
        agrees[rows[good]] = True
    rated = np.isfinite(observations.range_rate)
    marked = observations.mark(rated & tested & ~agrees, DISAGREES)
    return marked.mark(rated & ~tested, UNTRACKED)


def has_phase(observations: GnssObservations) -> bool:
    """Return whether the receiver gives carrier phases: with a fifth of its range rates or more.

    In a street canyon a u-blox has them for fewer than half of its rows; one that hardly has any
    says nothing about the others.
    """
    rated = observations.usable & np.isfinite(observations.range_rate)
    return bool(rated.any() and np.mean(np.isfinite(observations.carrier[rated])) > _SOME)


def with_phase_rates(observations: GnssObservations, limit: float = LIMIT) -> GnssObservations:
    """Return the observations with range rates from the phase where they are better.

    The rate at a row is the mean over the two intervals around it, which for a steady change of
    the rate is that of the instant. It is taken where both agree with Doppler to a quarter of a
    cycle, so that half a cycle lost would not pass, and are so short that Doppler can tell: a
    quarter of a cycle is half the limit there or more.

    Parameters
    ----------
    observations : GnssObservations
    limit : float
        Largest disagreement with Doppler [m/s].

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> from certnav.velocity import with_phase_rates
    >>> drive = simulate(SimulationConfig(duration=20.0, density="open", noise=False))
    >>> observations, pos_e = drive.observations, drive.reference.pos_e[0]
    >>> better = with_phase_rates(observations)
    >>> bool(abs(better.range_rate - observations.range_rate).max() < 0.05)  # [m/s]
    True
    """
    intervals = phase_intervals(observations)
    elapsed = observations.time[intervals.after] - observations.time[intervals.before]
    quarter = 0.25 * observations.wavelength[intervals.after] / elapsed
    good = (np.abs(intervals.misfit) <= np.minimum(limit, quarter)) & (quarter >= 0.5 * limit)
    ended, begun = (np.full(len(observations), -1) for _ in range(2))
    ended[intervals.after[good]] = begun[intervals.before[good]] = np.flatnonzero(good)
    row = np.flatnonzero((ended >= 0) & (begun >= 0))
    first, second = ended[row], begun[row]
    weight = elapsed[second] / (elapsed[first] + elapsed[second])
    rate = observations.range_rate.copy()
    # Rates of the middles of the intervals, interpolated to the row between them.
    rate[row] = intervals.rate[first] * weight + intervals.rate[second] * (1.0 - weight)
    return observations.with_columns(range_rate=rate)
