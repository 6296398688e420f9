"""One method on one drive reduced to its figures, and all of them together."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from collections.abc import Sequence as Listing
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...filters.earth import ecef_to_lla
from ...filters.rotation import FloatArray
from ..evaluation.accuracy import METRICS, Evaluation, normalised_nis
from ..solution import Solution
from ..spells.drift import SpellFigures, spell_figures, statistics
from ..spells.outages import Spell, in_spells
from .intervals import rms_interval
from .methods import METHODS, Method, fresh

#: Points of a track that a page can show.
_TRACK_POINTS = 1500
_FAR = 5.0
#: Spells are long alike within this share, or within an epoch [s]: what grows with the square of
#: time differs by a tenth then, less than spells do among themselves.
_ALIKE, _EPOCH = 0.05, 1.0
#: The table of all recordings.
TOGETHER = "All recordings together"


@dataclass(frozen=True, eq=False)
class Run:
    """One method on one variant of one drive, reduced to what a comparison needs.

    Parameters
    ----------
    method, sequence, variant : str
    metrics : dict
        See `nav.evaluation.accuracy.METRICS`.
    consistency : dict
        'nees_in', 'nees_out': mean NEES of position within and outside spells; 'nees_velocity',
        'nees_heading': of velocity, its axes taken for themselves, and of heading; 'nis_mean'.
    availability : float
        Share of the judged epochs with a solution that is not merely held.
    near : float
        Share of the judged epochs within 5 m horizontally.
    spells : tuple of SpellFigures
    track : ndarray, shape (n, 2)
        Longitude, latitude [deg].
    headings : dict
        Of sliding-window alignment (`nav.windows.recording.summary`); empty for other methods.
    used : dict
        By kind of update, (accepted, offered, NIS per degree of freedom or None).
    reason : str
        Why there is no result; '' when there is one.
    """

    method: str
    sequence: str
    variant: str
    metrics: dict[str, float | None] = field(default_factory=lambda: dict.fromkeys(METRICS))
    consistency: dict[str, float | None] = field(default_factory=dict)
    availability: float = float("nan")
    near: float = float("nan")
    spells: tuple[SpellFigures, ...] = ()
    track: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    headings: dict[str, Any] = field(default_factory=dict)
    used: dict[str, tuple[int, int, float | None]] = field(default_factory=dict)
    reason: str = ""

    def __repr__(self) -> str:
        title = f"{self.method} on {self.sequence}{self.variant}"
        if self.reason:
            return f"<Run {title}: not available: {self.reason}>"
        figures = [("drift RMS", statistics(s.drift for s in self.spells)["rms_of_maxima"])]
        figures.append(("horizontal RMS", self.metrics["horizontal_rms_m"]))
        said = [f"{name} {value:.3g} m" for name, value in figures if value is not None]
        return f"<Run {title}: {', '.join([f'{len(self.spells)} spells', *said])}>"


@dataclass(frozen=True, eq=False)
class Comparison:
    """All runs, and what they were made of.

    Parameters
    ----------
    runs : tuple of Run
        In the order of methods, then drives, then variants.
    reference : dict
        By drive: track of the reference, longitude and latitude [deg], shape (n, 2).
    outages : str
        SPEC of the spells.
    notes : tuple of str
    others : dict
        What others' results are, by the name of their method.
    """

    runs: tuple[Run, ...]
    reference: dict[str, FloatArray]
    outages: str
    notes: tuple[str, ...] = ()
    others: dict[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        weak = f"weak GNSS {self.outages}" if self.outages else "no spells"
        some = ", ".join(self.methods[:3]) + (" …" if len(self.methods) > 3 else "")
        return f"<Comparison of {len(self.runs)} runs, {weak}: {some}>"

    @property
    def methods(self) -> list[str]:
        """Names of the methods in order."""
        return list(dict.fromkeys(run.method for run in self.runs))

    @property
    def definitions(self) -> dict[str, str]:
        """What each method does, in a sentence."""
        own = {name: METHODS[name].sentence for name in self.methods if name in METHODS}
        return {name: (self.others | own).get(name, "") for name in self.methods}

    def of(self, method: str) -> list[Run]:
        """Return the runs of a method."""
        return [run for run in self.runs if run.method == method]


def reduced(
    method: str,
    sequence: str,
    variant: str,
    solution: Solution,
    evaluation: Evaluation,
    spells: Listing[Spell],
    kind: Method | None = None,
    availability: float = float("nan"),
) -> Run:
    """Reduce a solution and its evaluation to a `Run`.

    Parameters
    ----------
    method, sequence, variant : str
    solution : Solution
    evaluation : Evaluation
    spells : sequence of Spell
    kind : Method, optional
        To tell held epochs from fresh ones; without it `availability` is taken as given.
    availability : float
    """
    time = evaluation.time
    inside = in_spells(time, spells)
    horizontal = np.hypot(evaluation.error_pos_n[:, 0], evaluation.error_pos_n[:, 1])
    if kind is not None and time.size:
        availability = float(fresh(solution, kind, time).mean())
    offered: dict[str, list[bool]] = {}
    for u in solution.updates:
        offered.setdefault(u.kind, []).append(u.accepted)
    used = {
        kind: (sum(accepted), len(accepted), normalised_nis(solution.updates, kind))
        for kind, accepted in offered.items()
    }
    return Run(
        method=method,
        sequence=sequence,
        variant=variant,
        metrics=evaluation.metrics,
        consistency={
            "nees_in": _mean(evaluation.nees_position[inside]),
            "nees_out": _mean(evaluation.nees_position[~inside]),
            "nees_velocity": _squared(evaluation.error_vel_n, evaluation.sigma_vel_n),
            "nees_heading": _squared(evaluation.error_rpy[:, 2:], evaluation.sigma_rpy[:, 2:]),
            "nis_mean": evaluation.consistency["nis_mean"],
        },
        availability=availability,
        near=float((horizontal <= _FAR).mean()) if time.size else float("nan"),
        spells=tuple(s for spell in spells if (s := spell_figures(evaluation, spell)) is not None),
        track=thin_track(solution.trajectory.pos_e),
        used=used,
    )


def _mean(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None


def _squared(error: FloatArray, sigma: FloatArray) -> float | None:
    """Return the mean over epochs of Σ (e/σ)² over axes; None where no σ is stated."""
    stated = (sigma > 0.0).all(axis=1)
    return _mean(np.sum(np.square(error[stated] / sigma[stated]), axis=1))


def thin_track(pos_e: FloatArray) -> FloatArray:
    """Return longitude and latitude [deg] of what a page can show of a track, shape (n, 2)."""
    keep = np.unique(np.linspace(0, len(pos_e) - 1, _TRACK_POINTS).astype(int))
    lla = ecef_to_lla(pos_e[keep])
    return np.degrees(lla[:, [1, 0]])


def figures_of(runs: list[Run]) -> dict[str, Any]:
    """Return the figures of one method: of its one run, or the median over its runs.

    Drift and the other figures of spells are over all spells of all runs; there are none where
    those do not agree in their duration (`durations_agree`).
    """
    good = [run for run in runs if not run.reason]
    spells = spells_of(good)
    stretches = drifts(good)
    if not durations_agree(spells):
        spells, stretches = [], {}
    reasons = list(dict.fromkeys(run.reason for run in runs if run.reason))

    def over(values: Iterable[float | None]) -> float | None:
        known = [v for v in values if v is not None and np.isfinite(v)]
        return float(np.median(known)) if known else None

    out: dict[str, Any] = {
        "runs": len(good),
        "errors": {key: over(run.metrics[key] for run in good) for key in METRICS},
        "drift_m": statistics(s.drift for s in spells),
        "drift_interval_m": rms_interval(stretches),
        "spells": len(spells),
        "max_error_m": statistics(s.max_error for s in spells),
        "final_error_m": statistics(s.final_error for s in spells),
        "velocity_error_mps": statistics(s.velocity_error for s in spells),
        "heading_drift_deg": statistics(abs(np.degrees(s.heading_drift)) for s in spells),
        "availability": over(run.availability for run in good),
        "within_5_m": over(run.near for run in good),
        "consistency": {
            key: over(run.consistency.get(key) for run in good)
            for key in ("nees_in", "nees_out", "nees_velocity", "nees_heading", "nis_mean")
        },
    }
    kinds = dict.fromkeys(kind for run in good for kind in run.used)
    out["updates"] = {
        kind: {
            "offered": sum(run.used[kind][1] for run in good if kind in run.used),
            "accepted": sum(run.used[kind][0] for run in good if kind in run.used),
            "nis_mean": over(run.used[kind][2] for run in good if kind in run.used),
        }
        for kind in kinds
    }
    if any(run.headings for run in good):
        keys = {k: None for run in good for k in run.headings}
        out["alignment_windows"] = {k: over(run.headings.get(k) for run in good) for k in keys}
    if reasons:
        out["not_available"] = reasons
    return out


def spells_of(runs: Iterable[Run]) -> list[SpellFigures]:
    """Return the spells of all runs."""
    return [spell for run in runs for spell in run.spells]


def drifts(runs: Iterable[Run]) -> dict[Hashable, list[float]]:
    """Return the drift of each spell by the stretch of road it is in [m]."""
    out: dict[Hashable, list[float]] = {}
    for run in runs:
        for spell in run.spells:
            out.setdefault((run.sequence, spell.start), []).append(spell.drift)
    return out


def durations_agree(spells: Listing[SpellFigures]) -> bool:
    """Whether spells are long alike, so that one figure can stand for all of them."""
    length = [s.end - s.start for s in spells]
    return not length or max(length) - min(length) <= max(_ALIKE * max(length), _EPOCH)


def tables(comparison: Comparison) -> list[tuple[str, dict[str, list[Run]]]]:
    """Return the runs of each method, recording by recording, then of all recordings together.

    The last only where there are several, and where all spells are long alike.
    """
    names = list(dict.fromkeys(run.sequence for run in comparison.runs))
    out = [
        (name, {m: [r for r in comparison.of(m) if r.sequence == name] for m in comparison.methods})
        for name in names
    ]
    every = {m: comparison.of(m) for m in comparison.methods}
    spells = spells_of(comparison.runs)
    if len(names) > 1 and spells and durations_agree(spells):
        out.append((TOGETHER, every))
    return out


def as_dict(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison as plain values, one entry a method, and that for each recording."""
    return {
        "outages": comparison.outages,
        "sequences": list(comparison.reference),
        "methods": {name: figures_of(comparison.of(name)) for name in comparison.methods},
        "recordings": {
            title: {m: figures_of(runs) for m, runs in by_method.items() if runs}
            for title, by_method in tables(comparison)
            if title != TOGETHER
        },
        "definitions": comparison.definitions,
        "notes": list(comparison.notes),
    }
