"""Alignment when part of the Doppler rows is wrong: which rows to believe.

Truncated least squares, Σ min(rᵢ², c²), has many local minima. Three things find the lowest in
practice: a gate that no rotation enters (the clock must lie within |v| of −z), graduated
non-convexity (Yang et al. 2020) with its two losses, truncated and Geman–McClure, each step solved
to the *global* optimum, and the best of what these find. What is left to chance is then asked of
`alignment.proofs.consensus_proof`: whether another rotation could have as many rows on its side.
Where that cannot be excluded the result does not pass, whatever its own rows say about it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..filters.errors import AlignmentError, ConfigError, DataError
from ..filters.rotation import FloatArray
from .priors import Prior, with_priors
from .problem import AlignmentRows, ClockModel, build_problem, design_matrix
from .proofs.consensus_proof import ConsensusProof, consensus, prove_consensus, row_weights
from .solver.constraints import lift
from .solver.fast_solver import fast_minimum
from .verdict import AlignmentResult, Verdict, VerdictLimits, align

Mask = NDArray[np.bool_]

#: Steps of the graduation, and how fast it goes.
_GNC_STEPS, _GNC_FACTOR = 120, 1.4
#: Fewest rows that say anything about a rotation and a clock.
_FEWEST = 4
#: Radius that excludes nothing [rad].
_ANYWHERE = 1e-3


@dataclass(frozen=True)
class RobustOptions:
    """How rows are judged.

    Parameters
    ----------
    cutoff : float
        Largest residual of an inlier, in σ.
    support : float
        Largest residual of a row that supports a rotation in the proofs, in σ. At the cutoff,
        rotations far apart would have the same inliers; noise leaves 95 % of them within 2σ.
    reserve : float
        Share of its consensus that a rotation must be ahead of all others: the proof asks for
        (1 − reserve) times the consensus. Among the rows rejected alone, none may have
        (1 − 2·reserve) times as many: another clock drift makes a party of its own.
    radius : float
        'Others' are those further away than this [rad].
    minority, coherence : float
        If the rows rejected are more than this share of all, no other rotation may explain this
        share of them: rows that agree with each other are a second opinion, not noise.
    max_cells : int
        Where branch and bound gives up.
    """

    cutoff: float = 3.5
    support: float = 2.0
    reserve: float = 0.2
    radius: float = float(np.radians(25.0))
    minority: float = 0.2
    coherence: float = 0.7
    max_cells: int = 40_000

    def correlated(self, count: float) -> RobustOptions:
        """Return the options for rows whose σ was multiplied by √count: the same in m/s."""
        root = float(np.sqrt(count))
        return replace(self, cutoff=self.cutoff / root, support=self.support / root)

    def __post_init__(self) -> None:
        ordered = self.cutoff >= self.support > 0.0
        if not (ordered and 0.0 <= self.reserve < 0.5 and 0.0 < self.radius < np.pi):
            raise ConfigError(
                "robust alignment: expected cutoff ≥ support > 0, 0 ≤ reserve < ½ and "
                f"0 < radius < 180°, found {self.cutoff:g}, {self.support:g}, {self.reserve:g} and "
                f"{np.degrees(self.radius):g}°"
            )


@dataclass(frozen=True, eq=False)
class RobustAlignment:
    """An alignment with the rows it rests on.

    Attributes
    ----------
    result : AlignmentResult
        Of the inliers; its verdicts include 'consensus'.
    inliers : ndarray of bool, shape (k,)
        One per row, as given.
    truncated_cost : float
        Σ min(r², cutoff²) over all rows.
    method : str
        What found it.
    proof : ConsensusProof or None
        That no other rotation has such a consensus; None where there are no outliers, or the
        nuisances admit no proof.
    opposition : ConsensusProof or None
        That none unites the rows rejected; None where they are few.
    """

    result: AlignmentResult
    inliers: Mask
    truncated_cost: float
    method: str
    proof: ConsensusProof | None
    opposition: ConsensusProof | None = None

    @property
    def outliers(self) -> NDArray[np.int64]:
        """Indices of the rows that were not believed."""
        return np.flatnonzero(~self.inliers)

    @property
    def passed(self) -> bool:
        """The overall verdict."""
        return self.result.passed


def align_robust(
    rows: AlignmentRows,
    clock: ClockModel | None = None,
    *,
    nuisance: ArrayLike | None = None,
    priors: Iterable[Prior] = (),
    options: RobustOptions | None = None,
    limits: VerdictLimits | None = None,
    vel_sigma: float = 0.0,
    correlated: float = 1.0,
    backend: str | None = None,
) -> RobustAlignment:
    """Align with rows of which an unknown part is wrong.

    Parameters
    ----------
    rows : AlignmentRows
    clock : ClockModel, optional
    nuisance : array_like, shape (k, m), optional
        As for `alignment.problem.build_problem`.
    priors : iterable of Prior
        Believed as they are.
    options : RobustOptions, optional
    limits : VerdictLimits, optional
    vel_sigma : float
    correlated : float
        As for `alignment.problem.build_problem`. The cutoff stays that of a single row.
    backend : {'numba', 'numpy'}, optional

    Raises
    ------
    AlignmentError
        If too few rows agree on anything.
    """
    clock, options, priors = clock or ClockModel(), options or RobustOptions(), tuple(priors)
    original, rows = rows, rows.correlated(correlated)
    options = options.correlated(correlated)
    stack = _Stack.of(rows, clock, nuisance, priors)
    found = _best(stack, rows, clock, options, nuisance is not None, backend)
    problem = build_problem(
        original.take(found.inliers), clock,
        None if nuisance is None else np.asarray(nuisance, dtype=float)[found.inliers],
        correlated=correlated,
    )  # fmt: skip
    if priors:
        problem = with_priors(problem, priors)
    result = align(problem, limits=limits, vel_sigma=vel_sigma, backend=backend)
    proof, opposition = None, None
    if not found.inliers.all():
        if nuisance is None and clock.kind != "linear":
            proof, opposition = _proofs(rows, clock, result.C_ew, found.inliers, options, priors)
        verdict = _consensus_verdict(found.inliers, proof, opposition, options)
        result = replace(result, extra=(verdict,))
    return RobustAlignment(result, found.inliers, found.cost, found.method, proof, opposition)


def robust_residuals(
    rows: AlignmentRows,
    clock: ClockModel | None = None,
    *,
    correlated: float = 1.0,
    options: RobustOptions | None = None,
    priors: Iterable[Prior] = (),
    backend: str | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return C_ew and what it leaves of every row, rejected ones too [m/s], shape (k,).

    Parameters
    ----------
    rows, clock, correlated, options, priors, backend
        As for `align_robust`.

    Raises
    ------
    AlignmentError
        If too few rows agree on anything.
    """
    clock, options = clock or ClockModel(), options or RobustOptions()
    rows = rows.correlated(correlated)
    options = options.correlated(correlated)
    stack = _Stack.of(rows, clock, None, tuple(priors))
    found = _best(stack, rows, clock, options, False, backend)
    C_ew, residuals = stack.fit(found.inliers.astype(float), backend)
    return C_ew, residuals * rows.sigma


