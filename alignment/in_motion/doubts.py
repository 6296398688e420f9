"""What speaks against the solution of a window in motion: rows, rivals, single satellites.

Rows that do not fit are rejected one by one. Then three questions, beside those that every
alignment is asked: whether enough rows are left, whether other minima lose at their own
linearisation, too, and whether the attitude hangs on a single satellite.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import gammaincinv

from ...filters.earth import OMEGA_IE_SKEW
from ...filters.errors import AlignmentError
from ...filters.rotation import FloatArray
from ..result import AlignmentResult, Ask, Verdict
from ..solver.attitude_bound import region_threshold
from ..solver.refinement import rotation_angle
from .rows import InertialDoppler
from .unknowns import InertialOptions
from .window import Mask, Solved, Window, settle

#: Probability with which each part of a sound window agrees with its weights: one window in fifty
#: has twenty such parts and one that does not, were σ not on the safe side.
_EVERYWHERE = 0.999
#: Spread of z over an epoch's satellites that is motion [m/s], at least so many σ of the noisiest,
#: and rows in motion from which a share of them means something.
_MOTION, _STILL, _MOVING_ROWS = 1.0, 4.0, 10
#: Makes the window at given biases.
Linearised = Callable[[FloatArray], Window]


def reject(window: Linearised, solved: Solved, options: InertialOptions, moves: Mask) -> Solved:
    """Reject the worst row of each epoch by turns until all agree (Baarda's data snooping).

    The residual of a row is judged by its own σ after the fit: a row that the fit follows
    whatever it says has a small residual and a small σ of it. What is rejected stays so: once
    too few rows are left for `consensus`, to which `moves` goes, the window has failed, and
    finding out how badly would cost most of the time that a wait in a street takes.
    """
    inliers = solved.inliers.copy()
    epoch = solved.window.stretch.rows.epoch
    for _ in range(40):
        score = solved.scores()
        worst = float(score.max())
        if worst <= options.cutoff or not consensus(inliers, options, moves).passed:
            break
        # Only what is nearly as bad as the worst: the others may suffer from it.
        bad = score > max(options.cutoff, 0.6 * worst)
        inliers = inliers.copy()
        for e in np.unique(epoch[bad]):
            rows = np.flatnonzero(epoch == e)
            inliers[rows[np.argmax(score[rows])]] = False
        solved = settle(window, solved.window.biases, options, None, inliers)
    return solved


def consensus(inliers: Mask, options: InertialOptions, moves: Mask | None = None) -> Verdict:
    """Return whether enough rows are left, of all and of those in motion.

    Parameters
    ----------
    inliers : ndarray of bool, shape (k,)
    options : InertialOptions
    moves : ndarray of bool, shape (k,), optional
        Rows of a moving vehicle (`in_motion`). At rest nothing contradicts anything: half a
        minute of it would outvote six seconds in which the one right satellite was rejected.
    """
    share, text = float(np.mean(inliers)), f"{int(np.sum(inliers))} of {inliers.size} rows agree"
    if moves is not None and moves.sum() >= _MOVING_ROWS and np.mean(inliers[moves]) < share:
        share = float(np.mean(inliers[moves]))
        text = f"{int(np.sum(inliers[moves]))} of {int(moves.sum())} rows in motion agree"
    passed = share >= 1.0 - options.minority
    if not passed:
        text = f"at most {text}, {100.0 * (1.0 - options.minority):.0f} % are needed"
    return Verdict(Ask.CONSENSUS, passed, share, 1.0 - options.minority, text)


def in_motion(doppler: InertialDoppler) -> Mask:
    """Return which rows belong to epochs at which the satellites see a velocity, shape (k,).

    At rest z is the clock's drift for all of them.
    """
    earth = (doppler.pos_e @ OMEGA_IE_SKEW.T)[doppler.epoch]
    z = doppler.z - np.sum(doppler.e_e * earth, axis=1)
    first = np.searchsorted(doppler.epoch, np.arange(doppler.time.size))
    spread = np.maximum.reduceat(z, first) - np.minimum.reduceat(z, first)
    noise = np.maximum.reduceat(doppler.sigma, first)
    return np.asarray((spread > np.maximum(_MOTION, _STILL * noise))[doppler.epoch])


def contradicted(solved: Solved) -> bool:
    """Return whether the rows of some eighth of the window, or of some satellite, do not agree.

    χ² of all rows says little of a few: forty seconds at rest, where nothing contradicts anything,
    hide fifteen epochs in which one of three satellites was a reflection. Noise that lasts fails
    this, too: it is a reason to ask for `separation`, which tells them apart.
    """
    scores, rows = solved.scores(), solved.window.stretch.rows
    eighth = np.minimum(8 * rows.epoch // rows.time.size, 7)
    parts = [rows.sat == sat for sat in np.unique(rows.sat)]
    for part in [*parts, *(eighth == k for k in range(8))]:
        judged = scores[part & (scores > 0.0)]
        if judged.size < 3:
            continue
        allowed = float(2.0 * gammaincinv(0.5 * judged.size, _EVERYWHERE))
        if float(judged @ judged) > allowed:
            return True
    return False


def separation(
    window: Linearised, solved: Solved, result: AlignmentResult,
    inliers: Mask, options: InertialOptions,
) -> Verdict:  # fmt: skip
    """Leave out each satellite in turn: none may carry the attitude by itself.

    Where rows had to be rejected, or contradict, others of the same reflections may have stayed.
    The solution without a satellite differs from that with it by P_without − P_with if the
    satellite is sound (solution separation, as in receiver integrity monitoring); the largest of
    these tests counts.
    """
    rows = solved.window.stretch.rows
    _, cov = solved.estimate(result)
    limit = region_threshold(1.0 - 1e-4)
    worst, name = 0.0, ""
    for sat in np.unique(rows.sat[inliers]):
        others = inliers & (rows.sat != sat)
        try:
            without = settle(window, solved.window.biases, options, solved.C_ew, others)
        except AlignmentError:
            return Verdict(Ask.SEPARATION, False, np.inf, limit, f"nothing is left without {sat}")
        _, wider = without.estimate(result)
        off = without.C_ew @ solved.C_ew.T
        turn_e = 0.5 * np.array(
            [off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]
        )
        values, axes = np.linalg.eigh(wider[:3, :3] - cov[:3, :3])
        # A satellite that adds nothing moves nothing: a hundredth of σ² is the floor.
        floor = 0.01 * float(np.linalg.eigvalsh(cov[:3, :3])[0])
        score = float(np.sum((axes.T @ turn_e) ** 2 / np.maximum(values, floor)))
        if score > worst:
            worst, name = score, str(sat)
    passed = worst <= limit
    text = f"without {name} the attitude moves by χ² {worst:.3g}"
    return Verdict(
        Ask.SEPARATION, passed, worst, limit, text + ("" if passed else f" (limit {limit:.0f})")
    )


def rivals(
    window: Linearised, solved: Solved, result: AlignmentResult,
    inliers: Mask, options: InertialOptions,
) -> Verdict:  # fmt: skip
    """Follow the other minima to their own linearisation; they must still be worse there."""
    limit = result.inflation * options.limits.ambiguity
    least = np.inf
    for C, cost in zip(result.rivals.C, result.rivals.cost, strict=True):
        # Its own biases gain nothing to speak of where the excess is a hundred times the limit.
        if cost - result.cost > 100.0 * limit or len(result.rivals.cost) > 8:
            continue
        other = settle(window, solved.window.biases, options, C, inliers)
        if rotation_angle(other.C_ew, result.C_ew) > 0.01:
            least = min(least, other.cost - result.cost)
    passed = not least < limit
    text = f"nearest rival with biases of its own at χ² +{least:.3g}"
    if np.isinf(least):
        text = "no rival with biases of its own"
    elif not passed:
        text += f" (limit {limit:.0f}): needs a turn or a change of speed"
    return Verdict(Ask.RIVALS, passed, least, limit, text)
