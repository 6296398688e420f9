"""What 200 s of unaided inertial attitude cost the Doppler velocity (Table 4, Fig. 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ...datasets.sequence import Sequence
from ...filters.earth import C_en_of
from ...filters.errors import DataError
from ...filters.rotation import FloatArray, rpy_from_matrix, wrap_angle
from ...filters.strapdown import InertialStream, NavState, integrate
from ..vehicle_motion import forward_motion
from .pairs import all_pairs, velocity_errors
from .samples import interpolated, rate_eb_b, reference_attitude, reference_samples
from .statistics import attitude_effect


@dataclass(frozen=True, eq=False)
class DriftEffect:
    """One stretch of inertial attitude.

    Attributes
    ----------
    start, duration : float
        [s].
    rpy_rms : ndarray, shape (3,)
        RMS of roll, pitch and heading error against the reference [rad].
    rpy_end : ndarray, shape (3,)
        Their errors at the end [rad].
    figures : dict
        See `velocity.study.statistics.attitude_effect`.
    """

    start: float
    duration: float
    rpy_rms: FloatArray
    rpy_end: FloatArray
    figures: dict[str, float]


def drift_effect(
    sequence: Sequence,
    start: float,
    duration: float = 200.0,
    *,
    learn: float = 60.0,
    systems: str = "G",
) -> DriftEffect:
    """Return what the attitude costs that the IMU integrates alone from `start` on.

    Attitude starts from the reference. The gyro's bias is what best explains the reference's
    attitude over the `learn` seconds before, as an aided filter would know it.

    Parameters
    ----------
    sequence : Sequence
        With IMU, observations and a reference of the IMU's attitude.
    start : float
        GPS time [s].
    duration, learn : float
        [s].
    systems : str
        Constellation letters.

    Raises
    ------
    DataError
        If the reference has no attitude over that time.
    """
    imu, reference = sequence.inertial, sequence.reference
    end = start + duration
    if reference is None or not np.isfinite(reference.rpy).all(1).any():
        raise DataError(f"{sequence.name}: no reference attitude to compare the IMU's with")
    first, last = max(imu.time[0], reference.time[0]), min(imu.time[-1], reference.time[-1])
    if start - learn < first or end > last:
        raise DataError(
            f"{sequence.name}: needs {learn:g} s before and {duration:g} s after {start:.1f} s, "
            f"found {first:.1f}…{last:.1f} s",
            remedy="choose another start or a shorter duration",
        )
    bias = np.zeros(3)
    for _ in range(3):
        rows = _integrated(sequence, start - learn, start, bias)
        bias += _bias_left(sequence, rows)
    rows = _integrated(sequence, start, end, bias)
    within = reference_samples(
        sequence.between(start, end),
        direction="attitude",
        systems=systems,
    )
    C_imu = rows[:, 7:16].reshape(-1, 3, 3)
    nearest = np.clip(np.searchsorted(rows[:, 0], within.time), 1, len(rows) - 1)
    nearest -= within.time - rows[nearest - 1, 0] < rows[nearest, 0] - within.time
    calibration = sequence.calibration
    motion = forward_motion(
        C_imu[nearest],
        rate_eb_b(imu, within.time, C_imu[nearest]),
        calibration.lever_antenna_b,
        C_bv=calibration.C_bv,
        lever_vehicle_b=calibration.lever_vehicle_b,
    )
    true_pairs = within.pairs()
    drifted = all_pairs(within.rows, within.epoch, motion, within.cn0, within.elevation)
    # The velocity from the drifted attitude, judged against the truth.
    error_imu = velocity_errors(drifted.speed, drifted.epoch, motion, within.vel_e)
    C_ne = np.swapaxes(C_en_of(rows[:, 1:4]), 1, 2)
    C_true = reference_attitude(sequence, reference.time, rows[:, 0])
    rpy = wrap_angle(rpy_from_matrix(C_ne @ C_imu) - rpy_from_matrix(C_ne @ C_true))
    return DriftEffect(
        start,
        duration,
        np.sqrt(np.nanmean(rpy**2, axis=0)),
        rpy[np.isfinite(rpy).all(1)][-1],
        attitude_effect(within.errors(true_pairs), error_imu, true_pairs.k),
    )


def _integrated(sequence: Sequence, start: float, end: float, bias: FloatArray) -> FloatArray:
    """Return inertial rows from `start` on, which begin at the reference."""
    imu, reference = sequence.inertial, sequence.reference
    assert reference is not None
    at = np.array([start])
    state = NavState(
        start,
        interpolated(at, reference.time, reference.pos_e)[0],
        interpolated(at, reference.time, reference.vel_e)[0],
        reference_attitude(sequence, reference.time, at)[0],
    )
    return integrate(InertialStream(imu.time, imu.gyro_b - bias, imu.accel_b), state, end)


def _bias_left(sequence: Sequence, rows: FloatArray) -> FloatArray:
    """Return the gyro bias that explains how inertial attitude left the reference's.

    A bias b turns the attitude by φ_e(t) = ∫ C_eb b dt: linear least squares over all samples.
    """
    assert sequence.reference is not None
    C_imu = rows[:, 7:16].reshape(-1, 3, 3)
    C_true = reference_attitude(sequence, sequence.reference.time, rows[:, 0])
    known = np.isfinite(C_true).all((1, 2))
    turned = np.cumsum(C_imu * np.gradient(rows[:, 0])[:, None, None], axis=0)
    phi_e = Rotation.from_matrix(C_imu[known] @ np.swapaxes(C_true[known], 1, 2)).as_rotvec()
    return np.linalg.lstsq(turned[known].reshape(-1, 3), phi_e.ravel(), rcond=None)[0]
