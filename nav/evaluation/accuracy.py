"""How good a solution is: its errors against a reference, and whether its covariance is honest.

The solution is interpolated to the reference's epochs, carried to the reference's own point and
frame, and compared there in north-east-down. Errors are *solution − reference*. The reference is
never interpolated and the solution never extrapolated: a reference epoch before the first or
after the last solution epoch, or in a hole of the solution, is left out and counted.

A constant rotation between the reference's body axes and the IMU's (two boxes are never bolted
down parallel) is estimated as the mean rotation and reported apart; roll, pitch and heading
errors are given both raw and with it removed. Removing it also hides a constant error of the
filter, so the raw figures stay the headline.

Consistency: `nees_position_mean` is the mean of eᵀP⁻¹e, 3 degrees of freedom, 3 when the
covariance is right (the reference counts as exact). `nis_mean` is the mean of NIS divided by its
degrees of freedom over the updates that passed the gate: 1 when model and noise are right. What
the gate threw out is reported with the gate; in a mean it would drown everything else.
"""

from __future__ import annotations

import math
from collections.abc import Sequence as Listing
from dataclasses import dataclass

import numpy as np

from ...datasets.sequence import Sequence
from ...datasets.series import ImuData, Reference
from ...filters.earth import C_en_of, ecef_to_lla
from ...filters.errors import DataError
from ...filters.levers import lever_velocity, rate_over_earth
from ...filters.rotation import (
    FloatArray,
    matrix_from_rpy,
    orthonormalise,
    rpy_from_matrix,
    wrap_angle,
)
from ..solution import Solution, Trajectory, Update
from .interpolation import covered, interpolate

