"""The same drives, the same spells of weak GNSS, every method: what each one is worth.

Drift of a spell is how far the horizontal position error has moved since the spell began, at its
worst: max |e(t) − e(t₀)|, e the error vector north and east, t₀ the last reference epoch before the
spell. What was wrong before the spell does not count; what grew and healed within it does. The
largest error itself is reported beside it. Over all spells of a method: median, RMS and 95th
percentile of these maxima.

Every method is judged at the same reference epochs, from the alignment of the run without spells
on. Where a set has no reference, that run, smoothed, is the judge, and the page says so.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable
from collections.abc import Sequence as Listing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...datasets.sequence import Sequence
from ...datasets.series import Reference
from ...filters.earth import C_en_of, ecef_to_lla
from ...filters.errors import AlignmentError, ConfigError, NavError
from ...filters.rotation import FloatArray, rpy_from_matrix
from ..config import Config
from ..config_files import to_toml
from ..evaluation.accuracy import METRICS, Evaluation, evaluate, normalised_nis
from ..pipeline import navigate
from ..results.directory import write_result
from ..solution import AlignmentReport, Solution
from ..sweep import in_parallel
from .degradation import Outages, degrade, in_spells
from .methods import Method, fresh, solve

#: After alignment, before the first periodic spell [s]: a filter needs to settle.
SETTLE = 10.0
#: What stands beside a result directory's files when it took part in a comparison.
SIDECAR = "comparison-run.json"
#: Points of a track that a page can show.
_TRACK_POINTS = 1500
_FAR = 5.0


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
    final_error : float
        Horizontal error at its last reference epoch [m].
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
    final_error: float
    velocity_error: float
    heading_drift: float
    nees_before: float
    nees_end: float
    since: FloatArray
    growth: FloatArray


@dataclass(frozen=True, eq=False)
class Run:
    """One method on one variant of one drive, reduced to what a comparison needs.

    Parameters
    ----------
    method, sequence, variant : str
    metrics : dict
        See `nav.evaluation.accuracy.METRICS`.
    consistency : dict
        'nees_in', 'nees_out': mean NEES of position within and outside spells; 'nis_mean'.
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
    """

    runs: tuple[Run, ...]
    reference: dict[str, FloatArray]
    outages: str
    notes: tuple[str, ...] = ()

    @property
    def methods(self) -> list[str]:
        """Names of the methods in order."""
        return list(dict.fromkeys(run.method for run in self.runs))

    def of(self, method: str) -> list[Run]:
        """Return the runs of a method."""
        return [run for run in self.runs if run.method == method]


@dataclass(frozen=True, eq=False)
class _Task:
    method: Method
    alignment: AlignmentReport
    config: Config
    outages: Outages
    spells: FloatArray
    seed: int
    variant: str
    out: Path | None
    draw: Callable[[Path], object] | None


def compare(
    sequences: Iterable[Sequence],
    methods: Listing[Method],
    outages: Outages,
    config: Config,
    *,
    seeds: int = 1,
    out: Path | None = None,
    draw: Callable[[Path], object] | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Comparison:
    """Run every method over every variant of every drive.

    Parameters
    ----------
    sequences : iterable of Sequence
        With an IMU.
    methods : list of Method
    outages : Outages
    config : Config
        What all methods share.
    seeds : int
        Draws of satellites; without effect where nothing is drawn.
    out : Path, optional
        Result directories go here: one a method; where there are several drives or shifts, one a
        drive and shift below it. Only the first draw is written.
    draw : callable, optional
        Adds pages to each of them, for example `nav.report.run.write_report`.
    jobs : int
        Processes; −1 for all processors.
    scheduler : str, optional
        Address of a Dask scheduler; the runs are spread over its workers. With `out`, they have
        to see the same file system.
    progress : callable, optional
        Told the fraction done and what is being done.

    Raises
    ------
    NavError
        If a drive cannot be navigated even without spells, or no spell fits.
    """
    say = progress or (lambda fraction, what: None)
    sequences = _named(list(sequences))
    draws = range(seeds if outages.is_random else 1)
    several = len(sequences) * len(outages.shifts) > 1
    notes, reference = [], {}
    tasks: list[tuple[_Task, Sequence]] = []
    if seeds > 1 and not outages.is_random:
        notes.append(f"{outages.text} draws nothing: one run instead of {seeds} seeds")
    for sequence in sequences:
        say(0.0, f"{sequence.name} without spells")
        sequence, alignment, more = _judged(sequence, config)
        assert sequence.reference is not None
        notes += [f"{sequence.name}: {note}" for note in more]
        reference[sequence.name] = thin_track(sequence.reference.pos_e)
        first, last = sequence.span
        settle = 0.0 if np.isfinite(outages.start) else SETTLE
        for shift in outages.shifts:
            spells = outages.spells(first, last, alignment.time + settle, shift)
            place = f"{sequence.name}@{shift:g}" if several else ""
            for seed in draws:
                variant = f"@{shift:g} seed {seed}" if outages.is_random else f"@{shift:g}"
                for method in methods:
                    where = out / method.name / place if out is not None and seed == 0 else None
                    task = _Task(
                        method, alignment, config, outages, spells, seed, variant, where, draw
                    )
                    tasks.append((task, sequence))
    order = {method.name: k for k, method in enumerate(methods)}
    runs: list[Run] = []
    shared = list({id(sequence): sequence for _, sequence in tasks}.values())
    for run in in_parallel(_carry_out, tasks, jobs=jobs, scheduler=scheduler, shared=shared):
        runs.append(run)
        say(len(runs) / len(tasks), f"{run.method} {run.sequence}{run.variant}")
    runs.sort(key=lambda run: order[run.method])
    return Comparison(tuple(runs), reference, outages.text, tuple(dict.fromkeys(notes)))


def _named(sequences: list[Sequence]) -> list[Sequence]:
    """Return the sequences with different names."""
    names = [s.name for s in sequences]
    if len(set(names)) == len(names):
        return sequences
    return [dataclasses.replace(s, name=f"{s.name}-{k + 1}") for k, s in enumerate(sequences)]


def _judged(
    sequence: Sequence, config: Config
) -> tuple[Sequence, AlignmentReport, tuple[str, ...]]:
    """Navigate without spells; return the sequence with a reference to judge by, and notes."""
    undisturbed = navigate(sequence, config)
    notes = [f"without spells, as configured: {_in_short(undisturbed, sequence)}"]
    if not sequence.calibration.mounting_source and config.vehicle.nhc == "auto":
        notes.append(
            "the mounting of the IMU is not declared: +vehicle is standstill only "
            "(--set vehicle.nhc=on to constrain all the same)"
        )
    if sequence.reference is None:
        smoothing = dataclasses.replace(config.filter, smooth=True)
        best = navigate(sequence, dataclasses.replace(config, filter=smoothing)).trajectory
        C_nb = np.swapaxes(C_en_of(best.pos_e), 1, 2) @ best.C_eb
        judge = Reference(
            best.time, best.pos_e, best.vel_e, rpy_from_matrix(C_nb), np.zeros(3), "imu",
            "the smoothed solution without spells: NOT independent",
        )  # fmt: skip
        sequence = dataclasses.replace(sequence, reference=judge)
        notes.append("no reference: judged by the smoothed solution without spells")
    else:
        notes.append(f"judged by {sequence.reference.source}")
    return sequence, undisturbed.alignment, tuple(notes)


def _in_short(solution: Solution, sequence: Sequence) -> str:
    if sequence.reference is None:
        return f"aligned after {solution.alignment.waited:.0f} s"
    m = evaluate(solution, sequence).metrics
    return (
        f"horizontal RMS {m['horizontal_rms_m']:.2f} m, 95 % {m['horizontal_p95_m']:.2f} m, "
        f"aligned after {solution.alignment.waited:.0f} s"
    )


def _carry_out(task: _Task, sequence: Sequence) -> Run:
    """Run one method on one variant; what goes wrong knowingly is in the run."""
    name = task.method.name
    gnss = task.config.gnss
    try:
        degraded = degrade(
            sequence, task.spells, task.outages, seed=task.seed,
            min_cn0_dbhz=gnss.min_cn0_dbhz, elevation_mask_deg=gnss.elevation_mask_deg,
        )  # fmt: skip
        if task.method.kind == "windows":
            return _windows(degraded, task)
        solution = solve(degraded, task.method, task.config, task.alignment)
        evaluation = evaluate(solution, degraded)
    except NavError as error:
        return Run(name, sequence.name, task.variant, reason=str(error))
    run = reduced(name, sequence.name, task.variant, solution, evaluation, task.spells, task.method)
    if task.out is not None:
        config = to_toml(task.method.config(task.config))

        def draw(draft: Path) -> None:
            write_sidecar(draft, run, task.spells, task.outages.text)
            if task.draw is not None:
                task.draw(draft)

        write_result(task.out, solution, evaluation, degraded, config, draw=draw)
    return run


def _windows(sequence: Sequence, task: _Task) -> Run:
    from ..windows.recording import WindowOptions, align_windows, summary

    name = task.method.name
    try:
        results = align_windows(sequence, WindowOptions())
    except (AlignmentError, ConfigError) as error:
        return Run(name, sequence.name, task.variant, reason=str(error))
    starts = np.array([r.start for r in results])
    found = summary(results)
    weak = in_spells(starts, task.spells)
    found["windows_in_spells"] = int(weak.sum())
    found["solved_in_spells"] = int(
        sum(np.isfinite(r.heading) for r, w in zip(results, weak, strict=True) if w)
    )
    missed = np.array([abs(r.error) for r in results])[weak]
    missed = missed[np.isfinite(missed)]
    found["mae_in_spells_deg"] = float(np.degrees(missed.mean())) if missed.size else float("nan")
    return Run(name, sequence.name, task.variant, headings=found)


def write_sidecar(out: Path, run: Run, spells: FloatArray, outages: str) -> None:
    """Write what a result directory must know to take part in a comparison again."""
    content = {
        "method": run.method, "sequence": run.sequence, "variant": run.variant,
        "outages": outages, "spells": spells.tolist(), "availability": run.availability,
    }  # fmt: skip
    (out / SIDECAR).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def reduced(
    method: str,
    sequence: str,
    variant: str,
    solution: Solution,
    evaluation: Evaluation,
    spells: FloatArray,
    kind: Method | None = None,
    availability: float = float("nan"),
) -> Run:
    """Reduce a solution and its evaluation to a `Run`.

    Parameters
    ----------
    method, sequence, variant : str
    solution : Solution
    evaluation : Evaluation
    spells : ndarray, shape (k, 2)
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
            "nis_mean": evaluation.consistency["nis_mean"],
        },
        availability=availability,
        near=float((horizontal <= _FAR).mean()) if time.size else float("nan"),
        spells=tuple(s for pair in spells if (s := spell_figures(evaluation, *pair)) is not None),
        track=thin_track(solution.trajectory.pos_e),
        used=used,
    )


