"""Where the filter starts: attitude, position and velocity at one instant, with covariances.

Events are taken one by one in the order of time, and what is decided at one follows from what
lies before it: a recorded drive and the same drive live start at the same instant with the same
numbers. The rule of 'auto':

    roll, pitch and heading given   →  these, at the first velocity with a position
    a standstill to begin with      →  levelled there, heading from course as soon as it drives
    raw Doppler                     →  certified in motion, if a window passes within twice
                                       `max_window_s` of the first Doppler
    no raw Doppler, or no window    →  levelled in motion, heading from course, at the instant at
       passed by then                  which there was enough for it; the message says why

A certified attitude is worth a wait, for it needs no mounting, no course and comes with a bound;
after two windows without a pass there is no telling when one will. The wait costs little of the
solution: what the window proves holds at its beginning, too, as far as the gyros can carry it
back, and the filter begins there (`StartFinder._from_window`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...alignment.levelling import (
    LEVEL_WINDOW,
    REST_SPEED,
    InitialAttitude,
    VelocityTrack,
    given_attitude,
    level_and_course,
)
from ...datasets.sequence import Calibration
from ...filters.earth import OMEGA_IE_E, C_en_of
from ...filters.ekf import ErrorStateFilter
from ...filters.error_model import ACCEL_BIAS, ATT, GYRO_BIAS, VEL, ErrorModel
from ...filters.errors import AlignmentError
from ...filters.rotation import FloatArray
from ...filters.strapdown import InertialStream, NavState
from ..config import AlignmentConfig, FilterConfig
from ..solution import AlignmentReport
from .gnss import GnssEvent

if TYPE_CHECKING:
    from ...alignment.in_motion.align import InertialAlignment
    from ...alignment.in_motion.waiting import MotionAligner

#: A velocity can start the filter if a position lies this close to it [s].
_POSITION_NEAR = 2.5
#: What levelling in motion looks at past its instant [s].
_LEVEL_AFTER = 0.5 * LEVEL_WINDOW + 2.0
#: Windows without a pass after which 'auto' waits no longer for a certified attitude.
_WINDOWS = 2.0
#: Share of a window's information that a start at its beginning takes: 1σ is what 3σ was.
_WEIGHT = 1.0 / 9.0


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
    """

    attitude: InitialAttitude
    state: NavState
    pos_cov_e: FloatArray
    vel_cov_e: FloatArray
    accel_bias: FloatArray = field(default_factory=lambda: np.zeros(3))
    certified: InertialAlignment | None = None
    joint_cov: FloatArray | None = None
    attempts: tuple[tuple[float, str], ...] = field(default=())

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


