"""Velocity and receiver clock drift from four or more Doppler measurements, with fault exclusion.

Weighted least squares of ``z = e·v_e − cδṫ_r`` (DDIA-VE eqs. (5), (6)); rows as
`range_rate.doppler_rows` makes them. A chi-square test of the residuals detects faults; excluded
are the fewest rows whose absence makes it pass, and of several such sets the best fitting.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..datasets.observations import GnssObservations
from ..filters.fault_exclusion import consistent_rows
from ..filters.rotation import FloatArray
from .range_rate import DopplerNoise, DopplerRows, doppler_rows

#: Reason given to rows that the residual test excludes.
REJECTED = "doppler residual"


def _no_vector() -> FloatArray:
    return np.full(3, np.nan)


def _no_matrix() -> FloatArray:
    return np.full((3, 3), np.nan)


def _no_rows() -> NDArray[np.int64]:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class DopplerVelocity:
    """Least-squares velocity of one epoch, with everything needed to judge it.

    Attributes
    ----------
    time : float
        GPS time [s].
    status : {'ok', 'too few satellites', 'degenerate geometry', 'inconsistent'}
        Numbers below are NaN unless 'ok'. 'inconsistent': the residual test fails and there are
        too few rows to tell which is wrong.
    vel_e : ndarray, shape (3,)
        Antenna velocity, ECEF [m/s].
    cov_e : ndarray, shape (3, 3)
        Its covariance [m²/s²], already multiplied by `variance_factor`.
    clock_drift : float
        c·δṫ_r [m/s].
    satellites : tuple of str
        Used satellites.
    row : ndarray of int
        Used rows of the observations given.
    residuals : ndarray
        z − model of the used rows [m/s].
    rejected : tuple of int
        Rows of the observations excluded for 'doppler residual'.
    dof : int
        Used rows − 4. With 0 nothing has checked the solution.
    chi2 : float
        Σ(residual/σ)².
    variance_factor : float
        max(1, chi2/dof): what the residuals say the assumed σ² lack.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import DopplerRows, doppler_velocity
    >>> e_e = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.8, 0], [0, 0.6, 0.8]])
    >>> z = e_e @ [10.0, 2.0, -1.0] - 30.0
    >>> sats = np.array(["G01", "G02", "G03", "G04", "G05"])
    >>> rows = DopplerRows(np.arange(5), sats, e_e, z, np.full(5, 0.05))
    >>> found = doppler_velocity(rows, time=0.0)
    >>> np.sqrt(np.diag(found.cov_e)).round(2)  # 1σ [m/s] of rows of 5 cm/s
    array([0.13, 0.11, 0.13])
    """

    time: float
    status: str
    vel_e: FloatArray = field(default_factory=_no_vector)
    cov_e: FloatArray = field(default_factory=_no_matrix)
    clock_drift: float = np.nan
    satellites: tuple[str, ...] = ()
    row: NDArray[np.int64] = field(default_factory=_no_rows)
    residuals: FloatArray = field(default_factory=lambda: np.zeros(0))
    rejected: tuple[int, ...] = ()
    dof: int = 0
    chi2: float = np.nan
    variance_factor: float = np.nan

    def __repr__(self) -> str:
        if not self.ok:
            return f"DopplerVelocity(t = {self.time:.3f} s, {self.status})"
        speed, sigma = np.linalg.norm(self.vel_e), np.sqrt(np.trace(self.cov_e))
        return (
            f"DopplerVelocity(t = {self.time:.3f} s, {speed:.2f} m/s ± {sigma:.2f} in space, "
            f"{len(self.satellites)} satellites, {len(self.rejected)} rejected)"
        )

    @property
    def ok(self) -> bool:
        """True if there is a velocity."""
        return self.status == "ok"


class Solution(NamedTuple):
    """Weighted least squares of one set of rows: state [v_e, cδṫ_r] and what it leaves."""

    state: FloatArray
    cov: FloatArray
    residuals: FloatArray
    chi2: float


def solve(e_e: ArrayLike, z: ArrayLike, sigma: ArrayLike, max_dop: float = 20.0) -> Solution | None:
    """Return the weighted least-squares solution, or None if the geometry is degenerate.

    Parameters
    ----------
    e_e : array_like, shape (n, 3)
        Lines of sight, receiver to satellite, n ≥ 4.
    z, sigma : array_like, shape (n,)
        Measurement and its 1σ [m/s].
    max_dop : float
        Largest velocity DOP √tr((HᵀH)⁻¹)₃ₓ₃ taken for a solution.
    """
    e_e, z, sigma = (np.asarray(a, dtype=float) for a in (e_e, z, sigma))
    H = np.column_stack([e_e, -np.ones(len(z))])
    normal = H.T @ H
    eigenvalues = np.linalg.eigvalsh(normal)
    if eigenvalues[0] <= 1e-12 * eigenvalues[-1]:
        return None
    if np.sqrt(np.trace(np.linalg.inv(normal)[:3, :3])) > max_dop:
        return None
    q, r = np.linalg.qr(H / sigma[:, None])
    r_inverse = np.linalg.inv(r)
    state = r_inverse @ (q.T @ (z / sigma))
    residuals = z - H @ state
    return Solution(
        state,
        r_inverse @ r_inverse.T,
        residuals,
        float(np.sum((residuals / sigma) ** 2)),
    )


def doppler_velocity(
    rows: DopplerRows,
    time: float,
    *,
    significance: float = 1e-3,
    max_dop: float = 20.0,
) -> DopplerVelocity:
    """Return the velocity of one epoch.

    Parameters
    ----------
    rows : DopplerRows
        All rows of the epoch.
    time : float
        GPS time [s].
    significance : float
        Probability that the test accuses fault-free rows.
    max_dop : float
        Larger velocity DOPs are 'degenerate geometry'.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import DopplerRows, doppler_velocity
    >>> e_e = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.8, 0], [0, 0.6, 0.8]])
    >>> v_e, drift = np.array([10.0, 2.0, -1.0]), 30.0
    >>> sats = np.array(["G01", "G02", "G03", "G04", "G05"])
    >>> rows = DopplerRows(np.arange(5), sats, e_e, e_e @ v_e - drift, np.full(5, 0.05))
    >>> found = doppler_velocity(rows, time=0.0)
    >>> found.status, found.vel_e.round(6), round(found.clock_drift, 6), found.dof
    ('ok', array([10.,  2., -1.]), 30.0, 1)
    """
    if len(rows) < 4:
        return DopplerVelocity(time, "too few satellites")
    H = np.column_stack([rows.e_e, -np.ones(len(rows))])
    whole = solve(rows.e_e, rows.z, rows.sigma, max_dop)
    if whole is None:
        return DopplerVelocity(time, "degenerate geometry")

    def solved(keep: NDArray[np.bool_]) -> Solution | None:
        if keep.all():
            return whole
        return solve(rows.e_e[keep], rows.z[keep], rows.sigma[keep], max_dop)

    keep = consistent_rows(
        H, rows.z, rows.sigma, significance, lambda trial: solved(trial) is not None
    )
    if keep is None:
        return DopplerVelocity(time, "inconsistent")
    solution = solved(keep)
    assert solution is not None
    return _result(rows, keep, solution, time)


def doppler_velocities(
    observations: GnssObservations,
    pos_e: ArrayLike,
    *,
    noise: DopplerNoise | None = None,
    significance: float = 1e-3,
    max_dop: float = 20.0,
) -> list[DopplerVelocity]:
    """Return one `DopplerVelocity` per epoch; `row` and `rejected` index `observations`.

    Parameters
    ----------
    observations : GnssObservations
        One signal per satellite; rejected rows take no part.
    pos_e : array_like, shape (3,) or (n, 3)
        Antenna [m], one for all or one per row; within about 100 m.
    noise : DopplerNoise, optional
    significance, max_dop : float
        As for `doppler_velocity`.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> from certnav.velocity import doppler_velocities
    >>> drive = simulate(SimulationConfig(duration=20.0, density="open", noise=False))
    >>> observations, pos_e = drive.observations, drive.reference.pos_e[0]
    >>> found = doppler_velocities(observations, pos_e)
    >>> len(found), {v.status for v in found}  # the car stands still, the signals are exact
    (21, {'ok'})
    >>> float(max(np.linalg.norm(v.vel_e) for v in found).round(2)) + 0.0
    0.0
    """
    rows = doppler_rows(observations, pos_e, noise)
    out = []
    for time, epoch in observations.epochs():
        part = slice(*np.searchsorted(rows.row, [epoch.start, epoch.stop]))
        out.append(
            doppler_velocity(rows.take(part), time, significance=significance, max_dop=max_dop)
        )
    return out


def _result(
    rows: DopplerRows, keep: NDArray[np.bool_], solution: Solution, time: float
) -> DopplerVelocity:
    dof = int(keep.sum()) - 4
    factor = max(1.0, solution.chi2 / dof) if dof else 1.0
    return DopplerVelocity(
        time=time,
        status="ok",
        vel_e=solution.state[:3],
        cov_e=factor * solution.cov[:3, :3],
        clock_drift=float(solution.state[3]),
        satellites=tuple(rows.sat[keep].tolist()),
        row=rows.row[keep],
        residuals=solution.residuals,
        rejected=tuple(map(int, rows.row[~keep])),
        dof=dof,
        chi2=solution.chi2,
        variance_factor=factor,
    )


def mark_rejected(
    observations: GnssObservations, velocities: Iterable[DopplerVelocity]
) -> GnssObservations:
    """Return the observations with the rows the velocities excluded marked 'doppler residual'."""
    mask = np.zeros(len(observations), dtype=bool)
    for velocity in velocities:
        mask[list(velocity.rejected)] = True
    return observations.mark(mask, REJECTED)
