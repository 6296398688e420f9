"""What is proved of a rotation: in one word, and as every solver hands it over."""

from __future__ import annotations

from enum import Enum
from typing import Protocol

from numpy.typing import ArrayLike

from ..filters.rotation import FloatArray
from .observability import Geometry


class AlignmentStatus(Enum):
    """What has been proved about a rotation; only the first starts a filter."""

    CERTIFIED = "the global optimum, and the only one"
    AMBIGUOUS = "a global optimum, but other rotations reach the same cost"
    UNOBSERVABLE = "nothing: the window does not determine the rotation, whatever the cost says"
    NOT_TIGHT = "nothing: the relaxation leaves a gap below this rotation's cost"
    NUMERICAL = "nothing: the rotation is not a stationary point to working precision"

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
        (cost − proved lower bound)/scale ≥ 0.
    best_margin : float
        t: proved, f(R) − f(C) ≥ t (1 − cos⁴(θ/2)) up to the gap, θ the angle between R and C;
        another rotation may cost as little where it is not positive.
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
    def status(self) -> AlignmentStatus: ...

    def covariance(self) -> FloatArray:
        """Return the covariance of θ, C_true = C·Exp(θ) [rad²], w axes, if f is χ²."""
        ...

    def multipliers(self, Q: ArrayLike) -> FloatArray:
        """Return the λₖ of all twenty constraints that prove the bound for this Q."""
        ...
