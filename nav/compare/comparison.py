"""The same drives, the same spells of weak GNSS, every method: what each one is worth.

Over all spells of a method: median, RMS and 95th percentile of their drift (`nav.spells.drift`).
Every method is judged at the same reference epochs, from the alignment of the run without spells
on. Where a set has no reference, that run, smoothed, is the judge, and the page says so.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from collections.abc import Sequence as Listing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...datasets.sequence import Sequence
from ...filters.errors import AlignmentError, ConfigError, NavError
from ..config import Config
from ..evaluation.accuracy import evaluate
from ..pipeline import navigate
from ..results.directory import write_result
from ..solution import AlignmentReport, Solution
from ..spells.degradation import degrade
from ..spells.drift import as_reference
from ..spells.outages import Outages, Spell, in_spells
from ..sweep import in_parallel
from .directories import write_sidecar
from .methods import Method, solve
from .runs import Comparison, Run, reduced, thin_track

#: After alignment, before the first periodic spell [s]: a filter needs to settle.
SETTLE = 10.0


@dataclass(frozen=True, eq=False)
class _Task:
    method: Method
    alignment: AlignmentReport
    config: Config
    outages: Outages
    spells: Listing[Spell]
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
    if undisturbed.installation is not None:
        notes.append(f"+vehicle, as configured: {undisturbed.installation}")
    if sequence.reference is None:
        smoothing = dataclasses.replace(config.filter, smooth=True)
        best = navigate(sequence, dataclasses.replace(config, filter=smoothing)).trajectory
        judge = as_reference(best, "the smoothed solution without spells: NOT independent")
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
        config = task.method.config(task.config)

        def draw(draft: Path) -> None:
            write_sidecar(draft, run, task.spells, task.outages.text)
            if task.draw is not None:
                task.draw(draft)

        write_result(task.out, solution, evaluation, degraded, config, draw=draw)
    return run


def _windows(sequence: Sequence, task: _Task) -> Run:
    from ..windows.options import WindowOptions
    from ..windows.recording import align_windows, summary

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