@dataclass(frozen=True, eq=False)
class _Stack:
    """Rows of unit variance over x and the nuisances: measured ones, then those always believed.

    Attributes
    ----------
    measured, believed : ndarray, shape (k, m + 10) and (p, m + 10)
        Columns of the nuisances first.
    nuisances : int
        m.
    """

    measured: FloatArray
    believed: FloatArray
    nuisances: int

    @classmethod
    def of(
        cls, rows: AlignmentRows, clock: ClockModel, nuisance: ArrayLike | None,
        priors: tuple[Prior, ...],
    ) -> _Stack:  # fmt: skip
        """Return the rows; a random walk's increments become unknowns with a prior of their own."""
        columns = clock.columns(rows)
        increments = np.zeros((0, 0))
        if clock.kind == "random-walk" and clock.q:
            times, epoch = np.unique(rows.time, return_inverse=True)
            steps = np.arange(1, len(times))
            columns = np.hstack([columns, -1.0 * (epoch[:, None] >= steps)])
            increments = np.diag(1.0 / (clock.q * np.sqrt(np.diff(times))))
        if nuisance is not None:
            extra = np.asarray(nuisance, dtype=float)
            if extra.ndim != 2 or extra.shape[0] != len(rows):
                raise DataError(f"nuisance: expected shape ({len(rows)}, m), found {extra.shape}")
            columns = np.hstack([columns, extra])
        design = design_matrix(rows)
        # The clock takes up any constant; a small one keeps the weak rows below harmless.
        design[:, 9] += np.median(rows.z)
        m = columns.shape[1]
        # Unknowns that no row of weight one sees any more stay finite.
        believed = [np.hstack([1e-6 * np.eye(m), np.zeros((m, 10))])]
        if increments.size:
            wander = np.zeros((len(increments), m + 10))
            wander[:, 1 : 1 + len(increments)] = increments
            believed.append(wander)
        believed += [np.hstack([np.zeros((len(p.rows), m)), p.rows]) for p in priors]
        measured = np.hstack([columns, design]) / rows.sigma[:, None]
        return cls(measured, np.vstack(believed), m)

    def fit(self, weights: FloatArray, backend: str | None) -> tuple[FloatArray, FloatArray]:
        """Return the globally best rotation for the weights, and all rows' residuals."""
        weighted = np.sqrt(weights / weights.max())[:, None] * self.measured
        stacked = np.vstack([weighted, self.believed])
        triangle = np.asarray(np.linalg.qr(stacked, mode="r"), dtype=float)
        m = self.nuisances
        factor = triangle[m:, m:]
        minimum = fast_minimum(factor.T @ factor, backend=backend)
        x = lift(minimum.C)
        unknowns = np.append(-np.linalg.solve(triangle[:m, :m], triangle[:m, m:] @ x), x)
        return minimum.C, self.measured @ unknowns


