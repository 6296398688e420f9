"""Newton's method on SO(3) for f(C) = xᵀQx, x = [vec(C); 1].

Perturbation on the right, C·Exp(θ), so θ is a small rotation in local (w) axes. An interior-point
SDP stops 1e-6…1e-5° short of its own optimum; two or three Newton steps take that to the limit
of the arithmetic, eps·tr(Q)/λ_min.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...filters.rotation import FloatArray, matrix_from_rotvec, orthonormalise, skew
from .constraints import lift

_AXES: FloatArray = skew(np.eye(3))


def rotation_angle(C1: ArrayLike, C2: ArrayLike) -> FloatArray:
    """Return the angle of the rotation between C1 and C2 [rad], exact for small ones too."""
    relative = np.swapaxes(np.asarray(C1, dtype=float), -1, -2) @ np.asarray(C2, dtype=float)
    vector = relative - np.swapaxes(relative, -1, -2)
    sine = np.sqrt(np.sum(vector * vector, axis=(-1, -2)) / 8.0)
    cosine = 0.5 * (np.trace(relative, axis1=-2, axis2=-1) - 1.0)
    return np.arctan2(sine, cosine)


def tangent_basis(C: ArrayLike) -> FloatArray:
    """Return J with vec(C·Exp(θ)) = vec(C) + J θ + O(θ²), shape (9, 3)."""
    C = np.asarray(C, dtype=float)
    return np.vstack([-C @ axis for axis in _AXES])


def cost(Q: ArrayLike, C: ArrayLike) -> float:
    """Return xᵀQx at x = [vec(C); 1]."""
    x = lift(C)
    return float(x @ np.asarray(Q, dtype=float) @ x)


def cost_scale(Q: ArrayLike) -> float:
    """Return Σ|eigenvalues| of Q, its trace if semidefinite: what costs are small against."""
    return max(float(np.abs(np.linalg.eigvalsh(np.asarray(Q, dtype=float))).sum()), 1e-300)


def gradient(Q: ArrayLike, C: ArrayLike) -> FloatArray:
    """Return ∂f(C·Exp(θ))/∂θ at θ = 0, shape (3,)."""
    return 2.0 * tangent_basis(C).T @ (np.asarray(Q, dtype=float) @ lift(C))[:9]


def hessian(Q: ArrayLike, C: ArrayLike) -> FloatArray:
    """Return ∂²f(C·Exp(θ))/∂θ² at θ = 0, shape (3, 3).

    With f = χ² the covariance of θ is its inverse times two. The second term comes from the
    curvature of the group, [θ]² = θθᵀ − |θ|²I, with S = Cᵀ mat(Qx).
    """
    Q = np.asarray(Q, dtype=float)
    C = np.asarray(C, dtype=float)
    J = tangent_basis(C)
    S = C.T @ (Q @ lift(C))[:9].reshape(3, 3).T
    return 2.0 * (J.T @ Q[:9, :9] @ J) + (S + S.T) - 2.0 * np.trace(S) * np.eye(3)


@dataclass(frozen=True, eq=False)
class Minimum:
    """A local minimum on SO(3).

    Attributes
    ----------
    C : ndarray, shape (3, 3)
    cost : float
    gradient : ndarray, shape (3,)
        Should be of the order of eps·tr(Q).
    hessian : ndarray, shape (3, 3)
        In w axes; positive semidefinite.
    steps : int
    converged : bool
        False: the steps ran out first.
    """

    C: FloatArray
    cost: float
    gradient: FloatArray
    hessian: FloatArray
    steps: int
    converged: bool

    def __repr__(self) -> str:
        end = "converged" if self.converged else "not converged"
        slope = float(np.linalg.norm(self.gradient))
        return f"<Minimum {end} after {self.steps} steps: cost {self.cost:.6g}, |∂f| {slope:.1e}>"


def newton(
    Q: ArrayLike, start: ArrayLike, *, factor: ArrayLike | None = None, max_steps: int = 100
) -> Minimum:
    """Descend to the local minimum in whose basin `start` lies.

    Newton steps with the eigenvalues of the Hessian made positive, at most half a radian long,
    halved until the cost falls; away from saddles by a tenth of a radian.

    Parameters
    ----------
    Q : array_like, shape (10, 10)
        Symmetric; need not be semidefinite.
    start : array_like, shape (3, 3)
        Rotation.
    factor : array_like, shape (10, 10), optional
        With factorᵀ·factor = Q: residuals and gradient are then computed without squaring, which
        matters where the cost is nearly zero and the geometry weak.
    max_steps : int
    """
    Q = np.asarray(Q, dtype=float)
    F = None if factor is None else np.asarray(factor, dtype=float)

    def value_and_pull(C: FloatArray) -> tuple[float, FloatArray]:
        x = lift(C)
        if F is None:
            pull = Q @ x
            return float(x @ pull), pull[:9]
        residuals = F @ x
        return float(residuals @ residuals), (F.T @ residuals)[:9]

    scale = cost_scale(Q)
    C = orthonormalise(start)
    value, pull = value_and_pull(C)
    steps, previous, converged = 0, np.inf, False
    while steps < max_steps:
        slope = 2.0 * tangent_basis(C).T @ pull
        step = _newton_step(slope, hessian(Q, C), scale)
        length = float(np.linalg.norm(step))
        # Quadratic convergence ends where rounding begins: the step no longer shrinks.
        converged = length < 1e-15 or (length < 1e-5 and length > 0.5 * previous)
        if converged:
            break
        previous = length
        step *= min(1.0, 0.5 / length)
        rounding = 1e-15 * (scale if F is None else np.sqrt(scale * value) + 1e-15 * scale)
        for _ in range(30):
            trial = orthonormalise(C @ matrix_from_rotvec(step))
            trial_value, trial_pull = value_and_pull(trial)
            if trial_value <= value + 1e-4 * float(slope @ step) + rounding:
                break
            step = 0.5 * step
        C, value, pull = trial, trial_value, trial_pull
        steps += 1
    slope = 2.0 * tangent_basis(C).T @ pull
    return Minimum(C, value, slope, hessian(Q, C), steps, converged)


def _newton_step(slope: FloatArray, curvature: FloatArray, scale: float) -> FloatArray:
    """Return the descent step; directions in which f is flat to rounding are left alone."""
    values, axes = np.linalg.eigh(curvature)
    along = axes.T @ slope
    if values[0] < -1e-9 * scale and np.linalg.norm(slope) < 0.1 * np.abs(values[0]):
        # On a saddle or a maximum the slope says nothing; its own curvature leads away.
        return axes[:, 0] * (-0.1 if along[0] > 0.0 else 0.1)
    flat = (np.abs(values) < 1e-13 * scale) & (np.abs(along) < 1e-14 * scale)
    safe = np.maximum(np.abs(values), 1e-14 * scale)
    return -axes @ np.where(flat, 0.0, along / safe)
