"""The methods the certifiable one is compared with.

VOBA, velocity-based: a Doppler velocity at every epoch with four or more satellites, then the
rotation between the two sets of velocities by an SVD. Gauss–Newton: the rows themselves, as in
the initialisation of GVINS but with all three angles free, from a start that has to be good.
Neither says when it is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...filters.errors import AlignmentError
from ...filters.rotation import FloatArray, matrix_from_rotvec, orthonormalise
from ...velocity.least_squares import solve
from ..problem import AlignmentProblem
from ..rows import AlignmentRows
from ..solver.constraints import lift
from ..solver.refinement import tangent_basis


@dataclass(frozen=True, eq=False)
class BaselineRotation:
    """A rotation without a certificate.

    Attributes
    ----------
    C_ew : ndarray, shape (3, 3)
    converged : bool
        Gauss–Newton: the last step was small. VOBA: always.
    used : int
        Epochs (VOBA) or iterations (Gauss–Newton).
    """

    C_ew: FloatArray
    converged: bool
    used: int

    def __repr__(self) -> str:
        return f"<BaselineRotation {'' if self.converged else 'not '}converged, {self.used} used>"


def voba(rows: AlignmentRows) -> BaselineRotation:
    """Align the velocities of single epochs: min Σ |v_e − C_ew v_w|².

    Raises
    ------
    AlignmentError
        If fewer than two epochs have a Doppler velocity, or all velocities are parallel.
    """
    vel_e, vel_w = [], []
    for epoch in np.unique(rows.epoch):
        here = np.flatnonzero(rows.epoch == epoch)
        solution = None
        if here.size >= 4:
            solution = solve(rows.e_e[here], rows.z[here], rows.sigma[here], max_dop=np.inf)
        if solution is not None:
            vel_e.append(solution.state[:3])
            vel_w.append(rows.vel_w[here[0]])
    if len(vel_e) < 2:
        raise AlignmentError(
            f"VOBA: {len(vel_e)} epoch(s) with a velocity from four satellites, 2 are needed — "
            "use the certifiable alignment"
        )
    attitude_profile = np.array(vel_e).T @ np.array(vel_w)
    strength = np.linalg.svd(attitude_profile, compute_uv=False)
    if strength[1] <= 1e-9 * strength[0]:
        raise AlignmentError("VOBA: all velocities are parallel — the window needs a turn")
    return BaselineRotation(orthonormalise(attitude_profile), True, len(vel_e))


def gauss_newton(
    problem: AlignmentProblem,
    start: ArrayLike | None = None,
    *,
    max_steps: int = 20,
    tolerance: float = 1e-6,
) -> BaselineRotation:
    """Iterate undamped Gauss–Newton steps on SO(3).

    The clock enters linearly and starts anywhere: estimating it along, as GVINS does, gives the
    same rotations step by step as having it eliminated.

    Parameters
    ----------
    problem : AlignmentProblem
    start : array_like, shape (3, 3), optional
        Default: identity.
    max_steps : int
    tolerance : float
        Length of the step that ends it [rad]. Both defaults are those of Song et al.'s code.
    """
    C = np.eye(3) if start is None else orthonormalise(start)
    for step_number in range(1, max_steps + 1):
        jacobian = problem.factor[:, :9] @ tangent_basis(C)
        step = -np.linalg.lstsq(jacobian, problem.factor @ lift(C), rcond=None)[0]
        C = orthonormalise(C @ matrix_from_rotvec(step))
        if np.linalg.norm(step) < tolerance:
            return BaselineRotation(C, True, step_number)
    return BaselineRotation(C, False, max_steps)
