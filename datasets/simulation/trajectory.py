"""Continuous truth of a simulated vehicle.

The middle of the rear axle follows quintic splines in Cartesian axes fixed to the Earth: frame
`t`, north-east-down at an origin, so that ECEF is the origin plus a constant rotation and
nothing is approximated. Roll, pitch and heading of the vehicle (frame `v`) in `t` are quintic
splines too. Position, velocity, acceleration, angular rate and its derivative then follow in
closed form for any point fixed to the vehicle; only the mean over an IMU interval is a
(Gauss–Legendre) quadrature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline

from ...filters.earth import OMEGA_IE_E, C_en_at, C_en_of, gravity_e, lla_to_ecef
from ...filters.errors import DataError
from ...filters.rotation import FloatArray, matrix_from_rpy, rpy_from_matrix
from ..series import Reference

#: Lever of the IMU itself [m].
IMU_POINT = (0.0, 0.0, 0.0)
#: Gauss–Legendre nodes per IMU interval: at 100 Hz exact to rounding, since the integrand is
#: smooth and the error falls with the tenth power of the interval.
_QUADRATURE_NODES = 5


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Motion of one point of the vehicle at n instants.

    Parameters
    ----------
    pos_e, vel_e, accel_e : ndarray, shape (n, 3)
        Position and its derivatives in (rotating) ECEF axes [m], [m/s], [m/s²].
    C_eb : ndarray, shape (n, 3, 3)
        ``C_eb @ x_b == x_e``.
    omega_eb_b, omega_ib_b : ndarray, shape (n, 3)
        Angular rate of the body with respect to the Earth and to inertial space [rad/s].
    """

    pos_e: FloatArray
    vel_e: FloatArray
    accel_e: FloatArray
    C_eb: FloatArray
    omega_eb_b: FloatArray
    omega_ib_b: FloatArray

    @property
    def specific_force_b(self) -> FloatArray:
        """What an accelerometer triad at the point measures [m/s²], shape (n, 3).

        f^b = C_be (a_e + 2 ω_ie × v_e − g_e), gravity including the centrifugal part
        (Groves, Principles, 2nd ed., eq. 5.36 solved for f).
        """
        f_e = self.accel_e + 2.0 * np.cross(OMEGA_IE_E, self.vel_e) - gravity_e(self.pos_e)
        return np.einsum("nji,nj->ni", self.C_eb, f_e)


