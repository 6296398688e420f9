"""Unknowns that nobody asked for, taken out of rows by orthogonal transformations alone."""

from __future__ import annotations

import numpy as np
import scipy  # scipy.linalg is slow to import: left until it is used
from numpy.typing import ArrayLike

from ...filters.rotation import FloatArray


def eliminated(stack: FloatArray, m: int) -> tuple[FloatArray, FloatArray, int]:
    """Return the first m unknowns in terms of the others, what is left for these, and the rank.

    Parameters
    ----------
    stack : ndarray, shape (k, m + 10)
        Rows of unit variance, ``stack @ [unknowns; x] ≈ 0``.
    m : int

    Returns
    -------
    unknowns : ndarray, shape (m, 10)
        As functions of x.
    factor : ndarray, shape (10, 10)
        Upper triangular.
    rank : int
        Of the first m columns.
    """
    factor = np.zeros((10, 10))
    triangle = np.asarray(np.linalg.qr(stack, mode="r"), dtype=float)
    size = np.sqrt(np.sum(triangle[:, :m] ** 2, axis=0))
    pivot = np.abs(np.diagonal(triangle))[:m]
    if pivot.size == m and np.all(pivot > 1e-9 * size):
        left = triangle[m:, m:]
        factor[: len(left)] = left
        inverse, _ = scipy.linalg.lapack.dtrtri(triangle[:m, :m])
        return -inverse @ triangle[:m, m:], factor, m
    # Some unknowns say the same as others.
    projected, rank = project_out(stack[:, m:], stack[:, :m])
    left = np.asarray(np.linalg.qr(projected, mode="r"), dtype=float)
    factor[: len(left)] = left
    found = np.linalg.lstsq(stack[:, :m], stack[:, m:], rcond=1e-12)[0]
    return -np.asarray(found, dtype=float), factor, rank


def project_out(matrix: ArrayLike, columns: ArrayLike) -> tuple[FloatArray, int]:
    """Return `matrix` orthogonal to `columns`, and the rank of those.

    The projection is applied twice: once leaves eps times the part removed, which for a clock of
    1e6 m/s is more than the residuals.

    Parameters
    ----------
    matrix : array_like, shape (k, p)
    columns : array_like, shape (k, m)
        May be dependent.
    """
    left = np.asarray(matrix, dtype=float)
    basis = _orthonormal_basis(np.asarray(columns, dtype=float))
    for _ in range(2):
        left = left - basis @ (basis.T @ left)
    return left, basis.shape[1]


def _orthonormal_basis(columns: FloatArray) -> FloatArray:
    size = np.linalg.norm(columns, axis=0)
    columns = columns[:, size > 0.0] / size[size > 0.0]
    if columns.size == 0:
        return np.zeros((columns.shape[0], 0))
    q, r, _ = scipy.linalg.qr(columns, mode="economic", pivoting=True, check_finite=False)
    diagonal = np.abs(np.diag(r))
    return q[:, : int(np.sum(diagonal > 1e-12 * diagonal[0]))]
