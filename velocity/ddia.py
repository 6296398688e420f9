"""Velocity from fewer than four satellites: the attitude tells the direction, Doppler the speed.

A road vehicle moves where it points. With the attitude known, the antenna's velocity has one
unknown left, the signed forward speed s at the point the wheels constrain:

    v_e = s·u_e + swing_e,    u_e = C_eb C_bv (1, 0, 0)ᵀ,    swing_e = C_eb (ω_eb^b × l_b)

and each Doppler equation ``z = e·v_e − cδṫ_r`` of `range_rate` becomes one in [s, cδṫ_r].
NDIA-VE solves one of them with the drift known, DDIA-VE (eqs. (7)–(20)) two of them by their
difference, and weighted least squares any number; for two it *is* eq. (20), for more it equals
the optimally weighted mean of all pairs. s is signed, and nothing here divides by speed: reversing
and standing still need no special case.

An error φ' of the attitude used (estimated = (I + [φ'×]) true) turns u_e and swing_e together. With
g the estimator's gain on z and E the lines of sight it shifts the velocity by

    δv = (I − u gᵀE)(φ' × v),    δs = −gᵀE (φ' × v)

and a sideways velocity v_⟂ that the constraint ignores by −(I − u gᵀE) v_⟂.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..datasets.observations import GnssObservations
from ..filters.errors import ConfigError
from ..filters.fault_exclusion import consistent_rows
from ..filters.rotation import FloatArray, skew
from .aided_velocity import AidedVelocity
from .range_rate import DopplerNoise, DopplerRows, doppler_rows
from .vehicle_motion import ForwardMotion

#: |SDV·RMD| below which the paper calls a pair singular.
SINGULAR_K = 0.05


class DriftFree(NamedTuple):
    """Doppler equations without the receiver clock: ``z = e_e @ v_e``, covariance `cov`."""

    z: FloatArray
    e_e: FloatArray
    cov: FloatArray

    def __repr__(self) -> str:
        return f"DriftFree({len(self.z)} differences)"


class _Estimate(NamedTuple):
    """Speed and drift from the rows used, before what the attitude adds to them.

    `gain` is d(speed)/dz; the rest is named as in `AidedVelocity`, without a variance factor.
    """

    rows: DopplerRows
    speed: float
    gain: FloatArray
    sigma_doppler: float
    clock_drift: float
    sigma_clock_drift: float
    k: float
    residuals: FloatArray
    rejected: tuple[int, ...] = ()
    dof: int = 0


def drift_free(rows: DopplerRows) -> DriftFree:
    """Return n − 1 equations in velocity that the receiver clock has no part in.

    Row k is satellite k + 1 minus the first one: ``v_AB = e_AB·v_e``, eq. (14). As a filter
    update they need neither a division by k nor the vehicle constraint; which satellite is
    subtracted makes no difference as long as `cov`, which is not diagonal, is used.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import DopplerRows, drift_free
    >>> e_e = np.array([[0.8, 0.0, 0.6], [-0.6, 0.0, 0.8]])  # two satellites, ahead and behind
    >>> z = e_e @ [10.0, 0.0, 0.0] - 30.0
    >>> rows = DopplerRows(np.arange(2), np.array(["G01", "G02"]), e_e, z, np.full(2, 0.05))
    >>> free = drift_free(rows)
    >>> (free.e_e @ [10.0, 0.0, 0.0] - free.z).round(9) + 0.0  # the clock has no part in it
    array([0.])
    """
    if len(rows) < 2:
        raise ConfigError(f"between-satellite differences: expected ≥ 2 rows, found {len(rows)}")
    n = len(rows) - 1
    return DriftFree(
        rows.z[1:] - rows.z[0],
        rows.e_e[1:] - rows.e_e[0],
        np.diag(rows.sigma[1:] ** 2) + np.full((n, n), rows.sigma[0] ** 2),
    )


def ndia_velocity(
    rows: DopplerRows,
    motion: ForwardMotion,
    time: float,
    clock_drift: float,
    sigma_clock_drift: float,
    *,
    min_k: float = SINGULAR_K,
) -> AidedVelocity:
    """Return the velocity from one satellite, the receiver's drift being known (NDIA-VE).

    Parameters
    ----------
    rows : DopplerRows
        One row.
    motion : ForwardMotion
        Of this epoch.
    time : float
        GPS time [s].
    clock_drift, sigma_clock_drift : float
        c·δṫ_r and its 1σ [m/s], from the last epoch that observed it.
    min_k : float
        Smallest |e·u|.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import DopplerRows, ForwardMotion, ndia_velocity
    >>> motion = ForwardMotion([1.0, 0.0, 0.0], [0.0, 0.0, 0.0], 1e-5 * np.eye(3))
    >>> e_e, z = np.array([[0.8, 0.0, 0.6]]), np.array([8.0 - 30.0])  # one satellite
    >>> rows = DopplerRows(np.arange(1), np.array(["G01"]), e_e, z, np.array([0.05]))
    >>> found = ndia_velocity(rows, motion, time=0.0, clock_drift=30.0, sigma_clock_drift=0.02)
    >>> round(found.speed, 6), round(found.k, 2)
    (10.0, 0.8)
    """
    if len(rows) != 1:
        raise ConfigError(f"NDIA-VE: expected one satellite, found {len(rows)}")
    h = rows.e_e @ motion.u_e
    if not abs(h[0]) > min_k:
        return AidedVelocity(time, "singular geometry")
    y = rows.z - rows.e_e @ motion.swing_e
    sigma = np.hypot(rows.sigma[0], sigma_clock_drift)
    found = _Estimate(
        rows,
        speed=float((y[0] + clock_drift) / h[0]),
        gain=1.0 / h,
        sigma_doppler=sigma / abs(h[0]),
        clock_drift=clock_drift,
        sigma_clock_drift=sigma_clock_drift,
        k=abs(h[0]),
        residuals=np.zeros(1),
    )
    return _velocity(found, motion, time)


def ddia_pair(
    rows: DopplerRows, motion: ForwardMotion, time: float, *, min_k: float = SINGULAR_K
) -> AidedVelocity:
    """Return the velocity from two satellites as the paper writes it (DDIA-VE, eqs. (7)–(20)).

    Parameters
    ----------
    rows : DopplerRows
        Two rows; their order does not matter.
    motion : ForwardMotion
        Of this epoch.
    time : float
        GPS time [s].
    min_k : float
        Pairs with |SDV·RMD| up to this are 'singular geometry'.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import DopplerRows, ForwardMotion, ddia_pair
    >>> e_e = np.array([[0.8, 0.0, 0.6], [-0.6, 0.0, 0.8]])  # two satellites, ahead and behind
    >>> motion = ForwardMotion([1.0, 0.0, 0.0], [0.0, 0.0, 0.0], 1e-5 * np.eye(3))
    >>> z = e_e @ [10.0, 0.0, 0.0] - 30.0  # 10 m/s forward, clock drift 30 m/s
    >>> rows = DopplerRows(np.arange(2), np.array(["G01", "G02"]), e_e, z, np.full(2, 0.05))
    >>> pair = ddia_pair(rows, motion, time=0.0)
    >>> round(pair.speed, 6), round(pair.sigma_doppler, 4), round(0.05 * 2**0.5 / pair.k, 4)
    (10.0, 0.0505, 0.0505)
    """
    if len(rows) != 2:
        raise ConfigError(f"DDIA-VE pair: expected two satellites, found {len(rows)}")
    e_AB = rows.e_e[0] - rows.e_e[1]  # (13): κ, common drift coefficient, is in e_e
    along = float(e_AB @ motion.u_e)
    if not abs(along) > min_k:
        return AidedVelocity(time, "singular geometry")
    v_AB = rows.z[0] - rows.z[1]  # (14)
    speed = float(v_AB - e_AB @ motion.swing_e) / along  # (20), lever arm taken off
    gain = np.array([1.0, -1.0]) / along
    h = rows.e_e @ motion.u_e
    y = rows.z - rows.e_e @ motion.swing_e
    weight = rows.sigma**-2 / np.sum(rows.sigma**-2)
    sigma_drift = np.sqrt(np.sum(((weight @ h) * gain - weight) ** 2 * rows.sigma**2))
    found = _Estimate(
        rows,
        speed=speed,
        gain=gain,
        sigma_doppler=float(np.hypot(*rows.sigma)) / abs(along),
        clock_drift=float(weight @ (h * speed - y)),
        sigma_clock_drift=float(sigma_drift),
        k=abs(along),
        residuals=np.zeros(2),
    )
    return _velocity(found, motion, time)


def ddia_velocity(
    rows: DopplerRows,
    motion: ForwardMotion,
    time: float,
    *,
    min_k: float = SINGULAR_K,
    significance: float = 1e-3,
) -> AidedVelocity:
    """Return the weighted least-squares velocity from two or more satellites.

    State [s, cδṫ_r]. For two rows identical to `ddia_pair`.

    Parameters
    ----------
    rows : DopplerRows
        All usable rows of the epoch, one signal per satellite.
    motion : ForwardMotion
        Of this epoch.
    time : float
        GPS time [s].
    min_k : float
        Geometry worse than that of a pair with this |SDV·RMD| is 'singular geometry'.
    significance : float
        Probability that the residual test (three rows or more) accuses fault-free rows.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import DopplerRows, ForwardMotion, ddia_velocity
    >>> e_e = np.array([[0.8, 0.0, 0.6], [-0.6, 0.0, 0.8]])  # two satellites, ahead and behind
    >>> motion = ForwardMotion([1.0, 0.0, 0.0], [0.0, 0.0, 0.0], 1e-5 * np.eye(3))
    >>> z = e_e @ [10.0, 0.0, 0.0] - 30.0  # 10 m/s forward, clock drift 30 m/s
    >>> rows = DopplerRows(np.arange(2), np.array(["G01", "G02"]), e_e, z, np.full(2, 0.05))
    >>> found = ddia_velocity(rows, motion, time=0.0)
    >>> found.status, round(found.speed, 6), round(found.clock_drift, 6), round(found.k, 2)
    ('ok', 10.0, 30.0, 1.4)
    """
    if len(rows) < 2:
        return AidedVelocity(time, "too few satellites")
    h = rows.e_e @ motion.u_e
    y = rows.z - rows.e_e @ motion.swing_e

    def strong(keep: NDArray[np.bool_]) -> bool:
        return bool(keep.sum() >= 2 and _equivalent_k(h[keep], rows.sigma[keep]) > min_k)

    everything = np.ones(len(rows), dtype=bool)
    if not strong(everything):
        return AidedVelocity(time, "singular geometry")
    keep: NDArray[np.bool_] | None = everything
    if len(rows) > 2:
        H = np.column_stack([h, -np.ones(len(rows))])
        keep = consistent_rows(H, y, rows.sigma, significance, strong)
    if keep is None:
        return AidedVelocity(time, "inconsistent")
    used, h, y = rows.take(keep), h[keep], y[keep]
    weight = used.sigma**-2 / np.sum(used.sigma**-2)
    centred = h - weight @ h
    spread = np.sum(weight * centred**2)
    gain = weight * centred / spread
    speed = float(gain @ y)
    drift = float(weight @ (h * speed - y))
    drift_gain = (weight @ h) * gain - weight
    found = _Estimate(
        used,
        speed=speed,
        gain=gain,
        sigma_doppler=float(np.linalg.norm(gain * used.sigma)),
        clock_drift=drift,
        sigma_clock_drift=float(np.linalg.norm(drift_gain * used.sigma)),
        k=_equivalent_k(h, used.sigma),
        residuals=y - h * speed + drift,
        rejected=tuple(map(int, rows.row[~keep])),
        dof=len(used) - 2,
    )
    return _velocity(found, motion, time)


def ddia_velocities(
    observations: GnssObservations,
    pos_e: ArrayLike,
    motion: ForwardMotion,
    *,
    noise: DopplerNoise | None = None,
    min_k: float = SINGULAR_K,
    significance: float = 1e-3,
) -> list[AidedVelocity]:
    """Return one `AidedVelocity` per epoch; `row` and `rejected` index `observations`.

    Parameters
    ----------
    observations : GnssObservations
        One signal per satellite; rejected rows take no part.
    pos_e : array_like, shape (3,) or (n, 3)
        Antenna [m], one for all or one per row.
    motion : ForwardMotion
        One entry per epoch, in the order of `observations.epochs`.
    noise : DopplerNoise, optional
    min_k, significance : float
        As for `ddia_velocity`.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> from certnav.velocity import ddia_velocities, forward_motion
    >>> drive = simulate(SimulationConfig(duration=20.0, density="open", noise=False))
    >>> observations, pos_e = drive.observations, drive.reference.pos_e[0]
    >>> time = np.array([time for time, _ in observations.epochs()])
    >>> C_eb = drive.trajectory.kinematics(time).C_eb
    >>> motion = forward_motion(C_eb, np.zeros((len(time), 3)), drive.calibration.lever_antenna_b)
    >>> found = ddia_velocities(observations, pos_e, motion)
    >>> {v.status for v in found}, max(abs(round(v.speed, 2)) for v in found)  # it stands still
    ({'ok'}, 0.0)
    """
    rows = doppler_rows(observations, pos_e, noise)
    out = []
    for number, (time, epoch) in enumerate(observations.epochs()):
        part = slice(*np.searchsorted(rows.row, [epoch.start, epoch.stop]))
        out.append(
            ddia_velocity(
                rows.take(part), motion.take(number), time, min_k=min_k, significance=significance
            )
        )
    return out


def _equivalent_k(h: FloatArray, sigma: FloatArray) -> float:
    """Return √2·σ_rms/σ_s: |SDV·RMD| for a pair."""
    weight = sigma**-2
    centred = h - weight @ h / weight.sum()
    return float(np.sqrt(2.0 * np.mean(sigma**2) * np.sum(weight * centred**2)))


def _velocity(found: _Estimate, motion: ForwardMotion, time: float) -> AidedVelocity:
    """Return the antenna's velocity along the vehicle, and what attitude and noise do to it."""
    chi2 = float(np.sum((found.residuals / found.rows.sigma) ** 2))
    factor = max(1.0, chi2 / found.dof) if found.dof else 1.0
    u = motion.u_e
    vel_e = found.speed * u + motion.swing_e
    seen = found.gain @ found.rows.e_e
    project = np.eye(3) - np.outer(u, seen)
    attitude_e = -project @ skew(vel_e)
    across = project @ (np.eye(3) - np.outer(u, u)) @ project.T
    noise_cov = factor * found.sigma_doppler**2 * np.outer(u, u) + motion.sigma_cross**2 * across
    turned = seen @ skew(vel_e)
    return AidedVelocity(
        time=time,
        status="ok",
        speed=found.speed,
        sigma_doppler=float(np.sqrt(factor) * found.sigma_doppler),
        sigma_attitude=float(np.sqrt(turned @ motion.att_cov_e @ turned)),
        clock_drift=found.clock_drift,
        sigma_clock_drift=float(np.sqrt(factor) * found.sigma_clock_drift),
        vel_e=vel_e,
        noise_cov_e=noise_cov,
        cov_e=noise_cov + attitude_e @ motion.att_cov_e @ attitude_e.T,
        attitude_e=attitude_e,
        swing_e=project,
        k=float(found.k),
        satellites=tuple(map(str, found.rows.sat)),
        row=found.rows.row,
        residuals=found.residuals,
        rejected=found.rejected,
        dof=found.dof,
        chi2=chi2,
        variance_factor=factor,
    )
