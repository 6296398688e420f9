"""Alignment when part of the Doppler rows is wrong: which rows to believe.

The rows that agree are searched for (`alignment.row_selection`). What is left to chance there is
then asked of `alignment.proofs.consensus_proof`: whether another rotation could have as many rows
on its side. Where that cannot be excluded the result does not pass, whatever its own rows say
about it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..filters.errors import ConfigError
from ..filters.rotation import FloatArray
from .priors import Prior
from .problem import ClockModel
from .proofs.consensus_proof import ConsensusProof, prove_consensus, row_weights
from .result import AlignmentResult, Ask, Verdict
from .row_selection import Mask, RowStack, clock_wander, select_rows
from .rows import AlignmentRows
from .verdict import VerdictLimits, align

#: Parts of the range of an error that rows share, at most.
_PARTS = 8
#: Radius that excludes nothing [rad].
_ANYWHERE = 1e-3
#: Rows of a part from which a drift of its own costs little: of four, chance unites one or two.
_MANY = 4


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
        (1 − 2·reserve) times as many, if they are more than a minority.
    radius : float
        'Others' are those further away than this [rad]: another answer, where what is nearer
        belongs to the basin that the bound is about. A slow vehicle's rows leave four fifths of a
        consensus to headings 30° away.
    minority, coherence : float
        If the rows rejected are more than this share of all, by weight, no other rotation may
        explain this share of them: rows that agree with each other are a second opinion, not
        noise. If 40 % of the rows are right, and a third of those agrees with a wrong rotation by
        chance, the truth is among the rejected with 0.27 of all.
    unproved : float
        The share of rows that may be rejected where nuisances admit no proof.
    max_cells : int
        Where branch and bound gives up.

    Examples
    --------
    >>> from certnav.alignment import RobustOptions
    >>> RobustOptions().cutoff, RobustOptions(cutoff=5.0).cutoff  # [σ]
    (3.5, 5.0)
    """

    cutoff: float = 3.5
    support: float = 2.0
    reserve: float = 0.2
    radius: float = float(np.radians(40.0))
    minority: float = 0.27
    coherence: float = 0.7
    unproved: float = 0.2
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
        Of the inliers; where rows were rejected, CONSENSUS is among its verdicts.
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

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import align_robust
    >>> from certnav.alignment.reference import simulate_window
    >>> rng = np.random.default_rng(7)
    >>> window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05)
    >>> rows = window.rows
    >>> rows.z[:8] += 20.0  # two epochs of reflections
    >>> found = align_robust(rows)
    >>> found.result.passed, int((~found.inliers).sum())
    (True, 8)
    """

    result: AlignmentResult
    inliers: Mask
    truncated_cost: float
    method: str
    proof: ConsensusProof | None
    opposition: ConsensusProof | None = None

    def __repr__(self) -> str:
        kept = f"{int(self.inliers.sum())} of {self.inliers.size} rows"
        return f"<RobustAlignment {kept} by {self.method}: {self.result!r}>"

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

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import align_robust
    >>> from certnav.alignment.reference import simulate_window
    >>> rng = np.random.default_rng(7)
    >>> window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05)
    >>> rows = window.rows
    >>> rows.z[:8] += 20.0  # two epochs of reflections
    >>> found = align_robust(rows)
    >>> found.result.passed, int((~found.inliers).sum())
    (True, 8)
    """
    clock, options, priors = clock or ClockModel(), options or RobustOptions(), tuple(priors)
    original, rows = rows, rows.correlated(correlated)
    options = options.correlated(correlated)
    stack = RowStack.of(rows, clock, nuisance, priors)
    found = select_rows(
        stack, rows, clock, options.cutoff, free=nuisance is not None, backend=backend
    )
    result = align(
        original.take(found.inliers), clock,
        nuisance=None if nuisance is None else np.asarray(nuisance, dtype=float)[found.inliers],
        priors=priors, correlated=correlated, limits=limits, vel_sigma=vel_sigma, backend=backend,
    )  # fmt: skip
    proof, opposition = None, None
    if not found.inliers.all():
        if nuisance is None and clock.kind != "linear":
            _, residuals = stack.fit(found.inliers.astype(float), backend)
            agreeing = _Found(found.inliers, np.abs(residuals) <= options.support)
            proof, opposition = _proofs(rows, clock, result.C_ew, agreeing, options, priors)
        verdict = _consensus_verdict(found.inliers, proof, opposition, options)
        result = result.asked_further(verdict)
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
    stack = RowStack.of(rows, clock, None, tuple(priors))
    found = select_rows(stack, rows, clock, options.cutoff, backend=backend)
    C_ew, residuals = stack.fit(found.inliers.astype(float), backend)
    return C_ew, residuals * rows.sigma


