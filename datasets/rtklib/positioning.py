"""Single-point positions: RTKLIB's pntpos with a residual test that excludes faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...filters.fault_exclusion import consistent_rows
from ...filters.rotation import FloatArray
from ..observations import GnssFixes, GnssObservations
from .each_range import EachRange, each_range
from .persistence import Linearised, Persistent, persistent_faults, variance_factor
from .point_engine import Point, PointEngine, spp_options
from .satellites import ephemerides_used, load_navigation

#: How often satellites that are wrong all the time are looked for: without one, others are seen.
_ROUNDS = 3
#: Rows of a satellite that could have been excluded, and share of them that were, from which on it
#: is wrong all the time.
_MANY, _MOSTLY = 30, 0.5
#: Satellites to spare that tell which of them is wrong.
_SPARE = 2


@dataclass(frozen=True, eq=False)
class SinglePoint:
    """Single-point positions, and why the other epochs have none.

    Attributes
    ----------
    fixes : GnssFixes
        Antenna positions of quality 'single'; velocity NaN. `fixes.time` is the epoch's, by the
        receiver's clock; the position belongs to `time − clock/c` (ms for some receivers).
    clock : ndarray, shape (n,)
        Receiver clock offset c·δt_r at each fix [m], against GPS time.
    failed : tuple of (float, str)
        Time and reason of each epoch without a solution.
    satellites : tuple of tuple of str
        Satellites used by each fix.
    rejected : tuple of int
        Rows of the observations that the residual test excluded: 'pseudorange residual'.
    persistent : tuple of Persistent
        Satellites wrong all the time, also by less than one epoch's test can tell.
    left_out : tuple of int
        Rows of these that took no part in any fix: all, if it is known which satellite it is, or
        if there are satellites enough without any of the suspects.
    lasting_cov_e : ndarray, shape (n, 3, 3), optional
        What each fix's covariance lacks that no averaging over minutes takes away [m²]: the
        variance of orbits, clocks and ionosphere, times what the residuals of minutes have beyond
        that of sound satellites. Of those it is zero: what they share is the noise's business.
    misfit : float
        chi²/dof of the residuals of all fixes together; NaN where none has one to spare.
    ranges : tuple of EachRange, optional
        Of each fix, what an error of each pseudorange does to it, and what the others say of it.
    """

    fixes: GnssFixes
    clock: FloatArray
    failed: tuple[tuple[float, str], ...]
    satellites: tuple[tuple[str, ...], ...]
    rejected: tuple[int, ...]
    persistent: tuple[Persistent, ...] = ()
    left_out: tuple[int, ...] = ()
    lasting_cov_e: FloatArray | None = None
    misfit: float = float("nan")
    ranges: tuple[EachRange, ...] | None = None


def single_point(
    observations: GnssObservations,
    navigation: Sequence[str | Path],
    *,
    elevation_mask: float = 0.0,
    min_cn0: float = 0.0,
    ionosphere: str = "broadcast",
    troposphere: str = "saastamoinen",
    raim: bool = True,
    significance: float = 1e-3,
    code_sigma: float = 0.9,
    weak_sigma: float = 0.0,
) -> SinglePoint:
    """Return single-point positions from the usable rows, epoch by epoch (RTKLIB pntpos).

    Parameters
    ----------
    observations : GnssObservations
        Rejected rows take no part; of several signals of a satellite the first row counts.
    navigation : sequence of path
        Broadcast ephemerides.
    elevation_mask : float
        [rad].
    min_cn0 : float
        [dB-Hz]; rows without C/N0 pass.
    ionosphere : {'broadcast', 'off'}
        Klobuchar model of the navigation file, or none.
    troposphere : {'saastamoinen', 'off'}
    raim : bool
        Test the residuals and exclude faulty satellites (`filters.fault_exclusion`); an epoch
        whose faults cannot be told apart fails as 'inconsistent pseudoranges'. RTKLIB EX itself
        accepts solutions that fail its test. Satellites that contradict the others all the time
        (`persistence`) are left out altogether, where it can be told which.
    significance : float
        Probability that the test accuses a fault-free epoch.
    code_sigma : float
        Pseudorange noise at the zenith, 1σ [m]; it grows by √(1 + 1/sin elevation).
    weak_sigma : float
        What reflections add at 45 dB-Hz, 1σ [m]: tenfold at 25 dB-Hz, no less above. A signal
        that is weak has met something on its way.

    Returns
    -------
    SinglePoint
        The covariance is that of RTKLIB's weighted least squares, times max(1, chi²/dof) of the
        residuals. It takes as independent and Gaussian: code noise as given (GLONASS ×1.5),
        broadcast accuracy (URA), half of the modelled ionospheric delay (5 m when off), 0.3 m
        at the zenith for the troposphere (3 m when off), and 0.3 m of code bias. Common errors
        (ionosphere, URA over minutes) make successive fixes correlated: averaging them gains
        less than their covariance says. Satellites whose broadcast accuracy is 'no prediction'
        are left out by RTKLIB.
    """
    options = spp_options(elevation_mask, ionosphere, troposphere, code_sigma)
    nav = load_navigation(navigation)
    options.sateph = ephemerides_used(nav)
    engine = PointEngine(nav, options, observations, weak_sigma)
    offered = observations.usable & ~(observations.cn0 < min_cn0)
    offered &= np.isfinite(observations.pseudorange)
    take = offered.copy()
    epochs = _epochs(engine, observations, take, significance if raim else 0.0)
    faults: dict[str, Persistent] = {}
    for _ in range(_ROUNDS if raim else 0):
        new = _wrong(epochs, observations)
        out = take & _without(new, epochs, observations)
        faults = {fault.satellite: fault for fault in new} | faults
        if not out.any():
            break
        take &= ~out
        epochs = _epochs(engine, observations, take, significance)
    left_out = tuple(np.flatnonzero(offered & ~take).tolist())
    return _single_point(epochs, tuple(faults.values()), left_out, observations)


class _Epoch(NamedTuple):
    """What became of one epoch: its fix or why there is none, and what was excluded for it.

    Parameters
    ----------
    time : float
    point : Point or str
    excluded : ndarray of int
        Rows.
    excess : ndarray
        By how much these are too long [m].
    tested : ndarray of int
        Rows that could have been excluded.
    """

    time: float
    point: Point | str
    excluded: NDArray[np.int64]
    excess: FloatArray
    tested: NDArray[np.int64]


def _epochs(
    engine: PointEngine,
    observations: GnssObservations,
    take: NDArray[np.bool_],
    significance: float,
) -> list[_Epoch]:
    """Solve all epochs from the rows of `take`, excluding what fails the residual test."""
    out = []
    for time, rows in observations.epochs():
        index = np.flatnonzero(take[rows]) + rows.start
        _, first = np.unique(observations.sat[index], return_index=True)
        out.append(_epoch(engine, float(time), index[np.sort(first)], significance))
    return out


def _epoch(
    engine: PointEngine, time: float, index: NDArray[np.int64], significance: float
) -> _Epoch:
    none, nothing = np.zeros(0, dtype=np.int64), np.zeros(0)
    point = engine.solve(index)
    if isinstance(point, str) or not significance:
        return _Epoch(time, point, none, nothing, none)
    spare = point.used.size - np.linalg.matrix_rank(point.H)
    tested = point.used if spare >= _SPARE else none
    keep = consistent_rows(point.H, point.residuals, point.sigma, significance)
    if keep is None:
        return _Epoch(time, "inconsistent pseudoranges", none, nothing, tested)
    if keep.all():
        return _Epoch(time, point, none, nothing, tested)
    weight = 1.0 / point.sigma[keep, None]
    x = np.linalg.lstsq(point.H[keep] * weight, point.residuals[keep] * weight[:, 0], rcond=None)[0]
    excess = (point.residuals - point.H @ x)[~keep]
    return _Epoch(time, engine.solve(point.used[keep]), point.used[~keep], excess, tested)


def _wrong(epochs: list[_Epoch], observations: GnssObservations) -> tuple[Persistent, ...]:
    """Return the satellites that are wrong all the time: excluded mostly, or wrong on average."""
    out: list[Persistent] = []
    count = len(observations)
    excluded, excess, tested = (np.zeros(count, bool), np.zeros(count), np.zeros(count, bool))
    for epoch in epochs:
        excluded[epoch.excluded] = True
        excess[epoch.excluded] = epoch.excess
        tested[epoch.tested] = True
    for sat in np.unique(observations.sat[excluded]):
        rows = (observations.sat == sat) & tested
        gone = rows & excluded
        if rows.sum() >= _MANY and gone.sum() > _MOSTLY * rows.sum():
            out.append(Persistent(str(sat), float(np.median(excess[gone])), int(gone.sum())))
    if out:  # what these have done to the fixes is no fault of the others
        return tuple(out)
    return persistent_faults(_linearised(epochs, observations))


def _linearised(epochs: list[_Epoch], observations: GnssObservations) -> list[Linearised]:
    return [
        Linearised(e.time, observations.sat[p.used], p.H, p.residuals, p.noise, p.staying)
        for e in epochs
        if isinstance(p := e.point, Point)
    ]


def _lacking(epochs: list[_Epoch], observations: GnssObservations) -> FloatArray | None:
    """Return what the residuals of minutes say each fix's covariance lacks; None: nothing."""
    more = variance_factor(_linearised(epochs, observations)) - 1.0
    points = [e.point for e in epochs if isinstance(e.point, Point)]
    if more <= 0.0 or not points:
        return None
    return more * np.array([_lasting(p) for p in points])


