"""Mounting of the IMU in the vehicle, pitch and yaw, from straight driving.

Going straight, a vehicle moves along its own forward axis. The velocity of the point the wheels
constrain, seen in IMU axes, then points along C_bv (1, 0, 0)ᵀ, which is pitch and yaw of the
mounting; roll about the direction of motion is invisible, in this calibration as in DDIA-VE.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..datasets.sequence import Sequence
from ..filters.errors import DataError
from ..filters.rotation import FloatArray, matrix_from_rpy

#: Seconds of straight driving averaged into one independent value: attitude errors of a
#: reference and lane changes last for seconds.
_BLOCK = 5.0
_MIN_BLOCKS = 4


@dataclass(frozen=True)
class Mounting:
    """Direction of the vehicle's forward axis in IMU axes.

    Attributes
    ----------
    pitch, yaw : float
        [rad]: C_bv = R_z(yaw) R_y(pitch); positive where the vehicle's nose is up and to the
        right, seen from the IMU.
    sigma_pitch, sigma_yaw : float
        1σ [rad] from the scatter of blocks of some seconds. A constant error of the attitude
        they are measured against is not in it.
    straight_s : float
        Straight driving used [s].
    blocks : int
        Independent values behind it.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import calibrate_mounting
    >>> time = np.arange(0.0, 60.0, 0.1)
    >>> C_eb = np.tile(np.eye(3), (600, 1, 1))
    >>> vel_e = np.tile(10.0 * np.array([np.cos(0.02), np.sin(0.02), 0.0]), (600, 1))
    >>> mounting = calibrate_mounting(time, vel_e, C_eb, np.zeros((600, 3)))
    >>> round(mounting.yaw, 6), round(mounting.pitch, 6) + 0.0, round(mounting.straight_s)
    (0.02, 0.0, 60)
    """

    pitch: float
    yaw: float
    sigma_pitch: float
    sigma_yaw: float
    straight_s: float
    blocks: int

    @property
    def C_bv(self) -> FloatArray:
        """``C_bv @ x_v == x_b``, roll zero."""
        return matrix_from_rpy([0.0, self.pitch, self.yaw])


def calibrate_mounting(
    time: ArrayLike,
    vel_e: ArrayLike,
    C_eb: ArrayLike,
    omega_eb_b: ArrayLike,
    *,
    lever_b: ArrayLike = (0.0, 0.0, 0.0),
    min_speed: float = 5.0,
    max_yaw_rate: float = np.radians(1.0),
) -> Mounting:
    """Return the mounting from velocities and attitudes.

    Parameters
    ----------
    time : array_like, shape (n,)
        [s], increasing.
    vel_e : array_like, shape (n, 3)
        Velocity of a point of the vehicle, ECEF [m/s]: the reference's, or GNSS's.
    C_eb : array_like, shape (n, 3, 3)
        Attitude of the IMU.
    omega_eb_b : array_like, shape (n, 3)
        Angular rate with respect to the Earth [rad/s].
    lever_b : array_like, shape (3,)
        From that point to the one the wheels constrain [m].
    min_speed : float
        [m/s].
    max_yaw_rate : float
        Faster turning is not straight [rad/s]: at 1 °/s and 10 m/s half a metre of unknown
        lever arm makes 0.05°.

    Raises
    ------
    DataError
        If less than 20 s of driving were straight and fast enough.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import calibrate_mounting
    >>> time = np.arange(0.0, 60.0, 0.1)
    >>> C_eb = np.tile(np.eye(3), (600, 1, 1))
    >>> vel_e = np.tile(10.0 * np.array([np.cos(0.02), np.sin(0.02), 0.0]), (600, 1))
    >>> mounting = calibrate_mounting(time, vel_e, C_eb, np.zeros((600, 3)))
    >>> round(mounting.yaw, 6), round(mounting.pitch, 6) + 0.0, round(mounting.straight_s)
    (0.02, 0.0, 60)
    """
    time, vel_e, C_eb = (np.asarray(v, dtype=float) for v in (time, vel_e, C_eb))
    omega = np.asarray(omega_eb_b, dtype=float)
    vel_b = np.einsum("nji,nj->ni", C_eb, vel_e) + np.cross(omega, np.asarray(lever_b, float))
    speed = np.linalg.norm(vel_b, axis=1)
    step = float(np.median(np.diff(time)))
    with np.errstate(invalid="ignore"):
        straight = (speed > min_speed) & (np.linalg.norm(omega, axis=1) < max_yaw_rate)
    straight &= np.isfinite(vel_b).all(1)
    block = np.floor((time - time[0]) / _BLOCK).astype(np.int64)[straight]
    direction = vel_b[straight] / speed[straight, None]
    blocks = np.unique(block)
    seconds = float(straight.sum() * step)
    if seconds < _MIN_BLOCKS * _BLOCK or blocks.size < _MIN_BLOCKS:
        raise DataError(
            f"mounting: expected {_MIN_BLOCKS * _BLOCK:g} s of straight driving above "
            f"{min_speed:g} m/s, found {seconds:.0f} s",
            remedy="take a longer recording or lower min_speed",
        )
    # Backing up points the other way; the majority drives forward.
    main = np.median(direction, axis=0)
    direction *= np.where(direction @ main < 0.0, -1.0, 1.0)[:, None]
    pitch = -np.arcsin(np.clip(direction[:, 2], -1.0, 1.0))
    yaw = np.arctan2(direction[:, 1], direction[:, 0])
    centre = float(np.arctan2(main[1], main[0]))
    yaw = centre + (yaw - centre + np.pi) % (2.0 * np.pi) - np.pi
    mean_pitch, sigma_pitch = _robust_mean(pitch, block, blocks)
    mean_yaw, sigma_yaw = _robust_mean(yaw, block, blocks)
    return Mounting(mean_pitch, mean_yaw, sigma_pitch, sigma_yaw, seconds, int(blocks.size))


def _robust_mean(
    angle: FloatArray, block: NDArray[np.int64], blocks: NDArray[np.int64]
) -> tuple[float, float]:
    """Return a mean over block medians within 3σ (1.48 MAD) of their median, and its 1σ."""
    value = np.array([np.median(angle[block == b]) for b in blocks])
    centre = np.median(value)
    spread = 1.4826 * np.median(np.abs(value - centre))
    value = value[np.abs(value - centre) <= 3.0 * spread + 1e-12]
    deviation = float(np.std(value, ddof=1)) if value.size > 1 else float(spread)
    return float(value.mean()), deviation / np.sqrt(value.size)


def sequence_mounting(
    sequence: Sequence, *, min_speed: float = 5.0, max_yaw_rate: float = np.radians(1.0)
) -> Mounting:
    """Return the mounting of a sequence from its reference and gyro.

    Parameters
    ----------
    sequence : Sequence
        Its reference must have the IMU's attitude.
    min_speed, max_yaw_rate : float
        As for `calibrate_mounting`.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> from certnav.velocity import sequence_mounting
    >>> config = SimulationConfig(duration=120.0, density="open", mounting_rpy_deg=(0.0, 0.0, 3.0))
    >>> mounting = sequence_mounting(simulate(config).sequence())
    >>> round(mounting.yaw * 57.29578)  # [deg]: the nose is left of where the IMU points
    -3
    """
    from .study.samples import interpolated, rate_eb_b, reference_attitude  # slow to import

    reference = sequence.reference
    if reference is None or reference.attitude_frame != "b":
        raise DataError(f"{sequence.name}: no reference of the IMU's attitude: mounting unknown")
    imu = sequence.inertial
    inside = (reference.time >= imu.time[0]) & (reference.time <= imu.time[-1])
    time = reference.time[inside]
    C_eb = reference_attitude(sequence, reference.time, time)
    return calibrate_mounting(
        time,
        interpolated(time, reference.time, reference.vel_e),
        C_eb,
        rate_eb_b(imu, time, C_eb, window=1.0),
        lever_b=sequence.calibration.lever_vehicle_b - reference.lever_b,
        min_speed=min_speed,
        max_yaw_rate=max_yaw_rate,
    )
