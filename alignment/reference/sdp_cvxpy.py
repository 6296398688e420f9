"""The same dual written down a second time, for cvxpy: an independent check of `sdp`.

Nothing is shared with it: the Lagrangian is built from matrix multipliers and Kronecker products
instead of a list of forms, and the modelling layer puts the cone together. Needs the extra
`cvxpy`; ten times slower.
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike

from ...filters.errors import ConfigError


def solve_dual_cvxpy(Q: ArrayLike, *, tolerance: float = 1e-10, scaled_trace: float = 1e3) -> float:
    """Return γ, the optimum of the dual with all three families of constraints.

    For vec(C) stacking columns, with Λ, M symmetric 3×3 and h₁, h₂, h₃ in R³:
    tr Λ(CᵀC − I) is the form Λ ⊗ I, tr M(CCᵀ − I) is I ⊗ M, and h_k·(cᵢ × cⱼ − cₖ) puts
    −[h_k]× between the blocks i and j.

    Parameters
    ----------
    Q : array_like, shape (10, 10)
        Symmetric.
    tolerance : float
        Gap and feasibility, at the scaled trace.
    scaled_trace : float

    Raises
    ------
    ConfigError
        If cvxpy is not installed.
    """
    try:
        import cvxpy as cp
    except ImportError as error:
        raise ConfigError("the cross-check needs cvxpy — pip install 'certnav[cvxpy]'") from error
    Q = np.asarray(Q, dtype=float)
    scale = float(np.abs(np.linalg.eigvalsh(Q)).sum()) / scaled_trace
    gamma = cp.Variable()
    by_columns, by_rows = cp.Variable((3, 3), symmetric=True), cp.Variable((3, 3), symmetric=True)
    hand = cp.Variable((3, 3))  # column k belongs to cᵢ × cⱼ = cₖ, (i, j, k) cyclic
    crossed = [_cross(cp, hand[:, k]) for k in range(3)]
    zero = np.zeros((3, 3))
    # h·(cᵢ × cⱼ) = cᵢᵀ (cⱼ × h) = −cᵢᵀ [h]× cⱼ, half of it on either side of the diagonal.
    couplings = cp.bmat(
        [
            [zero, -0.5 * crossed[2], -0.5 * crossed[1].T],
            [-0.5 * crossed[2].T, zero, -0.5 * crossed[0]],
            [-0.5 * crossed[1], -0.5 * crossed[0].T, zero],
        ]
    )
    square = cp.kron(by_columns, np.eye(3)) + cp.kron(np.eye(3), by_rows) + couplings
    linear = -0.5 * cp.reshape(hand, (9, 1), order="F")
    corner = cp.reshape(-cp.trace(by_columns) - cp.trace(by_rows) - gamma, (1, 1), order="F")
    H = Q / scale + cp.bmat([[square, linear], [linear.T, corner]])
    problem = cp.Problem(cp.Maximize(gamma), [0.5 * (H + H.T) >> 0])
    with warnings.catch_warnings():
        # 'optimal_inaccurate' at a gap of 1e-13: the status says as little here as in `sdp`.
        warnings.filterwarnings("ignore", message="Solution may be inaccurate")
        problem.solve(
            solver=cp.CLARABEL, tol_gap_abs=tolerance, tol_gap_rel=tolerance, tol_feas=tolerance
        )
    return float(gamma.value) * scale


def _cross(cp, h):
    """Return [h]× of a cvxpy vector."""
    return cp.bmat([[0.0, -h[2], h[1]], [h[2], 0.0, -h[0]], [-h[1], h[0], 0.0]])
