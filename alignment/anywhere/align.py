"""Attitude from Doppler alone, from hundreds of kilometres away; position and time by the way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...datasets.observations import GnssObservations
from ...filters.error_model import ODOMETER_SCALE_SIGMA
from ...filters.errors import AlignmentError, ConfigError
from ...filters.rotation import FloatArray
from ..local_velocity import LocalTrack
from ..problem import ClockModel
from ..result import AlignmentResult, Ask, Verdict
from ..solver.fast_solver import fast_minimum
from ..solver.refinement import rotation_angle
from ..verdict import VerdictLimits, judge
from .ball import Ball, contracted
from .joint import UNIT, Joint, Known, Place
from .signals import Signals

#: Rounds at most, and the changes that end them [m], [rad]: a hundredth of what Doppler resolves.
_ROUNDS, _STILL, _STEADY = 25, 1.0, 1e-6
#: Furthest step of a round, as a share of the radius: the second order stays below the first.
_STEP = 1.0
#: Residual, in σ, from which a row is not believed, rounds of that, and the share beyond which
#: rejecting does not pass: that of alignment in motion.
_CUTOFF, _REJECTIONS, _MINORITY = 3.5, 6, 0.1
#: Fewest rows: three for the rotation and the position each, one for the clock, one that checks.
_FEWEST = 8


@dataclass(frozen=True, eq=False)
class AnywhereAlignment:
    """An attitude without a position, and the position that goes with it.

    Attributes
    ----------
    result : AlignmentResult
        `C_ew` takes local axes to ECEF. BOUNDED, and the bound, hold for the true cost everywhere
        within `radius` of where it was said to be near, not for a linearisation alone.
    located : Verdict
        Whether the truth is proved to be in a smaller ball than what was known.
    start : float
        Beginning of the track [s].
    pos_e : ndarray, shape (3,)
        Antenna at that time [m].
    pos_cov_e : ndarray, shape (3, 3)
        Its covariance [m²].
    radius : float
        The antenna is within this of `pos_e` [m]: proved as far as χ² goes where it is located,
        else what was known.
    late : float
        By how much the stamps were early [s]; 0 where they were taken as exact.
    speed_scale : float
        By how much speeds are too small, relative.
    inliers : ndarray of bool, shape (k,)
        Signals that were believed.
    rounds : int
        Linearisations it took.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import align_anywhere
    >>> from certnav.alignment.reference.earth_windows import displaced, earth_window
    >>> rng = np.random.default_rng(2)
    >>> window = earth_window(rng, 7, 30.0, noise=False)
    >>> near = displaced(rng, window.pos_e, 1e5)  # 100 km away
    >>> found = align_anywhere(window.signals, window.track, near, 1.5e5, speed_scale_sigma=0.0)
    >>> found.located.passed, bool(found.radius < 1.5e5), bool(found.inliers.all())
    (True, True, True)
    """

    result: AlignmentResult
    located: Verdict
    start: float
    pos_e: FloatArray
    pos_cov_e: FloatArray
    radius: float
    late: float
    speed_scale: float
    inliers: NDArray[np.bool_]
    rounds: int

    def __repr__(self) -> str:
        where = self.located.message
        return f"<AnywhereAlignment {where}: {self.result!r}>"

    @property
    def passed(self) -> bool:
        """The overall verdict on the attitude."""
        return self.result.passed

    @property
    def C_ew(self) -> FloatArray:
        """The attitude."""
        return self.result.C_ew

    @property
    def bound(self) -> float:
        """Every attitude that the signals allow is within this angle [rad]."""
        return self.result.bound

    @property
    def message(self) -> str:
        """One line for the log."""
        return f"{self.result.message}; {self.located.message}"


def align_anywhere(
    rows: Signals | GnssObservations,
    track: LocalTrack,
    near: ArrayLike,
    radius: float,
    height_sigma: float | None = None,
    time_sigma: float = 0.0,
    speed_scale_sigma: float = ODOMETER_SCALE_SIGMA,
    *,
    clock: ClockModel | None = None,
    correlated: float = 1.0,
    limits: VerdictLimits | None = None,
    level_sigma: float | None = None,
    robust: bool = True,
) -> AnywhereAlignment:
    """Find attitude and position from Doppler and local velocity, the place being unknown.

    Parameters
    ----------
    rows : Signals or GnssObservations
        Doppler with the satellites' states; what lies outside the track is left out.
    track : LocalTrack
        The vehicle's own idea of its motion.
    near : array_like, shape (3,)
        ECEF [m].
    radius : float
        The antenna is within this of `near` when the track begins [m]; what is claimed of attitude
        and position rests on that.
    height_sigma : float, optional
        1σ with which its height above the ellipsoid is that of `near` [m]. Default: unknown; three
        satellites need it.
    time_sigma : float
        1σ of the time stamps [s]; 0: exact. A tenth of a second is.
    speed_scale_sigma : float
        1σ of the relative error of the track's speeds.
    clock : ClockModel, optional
        Default: a random walk of 0.1 m/s/√s.
    correlated : float
        How many successive rows of a satellite say what one independent row would.
    limits : VerdictLimits, optional
    level_sigma : float, optional
        1σ per axis with which the track's z axis points down [rad]: 0.035 of a car on a road.
        Default: unknown.
    robust : bool
        Whether rows may be rejected; if more than a tenth are, the result does not pass.

    Raises
    ------
    AlignmentError
        If there are too few rows within the track.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import align_anywhere
    >>> from certnav.alignment.reference.earth_windows import displaced, earth_window
    >>> rng = np.random.default_rng(2)
    >>> window = earth_window(rng, 7, 30.0, noise=False)
    >>> near = displaced(rng, window.pos_e, 1e5)  # 100 km away
    >>> found = align_anywhere(window.signals, window.track, near, 1.5e5, speed_scale_sigma=0.0)
    >>> found.passed, bool(np.linalg.norm(found.pos_e - window.pos_e) < 10.0)  # [m]
    (True, True)
    """
    signals = rows if isinstance(rows, Signals) else Signals.of(rows)
    if not 1.0 <= correlated < np.inf:
        raise ConfigError(f"align_anywhere: expected correlated ≥ 1, found {correlated!r}")
    known = Known(
        np.asarray(near, dtype=float), radius, height_sigma, time_sigma, speed_scale_sigma,
        clock or ClockModel("random-walk", 0.1), level_sigma,
    )  # fmt: skip
    limits, inside = limits or VerdictLimits(), _inside(signals, track)
    window = _Window(signals.take(inside).wider(float(np.sqrt(correlated))), track, known)
    settled = window.settle(_CUTOFF / float(np.sqrt(correlated)) if robust else np.inf)
    inliers = np.zeros(len(signals), dtype=bool)
    inliers[np.flatnonzero(inside)[settled.keep]] = True
    return _judged(window, settled, limits, correlated, inliers)


def _inside(signals: Signals, track: LocalTrack) -> NDArray[np.bool_]:
    inside = (signals.time >= track.time[0]) & (signals.time <= track.time[-1])
    if int(inside.sum()) < _FEWEST:
        raise AlignmentError(
            f"{int(inside.sum())} Doppler rows within the track, {_FEWEST} are the fewest that "
            "determine attitude and position: keep waiting"
        )
    return np.asarray(inside)


@dataclass(frozen=True, eq=False)
class _Settled:
    """Where the rounds ended."""

    place: Place
    keep: NDArray[np.bool_]
    rounds: int
    still: bool


class _Window:
    """Signals with the velocities that go with them."""

    def __init__(self, signals: Signals, track: LocalTrack, known: Known) -> None:
        self.signals, self.known, self.start = signals, known, float(track.time[0])
        self.vel_w = track.velocity_at(signals.time)
        self.moved_w = track.moved_at(signals.time)

    def joint(self, place: Place, keep: NDArray[np.bool_], *, exact: bool = False) -> Joint:
        """Return the cost linearised at a place."""
        return Joint(
            self.signals.take(keep), self.vel_w[keep], self.moved_w[keep], self.known, place,
            exact=exact,
        )  # fmt: skip

    def settle(self, cutoff: float) -> _Settled:
        """Linearise and solve by turns, and leave out what does not agree."""
        keep = np.ones(len(self.signals), dtype=bool)
        settled = self._rounds(Place(self.known.near), keep)
        for _ in range(_REJECTIONS if np.isfinite(cutoff) else 0):
            agree = self._residuals(settled) <= cutoff * self.signals.sigma
            if np.array_equal(agree, settled.keep) or int(agree.sum()) < _FEWEST:
                break
            settled = self._rounds(settled.place, agree)
        return settled

    def _rounds(self, place: Place, keep: NDArray[np.bool_]) -> _Settled:
        """Return the place at which the linearisation is its own solution."""
        longest = _STEP * self.known.radius
        for number in range(1, _ROUNDS + 1):
            joint = self.joint(place, keep)
            C_ew = fast_minimum(joint.problem.Q, factor=joint.problem.factor).C
            unknowns = joint.unknowns(C_ew)
            step = UNIT * unknowns[:3]
            length = float(np.linalg.norm(step))
            turned = np.pi if place.C_ew is None else float(rotation_angle(C_ew, place.C_ew))
            late = float(unknowns[3]) if self.known.time_sigma else 0.0
            step *= min(1.0, longest / max(length, 1e-300))
            place = Place(place.pos_e + step, C_ew, place.late + late)
            if not 1e6 < float(np.linalg.norm(place.pos_e)) < 2e7:
                return _Settled(replace(place, pos_e=self.known.near), keep, number, False)
            if length < _STILL and turned < _STEADY and abs(late) < 1e-3:
                return _Settled(place, keep, number, True)
        return _Settled(place, keep, _ROUNDS, False)

    def _residuals(self, settled: _Settled) -> FloatArray:
        """Return |residual| of every row against the median of those believed of its epoch [m/s].

        No cost is asked what a row rejected has to say.
        """
        joint, keep = self.joint(settled.place, np.ones(len(self.signals), bool)), settled.keep
        assert settled.place.C_ew is not None
        turned = self.vel_w @ settled.place.C_ew.T
        left = np.sum(joint.sight.e_e * turned, axis=1) - joint.sight.z
        for time in np.unique(self.signals.time):
            here = self.signals.time == time
            believed = here & keep
            left[here] -= np.median(left[believed if believed.any() else here])
        return np.abs(left)


def _judged(
    window: _Window, settled: _Settled, limits: VerdictLimits, correlated: float,
    inliers: NDArray[np.bool_],
) -> AnywhereAlignment:  # fmt: skip
    """Return the verdicts at the place found."""
    joint = window.joint(settled.place, settled.keep, exact=True)
    known, place, problem = window.known, settled.place, joint.problem
    if correlated > 1.0:
        lost = int(settled.keep.sum() * (1.0 - 1.0 / correlated))
        problem = replace(problem, dof=problem.dof - lost)
    result = judge(problem, limits=limits)
    off = float(np.linalg.norm(place.pos_e - known.near))
    ball = Ball(known.radius + off, known.radius + off, np.pi, np.inf)
    if settled.still and joint.determined:
        ball = contracted(joint, result, known.radius + off, limits.probability)
    bounded = _bounded(ball, limits, settled.still)
    verdicts = tuple(bounded if v.name is Ask.BOUNDED else v for v in result.verdicts)
    result = replace(result, verdicts=verdicts, bound=ball.bound)
    if not settled.keep.all():
        result = result.asked_further(_consensus(settled.keep))
    # What χ² says of a place rests on rows that agree with each other and with their weights.
    sound = all(v.passed for v in result.verdicts if v.name in (Ask.CONSISTENT, Ask.CONSENSUS))
    unknowns = joint.unknowns(result.C_ew)
    scale = float(unknowns[-1]) if known.speed_scale_sigma else 0.0
    cov = result.inflation * joint.covariance(result.C_ew)
    return AnywhereAlignment(
        result, _located(ball, sound), window.start, place.pos_e, cov,
        ball.radius if sound else ball.within, place.late, scale / (1.0 - scale), inliers,
        settled.rounds,
    )  # fmt: skip


def _bounded(ball: Ball, limits: VerdictLimits, still: bool) -> Verdict:
    passed = ball.bound <= limits.bound
    if passed:
        text = f"attitude within {np.degrees(ball.bound):.2g}°, wherever it is"
    elif not still:
        text = "position and attitude do not settle: needs a turn or more satellites"
    elif ball.bound < np.pi:
        text = (
            f"attitude bound {np.degrees(ball.bound):.0f}° (limit "
            f"{np.degrees(limits.bound):.0f}°), needs a turn, more satellites or a smaller radius"
        )
    else:
        text = "no attitude bound, needs a turn, more satellites or a smaller radius"
    return Verdict(Ask.BOUNDED, passed, ball.bound, limits.bound, text)


def _located(ball: Ball, sound: bool) -> Verdict:
    near, within = ball.radius / 1e3, ball.within / 1e3
    passed = ball.contracts and sound
    if passed:
        text = f"within {near:.3g} km of where it was found"
    elif ball.contracts:
        text = "not located: the rows do not agree"
    else:
        text = f"not located: nothing smaller than {within:.3g} km is proved"
    return Verdict(Ask.LOCATED, passed, ball.radius, ball.within, text)


def _consensus(keep: NDArray[np.bool_]) -> Verdict:
    share, limit = float(np.mean(keep)), 1.0 - _MINORITY
    text = f"{int(keep.sum())} of {keep.size} rows agree"
    if share < limit:
        text += f", {100.0 * limit:.0f} % are needed"
    return Verdict(Ask.CONSENSUS, share >= limit, share, limit, text)