def spell_figures(evaluation: Evaluation, start: float, end: float) -> SpellFigures | None:
    """Return the figures of one spell; None where the reference has no epochs in it."""
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
        final_error=float(horizontal[-1]),
        velocity_error=float(np.linalg.norm(evaluation.error_vel_n[rows, :2], axis=1).max()),
        heading_drift=float(np.angle(np.exp(1j * (heading[1] - heading[0])))),
        nees_before=float(evaluation.nees_position[rows[0]]),
        nees_end=float(evaluation.nees_position[rows[-1]]),
        since=grid,
        growth=np.interp(grid, since, growth),
    )


def _mean(values: FloatArray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None


def thin_track(pos_e: FloatArray) -> FloatArray:
    """Return longitude and latitude [deg] of what a page can show of a track, shape (n, 2)."""
    keep = np.unique(np.linspace(0, len(pos_e) - 1, _TRACK_POINTS).astype(int))
    lla = ecef_to_lla(pos_e[keep])
    return np.degrees(lla[:, [1, 0]])


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


def figures_of(runs: list[Run]) -> dict[str, Any]:
    """Return the figures of one method: of its one run, or the median over its runs.

    Drift and the other figures of spells are over all spells of all runs.
    """
    good = [run for run in runs if not run.reason]
    spells = [spell for run in good for spell in run.spells]
    reasons = list(dict.fromkeys(run.reason for run in runs if run.reason))

    def over(values: Iterable[float | None]) -> float | None:
        known = [v for v in values if v is not None and np.isfinite(v)]
        return float(np.median(known)) if known else None

    out: dict[str, Any] = {
        "runs": len(good),
        "errors": {key: over(run.metrics[key] for run in good) for key in METRICS},
        "drift_m": statistics(s.drift for s in spells),
        "spells": len(spells),
        "max_error_m": statistics(s.max_error for s in spells),
        "final_error_m": statistics(s.final_error for s in spells),
        "velocity_error_mps": statistics(s.velocity_error for s in spells),
        "heading_drift_deg": statistics(abs(np.degrees(s.heading_drift)) for s in spells),
        "availability": over(run.availability for run in good),
        "within_5_m": over(run.near for run in good),
        "consistency": {
            key: over(run.consistency.get(key) for run in good)
            for key in ("nees_in", "nees_out", "nis_mean")
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


def as_dict(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison as plain values, one entry a method."""
    return {
        "outages": comparison.outages,
        "sequences": list(comparison.reference),
        "methods": {name: figures_of(comparison.of(name)) for name in comparison.methods},
        "notes": list(comparison.notes),
    }
