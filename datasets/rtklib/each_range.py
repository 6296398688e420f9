"""Each pseudorange held against the others of its epoch: what an error of it does, and how large
it is.

For residuals r = ρ − h(x̂) of a weighted least-squares position, W = diag(σ⁻²), with one range off
by b, the others say (leave one out)

    b̂ = (A r)_i / A_ii,    A = W − W H (HᵀWH)⁻¹ Hᵀ W,

and the position without that range is x̂ − s_i b̂ with s_i the column of the gain (HᵀWH)⁻¹HᵀW.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...filters.rotation import FloatArray
from .point_engine import Point

#: An A_ii below this share of σ⁻² is rounding: the others cannot do without the range.
_NO_INFORMATION = 1e-9
#: Residuals smaller than σ says make σ smaller, not below this share in variance: half a metre of
#: the four that are usual, as broadcast orbits and clocks alone.
_LEAST_MISFIT = 1.0 / 64.0


class EachRange(NamedTuple):
    """The pseudoranges of one position, one by one.

    Parameters
    ----------
    gain : ndarray, shape (3, n)
        Derivative of the position (ECEF) with respect to each.
    excess : ndarray, shape (n,)
        By how much it is too long, say the others [m]; 0 where they say nothing.
    noise, lasting : ndarray, shape (n,)
        1σ of the error of that, the epoch's own and what stays for minutes [m]; infinite where
        they say nothing.
    """

    gain: FloatArray
    excess: FloatArray
    noise: FloatArray
    lasting: FloatArray


def each_range(point: Point, misfit: float) -> EachRange:
    """Return what an error of each pseudorange does to a position, and how large it is.

    Parameters
    ----------
    point : Point
    misfit : float
        chi²/dof of the residuals of the whole recording; NaN where unknown.
    """
    weight = point.sigma**-2
    whitened = point.H / point.sigma[:, None]
    gain = np.linalg.pinv(whitened)[:3] / point.sigma
    basis = np.linalg.svd(whitened, full_matrices=False)[0]
    basis = basis[:, : np.linalg.matrix_rank(whitened)]
    A = (np.eye(len(weight)) - basis @ basis.T) / np.outer(point.sigma, point.sigma)
    information = np.diag(A).copy()
    known = information > _NO_INFORMATION * weight
    excess, noise, lasting = np.zeros(len(weight)), *np.full((2, len(weight)), np.inf)
    B = A[known] / information[known, None]
    excess[known] = B @ point.residuals
    noise[known] = np.sqrt(B**2 @ point.noise**2)
    noise *= np.sqrt(_scale(point, excess, information, misfit))
    # What stays of the range itself is its own error; what stays of the others is one of b̂.
    B[np.arange(len(B)), np.flatnonzero(known)] = 0.0
    lasting[known] = np.sqrt(B**2 @ point.staying**2)
    return EachRange(gain, excess, noise, lasting)


def _scale(point: Point, excess: FloatArray, information: FloatArray, misfit: float) -> FloatArray:
    """Return the variance of the ranges without each over what σ says.

    The recording's, or that of the epoch's other residuals where it is larger.
    """
    usual = float(np.clip(np.nan_to_num(misfit, nan=1.0), _LEAST_MISFIT, 1.0))
    chi2 = float(np.sum((point.residuals / point.sigma) ** 2)) - information * excess**2
    spare = len(excess) - int(np.linalg.matrix_rank(point.H)) - 1
    here = np.maximum(chi2, 0.0) / spare if spare > 0 else np.ones(len(excess))
    return np.maximum(usual, here)