def _lasting(point: Point) -> FloatArray:
    """Return the covariance that what stays of the ranges leaves in the position."""
    gain = np.linalg.pinv(point.H / point.sigma[:, None])[:3] / point.sigma
    return np.asarray((gain * point.staying**2) @ gain.T)


def _without(
    faults: tuple[Persistent, ...], epochs: list[_Epoch], observations: GnssObservations
) -> NDArray[np.bool_]:
    """Return the rows to leave out: of several suspects all, if enough remains to be tested."""
    out = np.zeros(len(observations), dtype=bool)
    for fault in faults:
        names = [fault.satellite, *fault.suspects]
        spare = [
            int(np.sum(~np.isin(observations.sat[p.used], names))) - p.H.shape[1]
            for e in epochs
            if isinstance(p := e.point, Point)
        ]
        if not fault.suspects or (spare and np.median(spare) >= _SPARE):
            out |= np.isin(observations.sat, names) & fault.covers(observations.time)
    return out


def _single_point(
    epochs: list[_Epoch],
    persistent: tuple[Persistent, ...],
    left_out: tuple[int, ...],
    observations: GnssObservations,
) -> SinglePoint:
    points = [e.point for e in epochs if isinstance(e.point, Point)]
    n = len(points)
    dof = np.array([len(p.used) - np.linalg.matrix_rank(p.H) for p in points], dtype=int)
    chi2 = np.array([np.sum((p.residuals / p.sigma) ** 2) for p in points])
    spare = dof > 0
    factor = np.ones(n)
    factor[spare] = np.maximum(1.0, chi2[spare] / dof[spare])
    cov_e = np.array([p.cov_e for p in points], dtype=float).reshape(n, 3, 3)
    fixes = GnssFixes(
        time=np.array([observations.time[p.used[0]] for p in points], dtype=float),
        pos_e=np.array([p.pos_e for p in points], dtype=float).reshape(n, 3),
        pos_cov_e=cov_e * factor[:, None, None],
        vel_e=np.full((n, 3), np.nan),
        vel_cov_e=np.full((n, 3, 3), np.nan),
        satellites=np.array([len(p.used) for p in points], dtype=np.int64),
        quality=np.full(n, "single"),
    )
    satellites = tuple(tuple(map(str, observations.sat[p.used])) for p in points)
    misfit = float(chi2[spare].sum() / dof[spare].sum()) if spare.any() else float("nan")
    return SinglePoint(
        fixes,
        np.array([p.clock for p in points], dtype=float),
        tuple((e.time, e.point) for e in epochs if isinstance(e.point, str)),
        satellites,
        tuple(int(row) for e in epochs for row in e.excluded),
        persistent,
        left_out,
        _lacking(epochs, observations),
        misfit,
        tuple(each_range(p, misfit) for p in points),
    )