#: Error figures every evaluation has; None where the reference does not tell.
METRICS = (
    "horizontal_rms_m", "horizontal_p50_m", "horizontal_p95_m", "horizontal_max_m",
    "up_rms_m", "position_3d_rms_m", "velocity_3d_rms_mps",
    "roll_rms_deg", "pitch_rms_deg", "heading_rms_deg",
    "roll_rms_after_misalignment_deg", "pitch_rms_after_misalignment_deg",
    "heading_rms_after_misalignment_deg",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors of a solution at the reference's epochs; all arrays empty without a reference.

    Parameters
    ----------
    metrics : dict
        The figures of `METRICS` [m, m/s, deg]; None where there is nothing to compare with.
    consistency : dict
        'nees_position_mean' and 'nis_mean' (see the module), None where not computable.
    time : ndarray, shape (m,)
        GPS time of the compared reference epochs [s].
    ref_lla : ndarray, shape (m, 3)
        Reference point: latitude, longitude [rad], ellipsoidal height [m].
    error_pos_n, error_vel_n : ndarray, shape (m, 3)
        Solution − reference at the reference point, north-east-down [m], [m/s].
    error_rpy, error_rpy_aligned : ndarray, shape (m, 3)
        Solution − reference of roll, pitch, heading [rad] in [−π, π), raw and with the constant
        misalignment removed. NaN where the reference has none.
    sigma_pos_n, sigma_vel_n, sigma_rpy : ndarray, shape (m, 3)
        The filter's 1σ of the same (of the IMU's position and velocity: the lever arm's share
        of the attitude uncertainty is not added).
    nees_position : ndarray, shape (m,)
    misalignment_rpy : ndarray, shape (3,)
        The rotation removed, as roll, pitch, heading of the solution's axes seen from the
        reference's [rad]; NaN where not estimated.
    left_out : int
        Reference epochs the solution does not cover.
    source, point : str
        What made the reference, and which point of the vehicle it follows.

    Examples
    --------
    >>> from certnav.nav.evaluation.accuracy import without_reference
    >>> without_reference().has_reference, without_reference().metrics["horizontal_rms_m"]
    (False, None)
    """

    metrics: dict[str, float | None]
    consistency: dict[str, float | None]
    time: FloatArray
    ref_lla: FloatArray
    error_pos_n: FloatArray
    error_vel_n: FloatArray
    error_rpy: FloatArray
    error_rpy_aligned: FloatArray
    sigma_pos_n: FloatArray
    sigma_vel_n: FloatArray
    sigma_rpy: FloatArray
    nees_position: FloatArray
    misalignment_rpy: FloatArray
    left_out: int = 0
    source: str = ""
    point: str = ""

    @property
    def has_reference(self) -> bool:
        """Whether there was anything to compare with."""
        return self.time.size > 0


def evaluate(solution: Solution, sequence: Sequence, *, max_gap: float = 1.0) -> Evaluation:
    """Compare `solution` with the reference of `sequence`, and test its consistency.

    Parameters
    ----------
    solution : Solution
    sequence : Sequence
        Its reference, its mounting `C_bv` (for a reference attitude of the vehicle) and its
        gyro (for the velocity of the lever arm) are used.
    max_gap : float
        The solution is not interpolated over steps longer than this [s], unless its usual
        step is longer itself (then 1.5 usual steps).

    Returns
    -------
    Evaluation
        Without errors (metrics None) when the sequence has no reference.

    Raises
    ------
    DataError
        If there is a reference but the solution covers none of its epochs.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, load
    >>> from certnav.datasets.great.writer import simulate_folder
    >>> from certnav.nav import Config, evaluate, navigate
    >>> folder = simulate_folder(SimulationConfig("city", duration=90.0, density="open"), "city")
    >>> sequence = load(folder)
    >>> solution = navigate(sequence, Config())
    >>> evaluate(solution, sequence).metrics["horizontal_rms_m"] < 3.0  # [m]
    True
    """
    if sequence.reference is None:
        return without_reference(normalised_nis(solution.updates))
    return against(
        solution, sequence.reference, sequence.calibration.C_bv, sequence.imu, max_gap=max_gap
    )


def against(
    solution: Solution,
    reference: Reference,
    C_bv: FloatArray,
    imu: ImuData | None = None,
    *,
    max_gap: float = 1.0,
) -> Evaluation:
    """Compare `solution` with a reference; what `evaluate` does.

    Parameters
    ----------
    solution : Solution
    reference : Reference
    C_bv : ndarray, shape (3, 3)
        Mounting, for a reference attitude of the vehicle.
    imu : ImuData, optional
        Without it the velocity of a reference point away from the IMU is not compared.
    max_gap : float
        As for `evaluate`.

    Raises
    ------
    DataError
        If the solution covers no epoch of the reference.
    """
    nis_mean = normalised_nis(solution.updates)
    keep = covered(solution.trajectory.time, reference.time, max_gap)
    if not keep.any():
        raise _no_overlap(solution, reference)
    time, ref_pos_e = reference.time[keep], reference.pos_e[keep]
    at = interpolate(solution.trajectory, time)
    C_ne_ref = np.swapaxes(C_en_of(ref_pos_e), 1, 2)

    error_pos_n = _rotate(C_ne_ref, at.pos_e + at.C_eb @ reference.lever_b - ref_pos_e)
    vel_e = at.vel_e + _lever_velocity_e(at, imu, reference.lever_b)
    error_vel_n = _rotate(C_ne_ref, vel_e - reference.vel_e[keep])

    C_nb = C_ne_ref @ at.C_eb  # the same north for both: their meridians converge
    if reference.attitude_frame == "v":
        C_nb = C_nb @ C_bv
    error_rpy = wrap_angle(rpy_from_matrix(C_nb) - reference.rpy[keep])
    aligned, misalignment_rpy = remove_misalignment(C_nb, reference.rpy[keep])

    nees = _nees(error_pos_n, at.cov_pos_n)
    return Evaluation(
        metrics=errors_of(error_pos_n, error_vel_n, error_rpy, aligned),
        consistency={"nees_position_mean": _mean(nees), "nis_mean": nis_mean},
        time=time,
        ref_lla=ecef_to_lla(ref_pos_e),
        error_pos_n=error_pos_n,
        error_vel_n=error_vel_n,
        error_rpy=error_rpy,
        error_rpy_aligned=aligned,
        sigma_pos_n=standard_deviation(at.cov_pos_n),
        sigma_vel_n=standard_deviation(at.cov_vel_n),
        sigma_rpy=standard_deviation(rpy_covariance(at.cov_att_n, rpy_from_matrix(C_nb))),
        nees_position=nees,
        misalignment_rpy=misalignment_rpy,
        left_out=int((~keep).sum()),
        source=reference.source,
        point=reference.point,
    )


def without_reference(nis_mean: float | None = None) -> Evaluation:
    """Return the evaluation of a run that has nothing to be compared with."""
    none, three = np.zeros(0), np.zeros((0, 3))
    return Evaluation(
        dict.fromkeys(METRICS), {"nees_position_mean": None, "nis_mean": nis_mean}, none,
        three, three, three, three, three, three, three, three, none, np.full(3, np.nan),
    )  # fmt: skip


def mean_rate_b(imu: ImuData, time: FloatArray, window: float = 0.1) -> FloatArray:
    """Return ω_ib^b averaged over `window` [s] around each `time`, shape (m, 3) [rad/s].

    Near the ends of the IMU data the window is what is left of it; NaN outside. The average
    keeps vibration out; attitude differences would instead turn every filter update into a
    burst of angular rate.
    """
    edges = np.concatenate([[imu.time[0] - imu.interval], imu.time])
    angle = np.zeros((edges.size, 3))
    np.cumsum(imu.gyro_b * np.diff(edges)[:, None], axis=0, out=angle[1:])
    low, high = (np.clip(time + half, edges[0], edges[-1]) for half in (-window / 2, window / 2))
    turned = [np.interp(high, edges, a) - np.interp(low, edges, a) for a in angle.T]
    with np.errstate(invalid="ignore", divide="ignore"):
        rate: FloatArray = np.stack(turned, axis=-1) / (high - low)[:, None]
    return rate


def _lever_velocity_e(at: Trajectory, imu: ImuData | None, lever_b: FloatArray) -> FloatArray:
    """Return C_eb (ω_eb^b × lever_b) [m/s], shape (m, 3); NaN where the rate is not known."""
    if not lever_b.any():
        return np.zeros_like(at.vel_e)
    if imu is None:
        return np.full_like(at.vel_e, np.nan)
    rate_b = rate_over_earth(at.C_eb, mean_rate_b(imu, at.time) - at.gyro_bias)
    return lever_velocity(at.C_eb, rate_b, lever_b)


def rpy_covariance(cov_att_n: FloatArray, rpy: FloatArray) -> FloatArray:
    """Return the covariance of roll, pitch, heading from that of the NED attitude error vector.

    First order in the error, exact in the attitude (pitch away from ±90°), the inverse of
    φ_n = R_z(ψ) R_y(θ) e_x δroll + R_z(ψ) e_y δpitch + e_z δheading.

    Parameters
    ----------
    cov_att_n : ndarray, shape (n, 3, 3)
        [rad²].
    rpy : ndarray, shape (n, 3)
        [rad].
    """
    jacobian = rpy_from_attitude_vector(rpy)
    return jacobian @ cov_att_n @ np.swapaxes(jacobian, 1, 2)


def rpy_from_attitude_vector(rpy: FloatArray) -> FloatArray:
    """Return the inverse of `attitude_vector_from_rpy`, shape (n, 3, 3)."""
    _, pitch, heading = rpy.T
    north, east = np.cos(heading) / np.cos(pitch), np.sin(heading) / np.cos(pitch)
    out = np.zeros((len(rpy), 3, 3))
    out[:, 0, 0], out[:, 0, 1] = north, east
    out[:, 1, 0], out[:, 1, 1] = -np.sin(heading), np.cos(heading)
    out[:, 2, 0], out[:, 2, 1], out[:, 2, 2] = np.sin(pitch) * north, np.sin(pitch) * east, 1.0
    return out


def attitude_vector_from_rpy(rpy: FloatArray) -> FloatArray:
    """Return the matrix from small (roll, pitch, heading) to the NED attitude error vector."""
    _, pitch, heading = rpy.T
    zero, one = np.zeros_like(pitch), np.ones_like(pitch)
    rows = [
        [np.cos(pitch) * np.cos(heading), -np.sin(heading), zero],
        [np.cos(pitch) * np.sin(heading), np.cos(heading), zero],
        [-np.sin(pitch), zero, one],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def remove_misalignment(C_nb: FloatArray, ref_rpy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the roll, pitch, heading errors without their constant part, and that part.

    With a full reference attitude the constant part is the mean rotation M of C_nb_refᵀ C_nb
    (nearest rotation to the mean matrix), and C_nb Mᵀ is compared. With heading alone it is the
    circular mean of the heading error.

    Parameters
    ----------
    C_nb : ndarray, shape (m, 3, 3)
        Attitude of the solution.
    ref_rpy : ndarray, shape (m, 3)
        Reference roll, pitch, heading [rad], NaN where unknown.

    Returns
    -------
    error_rpy : ndarray, shape (m, 3)
        [rad].
    misalignment_rpy : ndarray, shape (3,)
        [rad], NaN where not estimated.
    """
    full = np.isfinite(ref_rpy).all(axis=1)
    if full.any():
        C_ref = matrix_from_rpy(ref_rpy[full])
        M = orthonormalise((np.swapaxes(C_ref, 1, 2) @ C_nb[full]).mean(axis=0))
        return wrap_angle(rpy_from_matrix(C_nb @ M.T) - ref_rpy), rpy_from_matrix(M)
    error = wrap_angle(rpy_from_matrix(C_nb) - ref_rpy)
    misalignment = np.full(3, np.nan)
    known = np.isfinite(error[:, 2])
    if known.any():
        misalignment[2] = np.angle(np.exp(1j * error[known, 2]).mean())
        error[:, 2] = wrap_angle(error[:, 2] - misalignment[2])
    return error, misalignment


