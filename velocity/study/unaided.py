"""What the IMU's own attitude costs the Doppler velocity in an outage (Table 4, Fig. 4).

The first 200 epochs of the receiver after GNSS would have gone: the attitude starts from the
reference, the IMU turns it on, and its gyro bias is what best explains the reference's attitude
before the outage. Nothing of what comes after is used but as the truth. The same pairs of
satellites are then solved with either attitude, and their velocities compared axis by axis.
"""

from __future__ import annotations

from collections.abc import Sequence as Listing
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...datasets.sequence import Sequence
from ...filters.earth import C_en_of
from ...filters.errors import DataError
from ...filters.rotation import FloatArray, rpy_from_matrix, wrap_angle
from ...filters.strapdown import InertialStream, NavState, integrate
from ..ddia import SINGULAR_K
from ..vehicle_motion import ForwardMotion, forward_motion
from .pairs import Pairs, all_pairs
from .samples import (
    MAX_GAP,
    Samples,
    interpolated,
    rate_eb_b,
    reference_attitude,
    reference_samples,
)
from .statistics import rejection

#: Of an outage, as the paper has it.
EPOCHS = 200
#: What the gyro bias is learned from, and what is the least to learn it from [s].
LEARN, LEAST = 60.0, 10.0


@dataclass(frozen=True, eq=False)
class Outage:
    """The attitude and the velocities of one outage.

    Attributes
    ----------
    start : float
        GPS time [s].
    learned : float
        Length of what the gyro bias was learned from, just before [s].
    time : ndarray, shape (n,)
        Epochs of the receiver [s].
    rpy_error : ndarray, shape (n, 3)
        Roll, pitch and heading of the IMU's attitude against the reference's [rad].
    pair_time : ndarray, shape (m,)
        Epoch of every pair [s].
    difference_e : ndarray, shape (m, 3)
        Velocity with the IMU's attitude against that with the reference's, ECEF [m/s], of the
        pairs whose k exceeds 0.05 with either attitude and whose error with the reference's is
        no outlier.
    """

    start: float
    learned: float
    time: FloatArray
    rpy_error: FloatArray
    pair_time: FloatArray
    difference_e: FloatArray

    def __repr__(self) -> str:
        return (
            f"Outage({self.time.size} epochs from {self.start:.1f} s, {len(self.pair_time)} pairs)"
        )


def outages(
    sequence: Sequence, *, epochs: int = EPOCHS, learn: float = LEARN, systems: str = "G"
) -> list[Outage]:
    """Return outages of so many epochs, one after the other as far as the recording goes.

    Parameters
    ----------
    sequence : Sequence
        With IMU, observations and a reference of the IMU's attitude.
    epochs : int
        Length of an outage, in usual steps of the receiver.
    learn : float
        Longest stretch before an outage to learn the gyro bias from [s]; a recording that is too
        short for it leaves what it has, ten seconds at least.
    systems : str
        Constellation letters.

    Raises
    ------
    DataError
        If there is no IMU, the reference has no attitude, or no outage fits.
    """
    imu, reference = sequence.inertial, sequence.reference
    known = None if reference is None else np.isfinite(reference.rpy).all(1)
    if reference is None or known is None or known.sum() < 2:
        raise DataError(f"{sequence.name}: no reference attitude to compare the IMU's with")
    samples = reference_samples(sequence, direction="attitude", systems=systems)
    if samples.time.size < 2:
        raise DataError(f"{sequence.name}: one epoch of Doppler is no outage")
    step = float(np.median(np.diff(samples.time)))
    length = epochs * step
    judged = reference.time[known]
    first, last = max(imu.time[0], judged[0]), min(imu.time[-1], judged[-1], samples.time[-1])
    learned = min(learn, last - first - length)
    if learned < LEAST:
        raise DataError(
            f"{sequence.name}: {epochs} epochs of {step:g} s after {LEAST:g} s to learn from need "
            f"{length + LEAST:.0f} s with a reference attitude, found {last - first:.0f} s"
        )
    count = int((last - first - learned) / length + 1e-6)
    begins = [first + learned + k * length for k in range(count)]
    found = [
        _outage(sequence, samples, begin, length, learned)
        for begin in begins
        if _seamless(judged, begin - learned, begin + length)
    ]
    found = [outage for outage in found if outage.pair_time.size]
    if not found:
        raise DataError(
            f"{sequence.name}: no {length:.0f} s with a reference attitude throughout and pairs"
        )
    return found