class StartFinder:
    """Finds the initial attitude, and position and velocity at its time, from events as they come.

    Parameters
    ----------
    stream : InertialStream
        May grow; it must reach a few samples past an event when that is offered.
    calibration : Calibration
    config : AlignmentConfig
    model : ErrorModel

    Attributes
    ----------
    waiting : str
        What is missing, in one line.
    attempts : list of (float, str)
        GPS time of each certified attempt [s], and what it was waiting for or found.
    """

    def __init__(
        self,
        stream: InertialStream,
        calibration: Calibration,
        config: AlignmentConfig,
        model: ErrorModel,
    ) -> None:
        self.stream, self.calibration, self.config, self.model = stream, calibration, config, model
        self.waiting = "no data yet"
        self.attempts: list[tuple[float, str]] = []
        angles = (config.roll_deg, config.pitch_deg, config.heading_deg)
        known = config.method == "auto" and None not in angles
        self.method = "given" if known else config.method
        self._last = -np.inf
        self._position: GnssEvent | None = None
        self._unpaired: list[GnssEvent] = []
        self._pairs: list[tuple[GnssEvent, GnssEvent]] = []
        self._counts = {"position": 0, "velocity": 0}
        self._level_at: float | None = None
        self._level_tried = False
        self._fallback: Start | None = None
        self._aligner: MotionAligner | None = None
        self._first_epoch: float | None = None

    def offer(self, event: GnssEvent) -> Start | None:
        """Take an event; return the start if there now is one.

        An event earlier than the one before comes too late to matter here and is passed over.
        """
        if event.time < self._last - 1e-9:
            return None
        self._last = event.time
        self._pair(event)
        if self.method == "given":
            return self._given()
        levelled = self._levelled(event.time) if self.method != "certified" else None
        if levelled is not None and levelled.attitude.sigma_gyro_bias is not None:
            return levelled
        certified = self._certified(event) if self.method != "level+course" else None
        if certified is not None:
            return certified
        self._fallback = self._fallback or levelled
        if self._fallback is None or self.method == "certified":
            return None
        if self._first_epoch is None or event.time >= self._deadline:
            return self._without_certificate(self._fallback)
        return None

    def close(self) -> Start:
        """Return the start from what there is: no more will come.

        Raises
        ------
        AlignmentError
            Why there is no attitude.
        """
        missing = [kind for kind, count in self._counts.items() if not count]
        if self.method == "certified":
            raise AlignmentError(self._why_not_certified())
        if missing:
            raise AlignmentError(
                f"no usable GNSS {missing[0]}, so there is nothing to start from — `certnav check` "
                "says what the recording holds"
            )
        if not self._pairs:
            raise AlignmentError(
                f"no GNSS velocity with a position within {_POSITION_NEAR} s inside the IMU data"
            )
        if self._fallback is None:
            try:
                self._fallback = self._from_pairs(self._level())
            except AlignmentError as error:
                if not self.attempts:
                    raise
                raise AlignmentError(f"{error}; {self._why_not_certified()}") from None
        return self._without_certificate(self._fallback)

    def _pair(self, event: GnssEvent) -> None:
        """Find each velocity within the IMU data its position: the last before, else the next."""
        if event.reason or event.kind not in self._counts:
            return
        self._counts[event.kind] += 1
        if event.kind == "position":
            self._position = event
        elif self.stream.edges[1] <= event.time < self.stream.end:  # a sample has ended by then
            self._unpaired.append(event)
        if self._position is None:
            return
        for velocity in self._unpaired:
            if abs(self._position.time - velocity.time) <= _POSITION_NEAR:
                self._pairs.append((velocity, self._position))
                self._note_speed(velocity, self._position)
        newest = self._position.time
        self._unpaired = [
            v for v in self._unpaired if v.time > newest + _POSITION_NEAR
        ]  # fmt: skip

    def _note_speed(self, velocity: GnssEvent, position: GnssEvent) -> None:
        up = position.value_e / np.linalg.norm(position.value_e)
        level = velocity.value_e - up * (up @ velocity.value_e)
        if self._level_at is None and np.linalg.norm(level) >= self.config.min_speed_mps:
            self._level_at = velocity.time + 1e-3  # with the epoch after it
        if self._level_at is None:
            self.waiting = f"no heading: slower than {self.config.min_speed_mps:.1f} m/s so far"

    def _given(self) -> Start | None:
        if not self._pairs:
            return None
        velocity, position = self._pairs[0]
        config = self.config
        level, heading = np.radians([config.sigma_level_deg, config.sigma_heading_deg])
        rpy = np.radians(
            np.array([config.roll_deg, config.pitch_deg, config.heading_deg], dtype=float)
        )
        return self._from_pairs(
            given_attitude(velocity.time, position.value_e, rpy, level, heading)
        )

    def _level(self) -> InitialAttitude:
        config = self.config
        track = VelocityTrack(
            np.array([v.time for v, _ in self._pairs]),
            np.array([v.value_e for v, _ in self._pairs]),
            np.array([np.sqrt(np.trace(v.cov_e) / 3.0) for v, _ in self._pairs]),
            np.array([p.value_e for _, p in self._pairs]),
        )
        level, heading = np.radians([config.sigma_level_deg, config.sigma_heading_deg])
        return level_and_course(
            self.stream, track, self.calibration.C_bv, self.model.imu,
            min_speed=config.min_speed_mps, sigma_level=level, sigma_heading=heading,
        )  # fmt: skip

    def _levelled(self, now: float) -> Start | None:
        """Level once it is fast enough: at once after a standstill, else around that instant."""
        if self._fallback is not None or self._level_at is None or now < self._level_at:
            return None
        self._level_tried = True
        try:
            attitude = self._level()
        except AlignmentError as error:
            self.waiting, self._level_at = str(error), now + 1.0
            return None
        ready = attitude.time + _LEVEL_AFTER
        if attitude.sigma_gyro_bias is None and now < ready:
            self.waiting, self._level_at = f"levelling: complete at {ready:.1f} s", ready
            return None
        return self._from_pairs(attitude)

    def _from_pairs(self, attitude: InitialAttitude) -> Start:
        """Return the start with position and velocity from GNSS, moved from antenna to IMU."""
        v, p = min(self._pairs, key=lambda pair: abs(pair[0].time - attitude.time))
        pos_e = p.value_e + v.value_e * (attitude.time - p.time)
        lever_e = attitude.C_eb @ self.calibration.lever_antenna_b
        state = NavState(
            attitude.time, pos_e - lever_e, v.value_e - self._lever_velocity(attitude),
            attitude.C_eb,
        )  # fmt: skip
        return Start(attitude, state, p.cov_e, v.cov_e)

    def _lever_velocity(self, attitude: InitialAttitude) -> FloatArray:
        """Return C_eb (ω_eb × lever), the antenna's velocity less the IMU's."""
        k = min(self.stream.index(attitude.time), self.stream.gyro.shape[0] - 1)
        omega_eb = self.stream.gyro[k] - attitude.gyro_bias - attitude.C_eb.T @ OMEGA_IE_E
        return attitude.C_eb @ np.cross(omega_eb, self.calibration.lever_antenna_b)

    def _certified(self, event: GnssEvent) -> Start | None:
        """Try on the Doppler of an event, if it has any and an attempt is due."""
        epoch, stream = event.epoch, self.stream
        if epoch is None or not stream.start <= epoch.time <= stream.end:
            return None
        if self._aligner is None:
            self._aligner, self._first_epoch = self._new_aligner(), epoch.time
        attempt = self._aligner.add(epoch, not self._levels_first(epoch.time))
        if attempt is None:
            return None
        position = self._position
        far = position is None or abs(position.time - epoch.time) > _POSITION_NEAR
        message = attempt.message
        if attempt.passed and far:
            message += f"; but no GNSS position within {_POSITION_NEAR} s to start from"
        self.attempts.append((attempt.time, message))
        self.waiting = message
        if not attempt.passed or far:
            return None
        assert attempt.alignment is not None and position is not None
        return self._from_window(attempt.alignment, position)

    def _levels_first(self, now: float) -> bool:
        """Whether 'auto' leaves it to levelling: GNSS saw a standstill first, and nothing since."""
        if self.method != "auto" or self._level_tried or not self._pairs:
            return False
        velocity, _ = self._pairs[0]
        sigma = float(np.sqrt(np.trace(velocity.cov_e) / 3.0))
        at_rest = np.linalg.norm(velocity.value_e) <= max(REST_SPEED, 3.0 * sigma)
        return bool(at_rest) and now < self._deadline

    @property
    def _deadline(self) -> float:
        """When 'auto' has waited long enough for a window [s]."""
        first = self._first_epoch
        return np.inf if first is None else first + _WINDOWS * self.config.max_window_s

    def _new_aligner(self) -> MotionAligner:
        from ...alignment.in_motion.unknowns import InertialOptions
        from ...alignment.in_motion.waiting import MotionAligner, MotionOptions
        from ...alignment.problem import ClockModel

        clock = ClockModel("random-walk", self.config.sigma_clock_walk_mps)
        options = MotionOptions(
            InertialOptions(imu=self.model.imu, clock=clock),
            longest=self.config.max_window_s,
            sigma_heading=float(np.radians(self.config.max_sigma_heading_deg)),
        )
        return MotionAligner(self.stream, self.calibration.lever_antenna_b, options)

    def _from_window(self, found: InertialAlignment, position: GnssEvent) -> Start:
        """Return the start at the first epoch of the window where its heading is good enough.

        The window is then filtered, and its Doppler used twice; `_WEIGHT` sees to it that this
        does not make the filter too sure. Without a velocity and a position of GNSS at such an
        epoch the start is at the end.
        """
        at = found.track.time
        down_e = C_en_of(found.pos_e)[:, 2]
        limit = np.radians(self.config.max_sigma_heading_deg)
        for k in map(int, np.flatnonzero(self._has_pair(at))):
            C_eb, cov = found.carried_to(k)
            if down_e @ cov[:3, :3] @ down_e <= limit**2:
                break
        else:
            return self._from_window_end(found, position)
        C_eb, cov = found.carried_to(k, _WEIGHT)
        ended = found.initial_attitude()
        message = f"{ended.message}; started {found.time - at[k]:.0f} s before its end, at 3σ"
        attitude = replace(
            ended, time=float(at[k]), C_eb=C_eb, cov_e=cov[:3, :3], message=message,
            sigma_heading=float(np.sqrt(down_e @ cov[:3, :3] @ down_e)),
        )  # fmt: skip
        start = self._from_pairs(attitude)
        joint = np.zeros((12, 12))
        inner = np.r_[0:3, 6:12]
        joint[np.ix_(inner, inner)] = cov
        joint[3:6, 3:6] = start.vel_cov_e
        return self._with_window(start, found, joint)

    def _has_pair(self, time: FloatArray) -> NDArray[np.bool_]:
        """Return at which of the times GNSS has a velocity with a position."""
        paired = np.array([v.time for v, _ in self._pairs])
        return np.any(np.abs(time[:, None] - paired) < 1e-6, axis=1)

    def _from_window_end(self, found: InertialAlignment, position: GnssEvent) -> Start:
        """Return the start at the end of a window: all but the position is from there."""
        attitude = found.initial_attitude()
        elapsed = found.time - position.time
        vel_antenna_e = found.vel_e + self._lever_velocity(attitude)
        pos_e = position.value_e + vel_antenna_e * elapsed
        lever_e = attitude.C_eb @ self.calibration.lever_antenna_b
        state = NavState(found.time, pos_e - lever_e, found.vel_e, attitude.C_eb)
        vel_cov_e = found.cov[3:6, 3:6]
        # The speed may have changed by 3 m/s/s since the position.
        moved = vel_cov_e * elapsed**2 + np.eye(3) * (1.5 * elapsed**2) ** 2
        start = Start(attitude, state, position.cov_e + moved, vel_cov_e)
        return self._with_window(start, found, found.cov)

    def _with_window(self, start: Start, found: InertialAlignment, joint_cov: FloatArray) -> Start:
        """Add what the window knows; its covariance has the attitude in e axes."""
        T = np.eye(12)
        T[:3, :3] = start.state.C_eb.T
        return replace(
            start, accel_bias=found.accel_bias, certified=found, joint_cov=T @ joint_cov @ T.T,
            attempts=tuple(self.attempts),
        )  # fmt: skip

    def _without_certificate(self, start: Start) -> Start:
        """Return a levelled start with the reason why it is not a certified one."""
        attitude = start.attitude
        if self.attempts:
            message = f"{attitude.message}; {self._why_not_certified()}"
            attitude = replace(attitude, message=message)
        return replace(start, attitude=attitude, attempts=tuple(self.attempts))

    def _why_not_certified(self) -> str:
        if self._first_epoch is None:
            return (
                "alignment.method 'certified' needs raw Doppler with satellite states: "
                "observations and navigation files"
            )
        if not self.attempts:
            return "not certified: less than 5 s of Doppler within the IMU data"
        time, message = self.attempts[-1]
        after, count = time - self._first_epoch, len(self.attempts)
        return f"not certified in {count} attempts, the last after {after:.0f} s: {message}"


