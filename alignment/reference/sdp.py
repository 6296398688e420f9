"""The Lagrangian dual of the alignment problem as a semidefinite program, through clarabel.

    maximise γ  subject to  H = Q − γJ + Σ λₖAₖ ⪰ 0             (Song et al., problem (D))

Every rotation satisfies xᵀAₖx = 0 and xᵀJx = 1, so γ is a lower bound of the cost whatever the
multipliers are. The cone's dual variable is the moment matrix Z, [xxᵀ] of the optimum where the
relaxation is tight; both come from one solve. The dual form is the one to use: the primal one
takes ten times the time through a modelling layer and loses four digits.

Tolerances of an interior-point solver are absolute and the cost of a noise-free window is zero,
so Q is scaled to tr Q = 1000 first; with tr Q = 1 the rotation is a hundred times worse. The
solver then often says `AlmostSolved` at a gap of 1e-13: its status is no certificate
(`alignment.proofs.certificate` is).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import clarabel
import numpy as np
import scipy.sparse
from numpy.typing import ArrayLike

from ...filters.errors import AlignmentError
from ...filters.rotation import FloatArray, orthonormalise
from ..solver.constraints import ALL, HOMOGENEOUS, constraint_matrices
from ..solver.refinement import cost_scale

#: Trace that Q is scaled to, and gap and feasibility tolerances at that scale.
SCALED_TRACE = 1e3
TOLERANCE = 1e-10

#: Upper triangle, column by column, off-diagonals times √2: clarabel's PSD triangle cone.
_COLUMN, _ROW = np.tril_indices(10)
_WEIGHT = np.where(_ROW == _COLUMN, 1.0, np.sqrt(2.0))


@dataclass(frozen=True, eq=False)
class DualSolution:
    """What the solver returns, in the units of Q.

    Attributes
    ----------
    dual_cost : float
        γ; a lower bound only as far as the Lagrangian at these multipliers is semidefinite.
    primal_cost : float
        tr(QZ).
    multipliers : ndarray, shape (m,)
        λ, in the order of `constraint_matrices(families)`.
    families : tuple of str
    H : ndarray, shape (10, 10)
        Q − γJ + Σ λₖAₖ as the solver holds it, its slack: inside the cone, and equal to
        `alignment.solver.constraints.lagrangian` up to the feasibility tolerance.
    Z : ndarray, shape (10, 10)
        Moment matrix, Z[9, 9] ≈ 1.
    iterations : int
    status : str
        The solver's own word, for the log only.
    """

    dual_cost: float
    primal_cost: float
    multipliers: FloatArray
    families: tuple[str, ...]
    H: FloatArray
    Z: FloatArray
    iterations: int
    status: str

    def __repr__(self) -> str:
        return (
            f"<DualSolution {self.status} after {self.iterations} iterations: dual "
            f"{self.dual_cost:.6g}, primal {self.primal_cost:.6g}>"
        )


class _Cone(NamedTuple):
    """The constant part of the program: A, P, q of clarabel's form, and the settings."""

    A: scipy.sparse.csc_matrix
    P: scipy.sparse.csc_matrix
    q: FloatArray
    settings: clarabel.DefaultSettings


def _svec(matrix: FloatArray) -> FloatArray:
    return matrix[..., _ROW, _COLUMN] * _WEIGHT


def _smat(vector: ArrayLike) -> FloatArray:
    matrix = np.zeros((10, 10))
    matrix[_ROW, _COLUMN] = np.asarray(vector, dtype=float) / _WEIGHT
    matrix[_COLUMN, _ROW] = matrix[_ROW, _COLUMN]
    return matrix


@lru_cache(maxsize=16)
def _cone(families: tuple[str, ...], tolerance: float) -> _Cone:
    """Return A and q of: minimise −γ subject to A[γ; λ] + svec(H) = svec(Q), H ⪰ 0."""
    A = np.vstack([_svec(HOMOGENEOUS), -_svec(constraint_matrices(families))]).T
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 100
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    settings.tol_ktratio = 1e-9
    # All forms are of unit size already; equilibration costs a digit where geometry is weak.
    settings.equilibrate_enable = False
    settings.presolve_enable = False
    settings.chordal_decomposition_enable = False
    m = A.shape[1]
    q = np.append(-1.0, np.zeros(m - 1))
    return _Cone(scipy.sparse.csc_matrix(A), scipy.sparse.csc_matrix((m, m)), q, settings)


def solve_dual(
    Q: ArrayLike,
    families: Collection[str] = ALL,
    *,
    scaled_trace: float | None = SCALED_TRACE,
    tolerance: float = TOLERANCE,
) -> DualSolution:
    """Solve the dual for a cost matrix.

    Parameters
    ----------
    Q : array_like, shape (10, 10)
        Symmetric.
    families : collection of str
        Constraints to relax, see `constraint_matrices`.
    scaled_trace : float or None
        Sum of |eigenvalues| that Q is scaled to; None solves it as it is.
    tolerance : float
        Absolute and relative gap and feasibility.

    Raises
    ------
    AlignmentError
        If the solver returns nothing finite.
    """
    Q = np.asarray(Q, dtype=float)
    scale = 1.0 if scaled_trace is None else cost_scale(Q) / scaled_trace
    key = tuple(f for f in ALL if f in families) if set(families) <= set(ALL) else tuple(families)
    cone = _cone(key, tolerance)
    solution = clarabel.DefaultSolver(
        cone.P, cone.q, cone.A, _svec(Q / scale), [clarabel.PSDTriangleConeT(10)], cone.settings
    ).solve()
    x, z = np.array(solution.x), np.array(solution.z)
    if not (np.isfinite(x).all() and np.isfinite(z).all()):
        raise AlignmentError(f"the semidefinite solver failed ({solution.status}): cost not finite")
    Z = _smat(z)
    return DualSolution(
        x[0] * scale, float(np.sum(Q * Z)), x[1:] * scale, key, scale * _smat(solution.s), Z,
        int(solution.iterations), str(solution.status),
    )  # fmt: skip


def rotations_from_moments(Z: ArrayLike) -> FloatArray:
    """Return rotations that the moment matrix suggests, shape (4, 3, 3).

    The first comes from its rank-one part. Where two optima x, y share the minimum the solver
    returns their mean, Z = (xxᵀ + yyᵀ)/2, whose leading eigenvector lies half-way, on the saddle
    between them; x and y are then the sum and difference of its two leading square roots, which
    are the other two rotations. Half a turn apart, x and y are orthogonal and may be the
    eigenvectors themselves: the second is the last rotation.
    """
    values, vectors = np.linalg.eigh(np.asarray(Z, dtype=float))
    leading, second = (vectors[:, -2:] * np.sqrt(np.maximum(values[-2:], 0.0))).T[::-1]
    candidates = np.stack([leading, leading + second, leading - second, second])
    candidates[candidates[:, 9] < 0.0] *= -1.0
    return orthonormalise(np.swapaxes(candidates[:, :9].reshape(-1, 3, 3), -1, -2))
