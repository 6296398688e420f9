"""The methods that `certnav compare` sets against each other.

==================  ============================================================================
gnss-only           positions and velocities as GNSS has them, interpolated between neighbouring
                    epochs, held where there are none; no IMU
alignment-only      starts like every other run, then the IMU alone
certified-only      starts certified, from IMU and Doppler in motion and from the latest position,
                    however old; then the IMU alone
lc4                 loose coupling with four satellites and more; below, inertial
lc+ddia             and DDIA-VE's velocity from two or three
lc+rows             and each satellite difference as a measurement from two or three
alignment-heading   heading of sliding-window alignment: no position (`nav.windows.recording`)
==================  ============================================================================

``+vehicle`` adds the vehicle constraints as they are configured, ``+smooth`` the smoother.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ...datasets.sequence import Sequence
from ...filters.earth import C_en_of
from ...filters.errors import AlignmentError, ConfigError
from ...filters.rotation import FloatArray, matrix_from_rpy
from ..config import Config
from ..engine.events import GnssEvent
from ..engine.gnss import GnssTimeline
from ..engine.prepared import Prepared, without_constraints
from ..evaluation.interpolation import covered
from ..notes import plain
from ..pipeline import navigate
from ..solution import AlignmentReport, Solution, Trajectory, Update

#: Below this speed the course of a GNSS velocity is no heading; the last one is held [m/s].
_MIN_SPEED = 2.0
_SENTENCES = {
    "gnss": "Positions and velocities as GNSS has them, interpolated between epochs, held where "
    "there are none; no IMU.",
    "inertial": "The start that every run has, with GNSS until it is found; then the IMU alone.",
    "certified": "An attitude certified in motion from IMU and Doppler, with the latest position "
    "until then; then the IMU alone.",
    "off": "Loose coupling with four satellites and more; below four the IMU alone.",
    "ddia": "Loose coupling; from two or three satellites the velocity of DDIA-VE.",
    "rows": "Loose coupling; from two or three satellites each difference of their Doppler as a "
    "measurement.",
    "windows": "Heading of sliding windows, each aligned for itself from Doppler and odometer, or "
    "from Doppler and IMU where there is none; no position.",
}
#: Kinds that have no GNSS once there is a start.
ALONE = ("inertial", "certified")
#: An epoch is in force for so many median intervals.
_IN_FORCE = 2.5


@dataclass(frozen=True)
class Method:
    """One way to navigate.

    Parameters
    ----------
    name : str
    kind : {'gnss', 'inertial', 'certified', 'loose', 'windows'}
    below_four : {'off', 'ddia', 'rows'}
    vehicle, smooth : bool
    """

    name: str
    kind: str = "loose"
    below_four: str = "off"
    vehicle: bool = False
    smooth: bool = False

    @property
    def sentence(self) -> str:
        """What it does, for people."""
        words = _SENTENCES[self.below_four if self.kind == "loose" else self.kind]
        words += " The vehicle's constraints hold throughout, as configured." * self.vehicle
        return words + " Smoothed: every epoch knows what came after it." * self.smooth

    def config(self, base: Config) -> Config:
        """Return the configuration that makes a run this method."""
        alignment = base.alignment
        if self.kind == "certified":
            # Where it is may be known less well than how it stands: what drifts is judged anyway.
            alignment = dataclasses.replace(
                alignment, method="certified", position_age_s=float("inf")
            )
        return dataclasses.replace(
            base if self.vehicle else without_constraints(base),
            alignment=alignment,
            filter=dataclasses.replace(base.filter, smooth=self.smooth),
            gnss=dataclasses.replace(base.gnss, below_four=self.below_four),
        )


def _all() -> dict[str, Method]:
    bases = (
        ("alignment-only", "inertial", "off"),
        ("certified-only", "certified", "off"),
        ("lc4", "loose", "off"),
        ("lc+ddia", "loose", "ddia"),
        ("lc+rows", "loose", "rows"),
    )
    made = [Method("gnss-only", "gnss")]
    for smooth in (False, True):
        for vehicle in (False, True):
            for name, kind, below_four in bases:
                if not (smooth and kind in ("inertial", "certified")):
                    full = name + "+vehicle" * vehicle + "+smooth" * smooth
                    made.append(Method(full, kind, below_four, vehicle, smooth))
    made.append(Method("alignment-heading", "windows"))
    return {method.name: method for method in made}


METHODS = _all()


def parse_methods(text: str) -> list[Method]:
    """Return the methods of a comma-separated list; 'all' is all.

    Raises
    ------
    ConfigError
        An unknown one, with the nearest known.
    """
    if text.strip() == "all":
        return list(METHODS.values())
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in METHODS:
            raise ConfigError.unknown_key(name, METHODS, where="--methods")
    if not names:
        raise ConfigError("--methods: expected at least one")
    return [METHODS[name] for name in dict.fromkeys(names)]


def solve(
    sequence: Sequence,
    method: Method,
    config: Config,
    alignment: AlignmentReport,
    prepared: Prepared | None = None,
) -> Solution:
    """Return the solution of one method.

    Parameters
    ----------
    sequence : Sequence
        Degraded.
    method : Method
        Of any kind but 'windows', which has no trajectory.
    config : Config
    alignment : AlignmentReport
        Of the run without spells: GNSS alone is judged from there on.
    prepared : Prepared, optional
        What the methods have in common on `sequence`.

    Raises
    ------
    NavError
        Why there is none.
    """
    prepared = prepared or Prepared(sequence)
    own = method.config(config)
    if method.kind == "gnss":
        return gnss_only(sequence, own, alignment, prepared.timeline(own))
    if method.kind in ALONE:
        start, _ = prepared.start(own)
        return navigate(sequence, own, prepared=prepared, until=start.known)
    return navigate(sequence, own, prepared=prepared)


def gnss_only(
    sequence: Sequence, config: Config, alignment: AlignmentReport, timeline: GnssTimeline
) -> Solution:
    """Return GNSS positions and velocities as a trajectory of the IMU, without using the IMU.

    The lever arm is taken off with the course as heading, level. Where epochs are missing, the
    last position and velocity are held: a receiver that has lost its satellites knows no more.

    Raises
    ------
    AlignmentError
        If there are no positions.
    """
    positions = _usable(timeline.events, "position")
    if not positions:
        raise AlignmentError(f"{sequence.name}: no GNSS positions")
    time = np.array([e.time for e in positions])
    pos_e = np.array([e.value_e for e in positions])
    C_en = C_en_of(pos_e)
    vel_e, vel_cov_e = _velocities_at(time, pos_e, _usable(timeline.events, "velocity"))
    vel_n = np.einsum("nji,nj->ni", C_en, vel_e)
    heading = _held_course(vel_n)
    C_nb = matrix_from_rpy(np.column_stack([np.zeros((time.size, 2)), heading]))
    C_eb = C_en @ C_nb
    nothing = np.zeros((time.size, 3))
    trajectory = Trajectory(
        time=time,
        pos_e=pos_e - C_eb @ sequence.calibration.lever_antenna_b,
        vel_e=vel_e,
        C_eb=C_eb,
        gyro_bias=nothing,
        accel_bias=nothing,
        cov_pos_n=_to_ned(C_en, np.array([e.cov_e for e in positions])),
        cov_vel_n=_to_ned(C_en, vel_cov_e),
        cov_att_n=np.full((time.size, 3, 3), np.nan),
        std_gyro_bias=nothing,
        std_accel_bias=nothing,
    )
    trajectory = _with_holds(trajectory, alignment.time, float(sequence.inertial.time[-1]))
    updates = tuple(
        Update(e.time, e.kind, e.satellites, accepted=not e.reason, reason=e.reason)
        for e in timeline.events
    )
    return Solution(
        sequence.name, trajectory, updates, alignment, timeline.epochs,
        (*plain([*sequence.notes, "GNSS alone: the IMU was not used"]), *timeline.notes),
    )  # fmt: skip


def fresh(solution: Solution, method: Method, time: FloatArray) -> np.ndarray:
    """Return True where the method has a solution of its own at `time`, not a held one."""
    node = solution.trajectory.time
    if method.kind != "gnss":
        return covered(node, time, 1.0)
    at = np.array([u.time for u in solution.updates if u.kind == "position" and u.accepted])
    limit = _IN_FORCE * float(np.median(np.diff(at))) if at.size > 1 else 1.0
    last = np.searchsorted(at, time + 1e-6, side="right") - 1
    held: np.ndarray = (last >= 0) & (time - at[np.maximum(last, 0)] <= limit)
    return held


def _usable(events: tuple[GnssEvent, ...], kind: str) -> list[GnssEvent]:
    chosen = [e for e in events if e.kind == kind and not e.reason]
    keep = np.diff([e.time for e in chosen], prepend=-np.inf) > 0
    return [e for e, k in zip(chosen, keep, strict=True) if k]


def _velocities_at(
    time: FloatArray, pos_e: FloatArray, velocities: list[GnssEvent]
) -> tuple[FloatArray, FloatArray]:
    """Return the velocity nearest to each position, else differenced positions."""
    if not velocities:
        vel_e = np.gradient(pos_e, time, axis=0) if time.size > 1 else np.zeros_like(pos_e)
        return vel_e, np.tile(np.eye(3), (time.size, 1, 1))
    at = np.array([e.time for e in velocities])
    nearest = np.abs(time[:, None] - at[None]).argmin(axis=1) if at.size < 20_000 else None
    if nearest is None:
        nearest = np.clip(np.searchsorted(at, time), 0, at.size - 1)
    return (
        np.array([velocities[k].value_e for k in nearest]),
        np.array([velocities[k].cov_e for k in nearest]),
    )


def _held_course(vel_n: FloatArray) -> FloatArray:
    """Return the course, held below `_MIN_SPEED` (0 before the first motion) [rad]."""
    moving = np.hypot(vel_n[:, 0], vel_n[:, 1]) >= _MIN_SPEED
    last = np.maximum.accumulate(np.where(moving, np.arange(moving.size), -1))
    course = np.arctan2(vel_n[:, 1], vel_n[:, 0])
    return np.where(last >= 0, course[np.maximum(last, 0)], 0.0)


def _to_ned(C_en: FloatArray, cov_e: FloatArray) -> FloatArray:
    return np.swapaxes(C_en, 1, 2) @ cov_e @ C_en


def _with_holds(trajectory: Trajectory, begin: float, end: float) -> Trajectory:
    """Return the part from `begin` to `end` with the last epoch repeated where some are missing."""
    time = trajectory.time
    step = float(np.median(np.diff(time))) if time.size > 1 else 1.0
    inside = np.arange(begin, end, step)
    wanted = np.union1d(time[(time >= begin) & (time <= end)], inside[_lonely(time, inside, step)])
    source = np.maximum(np.searchsorted(time, wanted + 1e-9, side="right") - 1, 0)
    held = {f.name: getattr(trajectory, f.name)[source] for f in dataclasses.fields(trajectory)}
    return Trajectory(**(held | {"time": wanted}))


def _lonely(time: FloatArray, at: FloatArray, step: float) -> np.ndarray:
    """Return True where the epochs around `at` are further apart than a neighbour's step."""
    after = np.searchsorted(time, at, side="right")
    before = np.where(after > 0, time[np.maximum(after - 1, 0)], -np.inf)
    following = np.where(after < time.size, time[np.minimum(after, time.size - 1)], np.inf)
    lonely: np.ndarray = following - before > _IN_FORCE * step
    return lonely
