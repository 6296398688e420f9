"""The one result of every alignment: an attitude, and the verdicts on what may be believed of it.

A verdict answers one question, and its name says which (`Ask`). A result passes if all that were
asked did: the least-squares solver asks the first five (`alignment.verdict`), rows that had to be
rejected one more (`alignment.robust`), alignment in motion up to three (`alignment.in_motion`), and
the semidefinite relaxation, as published, the first two (`alignment.reference.certifiable`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from ..filters.errors import AlignmentError
from ..filters.rotation import FloatArray
from .observability import Observability
from .problem import AlignmentProblem
from .solver.fast_solver import LocalMinima
from .status import AlignmentStatus, ProvedMinimum


class Ask(StrEnum):
    """What a verdict is about, in the order in which they build on each other."""

    #: Is the rotation proved to have the lowest cost?
    OPTIMAL = "optimal"
    #: Has no other rotation the same?
    UNIQUE = "unique"
    #: Could noise have preferred another minimum?
    UNAMBIGUOUS = "unambiguous"
    #: Do the rows agree with each other and with their weights?
    CONSISTENT = "consistent"
    #: Is every rotation near that the data do not exclude?
    BOUNDED = "bounded"
    #: Where rows were rejected: are those that agree enough to tell?
    CONSENSUS = "consensus"
    #: Do other minima lose with sensor biases of their own, too?
    RIVALS = "rivals"
    #: Where rows were rejected, or some contradict: does no satellite carry the attitude by itself?
    SEPARATION = "separation"
    #: Without a position: is the truth proved to be in a smaller ball than was known?
    LOCATED = "located"


@dataclass(frozen=True)
class Verdict:
    """One question, its answer and the number behind it.

    Attributes
    ----------
    name : Ask
    passed : bool
    value, limit : float
        What was found and what it was compared with.
    message : str
        One line; says what is missing where it did not pass.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import Ask, align
    >>> from certnav.alignment.reference import simulate_window
    >>> rng = np.random.default_rng(7)
    >>> window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05)
    >>> verdict = align(window.rows).verdict(Ask.CONSISTENT)
    >>> verdict.passed, verdict.value < verdict.limit
    (True, True)
    """

    name: Ask
    passed: bool
    value: float
    limit: float
    message: str


@dataclass(frozen=True, eq=False)
class AlignmentResult:
    """The attitude of the local frame, and what may be believed of it.

    Attributes
    ----------
    C_ew : ndarray, shape (3, 3)
        Local axes to ECEF.
    cov_w : ndarray, shape (3, 3)
        Covariance of θ, C_true = C_ew·Exp(θ) [rad²], from the Hessian, times χ²/dof where that
        exceeds one.
    bound : float
        Every rotation within the χ² region is within this angle [rad]; π if nothing is proved.
    verdicts : tuple of Verdict
        Those that were asked, in the order of `Ask`.
    cost : float
        χ² of the rows at C_ew.
    dof : int
        Its degrees of freedom.
    nuisance : ndarray, shape (m,)
        Clock drift cδṫ [m/s] first, in the order of the problem's columns.
    minimum : ProvedMinimum
        As the solver hands it over: a `FastMinimum`, or the `CertifiedMinimum` of the relaxation.
    rivals : LocalMinima
        Other minima, with their costs, the lowest first.
    observability : Observability
    problem : AlignmentProblem
        What was minimised.
    inliers : ndarray of bool, shape (k,), or None
        The rows it rests on, where these were searched for.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import Ask, align
    >>> from certnav.alignment.reference import simulate_window
    >>> rng = np.random.default_rng(7)
    >>> window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05)
    >>> result = align(window.rows)
    >>> [v.name.name for v in result.verdicts if not v.passed], result.verdict(Ask.OPTIMAL).passed
    ([], True)
    """

    C_ew: FloatArray
    cov_w: FloatArray
    bound: float
    verdicts: tuple[Verdict, ...]
    cost: float
    dof: int
    nuisance: FloatArray
    minimum: ProvedMinimum
    rivals: LocalMinima
    observability: Observability
    problem: AlignmentProblem
    inliers: NDArray[np.bool_] | None = None

    def __repr__(self) -> str:
        failed = f"not {', '.join(v.name for v in self.failed)}"
        bound = f"bound {np.degrees(self.bound):.3g}°" if self.bound < np.pi else "no bound"
        return (
            f"<AlignmentResult {'passed' if self.passed else failed}: {self.status.name}, "
            f"1σ {np.degrees(self.sigma):.3g}°, {bound}, χ² {self.cost:.4g} at {self.dof} dof>"
        )

    @property
    def status(self) -> AlignmentStatus:
        """What is proved of the rotation, as far as the geometry supports it."""
        return self.minimum.status.seen_in(self.observability.geometry)

    @property
    def sigma(self) -> float:
        """1σ about the axis that is known least [rad]; infinite where the cost is flat."""
        if not np.isfinite(self.cov_w).all():
            return float("inf")
        return float(np.sqrt(np.linalg.eigvalsh(self.cov_w)[-1]))

    @property
    def inflation(self) -> float:
        """χ² per degree of freedom where that exceeds one: what too small weights cost."""
        return inflation(self.cost, self.dof)

    def verdict(self, name: Ask) -> Verdict:
        """Return the verdict of that name.

        Raises
        ------
        KeyError
            If it was not asked of this window.
        """
        for verdict in self.verdicts:
            if verdict.name is name:
                return verdict
        raise KeyError(f"'{name}' was not asked; asked were {', '.join(self.asked)}")

    @property
    def asked(self) -> tuple[Ask, ...]:
        """The names of the verdicts there are."""
        return tuple(verdict.name for verdict in self.verdicts)

    def asked_further(self, *verdicts: Verdict) -> AlignmentResult:
        """Return the result with the answers to more questions."""
        return replace(self, verdicts=self.verdicts + verdicts)

    @property
    def passed(self) -> bool:
        """The overall verdict: this attitude may start a filter."""
        return all(verdict.passed for verdict in self.verdicts)

    @property
    def failed(self) -> tuple[Verdict, ...]:
        """The verdicts that did not pass."""
        return tuple(verdict for verdict in self.verdicts if not verdict.passed)

    @property
    def message(self) -> str:
        """One line for the log: the attitude's bound, or what it is waiting for."""
        if not self.passed:
            return "not aligned: " + "; ".join(verdict.message for verdict in self.failed)
        if Ask.BOUNDED not in self.asked:
            return "aligned: " + ", ".join(verdict.message for verdict in self.verdicts)
        told = (self.verdict(name).message for name in (Ask.BOUNDED, Ask.CONSISTENT))
        return "aligned: " + ", ".join(told)

    def require(self) -> AlignmentResult:
        """Return self if it passed.

        Raises
        ------
        AlignmentError
            With the message of the verdicts that did not.
        """
        if not self.passed:
            raise AlignmentError(self.message)
        return self


def inflation(cost: float, dof: int) -> float:
    """Return cost/dof where it exceeds one: regions of weights that are too optimistic grow.

    Never less than one: by weights that are too large nothing is gained the other way.
    """
    return max(1.0, cost / dof) if dof > 0 else 1.0