def normalised_nis(updates: Listing[Update], kind: str | None = None) -> float | None:
    """Return the mean of NIS / degrees of freedom over the updates that passed the gate.

    Parameters
    ----------
    updates : sequence of Update
    kind : str, optional
        Only updates of this kind.
    """
    ratios = [
        u.nis / len(u.whitened)
        for u in updates
        if u.accepted and not u.reason and math.isfinite(u.nis) and kind in (None, u.kind)
    ]
    return float(np.mean(ratios)) if ratios else None


def standard_deviation(cov: FloatArray) -> FloatArray:
    """Return the 1σ of a stack of covariances, shape (n, 3)."""
    return np.sqrt(np.clip(np.diagonal(cov, axis1=1, axis2=2), 0.0, None))


def _rotate(C: FloatArray, vectors: FloatArray) -> FloatArray:
    return (C @ vectors[:, :, None])[:, :, 0]


def _nees(error: FloatArray, cov: FloatArray) -> FloatArray:
    nees = np.full(len(error), np.nan)
    regular = np.asarray(np.isfinite(cov).all(axis=(1, 2)))
    regular[regular] = np.linalg.det(cov[regular]) > 0.0
    weighted = np.linalg.solve(cov[regular], error[regular][:, :, None])[:, :, 0]
    nees[regular] = np.sum(error[regular] * weighted, axis=1)
    return nees


