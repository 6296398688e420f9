"""The state a filter begins with, with covariances, and the filter made of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ....alignment.levelling import InitialAttitude
from ....datasets.sequence import Calibration
from ....filters.ekf import ErrorStateFilter
from ....filters.error_model import ACCEL_BIAS, ATT, GYRO_BIAS, POS, VEL, ErrorModel
from ....filters.rotation import FloatArray
from ....filters.strapdown import InertialStream, NavState
from ...config import FilterConfig
from ...solution import AlignmentReport
from ..events import GnssEvent

if TYPE_CHECKING:
    from ....alignment.in_motion.align import InertialAlignment


@dataclass(frozen=True, eq=False)
class Start:
    """State of the IMU at one instant, with covariances.

    Parameters
    ----------
    attitude : InitialAttitude
        How the attitude was found, and the gyro bias.
    state : NavState
    pos_cov_e, vel_cov_e : ndarray, shape (3, 3)
        [m²], [m²/s²].
    accel_bias : ndarray, shape (3,)
        [m/s²].
    certified : InertialAlignment, optional
        The window that passed.
    joint_cov : ndarray, shape (12, 12), optional
        Certified: of attitude (body axes), velocity (e axes), gyro and accelerometer bias, with
        their correlations. Position is taken as independent of them.
    attempts : tuple of (float, str)
        GPS time of each certified attempt [s], and what was missing.
    fix : GnssEvent, optional
        Where the position is from: what is wrong with it is wrong with the ones that follow.
    known : float
        GPS time of the event at which it was found: nothing later has told of it [s].
    doubt : str
        What was still open when the data ended, and was taken as likelier; '' if nothing was.
    """

    attitude: InitialAttitude
    state: NavState
    pos_cov_e: FloatArray
    vel_cov_e: FloatArray
    accel_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    certified: InertialAlignment | None = None
    joint_cov: FloatArray | None = None
    attempts: tuple[tuple[float, str], ...] = field(default=())
    fix: GnssEvent | None = None
    known: float = float("nan")
    doubt: str = ""

    def report(self, began: float) -> AlignmentReport:
        """Return how it was found, for the result; `began` is the beginning of the data [s]."""
        attitude, found = self.attitude, self.certified
        verdicts = found.result.verdicts if found is not None else ()
        return AlignmentReport(
            "given" if attitude.method == "given" else "aligned", attitude.method, attitude.time,
            attitude.time - began, attitude.sigma_heading, attitude.message,
            None if found is None else found.result.bound,
            tuple((v.name, v.message) for v in verdicts), self.attempts,
        )  # fmt: skip


def start_filter(
    start: Start,
    stream: InertialStream,
    calibration: Calibration,
    model: ErrorModel,
    config: FilterConfig,
) -> ErrorStateFilter:
    """Hand the start to the filter."""
    attitude = start.attitude
    att_cov_b = attitude.C_eb.T @ attitude.cov_e @ attitude.C_eb
    common_cov = None if start.fix is None else start.fix.common_cov_e
    P = model.initial_covariance(start.pos_cov_e, start.vel_cov_e, att_cov_b, common_cov)
    _position_by_antenna(P, model, start.state.C_eb, start.state.vel_e)
    if start.joint_cov is not None:
        filled = np.r_[ATT, VEL, GYRO_BIAS, ACCEL_BIAS]
        P[np.ix_(filled, filled)] = start.joint_cov
    elif attitude.sigma_gyro_bias is not None:
        P[GYRO_BIAS, GYRO_BIAS] = np.eye(3) * attitude.sigma_gyro_bias**2
    if attitude.method == "level+course":
        _heading_by_course(P, model, calibration.C_bv)
    rate = config.output_rate_hz
    interval = 1.0 / rate if rate > 0 else 0.0
    return ErrorStateFilter(
        model, stream, start.state, P, interval, attitude.gyro_bias, config.smooth,
        accel_bias=start.accel_bias,
    )  # fmt: skip


def _position_by_antenna(
    P: FloatArray, model: ErrorModel, C_eb: FloatArray, vel_e: FloatArray
) -> None:
    """Add what an uncertain lever and delay do to a position taken from the antenna's, in place.

    p = p_a − C l − v δ.
    """
    for index, derivative in ((model.antenna, -C_eb), (model.delay, -vel_e[:, None])):
        if index is None:
            continue
        part = np.atleast_1d(np.arange(model.size)[index])
        across = derivative @ P[np.ix_(part, part)]
        P[POS, POS] += across @ derivative.T
        P[POS, part], P[part, POS] = across, across.T


def _heading_by_course(P: FloatArray, model: ErrorModel, C_bv: FloatArray) -> None:
    """Add what a mounting that is not exact does to a heading taken from the course, in place.

    C_nb = C_nv C_bvᵀ, the vehicle's heading known: a mounting turned by the error μ makes an
    attitude error of φ = −C_bv μ. Of μ the yaw is meant; gravity keeps the IMU level.
    """
    mounting = model.mounting
    if mounting is None:
        return
    down_b, yaw, variance = C_bv[:, 2], mounting.start + 1, model.vehicle.sigma_mounting**2
    P[ATT, ATT] += variance * np.outer(down_b, down_b)
    P[ATT, yaw] -= variance * down_b
    P[yaw, ATT] -= variance * down_b
