"""Attitude and position in one quadratic cost, linearised at a position and a rotation.

With the antenna at p̂ + R̂s when the Doppler came, s the way since the beginning in local axes, a
position p̂ + δp and a rotation R move it by w = δp + (R − R̂)s. A row is then, g and J those of
`alignment.anywhere.signals`,

    e·R v − g·R s − (z − g·R̂s) − g·δp + (J δp)·R̂v − cδṫ = noise,

linear in vec(R), δp and the clock: the same cost, the same solver, the same proof as with a known
position. The speed's scale turns v and s into (1 + σ)v and (1 + σ)s; divided by that, everything
is as before but (1 − σ′)(z − g·R̂s), and δp and the clock are counted in the same measure. An error
of time moves the satellites. What is of second order vanishes as the linearisation is repeated.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...filters.earth import C_en_of, ecef_to_lla
from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray
from ..problem import AlignmentProblem, ClockModel
from ..rows import AlignmentRows
from ..solver.constraints import lift
from ..solver.elimination import eliminated
from .signals import Signals

#: Unit of positions among the unknowns [m]: numbers near one.
UNIT = 1e3


@dataclass(frozen=True, eq=False)
class Known:
    """What is known beforehand.

    Parameters
    ----------
    near : ndarray, shape (3,)
        ECEF [m]; the antenna is within `radius` of it at the beginning.
    radius : float
        [m].
    height_sigma : float, optional
        1σ with which its height above the ellipsoid is that of `near` [m]; None: unknown.
    time_sigma : float
        1σ of the time stamps [s]; 0: exact.
    speed_scale_sigma : float
        1σ of the relative error of the speeds; 0: exact.
    clock : ClockModel
    level_sigma : float, optional
        1σ per axis with which the local frame's z axis points down [rad]: of a car on a road.
        None: unknown.
    """

    near: FloatArray
    radius: float
    height_sigma: float | None = None
    time_sigma: float = 0.0
    speed_scale_sigma: float = 0.02
    clock: ClockModel = field(default_factory=lambda: ClockModel("random-walk", 0.1))
    level_sigma: float | None = None

    def __post_init__(self) -> None:
        near = np.asarray(self.near, dtype=float)
        if near.shape != (3,) or not 6e6 < float(np.linalg.norm(near)) < 7e6:
            raise ConfigError(
                f"align_anywhere: near: expected an ECEF position on the ground in metres, "
                f"found {near.tolist()}"
            )
        object.__setattr__(self, "near", near)
        for name, ok in (
            ("radius", 0.0 < self.radius <= 1e7),
            ("height_sigma", self.height_sigma is None or 0.0 < self.height_sigma < np.inf),
            ("level_sigma", self.level_sigma is None or 0.0 < self.level_sigma < 1.0),
            ("time_sigma", 0.0 <= self.time_sigma <= 3600.0),
            ("speed_scale_sigma", 0.0 <= self.speed_scale_sigma <= 0.2),
        ):
            if not ok:
                raise ConfigError(f"align_anywhere: {name} = {getattr(self, name)!r} out of range")


@dataclass(frozen=True, eq=False)
class Place:
    """Where a cost is linearised.

    Parameters
    ----------
    pos_e : ndarray, shape (3,)
        Antenna at the beginning [m].
    C_ew : ndarray, shape (3, 3), or None
        None at first: what depends on it is left out.
    late : float
        Time added to the stamps [s].
    """

    pos_e: FloatArray
    C_ew: FloatArray | None = None
    late: float = 0.0


class Joint:
    """The cost over rotations at a place, position, time, scale and clock eliminated.

    Parameters
    ----------
    signals : Signals
    vel_w, moved_w : ndarray, shape (k, 3)
        Velocity of the antenna [m/s] and its way since the beginning [m].
    known : Known
    place : Place
    exact : bool
        Whether ∂z/∂p is to be right to 1e-9 instead of 1e-4 (`alignment.anywhere.ball`).

    Attributes
    ----------
    problem : AlignmentProblem
        Its nuisances are the unknowns: clock, δp [km], time [s], scale.
    stack : ndarray, shape (n, m + 10)
        Rows of unit variance over unknowns and x, those of what is known beforehand last.
    clocks : int
        Unknowns of the clock; they come first.
    sight : Sight
        Along the way found so far.
    by_pos : ndarray, shape (k, 3)
        g as the cost has it.
    determined : bool
        Whether every unknown is told apart from the others.
    """

    def __init__(
        self, signals: Signals, vel_w: FloatArray, moved_w: FloatArray, known: Known,
        place: Place, *, exact: bool = False,
    ) -> None:  # fmt: skip
        self.vel_w, self.moved_w, self.known, self.place = vel_w, moved_w, known, place
        self.signals = signals = signals.later(place.late)
        C_ew = place.C_ew
        turned = np.zeros_like(vel_w) if C_ew is None else vel_w @ C_ew.T
        moved = np.zeros_like(moved_w) if C_ew is None else moved_w @ C_ew.T
        self.sight = sight = signals.at(place.pos_e + moved)
        g = self.by_pos = _differences(signals, place.pos_e + moved) if exact else sight.by_pos
        z = sight.z - np.sum(g * moved, axis=1)
        design = vel_w[:, :, None] * sight.e_e[:, None, :] - moved_w[:, :, None] * g[:, None, :]
        # The clock takes up any constant; what is taken off first costs no digits.
        self.level = float(np.median(z))
        x = np.hstack([design.reshape(len(z), 9), -(z - self.level)[:, None]])
        self.rows = rows = _as_rows(signals)
        clock = known.clock.columns(rows)
        self.clocks = clock.shape[1]
        columns = [clock, UNIT * (sight.across(turned) - g)]
        if known.time_sigma:
            # The satellites later by τ: e turns by −g/… along with z.
            columns.append((-sight.by_time - np.sum(g * turned, axis=1))[:, None])
        if known.speed_scale_sigma:
            columns.append((z - self.level)[:, None])
        measured = known.clock.whiten(rows, np.hstack([*columns, x]))
        self.stack = np.vstack([measured, self._beforehand(measured.shape[1])])
        parameters, factor, rank = eliminated(self.stack, measured.shape[1] - 10)
        dof = len(signals) - self.clocks - 3 - 3 + (known.height_sigma is not None)
        dof += 2 * (known.level_sigma is not None)
        parameters[: known.clock.drifts(rows), 9] -= self.level
        self.determined = rank == measured.shape[1] - 10
        self.problem = AlignmentProblem(
            factor.T @ factor, factor, dof, float(np.sum(signals.sigma**-2.0)), parameters
        )

    def _beforehand(self, width: int) -> FloatArray:
        """Return rows of what is known of position, height, level, time and scale."""
        known, place, at = self.known, self.place, self.clocks
        out = np.zeros((3, width))
        out[:, at : at + 3] = UNIT / known.radius * np.eye(3)
        out[:, -1] = (place.pos_e - known.near) / known.radius
        rows, up = [out], -C_en_of(place.pos_e)[:, 2]
        if known.level_sigma is not None:
            # C up_w = up(p + δp); the vertical turns by δp/|p| along the ground.
            level = np.zeros((3, width))
            along = (np.eye(3) - np.outer(up, up)) / np.linalg.norm(place.pos_e)
            level[:, at : at + 3] = -UNIT * along
            level[:, -10:-1] = np.kron([0.0, 0.0, -1.0], np.eye(3))
            level[:, -1] = -up
            rows.append(level / known.level_sigma)
        if known.height_sigma is not None:
            height = np.zeros((1, width))
            above = float(ecef_to_lla(place.pos_e)[2] - ecef_to_lla(known.near)[2])
            height[0, at : at + 3] = UNIT * up / known.height_sigma
            height[0, -1] = above / known.height_sigma
            rows.append(height)
        at += 3
        for sigma, value in ((known.time_sigma, place.late), (known.speed_scale_sigma, 0.0)):
            if sigma:
                row = np.zeros((1, width))
                row[0, at], row[0, -1] = 1.0 / sigma, value / sigma
                rows.append(row)
                at += 1
        return np.vstack(rows)

    def unknowns(self, C_ew: FloatArray) -> FloatArray:
        """Return δp [km], time [s] and scale that go with a rotation."""
        return self.problem.nuisance_at(C_ew)[self.clocks :]

    def covariance(self, C_ew: FloatArray) -> FloatArray:
        """Return that of δp [m²], the rotation not being known, shape (3, 3)."""
        m = self.stack.shape[1] - 10
        tangent = np.zeros((9, 3))
        for axis, (b, c) in enumerate(((1, 2), (2, 0), (0, 1))):
            turn = np.zeros((3, 3))
            turn[c, b], turn[b, c] = 1.0, -1.0
            tangent[:, axis] = lift(C_ew @ turn)[:9]
        jacobian = np.hstack([self.stack[:, :m], self.stack[:, m : m + 9] @ tangent])
        size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        half = np.linalg.pinv(jacobian / size)[self.clocks : self.clocks + 3]
        half = UNIT * half / size[self.clocks : self.clocks + 3, None]
        return np.asarray(half @ half.T)


def _as_rows(signals: Signals) -> AlignmentRows:
    """Return what a clock model asks of rows."""
    k = len(signals)
    up = np.tile([0.0, 0.0, 1.0], (k, 1))
    epoch = np.unique(signals.time, return_inverse=True)[1]
    return AlignmentRows(up, up, np.zeros(k), signals.sigma, epoch, signals.time)


def _differences(signals: Signals, pos_e: FloatArray, step: float = 1e3) -> FloatArray:
    """Return ∂z/∂p by central differences: 1e-9 of it is left, light time and κ included.

    Of third order 3v/ρ³·step²/6, and rounding of z over 2·step.
    """
    ends = [(signals.at(pos_e + d).z, signals.at(pos_e - d).z) for d in step * np.eye(3)]
    return np.stack([(more - less) / (2.0 * step) for more, less in ends], axis=1)
