"""Alignment from IMU and Doppler alone: attitude, velocity and biases, with verdicts.

The rows of `alignment.in_motion.rows` hold exactly for a perfect IMU. A MEMS gyro that is 500 deg/h
off at switch-on tilts gravity by 4° in thirty seconds, 10 m/s of Δv: a hundred times what Doppler
resolves. The errors are therefore unknowns of the problem (`alignment.in_motion.window`), which
is linearised at their estimates until nothing moves. The proof is then one for the problem
linearised at its own solution; `alignment.in_motion.doubts` asks what speaks against it.

What rows that had to be rejected say of the tails of the noise widens the σ of those kept, so that
covariance and bound do not profit from the selection.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...datasets.observations import GnssObservations
from ...filters.earth import gravity_e
from ...filters.errors import AlignmentError
from ...filters.rotation import FloatArray
from ...filters.sensors import ImuSpec
from ...filters.strapdown import InertialStream
from ..levelling import InitialAttitude
from ..result import AlignmentResult, Ask
from ..solver.refinement import rotation_angle
from ..verdict import judge
from .doubts import consensus, contradicted, in_motion, reject, rivals, separation
from .rows import InertialDoppler, inertial_doppler, inertial_rows
from .track import ImuParts, InertialTrack
from .unknowns import InertialOptions
from .window import Mask, Stretch, linearisations, settle


@dataclass(frozen=True, eq=False)
class InertialAlignment:
    """Attitude and velocity at the window's end from IMU and Doppler, with verdicts.

    Attributes
    ----------
    result : AlignmentResult
        `C_ew` is C_eb at `time`. Where rows were rejected, CONSENSUS is among its verdicts, and
        where the others passed, RIVALS; where rows were rejected or contradict, SEPARATION.
    start, time : float
        Begin and end of the window, GPS time [s].
    epochs : int
    vel_e : ndarray, shape (3,)
        Of the IMU at `time` [m/s]; 0.1 mm/s per metre of lever arm come of the Earth's turning.
    gyro_bias, accel_bias : ndarray, shape (3,)
        [rad/s], [m/s²].
    cov : ndarray, shape (12, 12)
        Of attitude (a small rotation in e axes), velocity, gyro bias and accelerometer bias.
    pos_e : ndarray, shape (3,)
        The antenna, as it was given [m].
    inliers : ndarray of bool, shape (k,)
        Of the rows.
    source : ndarray of int, shape (k,)
        Observation each row came from.
    outlier_sats : tuple of str
        Satellites with rejected rows.
    rounds : int
        Linearisations it took.
    track : InertialTrack
        Integrals of the IMU at the epochs, biases taken off, anchored at the last.
    imu : ImuSpec
    """

    result: AlignmentResult
    start: float
    time: float
    epochs: int
    vel_e: FloatArray
    gyro_bias: FloatArray
    accel_bias: FloatArray
    cov: FloatArray
    pos_e: FloatArray
    inliers: Mask
    source: NDArray[np.int64]
    outlier_sats: tuple[str, ...]
    rounds: int
    track: InertialTrack
    imu: ImuSpec

    def __repr__(self) -> str:
        kept = f"{int(self.inliers.sum())} of {self.inliers.size} rows"
        return (
            f"<InertialAlignment over {self.time - self.start:.0f} s, {self.epochs} epochs, "
            f"{kept}: heading 1σ {np.degrees(self.sigma_heading):.3g}°, {self.result!r}>"
        )

    @property
    def passed(self) -> bool:
        """The overall verdict."""
        return self.result.passed

    @property
    def C_eb(self) -> FloatArray:
        """Attitude at `time`."""
        return self.result.C_ew

    @property
    def cov_e(self) -> FloatArray:
        """Covariance of the attitude, a small rotation in e axes [rad²]."""
        return self.cov[:3, :3]

    @property
    def sigma_heading(self) -> float:
        """1σ of the rotation about the vertical [rad]."""
        return _heading(self.cov_e, self.pos_e)

    @property
    def message(self) -> str:
        """One line for the log."""
        return self.result.message

    def initial_attitude(self) -> InitialAttitude:
        """Return what starts the filter.

        Raises
        ------
        AlignmentError
            If the verdict did not pass.
        """
        self.result.require()
        sigma_bias = float(np.sqrt(np.linalg.eigvalsh(self.cov[6:9, 6:9])[-1]))
        rejected = int(np.sum(~self.inliers))
        aside = f", {rejected} rows rejected ({', '.join(self.outlier_sats)})" if rejected else ""
        return InitialAttitude(
            self.time, self.C_eb, self.cov_e, self.sigma_heading, self.gyro_bias, sigma_bias,
            "certified",
            f"certified in motion over {self.time - self.start:.0f} s and {self.epochs} epochs: "
            f"heading ±{np.degrees(self.sigma_heading):.2g}° 1σ, "
            f"{self.result.verdict(Ask.BOUNDED).message}{aside}",
        )  # fmt: skip

    def carried_to(self, k: int, weight: float = 1.0) -> tuple[FloatArray, FloatArray]:
        """Carry attitude and biases to epoch k of the window by the gyros.

        Whoever filters the window's Doppler from there on uses it twice. With a `weight` of 1/9
        it has told a ninth of what it knows before: 1σ is then what 3σ was.

        Parameters
        ----------
        k : int
        weight : float
            Of the information that the window adds to what was known of the sensor.

        Returns
        -------
        C_eb : ndarray, shape (3, 3)
        cov : ndarray, shape (9, 9)
            Of attitude (a small rotation in e axes), gyro bias and accelerometer bias.
        """
        C_eb, track, spec = self.track.attitude(self.C_eb, k), self.track, self.imu
        to_k = C_eb @ track.C_wb[k].T @ self.C_eb.T
        # A change δ of the gyro bias turns C_wb by −Aδ.
        J = np.eye(9)
        J[:3, :3] = to_k
        J[:3, 3:6] = -to_k @ self.C_eb @ track.A[k, :, :3]
        chosen = np.r_[0:3, 6:12]
        cov = J @ self.cov[np.ix_(chosen, chosen)] @ J.T
        gyro = np.hypot(spec.gyro_bias_initial_sigma, spec.gyro_bias_sigma)
        accel = np.hypot(spec.accel_bias_initial_sigma, spec.accel_bias_sigma)
        before = np.diag(np.r_[np.zeros(3), np.full(3, gyro), np.full(3, accel)] ** 2)
        before[3:, 3:] = np.linalg.inv(before[3:, 3:])
        cov = np.asarray(
            np.linalg.inv(weight * np.linalg.inv(cov) + (1.0 - weight) * before), float
        )
        angle = float(rotation_angle(np.eye(3), track.C_wb[k]))
        elapsed = abs(track.time[k] - self.time)
        scale = 1e-6 * spec.gyro_scale_ppm * angle
        cov[:3, :3] += np.eye(3) * (spec.gyro_noise_density**2 * elapsed + scale**2)
        return C_eb, cov


def align_inertial(
    stream: InertialStream,
    observations: GnssObservations,
    pos_e: ArrayLike,
    lever_b: ArrayLike = (0.0, 0.0, 0.0),
    options: InertialOptions | None = None,
    *,
    time: ArrayLike | None = None,
) -> InertialAlignment:
    """Find attitude, velocity and biases at the end of the observations.

    Parameters
    ----------
    stream : InertialStream
    observations : GnssObservations
        The window's; screened, with satellite states.
    pos_e : array_like, shape (3,) or (n, 3)
        Antenna, approximately, one for all or one per row [m].
    lever_b : array_like, shape (3,)
        IMU to antenna [m].
    options : InertialOptions, optional
    time : array_like, shape (n,), optional
        GPS time of each row where the receiver's clock is known to be off [s].

    Raises
    ------
    AlignmentError
        If there is no Doppler within the IMU data, or too little to solve for anything.
    """
    options = options or InertialOptions()
    when = observations.time if time is None else np.asarray(time, dtype=float)
    inside = (when >= stream.start) & (when <= stream.end)
    pos_e = np.asarray(pos_e, dtype=float)
    doppler = inertial_doppler(
        observations.take(inside), pos_e[inside] if pos_e.ndim == 2 else pos_e, options.noise,
        time=when[inside], interval=options.interval, position_sigma=options.position_sigma,
    )  # fmt: skip
    found = align_epochs(ImuParts(stream), doppler, lever_b, options)
    return replace(found, source=np.flatnonzero(inside)[found.source])


def align_epochs(
    parts: ImuParts,
    doppler: InertialDoppler,
    lever_b: ArrayLike = (0.0, 0.0, 0.0),
    options: InertialOptions | None = None,
    *,
    gyro_bias: ArrayLike | None = None,
    look: Callable[[float], None] | None = None,
) -> InertialAlignment:
    """Align on prepared rows; what `align_inertial` does.

    Parameters
    ----------
    parts : ImuParts
        Keeps what the next window has in common with this one.
    doppler : InertialDoppler
    lever_b, options
        As for `align_inertial`.
    gyro_bias : array_like, shape (3,), optional
        Where to linearise first, for example the estimate of the window before.
    look : callable, optional
        Told 1σ of the heading after one linearisation, as the weights have it [rad]: right to a
        factor of two, at a fraction of the work. It may raise AlignmentError.

    Raises
    ------
    AlignmentError
        If there is too little to solve for anything.
    """
    options = options or InertialOptions()
    if len(doppler.time) < 2:
        raise AlignmentError("fewer than two epochs with Doppler and IMU data: keep waiting")
    stretch = Stretch(inertial_rows(doppler), parts, lever_b, options)
    start = stretch.prior if gyro_bias is None else np.append(gyro_bias, np.zeros(3))
    for solved in linearisations(stretch.at, start, options, None):
        if look is not None and solved.rounds == 1:
            look(_heading(solved.covariance[:3, :3], doppler.pos_e[-1]))
    result, moves = judge(solved.problem, limits=options.limits), in_motion(doppler)
    consistent = result.verdict(Ask.CONSISTENT).passed
    if options.robust and not consistent and result.dof >= options.limits.redundancy:
        solved = reject(stretch.at, solved, options, moves)
        # Rejected rows tell of tails: those that were kept are as wide as all of them together.
        lost = int(np.sum(~solved.inliers))
        tails = (solved.cost + lost * options.cutoff**2) / max(solved.problem.dof + lost, 1)
        if lost and tails > 1.0:
            stretch = stretch.widened(float(np.sqrt(tails)))
            solved = settle(stretch.at, solved.window.biases, options, None, solved.inliers)
        result = judge(solved.problem, limits=options.limits)
    inliers = solved.inliers
    if not inliers.all():
        result = result.asked_further(consensus(inliers, options, moves))
    if result.passed:
        # Slow, and of no use to what waits anyway.
        further = [rivals(stretch.at, solved, result, inliers, options)]
        if not inliers.all() or contradicted(solved):
            further.append(separation(stretch.at, solved, result, inliers, options))
        result = result.asked_further(*further)
    vel_e, cov = solved.estimate(result)
    sats = tuple(map(str, np.unique(doppler.sat[~inliers])))
    return InertialAlignment(
        result, float(doppler.time[0]), float(doppler.time[-1]), doppler.time.size, vel_e,
        solved.biases[:3], solved.biases[3:], cov, doppler.pos_e[-1], inliers, doppler.source,
        sats, solved.rounds, solved.window.track, options.imu,
    )  # fmt: skip


def _heading(cov_e: FloatArray, pos_e: FloatArray) -> float:
    """Return 1σ of the rotation about gravity [rad]; that is the vertical to 1e-5 rad."""
    down_e = gravity_e(pos_e)
    return float(np.sqrt(down_e @ cov_e @ down_e / (down_e @ down_e)))