def find_start(
    events: tuple[GnssEvent, ...],
    stream: InertialStream,
    calibration: Calibration,
    config: AlignmentConfig,
    model: ErrorModel,
) -> Start:
    """Find the start of a recording.

    Raises
    ------
    AlignmentError
        Why there is no attitude.
    """
    finder = StartFinder(stream, calibration, config, model)
    for event in events:
        start = finder.offer(event)
        if start is not None:
            return start
    return finder.close()


def start_filter(
    start: Start,
    stream: InertialStream,
    calibration: Calibration,
    model: ErrorModel,
    config: FilterConfig,
) -> ErrorStateFilter:
    """Hand the start to the filter."""
    attitude = start.attitude
    pos_cov = start.pos_cov_e + np.eye(3) * calibration.lever_antenna_sigma**2
    att_cov_b = attitude.C_eb.T @ attitude.cov_e @ attitude.C_eb
    P = model.initial_covariance(pos_cov, start.vel_cov_e, att_cov_b)
    if start.joint_cov is not None:
        filled = np.r_[ATT, VEL, GYRO_BIAS, ACCEL_BIAS]
        P[np.ix_(filled, filled)] = start.joint_cov
    elif attitude.sigma_gyro_bias is not None:
        P[GYRO_BIAS, GYRO_BIAS] = np.eye(3) * attitude.sigma_gyro_bias**2
    rate = config.output_rate_hz
    interval = 1.0 / rate if rate > 0 else 0.0
    return ErrorStateFilter(
        model, stream, start.state, P, interval, attitude.gyro_bias, config.smooth,
        accel_bias=start.accel_bias,
    )  # fmt: skip