@dataclass(frozen=True, eq=False)
class _Candidate:
    inliers: Mask
    cost: float
    method: str


def _best(
    stack: _Stack, rows: AlignmentRows, clock: ClockModel, options: RobustOptions, free: bool,
    backend: str | None,
) -> _Candidate:  # fmt: skip
    """Return the candidate of least truncated cost; `free`: with other unknowns than a clock."""
    cutoff = options.cutoff
    everything = np.ones(len(rows), dtype=bool)
    if len(rows) < _FEWEST:
        raise AlignmentError(f"{len(rows)} rows cannot tell inliers from outliers")
    _, residuals = stack.fit(np.ones(len(rows)), backend)
    if np.all(np.abs(residuals) <= cutoff):
        return _Candidate(everything, float(residuals @ residuals), "all rows")
    best: _Candidate | None = None
    gates = [] if free else list(_clock_gates(rows, clock, cutoff))
    for gate, where in ((everything, ""), *((g, "clock gate, ") for g in gates)):
        for loss in (_truncated, _geman_mcclure):
            mask = _settle(stack, loss(stack, gate, cutoff, backend), cutoff, backend)
            if mask is None:
                continue
            _, residuals = stack.fit(mask.astype(float), backend)
            cost = float(np.sum(np.minimum(residuals**2, cutoff**2)))
            if best is None or cost < best.cost - 1e-9:
                name = "truncated" if loss is _truncated else "Geman–McClure"
                best = _Candidate(mask, cost, f"{where}{name} least squares")
    if best is None:
        raise AlignmentError(f"no {_FEWEST} of {len(rows)} rows agree within {cutoff:g}σ")
    return best