def _mean(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None


def _rms(values: FloatArray) -> float | None:
    mean = _mean(np.square(values))
    return None if mean is None else float(np.sqrt(mean))


def errors_of(
    pos_n: FloatArray, vel_n: FloatArray, rpy: FloatArray, aligned: FloatArray
) -> dict[str, float | None]:
    """Return the figures of `METRICS` of errors as an `Evaluation` has them."""
    horizontal = np.hypot(pos_n[:, 0], pos_n[:, 1])
    p50, p95 = (float(p) for p in np.percentile(horizontal, [50, 95]))
    values = [
        _rms(horizontal), p50, p95, float(horizontal.max()),
        _rms(pos_n[:, 2]), _rms(np.linalg.norm(pos_n, axis=1)), _rms(np.linalg.norm(vel_n, axis=1)),
        *(_rms(np.rad2deg(column)) for column in rpy.T),
        *(_rms(np.rad2deg(column)) for column in aligned.T),
    ]  # fmt: skip
    return dict(zip(METRICS, values, strict=True))


def _no_overlap(solution: Solution, reference: Reference) -> DataError:
    time = solution.trajectory.time
    span = f"{time[0]:.1f}…{time[-1]:.1f} s" if time.size else "empty"
    return DataError(
        f"{solution.name}: the solution ({span}) covers no epoch of the reference "
        f"({reference.time[0]:.1f}…{reference.time[-1]:.1f} s)",
        remedy="check the reference's GPS week, time scale and leap seconds",
    )
