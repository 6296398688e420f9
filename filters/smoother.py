"""Fixed-interval smoothing of the closed-loop error-state filter (Rauch, Tung, Striebel).

The filter feeds every estimated error back and starts again from zero, so the usual recursion
changes its look: with e the smoothed error of the *fed-back* state,

    over an update that fed back dx:   e ← dx ⊕ e
    over a prediction P⁺ → P⁻ by Φ:    A = P⁺ Φᵀ (P⁻)⁻¹,  e ← A e,  P ← P⁺ + A (P − P⁻) Aᵀ

run from the end of the data, where e is zero and P the filter's own. filterpy's smoothers know
neither feedback nor an EKF (rlabbe/filterpy#317), which is why this one is ours.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .compiled import rows as layout
from .error_model import ACCEL_BIAS, ATT, GYRO_BIAS, POS, VEL
from .rotation import FloatArray, matrix_from_rotvec

_NO_COVARIANCE = np.empty(0)


class Tape:
    """What the filter did, in order: predictions, corrections, and rows that were recorded."""

    def __init__(self) -> None:
        self.entries: list[tuple[FloatArray, ...]] = []

    def predict(self, before: FloatArray, phi: FloatArray, after: FloatArray) -> None:
        """Covariance before, transition matrix, covariance after."""
        self.entries.append((before, phi, after))

    def correct(self, dx: FloatArray) -> None:
        """Error that was fed back."""
        self.entries.append((dx.copy(),))

    def row(self, row: FloatArray) -> None:
        """Recorded row, as it was before any correction at its time."""
        self.entries.append((row.copy(), _NO_COVARIANCE))


def smooth(tape: Tape, P: FloatArray) -> FloatArray:
    """Return the recorded rows smoothed, laid out as the filter's.

    Parameters
    ----------
    tape : Tape
        Of a filter run with ``smoothing=True``.
    P : ndarray, shape (n, n)
        The filter's covariance at the end.

    Returns
    -------
    ndarray, shape (m, ROW_SIZE)
        Covariances and bias σ are those of the smoother.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import C_en_of, ErrorModel, ErrorStateFilter, InertialStream, NavState
    >>> from certnav.filters import gravity_e, imu_preset, lla_to_ecef, smooth
    >>> from certnav.filters.measurements import position
    >>> pos_e, still = lla_to_ecef(0.5, 2.0, 30.0), np.ones((1001, 1))
    >>> C_eb = C_en_of(pos_e)  # level, heading north, ten seconds at rest
    >>> gyro_b, accel_b = C_eb.T @ [0.0, 0.0, 7.292115e-5], -C_eb.T @ gravity_e(pos_e)
    >>> stream = InertialStream(0.01 * np.arange(1001), still * gyro_b, still * accel_b)
    >>> model = ErrorModel(imu_preset("adis16470"))
    >>> P = model.initial_covariance(25.0 * np.eye(3), 0.01 * np.eye(3), 1e-4 * np.eye(3))
    >>> start = NavState(0.0, pos_e + [3.0, 0.0, 0.0], np.zeros(3), C_eb)  # 3 m wrong
    >>> ekf = ErrorStateFilter(model, stream, start, P, smoothing=True)
    >>> for second in range(1, 11):
    ...     ekf.propagate(float(second))
    ...     _ = ekf.update(position(ekf.state, model.size, pos_e, np.eye(3), np.zeros(3)))
    ...
    >>> rows = smooth(ekf.tape, ekf.P)  # and how far the first is off, filtered and smoothed
    >>> print(*(f"{np.linalg.norm(r[0, 1:4] - pos_e):.2f} m" for r in (ekf.rows, rows)))
    3.00 m 0.04 m
    """
    e, P = np.zeros(P.shape[0]), P.copy()
    rows = []
    for entry in reversed(tape.entries):
        if len(entry) == 3:
            before, phi, after = entry
            gain = _gain(before, phi, after)
            e = gain @ e
            P = before + gain @ (P - after) @ gain.T
            P = 0.5 * (P + P.T)
        elif len(entry) == 1:
            e = _compose(entry[0], e)
        else:
            rows.append(_corrected(entry[0], e, P))
    return np.array(rows[::-1])


#: Later data whose position is so many times less certain than that of the earlier ones have none
#: to speak of: their share in the information, 1σ thirty times as large.
_SHARE = 1e-3


class Separation(NamedTuple):
    """What earlier and later data say of the position, against both together.

    Parameters
    ----------
    time : ndarray, shape (m,)
        [s].
    pos_e : ndarray, shape (m, 3)
        Smoothed [m].
    forward_e, backward_e : ndarray, shape (m, 3)
        Position from the data before an epoch alone, less the smoothed one; likewise from what the
        data from it on add to that, NaN where they do not know it in all directions [m], ECEF.
    chi2 : ndarray, shape (m,)
        Square of what is between the two, over its covariance: χ² of three degrees of freedom if
        σ is right; NaN as before.
    """

    time: FloatArray
    pos_e: FloatArray
    forward_e: FloatArray
    backward_e: FloatArray
    chi2: FloatArray


def separation(tape: Tape, smoothed: FloatArray) -> Separation:
    """Return forward and backward against combined positions.

    The smoothed position is the mean of two independent ones weighted by their information: the
    filter's, x_f with P_f, and what the later data make of it, x_b with P_b⁻¹ = P_s⁻¹ − P_f⁻¹:

        x_b − x_f = P_f (P_f − P_s)⁻¹ (x_s − x_f),   P_f + P_b = P_f (P_f − P_s)⁻¹ P_f.

    Parameters
    ----------
    tape : Tape
    smoothed : ndarray, shape (m, ROW_SIZE)
        `smooth` of it.
    """
    forward = np.array([entry[0] for entry in tape.entries if len(entry) == 2])
    place = slice(layout.ROW_POS, layout.ROW_POS + 3)
    step = smoothed[:, place] - forward[:, place]
    root = np.linalg.cholesky(_position_covariance(forward))
    inverse = np.linalg.inv(root)
    left = inverse @ _position_covariance(smoothed) @ np.swapaxes(inverse, 1, 2)
    # In units of the filter's σ, along axes in which both are independent.
    value, axes = np.linalg.eigh(np.eye(3) - left)
    known = value[:, 0] > _SHARE
    value = np.where(known[:, None], value, np.nan)
    y = np.einsum("mji,mjk,mk->mi", axes, inverse, step)
    between = np.einsum("mij,mjk,mk->mi", root, axes, y / value)
    chi2 = np.sum(y**2 / value, axis=1)
    return Separation(smoothed[:, layout.ROW_TIME], smoothed[:, place], -step, between - step, chi2)


def _position_covariance(rows: FloatArray) -> FloatArray:
    xx, xy, xz, yy, yz, zz = rows[:, layout.ROW_COV : layout.ROW_COV + 6].T
    return np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], axis=-1).reshape(-1, 3, 3)


def _gain(before: FloatArray, phi: FloatArray, after: FloatArray) -> FloatArray:
    """Return P⁺Φᵀ(P⁻)⁻¹, solved in units of each state's own σ: they span ten decades."""
    sigma = np.sqrt(np.diag(after))
    scaled = after / np.outer(sigma, sigma)
    right = (phi @ before) / sigma[:, None]
    return np.linalg.solve(scaled, right).T / sigma


def _compose(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the error that does what `first` and then `second` do."""
    from scipy.spatial.transform import Rotation  # slow to import

    total = first + second
    turn = matrix_from_rotvec(first[ATT]) @ matrix_from_rotvec(second[ATT])
    total[ATT] = Rotation.from_matrix(turn).as_rotvec()
    return total


def _corrected(row: FloatArray, e: FloatArray, P: FloatArray) -> FloatArray:
    """Return a copy of the row with the error applied and the covariance replaced."""
    out = row.copy()
    pos_e = row[layout.ROW_POS : layout.ROW_POS + 3] + e[POS]
    vel_e = row[layout.ROW_VEL : layout.ROW_VEL + 3] + e[VEL]
    C_eb = row[layout.ROW_C : layout.ROW_C + 9].reshape(3, 3) @ matrix_from_rotvec(e[ATT])
    bias = row[layout.ROW_BIAS : layout.ROW_BIAS + 6].copy()
    bias[:3] += e[GYRO_BIAS]
    bias[3:] += e[ACCEL_BIAS]
    layout.record(out, row[layout.ROW_TIME], pos_e, vel_e, C_eb, bias, P)
    return out