class Trajectory:
    """Twice differentiable motion of a vehicle that carries an IMU.

    Parameters
    ----------
    start : float
        GPS time from which `nodes` count [s].
    nodes : array_like, shape (n,)
        Node times after `start` [s], n ≥ 6; apart from it because GPS seconds in float64
        resolve only 0.24 µs, which splines would turn into rate noise.
    pos_t : array_like, shape (n, 3)
        Middle of the rear axle, north, east, down [m] in axes fixed at `origin`.
    rpy : array_like, shape (n, 3)
        Roll, pitch, heading of the vehicle in the same axes [rad]; heading unwrapped.
    origin : array_like, shape (3,)
        Latitude [rad], longitude [rad], ellipsoidal height [m].
    lever_imu_v : array_like, shape (3,)
        From the middle of the rear axle to the IMU, vehicle axes [m].
    C_bv : array_like, shape (3, 3)
        Mounting of the IMU: ``C_bv @ x_v == x_b``.

    Notes
    -----
    Every method that takes `lever_b` describes the point that far from the IMU, body axes [m];
    zero is the IMU itself and `lever_vehicle_b` the rear axle. Times outside the nodes are
    refused: a spline says nothing there.
    """

    def __init__(
        self,
        start: float,
        nodes: ArrayLike,
        pos_t: ArrayLike,
        rpy: ArrayLike,
        origin: ArrayLike,
        lever_imu_v: ArrayLike = (0.0, 0.0, 0.0),
        C_bv: ArrayLike | None = None,
    ) -> None:
        x = np.asarray(nodes, dtype=float)
        if x.ndim != 1 or x.size < 6 or np.any(np.diff(x) <= 0):
            raise DataError("trajectory: expected at least 6 increasing node times")
        self._zero = float(start)
        self._span = (float(x[0]), float(x[-1]))
        self.origin: FloatArray = np.asarray(origin, dtype=float)
        self.origin_e = lla_to_ecef(*self.origin)
        self.C_et = C_en_at(self.origin[0], self.origin[1])
        self.C_bv: FloatArray = np.eye(3) if C_bv is None else np.asarray(C_bv, dtype=float)
        self.lever_vehicle_b = -self.C_bv @ np.asarray(lever_imu_v, dtype=float)
        self._pos = _derivatives(x, pos_t)
        self._rpy = _derivatives(x, rpy)

    @property
    def span(self) -> tuple[float, float]:
        """First and last GPS time at which the trajectory is defined [s]."""
        return self._zero + self._span[0], self._zero + self._span[1]

    def kinematics(
        self, time: ArrayLike, lever_b: ArrayLike = IMU_POINT, offset: ArrayLike = 0.0
    ) -> Kinematics:
        """Return the motion of the point at `lever_b` from the IMU.

        Parameters
        ----------
        time : array_like, shape (n,)
            GPS time [s].
        lever_b : array_like, shape (3,)
            From the IMU, body axes [m].
        offset : array_like, shape (n,) or scalar
            Added to `time` [s] after the large part is taken off, for instants that GPS
            seconds in float64 cannot tell apart.
        """
        t = np.atleast_1d(np.asarray(time, dtype=float))
        x = (t - self._zero) + np.asarray(offset, dtype=float)
        if x.size and not (x.min() >= self._span[0] and x.max() <= self._span[1]):
            raise DataError(
                f"trajectory: asked for {x.min():.3f}…{x.max():.3f} s from its start, "
                f"defined for {self._span[0]:.3f}…{self._span[1]:.3f} s"
            )
        rpy, rpy_dot, rpy_ddot = (spline(x) for spline in self._rpy)
        omega_v, omega_dot_v = _body_rates(rpy, rpy_dot, rpy_ddot)
        C_ev = self.C_et @ matrix_from_rpy(rpy)
        arm_v = self.C_bv.T @ (np.asarray(lever_b, dtype=float) - self.lever_vehicle_b)
        swing_v = np.cross(omega_v, arm_v)
        bend_v = np.cross(omega_dot_v, arm_v) + np.cross(omega_v, swing_v)

        def to_e(vector_t: FloatArray, vector_v: FloatArray) -> FloatArray:
            return vector_t @ self.C_et.T + np.einsum("nij,nj->ni", C_ev, vector_v)

        C_eb = C_ev @ self.C_bv.T
        omega_eb_b = omega_v @ self.C_bv.T
        return Kinematics(
            pos_e=self.origin_e + to_e(self._pos[0](x), np.broadcast_to(arm_v, omega_v.shape)),
            vel_e=to_e(self._pos[1](x), swing_v),
            accel_e=to_e(self._pos[2](x), bend_v),
            C_eb=C_eb,
            omega_eb_b=omega_eb_b,
            omega_ib_b=omega_eb_b + np.einsum("nji,j->ni", C_eb, OMEGA_IE_E),
        )

    def pos_e(self, time: ArrayLike, lever_b: ArrayLike = IMU_POINT) -> FloatArray:
        """Return the ECEF position [m], shape (n, 3)."""
        return self.kinematics(time, lever_b).pos_e

    def vel_e(self, time: ArrayLike, lever_b: ArrayLike = IMU_POINT) -> FloatArray:
        """Return the ECEF velocity [m/s], shape (n, 3)."""
        return self.kinematics(time, lever_b).vel_e

    def accel_e(self, time: ArrayLike, lever_b: ArrayLike = IMU_POINT) -> FloatArray:
        """Return the derivative of the ECEF velocity [m/s²], shape (n, 3)."""
        return self.kinematics(time, lever_b).accel_e

    def C_eb(self, time: ArrayLike) -> FloatArray:
        """Return the IMU's attitude, ``C_eb @ x_b == x_e``, shape (n, 3, 3)."""
        return self.kinematics(time).C_eb

    def rpy(self, time: ArrayLike) -> FloatArray:
        """Return roll, pitch, heading of the IMU in the local north-east-down axes [rad]."""
        k = self.kinematics(time)
        return rpy_from_matrix(np.swapaxes(C_en_of(k.pos_e), -1, -2) @ k.C_eb)

    def omega_ib_b(self, time: ArrayLike) -> FloatArray:
        """Return the angular rate ω_ib^b [rad/s], shape (n, 3)."""
        return self.kinematics(time).omega_ib_b

    def specific_force_b(self, time: ArrayLike, lever_b: ArrayLike = IMU_POINT) -> FloatArray:
        """Return the specific force at a point, body axes [m/s²], shape (n, 3)."""
        return self.kinematics(time, lever_b).specific_force_b

    def imu_means(self, time: ArrayLike, lever_b: ArrayLike = IMU_POINT) -> tuple[FloatArray, ...]:
        """Return mean angular rate and mean specific force over each ``(time[k-1], time[k]]``.

        Parameters
        ----------
        time : array_like, shape (n,)
            Ends of the intervals, GPS time [s]; the first interval is as long as the second.
        lever_b : array_like, shape (3,)
            From the IMU to the sensor, body axes [m].

        Returns
        -------
        gyro_b, accel_b : ndarray, shape (n, 3)
            [rad/s], [m/s²].
        """
        end = np.asarray(time, dtype=float)
        step = np.diff(end, prepend=2.0 * end[0] - end[1])
        node, weight = np.polynomial.legendre.leggauss(_QUADRATURE_NODES)
        gyro_b, accel_b = np.zeros((end.size, 3)), np.zeros((end.size, 3))
        for x, w in zip(node, weight / 2.0, strict=True):
            k = self.kinematics(end, lever_b, offset=0.5 * (x - 1.0) * step)
            gyro_b += w * k.omega_ib_b
            accel_b += w * k.specific_force_b
        return gyro_b, accel_b

    def reference(
        self, time: ArrayLike, lever_b: ArrayLike = IMU_POINT, point: str = "imu"
    ) -> Reference:
        """Return the truth of the point at `lever_b` from the IMU as a `Reference`."""
        k = self.kinematics(time, lever_b)
        rpy = rpy_from_matrix(np.swapaxes(C_en_of(k.pos_e), -1, -2) @ k.C_eb)
        return Reference(
            time=np.asarray(time, dtype=float),
            pos_e=k.pos_e,
            vel_e=k.vel_e,
            rpy=rpy,
            lever_b=np.asarray(lever_b, dtype=float),
            point=point,
            source="simulation truth",
        )


