"""What a spell of weak GNSS did to a solution.

Drift of a spell is how far the horizontal position error has moved since the spell began, at its
worst: max |e(t) − e(t₀)|, e the error vector north and east, t₀ the last reference epoch before the
spell. What was wrong before the spell does not count; what grew and healed within it does. The
largest error itself is reported beside it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ...datasets.series import Reference
from ...filters.earth import C_en_of
from ...filters.rotation import FloatArray, rpy_from_matrix
from ..evaluation.accuracy import Evaluation
from ..solution import Trajectory
from .outages import Spell

#: So near to its beginning and its end, as a share of a spell or in seconds, a reference has to
#: have an epoch: what drifts with the square of time is a tenth larger after a twentieth more.
_SEEN, _SEEN_S = 0.05, 1.0


@dataclass(frozen=True, eq=False)
class SpellFigures:
    """What happened in one spell.

    Parameters
    ----------
    start, end : float
        GPS time [s].
    drift : float
        See the module [m].
    max_error : float
        Largest horizontal error in the spell [m].
    final_drift, final_error : float
        How far the horizontal error has moved, and how large it is, at the last reference epoch in
        the spell [m].
    velocity_error : float
        Largest horizontal velocity error [m/s].
    heading_drift : float
        Change of the heading error from beginning to end [rad]; NaN where unknown.
    nees_before, nees_end : float
        Of position, 3 degrees of freedom, at the last epoch before the spell and the last in it.
    since, growth : ndarray, shape (m,)
        Seconds since the beginning, on whole seconds, and |e(t) − e(t₀)| there [m].
    """

    start: float
    end: float
    drift: float
    max_error: float
    final_drift: float
    final_error: float
    velocity_error: float
    heading_drift: float
    nees_before: float
    nees_end: float
    since: FloatArray
    growth: FloatArray

    def __repr__(self) -> str:
        return (
            f"<SpellFigures {self.start:.1f}…{self.end:.1f} s: drift {self.drift:.3g} m, "
            f"largest error {self.max_error:.3g} m>"
        )


def judgeable(spells: Iterable[Spell], time: FloatArray) -> list[Spell]:
    """Return the spells whose beginning and end a reference has seen.

    Parameters
    ----------
    spells : iterable of Spell
    time : ndarray, shape (n,)
        Epochs of the reference, increasing [s].
    """
    found = []
    for spell in spells:
        near = max(_SEEN * (spell.end - spell.start), _SEEN_S)
        before = np.searchsorted(time, spell.start, side="right") - 1
        last = np.searchsorted(time, spell.end, side="left") - 1
        if before >= 0 and spell.start - time[before] <= near and spell.end - time[last] <= near:
            found.append(spell)
    return found


def spell_figures(evaluation: Evaluation, spell: Spell) -> SpellFigures | None:
    """Return the figures of one spell; None where the reference has no epochs in it."""
    start, end = spell
    time, error = evaluation.time, evaluation.error_pos_n[:, :2]
    first = max(int(np.searchsorted(time, start, side="right")) - 1, 0)
    inside = np.flatnonzero((time > start) & (time < end))
    if not inside.size:
        return None
    rows = np.r_[first, inside] if inside[0] > first else inside
    growth = np.linalg.norm(error[rows] - error[rows[0]], axis=1)
    horizontal = np.linalg.norm(error[rows], axis=1)
    since = time[rows] - start
    grid = np.arange(0.0, np.floor(since[-1] + 0.5) + 0.5)
    heading = evaluation.error_rpy[rows[[0, -1]], 2]
    return SpellFigures(
        start=start,
        end=min(end, float(time[rows[-1]])),
        drift=float(growth.max()),
        max_error=float(horizontal.max()),
        final_drift=float(growth[-1]),
        final_error=float(horizontal[-1]),
        velocity_error=float(np.linalg.norm(evaluation.error_vel_n[rows, :2], axis=1).max()),
        heading_drift=float(np.angle(np.exp(1j * (heading[1] - heading[0])))),
        nees_before=float(evaluation.nees_position[rows[0]]),
        nees_end=float(evaluation.nees_position[rows[-1]]),
        since=grid,
        growth=np.interp(grid, since, growth),
    )


def statistics(maxima: Iterable[float]) -> dict[str, float | None]:
    """Return median, RMS and 95th percentile of the maxima of all spells; None without any."""
    known = np.array([m for m in maxima if np.isfinite(m)])
    if not known.size:
        return {"median": None, "rms_of_maxima": None, "p95": None}
    return {
        "median": float(np.median(known)),
        "rms_of_maxima": float(np.sqrt(np.mean(known**2))),
        "p95": float(np.percentile(known, 95)),
    }


def as_reference(trajectory: Trajectory, source: str) -> Reference:
    """Return a solution as the reference that others are judged by; `source` says which it is."""
    C_nb = np.swapaxes(C_en_of(trajectory.pos_e), 1, 2) @ trajectory.C_eb
    return Reference(
        trajectory.time, trajectory.pos_e, trajectory.vel_e, rpy_from_matrix(C_nb), np.zeros(3),
        "imu", source,
    )  # fmt: skip
