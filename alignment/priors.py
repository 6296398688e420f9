"""What else is known of the attitude, as rows of the same problem.

A direction known in both frames, C_ew a_w ≈ a_e, is linear in C like a Doppler row. The vertical
removes the mirror that planar motion has under two satellites, and makes even one satellite
usable; a heading decides among what is left.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..filters.errors import ConfigError, DataError
from ..filters.rotation import FloatArray
from .problem import AlignmentProblem

#: 1σ of the part of a heading prior that tells forwards from backwards (a direction cosine, which
#: pitch and a slope of the road change as well).
_FORWARD_SIGMA = 0.1


@dataclass(frozen=True, eq=False)
class Prior:
    """Rows of unit variance, independent of clock and start velocity.

    Attributes
    ----------
    name : str
        For the log.
    rows : ndarray, shape (p, 10)
        ``rows @ x`` is the normalised residual, x = [vec(C_ew); 1].
    dof : int
        Angles it determines; what it adds to the degrees of freedom.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import Prior
    >>> from certnav.filters import C_en_of, lla_to_ecef, matrix_from_rpy
    >>> C_en = C_en_of(lla_to_ecef(0.5, 2.0, 30.0))
    >>> C_ew = C_en @ matrix_from_rpy([0.0, 0.0, 1.2])  # level, heading 1.2 rad
    >>> x = np.append(C_ew.ravel(order="F"), 1.0)
    >>> prior = Prior("nothing known", np.zeros((1, 10)), dof=0)
    >>> prior.rows @ x
    array([0.])
    """

    name: str
    rows: FloatArray
    dof: int

    def __repr__(self) -> str:
        return f"<Prior '{self.name}', {self.dof} dof>"


def up_prior(up_w: ArrayLike, C_en: ArrayLike, sigma: float) -> Prior:
    """Return the prior of a known vertical.

    Parameters
    ----------
    up_w : array_like, shape (3,)
        Upwards in local axes, of any length: the specific force of a standstill.
    C_en : array_like, shape (3, 3)
        NED axes to ECEF at the place.
    sigma : float
        1σ per axis of the direction [rad].

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import up_prior
    >>> from certnav.filters import C_en_of, lla_to_ecef, matrix_from_rpy
    >>> C_en = C_en_of(lla_to_ecef(0.5, 2.0, 30.0))
    >>> C_ew = C_en @ matrix_from_rpy([0.0, 0.0, 1.2])  # level, heading 1.2 rad
    >>> x = np.append(C_ew.ravel(order="F"), 1.0)
    >>> prior = up_prior([0.0, 0.0, -9.8], C_en, sigma=0.03)  # specific force at rest
    >>> np.abs(prior.rows @ x).round(6), prior.dof  # normalised residuals
    (array([0., 0., 0.]), 2)
    """
    up_w, up_e = _direction("up_w", up_w), -np.asarray(C_en, dtype=float)[:, 2]
    _check_sigma("up prior", sigma)
    return Prior("up", _rows(np.eye(3), up_w, up_e) / sigma, 2)


def heading_prior(direction_w: ArrayLike, heading: float, C_en: ArrayLike, sigma: float) -> Prior:
    """Return the prior of a known heading or course.

    Parameters
    ----------
    direction_w : array_like, shape (3,)
        In local axes, nearly level, of any length: the forward axis for a heading, the velocity
        for a course.
    heading : float
        Clockwise from north [rad].
    C_en : array_like, shape (3, 3)
        NED axes to ECEF at the place.
    sigma : float
        1σ [rad].

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import heading_prior
    >>> from certnav.filters import C_en_of, lla_to_ecef, matrix_from_rpy
    >>> C_en = C_en_of(lla_to_ecef(0.5, 2.0, 30.0))
    >>> C_ew = C_en @ matrix_from_rpy([0.0, 0.0, 1.2])  # level, heading 1.2 rad
    >>> x = np.append(C_ew.ravel(order="F"), 1.0)
    >>> prior = heading_prior([1.0, 0.0, 0.0], 1.2, C_en, sigma=0.02)
    >>> np.abs(prior.rows @ x).round(9), prior.dof  # normalised residual
    (array([0., 0.]), 1)
    """
    direction_w, C_en = _direction("direction_w", direction_w), np.asarray(C_en, dtype=float)
    _check_sigma("heading prior", sigma)
    north, east = C_en[:, 0], C_en[:, 1]
    forward = np.cos(heading) * north + np.sin(heading) * east
    right = np.cos(heading) * east - np.sin(heading) * north
    weights = np.diag([1.0 / sigma, 1.0 / float(np.hypot(sigma, _FORWARD_SIGMA))])
    return Prior("heading", weights @ _rows(np.stack([right, forward]), direction_w, forward), 1)


def with_priors(problem: AlignmentProblem, priors: Iterable[Prior]) -> AlignmentProblem:
    """Return the problem with the priors' rows added.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import build_problem, up_prior, with_priors
    >>> from certnav.alignment.reference import simulate_window
    >>> rng = np.random.default_rng(7)
    >>> window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05)
    >>> problem = build_problem(window.rows)
    >>> up_w = -window.C_ew.T[:, 2]  # the z axis of ECEF: any will do
    >>> more = with_priors(problem, [up_prior(up_w, np.eye(3), sigma=0.03)])
    >>> more.dof - problem.dof
    2
    """
    priors = tuple(priors)
    if not priors:
        return problem
    stacked = np.vstack([problem.factor, *(p.rows for p in priors)])
    factor = np.asarray(np.linalg.qr(stacked, mode="r"), dtype=float)
    return replace(
        problem, Q=factor.T @ factor, factor=factor, dof=problem.dof + sum(p.dof for p in priors)
    )


def _rows(axes_e: FloatArray, a_w: FloatArray, a_e: FloatArray) -> FloatArray:
    """Return the rows of axes_e @ (C_ew a_w − a_e)."""
    return np.hstack([np.kron(a_w, axes_e), -(axes_e @ a_e)[:, None]])


def _direction(name: str, value: ArrayLike) -> FloatArray:
    vector = np.asarray(value, dtype=float)
    length = float(np.linalg.norm(vector))
    if vector.shape != (3,) or not (0.0 < length < np.inf):
        raise DataError(f"prior {name}: expected a direction, found {vector.tolist()}")
    return vector / length


def _check_sigma(name: str, sigma: float) -> None:
    if not 0.0 < sigma < np.inf:
        raise ConfigError(f"{name}: expected σ > 0 in rad, found {sigma!r}")