def _derivatives(x: FloatArray, values: ArrayLike) -> tuple[BSpline, BSpline, BSpline]:
    """Return the quintic interpolating spline of `values` and its first two derivatives."""
    spline = make_interp_spline(x, np.asarray(values, dtype=float), k=5)
    return spline, spline.derivative(1), spline.derivative(2)


def _body_rates(
    rpy: FloatArray, rpy_dot: FloatArray, rpy_ddot: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return ω_tv^v and its derivative from Euler angles and their derivatives.

    ω = (φ̇ − ψ̇ sinθ, θ̇ cosφ + ψ̇ sinφ cosθ, −θ̇ sinφ + ψ̇ cosφ cosθ) for the z-y-x sequence
    (Groves, eq. 2.58 inverted); the second value is its derivative by the product rule.
    """
    sr, cr = np.sin(rpy[:, 0]), np.cos(rpy[:, 0])
    sp, cp = np.sin(rpy[:, 1]), np.cos(rpy[:, 1])
    r1, p1, y1 = rpy_dot.T
    r2, p2, y2 = rpy_ddot.T
    omega = np.stack([r1 - y1 * sp, p1 * cr + y1 * sr * cp, -p1 * sr + y1 * cr * cp], axis=-1)
    omega_dot = np.stack(
        [
            r2 - y2 * sp - y1 * p1 * cp,
            p2 * cr + y2 * sr * cp + r1 * omega[:, 2] - y1 * p1 * sr * sp,
            -p2 * sr + y2 * cr * cp - r1 * omega[:, 1] - y1 * p1 * cr * sp,
        ],
        axis=-1,
    )
    return omega, omega_dot
