"""Which rows to believe: a search for the lowest truncated least squares, Σ min(rᵢ², c²).

It has many local minima. Three things find the lowest in practice: a gate that no rotation enters
(the clock must lie within |v| of −z), graduated non-convexity (Yang et al. 2020) with its two
losses, truncated and Geman–McClure, each step solved to the *global* optimum, and the best of what
these find.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..filters.errors import AlignmentError, DataError
from ..filters.rotation import FloatArray
from .priors import Prior
from .problem import ClockModel, design_matrix
from .rows import AlignmentRows
from .solver.constraints import lift
from .solver.fast_solver import fast_minimum

Mask = NDArray[np.bool_]

#: Steps of the graduation, and how fast it goes.
_GNC_STEPS, _GNC_FACTOR = 120, 1.4
#: Fewest rows that say anything about a rotation and a clock.
_FEWEST = 4


@dataclass(frozen=True, eq=False)
class RowStack:
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
    ) -> RowStack:  # fmt: skip
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
        columns = np.hstack([columns, rows.shared])
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
        shared = rows.shared.shape[1]
        believed.append(np.eye(shared, m + 10, m - shared))
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
class Selection:
    """The rows to believe.

    Attributes
    ----------
    inliers : ndarray of bool, shape (k,)
    cost : float
        Σ min(r², cutoff²) over all rows.
    method : str
        What found them.
    """

    inliers: Mask
    cost: float
    method: str

    def __repr__(self) -> str:
        kept = f"{int(self.inliers.sum())} of {self.inliers.size} rows"
        return f"<Selection {kept} by {self.method}, truncated cost {self.cost:.4g}>"


def select_rows(
    stack: RowStack,
    rows: AlignmentRows,
    clock: ClockModel,
    cutoff: float,
    *,
    free: bool = False,
    backend: str | None = None,
) -> Selection:
    """Return the rows of least truncated cost that any of the searches finds.

    Parameters
    ----------
    stack : RowStack
        Of the rows.
    rows : AlignmentRows
    clock : ClockModel
    cutoff : float
        Largest residual of an inlier, in σ.
    free : bool
        There are other unknowns than a clock, so that no gate holds.
    backend : {'numba', 'numpy'}, optional

    Raises
    ------
    AlignmentError
        If too few rows agree on anything.
    """
    everything = np.ones(len(rows), dtype=bool)
    if len(rows) < _FEWEST:
        raise AlignmentError(f"{len(rows)} rows cannot tell inliers from outliers")
    _, residuals = stack.fit(np.ones(len(rows)), backend)
    if np.all(np.abs(residuals) <= cutoff):
        return Selection(everything, float(residuals @ residuals), "all rows")
    best: Selection | None = None
    gates = [] if free else list(clock_gates(rows, clock, cutoff))
    for gate, where in ((everything, ""), *((g, "clock gate, ") for g in gates)):
        for loss in (_truncated, _geman_mcclure):
            mask = _settle(stack, loss(stack, gate, cutoff, backend), cutoff, backend)
            if mask is None:
                continue
            _, residuals = stack.fit(mask.astype(float), backend)
            cost = float(np.sum(np.minimum(residuals**2, cutoff**2)))
            if best is None or cost < best.cost - 1e-9:
                name = "truncated" if loss is _truncated else "Geman–McClure"
                best = Selection(mask, cost, f"{where}{name} least squares")
    if best is None:
        raise AlignmentError(f"no {_FEWEST} of {len(rows)} rows agree within {cutoff:g}σ")
    return best


def clock_gates(rows: AlignmentRows, clock: ClockModel, cutoff: float) -> Iterator[Mask]:
    """Yield the rows that some one clock drift leaves possible, for the most popular drifts.

    cδṫ = e·C v − z lies within |v| of −z for every rotation: intervals on a line. Several maximal
    sets are kept, since a cluster of outliers may hold the largest.
    """
    if clock.kind not in ("constant", "random-walk"):
        return
    half = np.linalg.norm(rows.vel_w, axis=1) * np.linalg.norm(rows.e_e, axis=1)
    half += cutoff * rows.sigma + clock_wander(rows, clock) + rows.reach(3.0)
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


def clock_wander(rows: AlignmentRows, clock: ClockModel) -> float:
    """Return how far a random walk gets from its middle, at 3σ [m/s]."""
    return 3.0 * (clock.q or 0.0) * float(np.sqrt(0.5 * np.ptp(rows.time)))


def _truncated(stack: RowStack, gate: Mask, cutoff: float, backend: str | None) -> Mask:
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


def _geman_mcclure(stack: RowStack, gate: Mask, cutoff: float, backend: str | None) -> Mask:
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


def _settle(stack: RowStack, mask: Mask, cutoff: float, backend: str | None) -> Mask | None:
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