def _proofs(
    rows: AlignmentRows, clock: ClockModel, C_ew: FloatArray, found: _Found,
    options: RobustOptions, priors: tuple[Prior, ...],
) -> tuple[ConsensusProof, ConsensusProof | None]:  # fmt: skip
    """Return the proof of the consensus and, where it matters, that of no opposition."""
    proof = ConsensusProof(False, 0.0, options.radius, 0, None)
    for shared in _sharings(rows, clock, options):
        weight = row_weights(rows, options.support, shared.slack)
        if not weight.any():
            continue

        def prove(
            which: Mask, required: float, radius: float,
            shared: _Shared = shared, weight: FloatArray = weight,
        ) -> ConsensusProof:  # fmt: skip
            for part, reach in _parts(rows, options.support):
                proof = prove_consensus(
                    part.take(which), C_ew, required, cutoff=options.support, radius=radius,
                    parts=shared.parts[which], slack=shared.slack + reach[which],
                    max_cells=options.max_cells, weight=weight[which], priors=priors,
                )  # fmt: skip
                if not proof.proved:
                    break
            return proof

        total, rejected = float(weight.sum()), float(weight[~found.inliers].sum())
        count = float(weight[found.supporting].sum())
        if not count:
            continue
        proof = prove(np.ones_like(found.inliers), (1.0 - options.reserve) * count, options.radius)
        if not proof.proved and proof.rival is not None:
            continue  # a rival by the drifts allowed here; the other way allows less
        if not proof.proved:
            return proof, None
        if rejected <= options.minority * total:
            return proof, None
        # Some with another rotation, or nearly as many with another clock: which side is right?
        party = min(options.coherence * rejected, (1.0 - 2.0 * options.reserve) * count)
        return proof, prove(~found.inliers, party, _ANYWHERE)
    return proof, None


@dataclass(frozen=True, eq=False)
class _Found:
    """Rows believed, and rows near enough to support the rotation with the clock it has."""

    inliers: Mask
    supporting: Mask


@dataclass(frozen=True, eq=False)
class _Shared:
    """Which rows are taken to share a clock drift, and how far it may wander among them."""

    parts: NDArray[np.int64]
    slack: float


def _sharings(rows: AlignmentRows, clock: ClockModel, options: RobustOptions) -> list[_Shared]:
    """Return the ways to eliminate the clock in a proof: any of them bounds every rotation's rows.

    One drift for the whole window gives a rotation all that a walk may add, to every row. Parts
    so short that the walk adds no more than the noise have a drift of their own each, which costs
    less where satellites are many. The one more likely to succeed comes first.
    """
    if clock.kind == "per-epoch":
        return [_Shared(rows.epoch, 0.0)]
    span, wander = float(np.ptp(rows.time)), clock_wander(rows, clock)
    whole = _Shared(np.zeros(len(rows), dtype=np.int64), wander)
    noise = options.support * float(np.median(rows.sigma))
    # The wander grows with the root of time.
    number = int(np.ceil((wander / noise) ** 2))
    if number < 2:
        return [whole]
    place = np.floor((rows.time - rows.time.min()) * (number / (span * (1.0 + 1e-9))))
    _, parts = np.unique(place, return_inverse=True)
    longest = max(float(np.ptp(rows.time[parts == part])) for part in range(parts.max() + 1))
    short = _Shared(parts, wander * float(np.sqrt(longest / span)))
    many = len(rows) >= _MANY * (int(parts.max()) + 1)
    return [short, whole] if many else [whole, short]


def _parts(rows: AlignmentRows, support: float) -> list[tuple[AlignmentRows, FloatArray]]:
    """Return the rows for parts of the range of what they share, and how far that moves each.

    ±3σ, whatever the rotation. The largest of these errors is taken in parts of the size of what a
    row may be off by: together they are what it may be, and none is as wide.
    """
    shared = rows.shared
    if not shared.shape[1]:
        return [(rows, np.zeros(len(rows)))]
    apart = 3.0 * np.abs(shared - shared.mean(axis=0))
    largest = int(np.argmax(apart.max(axis=0)))
    widest = float(apart[:, largest].max()) / (0.25 * support * float(np.median(rows.sigma)))
    count = int(np.clip(np.ceil(widest), 1, _PARTS))
    reach = np.sqrt(np.sum(np.delete(apart, largest, axis=1) ** 2, axis=1))
    reach += apart[:, largest] / count
    middles = 3.0 * (2.0 * np.arange(count) + 1.0 - count) / count
    return [(replace(rows, z=rows.z - u * shared[:, largest]), reach) for u in middles]


def _consensus_verdict(
    inliers: Mask, proof: ConsensusProof | None, opposition: ConsensusProof | None,
    options: RobustOptions,
) -> Verdict:  # fmt: skip
    share = float(np.mean(inliers))
    away = f"more than {np.degrees(options.radius):.0f}° away"
    near = f"{1.0 - options.reserve:.0%}"
    least = 1.0 - (options.unproved if proof is None else options.minority)
    passed = share > least if proof is None else proof.proved
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
    return Verdict(Ask.CONSENSUS, passed, share, least, kept + reason)
