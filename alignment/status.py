"""What is proved of a rotation: in one word, and as every solver hands it over.

Every proof ends in the same inequality (`Growth`), and one rule makes the word of it, whoever
found the rotation and the multipliers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from numpy.typing import ArrayLike

from ..filters.rotation import FloatArray
from .observability import Geometry


class AlignmentStatus(Enum):
    """What has been proved about a rotation; only the first starts a filter."""

    CERTIFIED = "the global optimum, and the only one: what costs less is within `region` of it"
    AMBIGUOUS = "a global optimum, but other rotations reach the same cost"
    UNOBSERVABLE = "nothing: the window does not determine the rotation, whatever the cost says"
    NOT_TIGHT = "nothing: the relaxation leaves a gap below this rotation's cost"
    NUMERICAL = "nothing: the arithmetic does not carry the proof to a gap that χ² would not notice"

    @property
    def optimal(self) -> bool:
        """Whether no rotation costs less."""
        return self in (AlignmentStatus.CERTIFIED, AlignmentStatus.AMBIGUOUS)

    def seen_in(self, geometry: Geometry) -> AlignmentStatus:
        """Return the weaker of proof and geometry: unique in exact arithmetic, not under noise."""
        if geometry is Geometry.UNOBSERVABLE:
            return AlignmentStatus.UNOBSERVABLE
        if geometry is Geometry.MIRROR and self is AlignmentStatus.CERTIFIED:
            return AlignmentStatus.AMBIGUOUS
        return self


#: Gap [χ²] that counts as closed: likelihoods that differ by half a percent.
GAP = 1e-2
#: And relative to the scale of Q, for costs that are not χ²; likewise of a slope that is zero.
RELATIVE_GAP = 1e-9
#: Largest region [rad] of an only optimum, 0.06°: a tenth of the least 1σ that Doppler windows
#: of vehicles reach, so that the rotation stands for all of it.
REGION = 1e-3


@dataclass(frozen=True)
class Growth:
    """How a cost is proved to grow away from a rotation C, rounding included.

    For every rotation R, θ the angle between the two, w = cos(θ/2) and a² = 1 − w⁴,

        f(R) − f(C) ≥ t a² − 2κ w² a − ε.

    What costs less than C therefore has a < (κ + √(κ² + εt))/t, which for ε = 0 is 2κ/t: a
    proof of uniqueness only where that is small. Nothing costs less by more than ε + κ²/t.

    Attributes
    ----------
    margin : float
        t.
    slope : float
        κ ≥ 0: of ∂f/∂θ at C, |∂f/∂θ|/√2, with what rounding may add.
    scale : float
        Of Q, its trace if semidefinite: what t, κ and ε are small against.
    offset : float
        ε ≥ 0.
    """

    margin: float
    slope: float
    scale: float
    offset: float = 0.0

    @property
    def gap(self) -> float:
        """By how much another rotation may cost less, at most."""
        if self.margin > 0.0:
            # At a = κ/t; a ≤ 1 caps it where that is further away than any rotation.
            return self.offset + min(self.slope**2 / self.margin, 2.0 * self.slope)
        return self.offset + 2.0 * self.slope - self.margin

    @property
    def region(self) -> float:
        """Every rotation that costs less is within this angle [rad]; π: nothing is proved."""
        t = self.margin
        if not t > 0.0:
            return math.pi
        a2 = ((self.slope + math.sqrt(self.slope**2 + self.offset * t)) / t) ** 2
        if not a2 < 1.0:
            return math.pi
        return 2.0 * math.asin(math.sqrt(a2 / (1.0 + math.sqrt(1.0 - a2))))

    @property
    def status(self) -> AlignmentStatus:
        """The word for it."""
        gap = self.gap
        closed = gap <= RELATIVE_GAP * self.scale
        if closed and gap <= GAP:
            only = self.region <= REGION
            return AlignmentStatus.CERTIFIED if only else AlignmentStatus.AMBIGUOUS
        stationary = self.slope <= RELATIVE_GAP * self.scale
        return AlignmentStatus.NOT_TIGHT if stationary and not closed else AlignmentStatus.NUMERICAL


class ProvedMinimum(Protocol):
    """A minimum of f(C) = xᵀQx over the rotations, x = [vec(C); 1], with what is proved of it.

    Attributes
    ----------
    C : ndarray, shape (3, 3)
    cost : float
        f(C).
    scale : float
        Of Q: its trace if semidefinite. What gaps are small against.
    gap : float
        Proved: no rotation costs less by more than this; in units of the cost, χ² of a window.
    best_margin : float
        t: proved, f(R) − f(C) ≥ t (1 − cos⁴(θ/2)) up to the gap, θ the angle between R and C;
        another rotation may cost as little where it is not positive.
    region : float
        Proved: every rotation that costs less is within this angle of C [rad]; π if nothing is.
    status : AlignmentStatus
        What follows from Q alone.
    """

    @property
    def C(self) -> FloatArray: ...
    @property
    def cost(self) -> float: ...
    @property
    def scale(self) -> float: ...
    @property
    def gap(self) -> float: ...
    @property
    def best_margin(self) -> float: ...
    @property
    def region(self) -> float: ...
    @property
    def status(self) -> AlignmentStatus: ...

    def covariance(self) -> FloatArray:
        """Return the covariance of θ, C_true = C·Exp(θ) [rad²], w axes, if f is χ²."""
        ...

    def multipliers(self, Q: ArrayLike) -> FloatArray:
        """Return the λₖ of all twenty constraints that prove the bound for this Q."""
        ...
