"""What the update log says against the run it comes from, in sentences for its notes.

The innovation test lets a wrong measurement through once in ten thousand, by default. Refusals
that come in rows, or far more often than that, and innovations that are larger than their σ
throughout, mean that data or their stated accuracy are wrong, whoever is to blame. The solution
is then worth less than its covariance says.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ....filters.measurement_update import gate_limit
from ....filters.rotation import FloatArray
from ...notes import Note, clock
from ...solution import Update

#: Time without a position worth a sentence [s]: an accelerometer wrong by 0.05 m/s², as small ones
#: are, is off by 2.5 m then, what a single fix is off by.
_ALONE = 10.0
#: Updates that no sensor has measured.
_CONSTRAINTS = ("nhc", "zupt", "zaru")
#: Refusals in a row that are worth a sentence.
_IN_A_ROW = 4
#: Refusals of a kind of update, and share of them, that are worth one.
_REFUSED, _REFUSED_SHARE = 4, 0.01
#: Updates over which NIS per degree of freedom is averaged, and the mean from which σ is said to
#: be too small: with three components chance has 1 ± 0.1 there.
_WINDOW, _TOO_LARGE = 60, 1.5


def doubts(updates: Iterable[Update], gate_probability: float) -> tuple[Note, ...]:
    """Return a sentence for each kind of update that contradicts the filter.

    Parameters
    ----------
    updates : iterable of Update
        In order of time.
    gate_probability : float
        Probability with which the innovation test refuses a correct measurement.
    """
    by_kind: dict[str, list[Update]] = {}
    for update in updates:
        if np.isfinite(update.nis):
            by_kind.setdefault(update.kind, []).append(update)
    return tuple(
        Note("doubtful", sentence)
        for kind, tested in by_kind.items()
        for sentence in _of(kind, tested, gate_probability)
    )


def outages(updates: Iterable[Update], end: float) -> tuple[Note, ...]:
    """Return a sentence if the run had to do without positions for long.

    Parameters
    ----------
    updates : iterable of Update
        In order of time.
    end : float
        Of the solution [s].
    """
    at = [u.time for u in updates if u.kind == "position" and u.accepted]
    if not at:
        return ()
    gaps = np.diff([*at, max(end, at[-1])])
    long = np.flatnonzero(gaps > _ALONE)
    if not long.size:
        return ()
    worst = int(long[np.argmax(gaps[long])])
    text = (
        f"no position for more than {_ALONE:.0f} s in {long.size} spells, the longest "
        f"{gaps[worst]:.1f} s from {clock(at[worst])}: what else there is carries the solution, "
        "and σ grows"
    )
    return (Note("note", text),)


def _of(kind: str, tested: list[Update], gate_probability: float) -> Iterator[str]:
    refused = [_was_refused(u) for u in tested]
    count, share = sum(refused), sum(refused) / len(tested)
    longest, at = _longest_run(refused)
    expected = gate_probability * len(tested)
    often = count >= max(_REFUSED, 5.0 * expected) and share >= _REFUSED_SHARE
    said = often or longest >= _IN_A_ROW
    if said:
        text = f"{kind}: {count} of {len(tested)} updates failed the innovation test"
        if longest > 1:
            first, last = tested[at].time, tested[at + longest - 1].time
            text += f", {longest} in a row from {clock(first)} to {clock(last)}"
        cause = (
            "wrong data (a jump, time, frozen values) or σ too small; errors there can exceed 3σ"
        )
        if kind in _CONSTRAINTS:
            cause = "the vehicle moved as the constraint says it cannot, or its σ is too small"
        yield f"{text}; {expected:.1g} would be chance: {cause}"
    enlarged = [u.time for u in tested if u.accepted and u.reason.startswith("covariance enlarged")]
    if enlarged:
        yield (
            f"{kind}: after refusals in a row the covariance was enlarged "
            f"{len(enlarged)} times, first at {clock(enlarged[0])}: until then the solution or "
            "the data were wrong by more than the filter knew"
        )
    if len(tested) >= _WINDOW and not said:
        ratio, at = _largest_window(_nis_per_dof(tested, gate_probability))
        if ratio > _TOO_LARGE:
            first, last = tested[at].time, tested[at + _WINDOW - 1].time
            yield (
                f"{kind}: from {clock(first)} to {clock(last)} innovations are "
                f"{np.sqrt(ratio):.1f} times as large as their σ (RMS): the stated accuracy is too "
                "good there, or time stamps are off; the solution's σ may be too small by as much"
            )


def _was_refused(update: Update) -> bool:
    """Tell updates that failed the test, also those that were accepted although they did."""
    return bool(update.reason)


def _longest_run(flags: list[bool]) -> tuple[int, int]:
    """Return length and start of the longest run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(flags, dtype=int), [0]])))
    if not edges.size:
        return 0, 0
    lengths = edges[1::2] - edges[::2]
    longest = int(np.argmax(lengths))
    return int(lengths[longest]), int(edges[2 * longest])


def _nis_per_dof(tested: list[Update], gate_probability: float) -> FloatArray:
    """Return NIS per degree of freedom, each held at the test's limit.

    Refused ones count too: leaving them out would make any innovation look as it should. Held at
    the limit, a few gross errors do not make a σ too small.
    """
    dof = np.array([max(len(u.whitened), 1) for u in tested])
    limit = np.array([gate_limit(int(n), max(gate_probability, 1e-9)) for n in dof])
    nis = np.array([u.nis for u in tested])
    return np.asarray(np.minimum(nis, limit) / dof)


def _largest_window(values: FloatArray) -> tuple[float, int]:
    """Return the largest mean of a window, and where it begins."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    means = (total[_WINDOW:] - total[:-_WINDOW]) / _WINDOW
    at = int(np.argmax(means))
    return float(means[at]), at
