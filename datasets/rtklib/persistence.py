"""Satellites whose pseudoranges are wrong all the time: a stale ephemeris, a wrong channel.

A single epoch's test has to allow for multipath and passes an error of tens of metres in one
satellite. Over minutes reflections average out; what is left is what orbits, clocks and atmosphere
leave, a few metres, and the same error stands out. In every epoch position and clocks are free,

    residuals = H x + b + ε,    b = b₀ + b₁ u per satellite, u from −1 to 1 over the stretch,

so that only what contradicts the other satellites counts; a fault may have any b₀ and b₁ (an orbit
shifted along itself lengthens ranges by the line of sight's part of it, which changes by 2·10⁻⁴ of
the shift a second). What all positions share nobody contradicts: an error that other satellites
leave room for cannot be seen, not from the filter either, whose position came from these ranges.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...filters.fault_exclusion import chi2_limit
from ...filters.rotation import FloatArray

#: How long reflections last [s]: fixes within it count as one. With it none of Spirent, fuji-rtk,
#: nagoya-rtk-static, tckf_static and smartloc shows systematic errors beyond 0.5 m.
_CORRELATION = 30.0
#: Longest stretch [s]: longer, and b is no straight line. Shortest, and fewest fixes in it.
_STRETCH, _SHORTEST, _FIXES = 300.0, 60.0, 30
#: Fixes closer than this say the same [s].
_SPACING = 1.0
#: Sound satellites: b₁ over b₀, both 1σ.
_SLOPE = 0.5
#: Probability of accusing satellites of which none is at fault, in a stretch.
_SIGNIFICANCE = 1e-4
#: A satellite that explains the residuals worse by less than this in χ² may be the culprit too:
#: 0.1 % with one degree of freedom.
_EQUAL = 10.8
#: Sets of so many are tried, of three only among so few satellites.
_SETS, _FEW = (1, 2, 3), 15
#: Share of a satellite's stretches from which on it is accused for the whole recording.
_MOSTLY = 0.5


class Linearised(NamedTuple):
    """One fix: ``residuals = H x + b + ε`` for its satellites.

    Parameters
    ----------
    time : float
        [s].
    satellites : ndarray of str, shape (n,)
    H : ndarray, shape (n, p)
    residuals, noise, systematic : ndarray, shape (n,)
        [m]; 1σ of what an epoch has for itself, ε, and of what stays, b.
    """

    time: float
    satellites: NDArray[np.str_]
    H: FloatArray
    residuals: FloatArray
    noise: FloatArray
    systematic: FloatArray


@dataclass(frozen=True)
class Persistent:
    """A satellite that contradicts the others all the time.

    Attributes
    ----------
    satellite : str
    bias : float
        By how much its pseudoranges are too long [m], where that is largest.
    fixes : int
        In how many fixes, at most one a second.
    spans : tuple of (float, float)
        First and last time of the stretches where it does [s].
    suspects : tuple of str
        Others that explain as well what is wrong.
    """

    satellite: str
    bias: float
    fixes: int
    spans: tuple[tuple[float, float], ...] = ((-np.inf, np.inf),)
    suspects: tuple[str, ...] = ()

    def covers(self, time: FloatArray) -> NDArray[np.bool_]:
        """Return which of `time` lie where it is wrong."""
        inside = [(time >= first) & (time <= last) for first, last in self.spans]
        return np.any(inside, axis=0) if inside else np.zeros(time.shape, dtype=bool)


def persistent_faults(fixes: Sequence[Linearised]) -> tuple[Persistent, ...]:
    """Return the satellites that the others, on the average of many fixes, contradict.

    Parameters
    ----------
    fixes : sequence of Linearised
        In order of time.
    """
    found: dict[str, list[tuple[Persistent, int]]] = {}
    seen: dict[str, int] = {}
    stretches = list(_stretches(fixes))
    for stretch in stretches:
        for name in {str(s) for fix in stretch for s in fix.satellites}:
            seen[name] = seen.get(name, 0) + 1
        for fault in _faults(stretch):
            found.setdefault(fault.satellite, []).append((fault, len(stretch)))
    return tuple(_joined([f for f, _ in faults], seen[s]) for s, faults in sorted(found.items()))


def variance_factor(fixes: Sequence[Linearised]) -> float:
    """Return by what the variance of what stays is too small, at least 1: the worst stretch's.

    What is too little to accuse a satellite may still be more than sound ones show; how much more,
    the residuals say: each as far as it is what stays, not noise, that it varies by.
    """
    worst = 1.0
    for stretch in _stretches(fixes):
        names = sorted({str(s) for fix in stretch for s in fix.satellites})
        z, _, stays = _whitened(stretch, names)
        if z.size:
            worst = max(worst, float(stays**2 @ z**2 / (stays @ stays)))
    return worst


def _joined(faults: list[Persistent], stretches: int) -> Persistent:
    """Return what the stretches say of one satellite together."""
    worst = max(faults, key=lambda fault: abs(fault.bias))
    everywhere = len(faults) >= _MOSTLY * stretches
    spans = ((-np.inf, np.inf),) if everywhere else tuple(f.spans[0] for f in faults)
    # One stretch that knows the culprit speaks for the others.
    sure = any(not f.suspects for f in faults)
    suspects = () if sure else worst.suspects
    fixes = sum(f.fixes for f in faults)
    return Persistent(worst.satellite, worst.bias, fixes, spans, suspects)


def _stretches(fixes: Sequence[Linearised]) -> list[list[Linearised]]:
    """Return the fixes, thinned, in stretches of equal length."""
    if not fixes:
        return []
    thinned: list[Linearised] = []
    for fix in fixes:
        if not thinned or fix.time - thinned[-1].time >= _SPACING - 1e-3:
            thinned.append(fix)
    first, last = thinned[0].time, thinned[-1].time
    if last - first < _SHORTEST - _SPACING:
        return []
    count = max(1, int(np.ceil((last - first) / _STRETCH)))
    number = [min(count - 1, int(count * (f.time - first) / (last - first))) for f in thinned]
    parts = [[f for f, k in zip(thinned, number, strict=True) if k == n] for n in range(count)]
    return [p for p in parts if len(p) >= _FIXES]


def _faults(stretch: list[Linearised]) -> list[Persistent]:
    names = sorted({str(s) for fix in stretch for s in fix.satellites})
    z, A, _ = _whitened(stretch, names)
    if not z.size:
        return []
    blamed, suspects = _blamed(z, A, len(names))
    if not blamed:
        return []
    columns = _columns(blamed, len(names))
    bias = np.linalg.lstsq(A[:, columns], z, rcond=None)[0]
    span = (stretch[0].time, stretch[-1].time)
    others = tuple(names[k] for k in suspects)
    return [
        Persistent(
            names[k],
            float(bias[i]),
            sum(bool(np.isin(names[k], fix.satellites)) for fix in stretch),
            (span,),
            others,
        )
        for i, k in enumerate(blamed)
    ]


def _whitened(
    stretch: list[Linearised], names: list[str]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what the fixes say of [b₀; b₁]: ``z = A b + η``, η of unit covariance if all is sound.

    Last, the share of sound satellites' b in the variance of each z.

    Position and clocks are eliminated in each fix; of the normal equations that remain the
    directions with information are kept.
    """
    m, column = len(names), {name: k for k, name in enumerate(names)}
    first, last = stretch[0].time, stretch[-1].time
    middle, half = 0.5 * (first + last), max(0.5 * (last - first), 1e-9)
    normal, right = np.zeros((2 * m, 2 * m)), np.zeros(2 * m)
    systematic, count, whole = np.zeros(m), np.zeros(m), np.zeros(m)
    for fix in stretch:
        at = [column[str(s)] for s in fix.satellites]
        systematic[at] += fix.systematic
        count[at] += 1.0
        whole[at] += fix.noise**-2
        q, _ = np.linalg.qr(fix.H / fix.noise[:, None])
        free = (np.eye(len(at)) - q @ q.T) / fix.noise[:, None]
        information = free @ (free.T)
        rhs = free @ (free.T @ fix.residuals)
        u = (fix.time - middle) / half
        both = np.concatenate([at, np.add(at, m)])
        powers = np.array([[1.0, u], [u, u * u]])
        normal[np.ix_(both, both)] += np.kron(powers, information)
        right[both] += np.concatenate([rhs, u * rhs])
    # Fixes within the correlation time are one.
    together = max(1.0, _CORRELATION * (len(stretch) - 1) / max(last - first, 1e-9))
    values, axes = np.linalg.eigh(normal / together)
    known = values > 1e-6 * whole.max() / together
    values, axes = values[known], axes[:, known]
    sigma = systematic / np.maximum(count, 1.0)
    sound = np.concatenate([sigma, _SLOPE * sigma]) ** 2
    staying = (axes.T * sound) @ axes
    root = np.linalg.cholesky(staying + np.diag(1.0 / values))
    z = np.linalg.solve(root, axes.T @ right / together / values)
    share = np.linalg.solve(root, np.linalg.solve(root, staying).T)
    return z, np.linalg.solve(root, axes.T), np.diag(share)