def _seamless(time: FloatArray, start: float, end: float) -> bool:
    """Tell whether the reference's attitude goes through from `start` to `end`."""
    inside = time[(time > start) & (time < end)]
    return bool(np.diff(np.r_[start, inside, end]).max() <= MAX_GAP)


def over_outages(found: Listing[Outage]) -> dict[str, Any]:
    """Return the RMS over all outages (Table 4): angles [deg], velocity differences [m/s].

    ``outages``, ``epochs``, ``pairs`` say over how many; NaN stands for nothing to tell.
    """
    none = np.zeros((0, 3))
    rpy = np.vstack([none, *(outage.rpy_error for outage in found)])
    difference = np.vstack([none, *(outage.difference_e for outage in found)])
    roll, pitch, yaw = _rms(np.degrees(rpy))
    return {
        "outages": len(found),
        "learned_s": found[0].learned if found else np.nan,
        "epochs": len(rpy),
        "pairs": len(difference),
        "yaw_rms_deg": yaw,
        "roll_rms_deg": roll,
        "pitch_rms_deg": pitch,
        **dict(zip(("x_rms_mps", "y_rms_mps", "z_rms_mps"), _rms(difference), strict=True)),
    }


def _rms(columns: FloatArray) -> list[float]:
    known = columns[np.isfinite(columns).all(1)]
    return [float(v) for v in np.sqrt(np.mean(known**2, axis=0))] if len(known) else [np.nan] * 3


def _outage(
    sequence: Sequence, samples: Samples, start: float, length: float, learned: float
) -> Outage:
    """Integrate the attitude over one outage and solve its pairs with it."""
    bias = np.zeros(3)
    for _ in range(3):
        bias += _bias_left(sequence, _integrated(sequence, start - learned, start, bias))
    rows = _integrated(sequence, start, start + length, bias)
    just = 1e-3 * length / EPOCHS  # the first epoch is after the start, the last at the end
    within = samples.between(start + just, start + length + just)
    C_imu = rows[_nearest(rows[:, 0], within.time), 7:16].reshape(-1, 3, 3)
    reference = sequence.reference
    assert reference is not None
    C_true = reference_attitude(sequence, reference.time, within.time)
    at = interpolated(within.time, reference.time, reference.pos_e)
    C_ne = np.swapaxes(C_en_of(at), 1, 2)
    rpy = wrap_angle(rpy_from_matrix(C_ne @ C_imu) - rpy_from_matrix(C_ne @ C_true))
    motion = _motion(sequence, within.time, C_imu)
    true, drifted = (
        all_pairs(within.rows, within.epoch, of, within.cn0, within.elevation)
        for of in (within.motion, motion)
    )
    error = within.errors(true)
    known = np.isfinite(error)
    limit = rejection(true.k[known], error[known]).limit
    kept = (true.k > SINGULAR_K) & (drifted.k > SINGULAR_K) & known & (error <= limit)
    velocities = [_velocities(p, m, kept) for p, m in ((drifted, motion), (true, within.motion))]
    return Outage(
        start=start,
        learned=learned,
        time=within.time,
        rpy_error=rpy,
        pair_time=within.time[true.epoch[kept]],
        difference_e=velocities[0] - velocities[1],
    )


def _velocities(pairs: Pairs, motion: ForwardMotion, kept: NDArray[np.bool_]) -> FloatArray:
    """Return the antenna's velocity, eq. (20), of the pairs that are kept."""
    epoch = pairs.epoch[kept]
    return pairs.speed[kept, None] * motion.u_e[epoch] + motion.swing_e[epoch]


def _motion(sequence: Sequence, time: FloatArray, C_eb: FloatArray) -> ForwardMotion:
    calibration = sequence.calibration
    return forward_motion(
        C_eb,
        rate_eb_b(sequence.inertial, time, C_eb),
        calibration.lever_antenna_b,
        C_bv=calibration.C_bv,
        lever_vehicle_b=calibration.lever_vehicle_b,
    )


def _nearest(node: FloatArray, time: FloatArray) -> NDArray[np.int64]:
    """Return the index of the `node` closest to each `time`."""
    after = np.clip(np.searchsorted(node, time), 1, node.size - 1)
    return after - (time - node[after - 1] < node[after] - time)


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
