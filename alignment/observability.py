"""Which windows can be aligned at all, from ranks that mean something under noise.

Every row is a 3×3 matrix Mᵢ, its residual tr(Mᵢᵀ C_ew) + …; M stacks vec(Mᵢ)ᵀ after clock and
nuisances are projected out. Mᵢ = e vᵀ before that, so the ranges of all Mᵢᵀ and all Mᵢ are those
of the velocities V and of the lines of sight N — those that the elimination leaves: with a free
clock at every epoch two satellites have one difference, and rank N is 1.

Lemma 1 (Song et al.): rank V ≥ 2 and rank N ≥ 2 are necessary. Where one of them is 1, a turn
about that velocity or line of sight costs nothing.
Lemma 2: rank M = 9, or generally rank V · rank N, determines C without its being a rotation.

Between the two lies what the paper's Lemma 1 misses. If rank V = rank N = 2, with k normal to all
velocities and e to all lines of sight,

    C → (I − 2eeᵀ) C (I − 2kkᵀ)

is a rotation, leaves every residual as it is, and differs from C unless Ck = ±e: planar motion
under two satellites always has two global optima, and any solver certifies either. Uniqueness
needs rank V + rank N ≥ 5.

A direction d counts as spanned if turning its sign would be noticed: that changes χ² by at most
4λ, λ = Σ|Mᵢd|²/σᵢ². Satellites move 1.8 mrad in ten seconds, which in exact arithmetic makes
every rank full.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from ..filters.rotation import FloatArray

#: χ² that a change of sign must cause to be noticed (3σ).
NOTICEABLE = 9.0


class Geometry(Enum):
    """What the ranks say."""

    LINEAR = "determined by linear equations alone (Lemma 2)"
    GENERIC = "determined, by the rotation's orthogonality (rank V + rank N ≥ 5)"
    MIRROR = "two rotations, mirror images, have the same cost (rank V = rank N = 2)"
    UNOBSERVABLE = "a continuum of rotations has the same cost (Lemma 1 fails)"

    @property
    def determined(self) -> bool:
        """Whether one rotation fits best, by more than noise."""
        return self in (Geometry.LINEAR, Geometry.GENERIC)


@dataclass(frozen=True, eq=False)
class Observability:
    """Ranks of a window, with the numbers behind them.

    Attributes
    ----------
    geometry : Geometry
    rank_v, rank_n, rank_m : int
        Dimensions spanned by velocities, lines of sight, and both together.
    strength_v, strength_n : ndarray, shape (3,)
        λ of the principal directions, descending; χ² units.
    strength_m : ndarray, shape (9,)
    threshold_v, threshold_n : float
        What λ is compared with; `threshold_v` serves M too.
    axes_v, axes_n : ndarray, shape (3, 3)
        The directions as columns, in w and e axes. The last are k and e of the mirror.
    """

    geometry: Geometry
    rank_v: int
    rank_n: int
    rank_m: int
    strength_v: FloatArray
    strength_n: FloatArray
    strength_m: FloatArray
    threshold_v: float
    threshold_n: float
    axes_v: FloatArray
    axes_n: FloatArray

    def __repr__(self) -> str:
        ranks = f"ranks {self.rank_v} of V, {self.rank_n} of N, {self.rank_m} of M"
        return f"<Observability {self.geometry.name}: {ranks}>"

    @property
    def lemma_1(self) -> bool:
        """True if velocities and lines of sight each span two dimensions: necessary."""
        return min(self.rank_v, self.rank_n) >= 2

    @property
    def lemma_2(self) -> bool:
        """True if the linear equations alone determine the rotation: sufficient."""
        return self.geometry is Geometry.LINEAR

    def mirrored(self, C_ew: ArrayLike) -> FloatArray:
        """Return (I − 2eeᵀ) C_ew (I − 2kkᵀ), the other optimum of a MIRROR geometry."""
        e, k = self.axes_n[:, 2], self.axes_v[:, 2]
        return (
            (np.eye(3) - 2.0 * np.outer(e, e))
            @ np.asarray(C_ew, dtype=float)
            @ (np.eye(3) - 2.0 * np.outer(k, k))
        )


def observability(
    Q: ArrayLike, *, vel_sigma: float = 0.0, information: float = 0.0
) -> Observability:
    """Return the ranks of a cost matrix in χ² units.

    Parameters
    ----------
    Q : array_like, shape (10, 10)
        Positive semidefinite, `AlignmentProblem.Q`.
    vel_sigma : float
        1σ per axis of the local velocity [m/s]: noise spans three dimensions, too, and is
        expected to add vel_sigma² · information to every λ of V and M.
    information : float
        `AlignmentProblem.information` [s²/m²]; needed with `vel_sigma`.
    """
    blocks = np.asarray(Q, dtype=float)[:9, :9].reshape(3, 3, 3, 3)  # [w, e, w', e']
    strength_v, axes_v = _descending(np.einsum("aibi->ab", blocks))
    strength_n, axes_n = _descending(np.einsum("aiaj->ij", blocks))
    strength_m = np.linalg.eigvalsh(blocks.reshape(9, 9))[::-1]
    floor = max(0.25 * NOTICEABLE, 1e-13 * float(strength_m.sum()))
    # Three times the expectation: the noise of ten epochs stays below, with 3σ of its own.
    noise = 3.0 * vel_sigma**2 * information
    rank_v = int(np.sum(strength_v > floor + noise))
    rank_n = int(np.sum(strength_n > floor))
    rank_m = int(np.sum(strength_m > floor + noise))
    return Observability(
        _geometry(rank_v, rank_n, rank_m), rank_v, rank_n, rank_m,
        strength_v, strength_n, strength_m, floor + noise, floor, axes_v, axes_n,
    )  # fmt: skip


def _descending(gram: FloatArray) -> tuple[FloatArray, FloatArray]:
    values, vectors = np.linalg.eigh(gram)
    return values[::-1], vectors[:, ::-1]


def _geometry(rank_v: int, rank_n: int, rank_m: int) -> Geometry:
    if min(rank_v, rank_n) < 2:
        return Geometry.UNOBSERVABLE
    if rank_v == rank_n == 2:
        return Geometry.MIRROR
    # Two dimensions on one side fix two columns (or rows) of C, and those the third.
    return Geometry.LINEAR if rank_m >= rank_v * rank_n else Geometry.GENERIC
