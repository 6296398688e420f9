"""Where else could it be? A ball of positions and rotations that contracts on what was found.

The joint cost (`alignment.anywhere.joint`) is a linearisation. Let every true residual be the
linear one and a remainder, and let the truth be known to lie within r of the position found. Then,
whatever rotation and position in that ball have a cost of no more than F + T, F what was found,

    √(linear cost of R) ≤ √(F + T) + B(r, θ),        B a bound on the whitened remainders,

so that the certified bound on rotations (`alignment.solver.attitude_bound`) with the threshold
(√(F + T) + B)² − F holds for the true cost as well; and the position that goes with a rotation
within θ is off by no more than what the linear solution gives, B and noise included. Both are
smaller than what was put in, or they are not: where they contract the truth is in the last ball,
and where they do not nothing is claimed.

Remainders, w = δp + (R − R̂)s, |w| ≤ r + 2 sin(θ/2)|s|:

    ½ δp·h·δp and (J δp)·(R − R̂)v                of all rows together, projected: spectral norms
    δp·h·(R − R̂)s, ½ s·h·s, e of second order,
    z of third, time, light time, rounding       row by row, their norm

with derivatives of a length ρ = |r − p|: 1/ρ, 1.155/ρ² and 3/ρ³ are the largest of second, third
and fourth order (of √(1 + 2cε + ε²) the coefficients of ε²…ε⁴, at the c where they are largest).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...filters.rotation import FloatArray
from ..result import AlignmentResult
from ..solver.attitude_bound import attitude_bound, region_threshold
from ..solver.fast_solver import FastMinimum
from .joint import UNIT, Joint
from .signals import acceleration

#: Largest third and fourth derivatives of a length, in 1/ρ² and 1/ρ³.
THIRD, FOURTH = 2.0 / np.sqrt(3.0), 3.0
#: What differences leave of ∂z/∂p, what J and h are off by (κ, light time: some v/c), and rounding
#: [m/s].
_SLOPE, _TURN, _ROUNDING = 1e-8, 1e-4, 1e-7
#: How far time and scale may be off beyond what is known of them, in σ.
_SIGMAS = 4.0
#: Rounds at most, and how much smaller a ball must get for another.
_ROUNDS, _WORTH = 60, 0.999


@dataclass(frozen=True)
class Ball:
    """All positions and rotations that the signals allow within a ball.

    Attributes
    ----------
    within : float
        Radius of the ball about the position found that was asked about [m].
    radius : float
        Of the ball it contracted to [m].
    bound : float
        Every rotation is within this angle of that found [rad]; π if nothing is proved.
    remainder : float
        B of the last ball, in σ: what of the noise-like cost is not linear.
    """

    within: float
    radius: float
    bound: float
    remainder: float

    @property
    def contracts(self) -> bool:
        """Whether it is smaller than what it began as."""
        return self.radius < self.within


def contracted(joint: Joint, result: AlignmentResult, within: float, probability: float) -> Ball:
    """Return the ball around the place of a joint cost that the signals allow.

    Parameters
    ----------
    joint : Joint
        With exact derivatives, linearised at its own solution.
    result : AlignmentResult
        Of it.
    within : float
        The antenna is within this of the joint's position at the beginning [m].
    probability : float
        Of the χ² region, six degrees of freedom for attitude and position.
    """
    minimum = result.minimum
    assert isinstance(minimum, FastMinimum)  # of `alignment.verdict.judge`
    remainders = _Remainders(joint)
    # The row of what is known beforehand adds less than one to the cost of a truth within radius.
    threshold = result.inflation * (region_threshold(probability, 6) + 1.0)
    threshold *= (1.0 + _SIGMAS * joint.known.speed_scale_sigma) ** 2
    cost = result.cost
    total, offset = cost + threshold, UNIT * float(np.linalg.norm(joint.unknowns(result.C_ew)[:3]))
    radius, angle, rest = within, np.pi, np.inf
    for _ in range(_ROUNDS):
        if not remainders.holds(radius):
            break
        rest, _ = remainders.of(radius, angle)
        narrower = min(angle, attitude_bound(minimum, (np.sqrt(total) + rest) ** 2 - cost))
        rest, moved = remainders.of(radius, narrower)
        noise = np.sqrt(max(total - max(0.0, np.sqrt(cost) - rest) ** 2, 0.0))
        smaller = (
            offset + remainders.by_rotation * _chord(narrower) + moved
            + remainders.by_noise * noise
        )  # fmt: skip
        shrunk = smaller < _WORTH * radius or narrower < _WORTH * angle
        radius, angle = min(radius, smaller), narrower
        if not shrunk:
            break
    return Ball(within, radius, angle, rest)


def _chord(angle: float) -> float:
    """Return ‖R − R̂‖ of rotations so far apart, Frobenius."""
    return float(2.0 * np.sqrt(2.0) * np.sin(0.5 * min(angle, np.pi)))


class _Remainders:
    """What linearisation leaves out, as functions of the ball and the angle."""

    def __init__(self, joint: Joint) -> None:
        self.joint, sight = joint, joint.sight
        self.sigma = joint.signals.sigma
        self.speed = np.linalg.norm(joint.vel_w, axis=1)
        self.way = np.linalg.norm(joint.moved_w, axis=1)
        self.rate = np.linalg.norm(sight.sat_vel, axis=1)
        h = sight.curvature()
        self.curve = np.linalg.norm(h, axis=(1, 2))
        self.slope = np.linalg.norm(joint.by_pos, axis=1)
        force = acceleration(joint.signals.sat_pos_e, sight.sat_vel)
        self.force = np.linalg.norm(force, axis=1)
        m = joint.stack.shape[1] - 10
        size = np.maximum(np.linalg.norm(joint.stack[:, :m], axis=0), 1e-300)
        columns = joint.stack[:, :m] / size
        self._basis = np.linalg.qr(columns)[0]
        place = slice(joint.clocks, joint.clocks + 3)
        #: Rows to δp [m], the sign aside.
        self._to_place = UNIT * (np.linalg.pinv(columns) / size[:, None])[place]
        self.by_noise = _norm(self._to_place)
        self.by_rotation = UNIT * _norm(joint.problem.nuisance[place, :9])
        e, distance = sight.e, sight.distance[:, None, None]
        J = (e[:, :, None] * e[:, None, :] - np.eye(3)) / distance
        turn = J[:, :, :, None] * joint.vel_w[:, None, None, :]
        self.curved = self._norms(h.reshape(-1, 9))
        self.turned = self._norms(turn.reshape(-1, 27))

    def _norms(self, matrix: FloatArray) -> tuple[float, float]:
        """Return the norms of what rows do to the cost, and to δp [m]."""
        white = self.joint.known.clock.whiten(self.joint.rows, matrix)
        full = np.zeros((len(self._basis), matrix.shape[1]))
        full[: len(white)] = white
        across = full - self._basis @ (self._basis.T @ full)
        return _norm(across), _norm(self._to_place @ full)

    def holds(self, radius: float) -> bool:
        """Return whether satellites are far enough for the series to be one."""
        return bool(radius + 2.0 * self.way.max() < 0.5 * self.joint.sight.distance.min())

    def of(self, radius: float, angle: float) -> tuple[float, float]:
        """Return bounds of the remainders in the cost [σ], and in δp [m]."""
        rows = float(np.linalg.norm(self._row_by_row(radius, angle) / self.sigma))
        level = self.joint.known.level_sigma
        if level is not None:
            # Of the vertical's turn the second order, and what ellipsoid and height make of |p|.
            turn = radius / float(np.linalg.norm(self.joint.place.pos_e))
            rows = float(np.hypot(rows, (0.75 * turn**2 + 0.01 * turn) / level))
        chord = _chord(angle)
        cost, place = (
            0.5 * radius**2 * curved + radius * chord * turned
            for curved, turned in zip(self.curved, self.turned, strict=True)
        )
        return cost + rows, place + self.by_noise * rows

    def _row_by_row(self, radius: float, angle: float) -> FloatArray:
        """Return a bound on what is left of each row [m/s]."""
        known = self.joint.known
        turn = 2.0 * np.sin(0.5 * min(angle, np.pi))
        way, reach = turn * self.way, radius + turn * self.way
        near = self.joint.sight.distance - reach
        left = self.curve * (radius * way + 0.5 * way**2 + _TURN * radius**2)
        left += FOURTH / 6.0 * self.rate * reach**3 / near**3
        left += 0.5 * THIRD * self.speed * reach**2 / near**2 + way * self.speed / near
        left += _SLOPE * self.slope * reach + _TURN * self.speed * radius / near + _ROUNDING
        if known.speed_scale_sigma:
            # δp is counted in the measure of the speeds given.
            scale = _SIGMAS * known.speed_scale_sigma
            left += scale * radius * self.speed / near
        if known.time_sigma:
            late = _SIGMAS * known.time_sigma
            across = self.force / near + THIRD * self.rate**2 / near**2
            jerk = 3.0 * self.force * self.rate / near + THIRD * self.rate**3 / near**2
            # In a circular orbit the force turns by 1.5e-4 rad/s, and the Earth by half that.
            left += 0.5 * late**2 * (jerk + 3e-4 * self.force)
            left += late * (reach * across + self.rate * self.speed * turn / near)
        return np.asarray(left)


def _norm(matrix: FloatArray) -> float:
    return float(np.linalg.norm(matrix, 2))
