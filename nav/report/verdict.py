"""A run in plain sentences: how accurate, how honest, what is in doubt."""

from __future__ import annotations

import numpy as np

from ..notes import Note
from ..page.quantities import duration, length, percent
from ..results.directory import Result


def verdict(result: Result) -> list[str]:
    """Return what a reader wants first, in sentences: accuracy, honesty, and what is in doubt."""
    metrics, summary = result.evaluation.metrics, result.summary
    span = duration(summary["duration_s"])
    trajectory = result.solution.trajectory
    if metrics["horizontal_rms_m"] is not None:
        sentences = [
            f"Over {span} the horizontal error was {length(metrics['horizontal_rms_m'])} RMS, "
            f"below {length(metrics['horizontal_p95_m'])} for 95 % of the time and never above "
            f"{length(metrics['horizontal_max_m'])}.",
            f"Judged against: {result.evaluation.source.rstrip('.')}.",
        ]
    else:
        sigma = np.sqrt(trajectory.cov_pos_n[:, 0, 0] + trajectory.cov_pos_n[:, 1, 1])
        sentences = [
            f"{span[0].upper()}{span[1:]} navigated; there is no reference, so the accuracy is "
            f"not known. The filter itself claims {length(float(np.median(sigma)))} horizontally "
            "(1σ, median)."
        ]
    losses = [
        f"{'Lost and started again' if result.summary['status'] == 'restarted' else 'LOST'} "
        f"{note.text}."
        for note in result.solution.notes
        if note.severity == "lost"
    ]
    return [*losses, *sentences, *_consistency(result), *_doubt(result)]


def coverage(result: Result) -> str:
    """Return with how many satellites, in a sentence."""
    epochs = result.summary["epochs"]
    total = epochs["total"]
    if not total:
        return "Positions came as ready-made fixes, without satellite observations."
    return (
        f"Four or more satellites were usable in {percent(epochs['ge4'], total)} of {total} GNSS "
        f"epochs, two or three in {percent(epochs['two_or_three'], total)}, fewer in "
        f"{percent(epochs['lt2'], total)}."
    )


def gate_activity(result: Result) -> list[str]:
    """Return one sentence for each kind of update: how often its gate fired."""
    sentences = []
    for kind in result.summary["updates"]:
        tested = [u for u in result.solution.updates if u.kind == kind and np.isfinite(u.nis)]
        fired = sum(not u.accepted or u.reason != "" for u in tested)
        overruled = sum(u.accepted and u.reason != "" for u in tested)
        n = len(tested)
        if n == 0:
            sentences.append(f"{kind} gate: nothing to test.")
        elif fired == 0:
            sentences.append(
                f"{kind} gate never fired ({n} tested): it has protected nothing in this run."
            )
        elif fired == n:
            sentences.append(
                f"{kind} gate fired every time ({n} of {n}): measurement noise, lever arm, time "
                "offset or alignment is wrong."
            )
        else:
            sentences.append(
                f"{kind} gate fired {fired} of {n} ({percent(fired, n)})"
                + (f", {overruled} of them overruled." if overruled else ".")
            )
    return sentences


def _consistency(result: Result) -> list[str]:
    nees = result.evaluation.consistency["nees_position_mean"]
    if nees is None:
        return []
    if nees > 6.0:
        word = "too optimistic"
    elif nees < 1.5:
        word = "pessimistic"
    else:
        word = "about right"
    return [f"The filter's position covariance was {word} (NEES {nees:.3g}, ideal 3)."]


def doubts(result: Result) -> list[Note]:
    """Return the notes that speak against the run, but for losses: those come first of all."""
    return [note for note in result.solution.notes if note.severity == "doubtful"]


def _doubt(result: Result) -> list[str]:
    """Return the first doubt in a sentence, and how many there are."""
    found = doubts(result)
    if not found:
        return ["Nothing in the data or the run speaks against it."]
    more = "" if len(found) == 1 else f" (1 of {len(found)} doubts, the others below)"
    return [f"In doubt{more}: {found[0].text.rstrip('.')}."]
