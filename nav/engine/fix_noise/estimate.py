"""Scale, share and correlation time of the errors of positions, from innovations alone.

The most probable ones under wide priors. Where a receiver filters its positions, successive ones
differ by so little that only a² s/τ can be seen: a small error that lasts ten seconds and a large
one that lasts an hour look alike, and the prior has to say how large errors are. What is constant
throughout a recording cannot be seen at all: there a small scale is one of what does change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....filters.rotation import FloatArray
from ...solution import FixErrors
from ..events import SHARED
from .likelihood import log_likelihood

#: ln of the scale: a declared σ is wrong by a factor of two, seldom of five.
_SIGMA_SCALE = 0.8
#: ln of the correlation time: minutes, as of reflections at a car that stops and goes and of the
#: filter in a receiver (10 s) up to those of ionosphere and orbits (30 min).
_TIME, _SIGMA_TIME = 100.0, 1.5
#: Of ln(s/(1 − s)): a share from 2 % to 98 % is as probable as any.
_SIGMA_SHARE = 4.0
#: Scales are looked for so far to either side of the prior's middle, in steps of ln a.
_REACH, _STEP = 3.5, 0.25
#: Its posterior may be narrower than a step: 1/√(6 n) of n white errors.
_FINER = 25
#: Where the search begins: ln of the odds of a share, ln of a time [s].
_BEGINNINGS = ((2.2, 2.3), (-3.0, 4.5))
_SHORTEST, _LONGEST = 0.3, 2e4
#: A tenth of a unit and a twentieth of a log unit is near enough; so far around the search looks.
_OPTIONS = {"maxfev": 100, "xatol": 0.1, "fatol": 0.05}
_AROUND = 0.4 * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
#: Log units below the best: what is less probable has no weight.
_IMPROBABLE = 15.0
#: More positions than this say no more about three numbers.
_ENOUGH = 3000


@dataclass(frozen=True, eq=False)
class Innovations:
    """What positions differ by from a filter that was not given them.

    Parameters
    ----------
    time : ndarray, shape (n,)
        GPS time [s].
    value_n : ndarray, shape (n, 3)
        Position − antenna by the filter, north-east-down [m].
    filter_n : ndarray, shape (n, 3)
        Variance of the antenna by the filter [m²].
    declared_n : ndarray, shape (n, 3)
        Variance of the position [m²].
    kept : ndarray, shape (n,)
        Share of its satellites that the one before had, too.
    """

    time: FloatArray
    value_n: FloatArray
    filter_n: FloatArray
    declared_n: FloatArray
    kept: FloatArray

    def __len__(self) -> int:
        return self.time.size

    def thinned(self) -> Innovations:
        """Return every n-th, as many as say all there is to say."""
        step = -(-len(self) // _ENOUGH)
        rows = np.arange(0, len(self), step)
        kept = np.multiply.reduceat(np.r_[self.kept[1:], 1.0], rows)
        kept = np.r_[1.0, kept[:-1]]
        return Innovations(
            self.time[rows], self.value_n[rows], self.filter_n[rows], self.declared_n[rows], kept
        )


#: What the declared variance V stands for. 'steady': what is shared has the same size all the time,
#: V's median; a shared error that followed V would seem to be seen whenever V changes. 'allowance':
#: what is usual of V scales; what is beyond is allowed for reflections, and stays as declared.
STEADY, ALLOWANCE = "steady", "allowance"


def usual_variance(declared_n: FloatArray, meaning: str) -> FloatArray:
    """Return what of declared variances is usual, north-east-down, shape (3,) [m²].

    In the densest streets, too, a tenth of the positions is free of reflections.
    """
    usual: FloatArray = np.quantile(declared_n, 0.1 if meaning == ALLOWANCE else 0.5, axis=0)
    return usual


def parts(V: FloatArray, usual: FloatArray, meaning: str) -> FloatArray:
    """Return the variances W, U, C, D of a declared one (`likelihood`).

    Parameters
    ----------
    V : ndarray, shape (n, m)
        Declared, of any parts of a covariance that add up.
    usual : ndarray, shape (m,) or (n, m)
        `usual_variance`; with `ALLOWANCE` the share of V that is usual.
    meaning : {STEADY, ALLOWANCE}

    Returns
    -------
    ndarray, shape (4, n, m)
    """
    if meaning == ALLOWANCE:
        beyond = (1.0 - usual) * V
        return np.array([V - beyond, V - beyond, SHARED * beyond, (1.0 - SHARED) * beyond])
    return np.array([np.broadcast_to(usual, V.shape), V, 0.0 * V, 0.0 * V])


def fit(
    found: Innovations, reflections: bool, centre: float = 1.0, lasting: float = 10.0
) -> FixErrors:
    """Return the errors of positions that explain their innovations.

    Parameters
    ----------
    found : Innovations
        Two at least.
    reflections : bool
        Whether what is declared beyond the usual is to be expected.
    centre : float
        Scale that is thought most probable beforehand.
    lasting : float
        How long reflections last [s]: where they are expected, all that is shared does.
    """
    found = found.thinned()
    search = _Search(found, ALLOWANCE if reflections else STEADY, centre, lasting)
    chosen = search.profile()
    alone = np.array([search.white(x) for x in search.grid])
    gain = float(alone.min() - chosen.cost.min())
    # Two parameters more have to gain ln of the number of data (Schwarz); reflections last.
    if gain < np.log(found.value_n.size) and not reflections:
        level, spread = _level(search.grid, alone)
        shape = 0.0, 0.0
    else:
        level, spread = _level(search.grid, chosen.cost)
        shape = search.shape(search.at(level, chosen.at)[1])
    usual = tuple(map(float, usual_variance(found.declared_n, search.meaning)))
    return FixErrors(float(np.exp(level)), *shape, search.meaning, usual, gain, spread)


def _level(x: FloatArray, cost: FloatArray) -> tuple[float, float]:
    """Return ln of the scale, and its 1σ, where −ln of its density is `cost` at the nodes.

    The scale is √E[a²]: a variance of which only the distribution is known is its mean.
    """
    from scipy.interpolate import CubicSpline  # slow to import

    fine = np.linspace(x[0], x[-1], _FINER * (x.size - 1) + 1)
    density = CubicSpline(x, cost)(fine)
    weight = np.exp(density.min() - density)
    weight /= weight.sum()
    spread = np.sqrt(weight @ (fine - weight @ fine) ** 2)
    return float(0.5 * np.log(weight @ np.exp(2.0 * fine))), float(spread)


@dataclass(frozen=True, eq=False)
class _Profile:
    """−ln of the posterior over a grid of scales, each with the best share and time."""

    cost: FloatArray
    at: FloatArray


class _Search:
    def __init__(self, found: Innovations, meaning: str, centre: float, lasting: float) -> None:
        self.centre, self.meaning, self.lasting = float(np.log(centre)), meaning, lasting
        self.grid = self.centre + np.arange(-_REACH, _REACH + 0.5 * _STEP, _STEP)
        V = found.declared_n
        usual = usual_variance(V, meaning)
        if meaning == ALLOWANCE:
            usual = np.minimum(1.0, usual.sum() / V.sum(axis=1))[:, None]
        dt = np.diff(found.time, prepend=found.time[0])
        # Where the filter's variance falls it has learnt, and moves by what it has learnt.
        drift = np.abs(np.diff(found.filter_n, axis=0, prepend=found.filter_n[:1]))
        self._series = dt, found.kept, found.value_n, drift
        W, U, C, D = self._parts = parts(V, usual, meaning)
        self._alone = np.array([W, U, 0.0 * C, C + D])
        self._work = np.empty(len(found)), np.empty(len(found))

    def shape(self, x: FloatArray) -> tuple[float, float]:
        """Return share and correlation time [s] of the search's coordinates."""
        share = 1.0 / (1.0 + np.exp(-np.clip(x[0], -14.0, 14.0)))
        if self.meaning == ALLOWANCE:
            return float(share), self.lasting
        time = np.exp(np.clip(x[1], np.log(_SHORTEST), np.log(_LONGEST)))
        return float(share), float(time)

    def white(self, log_scale: float) -> float:
        """Return −ln of the posterior where nothing is shared."""
        return self._cost(self._alone, log_scale, 0.0, 1.0)

    def _cost(self, shape: FloatArray, log_scale: float, share: float, correlation: float) -> float:
        scale = float(np.exp(log_scale))
        ln_l = log_likelihood(*self._series, shape, scale, share, correlation, *self._work)
        return -float(ln_l) + 0.5 * ((log_scale - self.centre) / _SIGMA_SCALE) ** 2

    def at(self, log_scale: float, beginnings: FloatArray) -> tuple[float, FloatArray]:
        """Return −ln of the posterior at a scale, and the best coordinates there."""
        from scipy.optimize import minimize  # slow to import

        def total(x: FloatArray) -> float:
            away = ((x[1] - np.log(_TIME)) / _SIGMA_TIME) ** 2 + (x[0] / _SIGMA_SHARE) ** 2
            return self._cost(self._parts, log_scale, *self.shape(x)) + 0.5 * float(away)

        made = [
            minimize(
                total, x, method="Nelder-Mead", options=_OPTIONS | {"initial_simplex": x + _AROUND}
            )
            for x in beginnings
        ]
        best = min(made, key=lambda result: float(result.fun))
        return float(best.fun), np.asarray(best.x)

    def profile(self) -> _Profile:
        """Return the posterior over the scales, from both ends, each from its neighbour's best."""
        cost, at = np.full(self.grid.size, np.inf), np.zeros((self.grid.size, 2))
        for order in (range(self.grid.size), range(self.grid.size - 1, -1, -1)):
            beginnings = np.array(_BEGINNINGS)
            for k in order:
                if np.inf > cost[k] > cost.min() + _IMPROBABLE:
                    continue
                found, x = self.at(self.grid[k], beginnings)
                if found < cost[k]:
                    cost[k], at[k] = found, x
                beginnings = at[k][None]
        return _Profile(cost, at[[int(cost.argmin())]])