def _blamed(z: FloatArray, A: FloatArray, m: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the smallest set of satellites that explains `z`, and who might be it instead."""
    if z @ z <= chi2_limit(_SIGNIFICANCE, z.size):
        return (), ()
    for size in _SETS:
        if size == 3 and m > _FEW:
            break
        tried = [
            (_chi2_without(z, A, who, m), who) for who in itertools.combinations(range(m), size)
        ]
        passed = sorted(
            (chi2, who) for (chi2, dof), who in tried if chi2 <= chi2_limit(_SIGNIFICANCE, dof)
        )
        if passed:
            best, blamed = passed[0]
            equal = {k for chi2, who in passed if chi2 <= best + _EQUAL for k in who}
            return blamed, tuple(sorted(equal - set(blamed)))
    return (), ()


def _chi2_without(z: FloatArray, A: FloatArray, who: tuple[int, ...], m: int) -> tuple[float, int]:
    """Return χ² with the biases of some satellites free, and its degrees of freedom."""
    u, s, _ = np.linalg.svd(A[:, _columns(who, m)], full_matrices=False)
    u = u[:, s > 1e-9 * max(s[0], 1e-12)]
    rest = z - u @ (u.T @ z)
    return float(rest @ rest), z.size - u.shape[1]


def _columns(who: tuple[int, ...], m: int) -> list[int]:
    return [*who, *(k + m for k in who)]