def _clock_gates(rows: AlignmentRows, clock: ClockModel, cutoff: float) -> Iterator[Mask]:
    """Yield the rows that some one clock drift leaves possible, for the most popular drifts.

    cδṫ = e·C v − z lies within |v| of −z for every rotation: intervals on a line. Several maximal
    sets are kept, since a cluster of outliers may hold the largest.
    """
    if clock.kind not in ("constant", "random-walk"):
        return
    half = np.linalg.norm(rows.vel_w, axis=1) * np.linalg.norm(rows.e_e, axis=1)
    half += cutoff * rows.sigma + _wander(rows, clock)
    low, high = -rows.z - half, -rows.z + half
    points = np.unique(low)
    counts = np.sum((low <= points[:, None]) & (high >= points[:, None]), axis=1)
    seen: list[Mask] = []
    for k in np.argsort(-counts, kind="stable"):
        if counts[k] < max(_FEWEST, counts.max() // 3) or len(seen) == 3:
            return
        # All drifts up to where the next interval of the set ends.
        end = high[(low <= points[k]) & (high >= points[k])].min()
        mask = (low <= end) & (high >= points[k])
        if mask.all() or any(np.mean(mask != other) < 0.1 for other in seen):
            continue
        seen.append(mask)
        yield mask


def _wander(rows: AlignmentRows, clock: ClockModel) -> float:
    """Return how far a random walk gets from its middle, at 3σ [m/s]."""
    return 3.0 * (clock.q or 0.0) * float(np.sqrt(0.5 * np.ptp(rows.time)))


def _truncated(stack: _Stack, gate: Mask, cutoff: float, backend: str | None) -> Mask:
    """Graduated non-convexity with the truncated loss (Yang et al. 2020, eqs. 12–14)."""
    weights, c2 = gate.astype(float), cutoff**2
    _, residuals = stack.fit(weights, backend)
    r2 = residuals**2
    mu = c2 / max(2.0 * float(r2[gate].max()) - c2, 1e-9 * c2)
    for _ in range(_GNC_STEPS):
        with np.errstate(divide="ignore"):
            middle = np.sqrt(c2 * mu * (mu + 1.0) / r2) - mu
        weights = np.where(gate, np.clip(middle, 0.0, 1.0), 0.0)
        undecided = (weights > 0.0) & (weights < 1.0)
        if np.sum(weights > 0.0) < _FEWEST:
            break
        _, residuals = stack.fit(weights, backend)
        r2 = residuals**2
        if not undecided.any():
            break
        mu *= _GNC_FACTOR
    return gate & (r2 <= c2)


def _geman_mcclure(stack: _Stack, gate: Mask, cutoff: float, backend: str | None) -> Mask:
    """Graduated non-convexity with the Geman–McClure loss (Yang et al. 2020, eqs. 8–9)."""
    c2 = cutoff**2
    _, residuals = stack.fit(gate.astype(float), backend)
    mu = max(2.0 * float((residuals[gate] ** 2).max()) / c2, 1.0)
    for _ in range(_GNC_STEPS):
        weights = np.where(gate, (mu * c2 / (residuals**2 + mu * c2)) ** 2, 0.0)
        _, residuals = stack.fit(weights, backend)
        if mu <= 1.0:
            break
        mu = max(1.0, mu / _GNC_FACTOR)
    return gate & (residuals**2 <= c2)


def _settle(stack: _Stack, mask: Mask, cutoff: float, backend: str | None) -> Mask | None:
    """Fit and select by turns until the rows no longer change; None if too few are left."""
    for _ in range(20):
        if np.sum(mask) < _FEWEST:
            return None
        _, residuals = stack.fit(mask.astype(float), backend)
        selected = np.abs(residuals) <= cutoff
        if np.array_equal(selected, mask):
            break
        mask = selected
    return mask if np.sum(mask) >= _FEWEST else None


def _proofs(
    rows: AlignmentRows, clock: ClockModel, C_ew: FloatArray, inliers: Mask,
    options: RobustOptions, priors: tuple[Prior, ...],
) -> tuple[ConsensusProof, ConsensusProof | None]:  # fmt: skip
    """Return the proof of the consensus and, where it matters, that of no opposition."""
    per_epoch = clock.kind == "per-epoch"
    weight = row_weights(rows, options.support)
    if not weight.any():
        return ConsensusProof(False, 0.0, options.radius, 0, None), None

    def prove(which: Mask, required: float, radius: float) -> ConsensusProof:
        return prove_consensus(
            rows.take(which), C_ew, required, cutoff=options.support, radius=radius,
            per_epoch=per_epoch, slack=_wander(rows, clock), max_cells=options.max_cells,
            weight=weight[which], priors=priors,
        )  # fmt: skip

    total, rejected = float(weight.sum()), float(weight[~inliers].sum())
    count = consensus(rows, C_ew, options.support, per_epoch=per_epoch, weight=weight)
    proof = prove(np.ones_like(inliers), (1.0 - options.reserve) * count, options.radius)
    if not proof.proved or rejected <= options.minority * total:
        return proof, None
    opposition = prove(~inliers, options.coherence * rejected, options.radius)
    party = (1.0 - 2.0 * options.reserve) * count
    if opposition.proved and rejected >= party:
        # Nearly as many with another clock, whatever the rotation: which side is right?
        opposition = prove(~inliers, party, _ANYWHERE)
    return proof, opposition


def _consensus_verdict(
    inliers: Mask, proof: ConsensusProof | None, opposition: ConsensusProof | None,
    options: RobustOptions,
) -> Verdict:  # fmt: skip
    share = float(np.mean(inliers))
    away = f"more than {np.degrees(options.radius):.0f}° away"
    near = f"{1.0 - options.reserve:.0%}"
    passed = share > 1.0 - options.minority if proof is None else proof.proved
    if proof is None:
        reason = "" if passed else ": too few where the nuisances admit no proof"
    elif proof.proved:
        reason = f", proved: no rotation {away} has {near} of their weight"
    elif proof.rival is not None:
        reason = f", but {near} of their weight does so with a rotation {away}"
    else:
        reason = f", not excluded that {near} of their weight does with a rotation {away}"
    if opposition is not None and not opposition.proved:
        passed = False
        other = f"a rotation {away}" if opposition.radius > _ANYWHERE else "something else"
        reason = f", but too many of those rejected may agree on {other}"
    kept = f"{int(np.sum(inliers))} of {inliers.size} rows agree"
    return Verdict("consensus", passed, share, 1.0 - options.minority, kept + reason)
