"""The same drives, the same spells of weak GNSS, every method: what each one is worth.

Over all spells of a method: median, RMS and 95th percentile of their drift (`nav.spells.drift`).
Every method is judged at the same reference epochs, from the alignment of the run without spells
on. Where a set has no reference, that run, smoothed, is the judge, and the page says so.

What does not depend on the method is computed once for all of them: the start once for a drive,
GNSS and the noise of its positions once for each set of spells (`nav.engine.prepared`), and what
differs by smoothing alone is one pass through the filter. Where a spell takes something from what
the start was found with, the start is found anew, without it.
"""

from __future__ import annotations

import dataclasses
import threading
import uuid
from collections.abc import Callable, Iterable, Iterator
from collections.abc import Sequence as Listing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...datasets.sequence import Sequence
from ...datasets.series import Reference
from ...filters.errors import DataError, NavError
from ...filters.rotation import FloatArray
from ..config import Config
from ..engine.prepared import Found, Key, Prepared
from ..evaluation.accuracy import evaluate
from ..pipeline import navigate, navigate_twice
from ..results.directory import write_result
from ..solution import AlignmentReport, Solution
from ..spells.degradation import degrade
from ..spells.drift import as_reference
from ..spells.judged import Seen, judged_spells
from ..spells.outages import Outages, Spell, in_spells
from ..sweep.drives import Source, checked_drive
from ..sweep.parallel import in_parallel
from ..sweep.shared import Shared, itself
from .directories import write_sidecar
from .methods import Method, solve
from .others import Judge, Other, judged, notes_of
from .runs import Comparison, Run, reduced, thin_track


class _Last(threading.local):
    """What this thread has computed last: the runs over a recording come one after the other."""

    key: str = ""
    prepared: Prepared | None = None


_LAST = _Last()


@dataclass(frozen=True, eq=False)
class _Variant:
    """One drive with one set of spells, and what is known of it before."""

    key: str
    drive: str
    alignment: AlignmentReport
    starts: dict[Key, Found]
    config: Config
    outages: Outages
    spells: Listing[Spell]
    seed: int
    name: str
    out: Path | None
    place: str
    draw: Callable[[Path], object] | None


def compare(
    sources: Iterable[Source],
    methods: Listing[Method],
    outages: Outages,
    config: Config,
    *,
    others: Listing[Other] = (),
    settle: float = 0.0,
    seeds: int = 1,
    out: Path | None = None,
    draw: Callable[[Path], object] | None = None,
    checked: bool = True,
    cache: Path | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Comparison:
    """Run every method over every variant of every drive.

    Parameters
    ----------
    sources : iterable of path or Sequence
        With an IMU. A path is opened by the process that needs it, with the reader's options of
        `config`.
    methods : list of Method
    outages : Outages
    config : Config
        What all methods share.
    others : list of Other
        Results of other programs: judged where they cover a drive, spells or not.
    settle : float
        These are judged from so long after their beginning on [s].
    seeds : int
        Draws of satellites; without effect where nothing is drawn.
    out : Path, optional
        Result directories go here: one a method; where there are several drives or shifts, one a
        drive and shift below it. Only the first draw is written.
    draw : callable, optional
        Adds pages to each of them, for example `nav.report.run.write_report`.
    checked : bool
        Whether to refuse data that contradict physics.
    cache : Path, optional
        Folder of `datasets.cache` for what is slow to read; for processes of this machine.
    jobs : int
        Processes; −1 for all processors.
    scheduler : str, optional
        Address of a Dask scheduler; the runs are spread over its workers, which have to see the
        paths that are given, and `out`.
    progress : callable, optional
        Told the fraction done and what is being done.

    Raises
    ------
    NavError
        If a drive cannot be navigated even without spells, or no spell fits.
    """
    say = progress or (lambda fraction, what: None)
    drives = [
        checked_drive(source, config, checked, None if scheduler else cache) for source in sources
    ]
    draws = range(seeds if outages.is_random else 1)
    several = len(drives) * len(outages.shifts) > 1
    notes = []
    if seeds > 1 and not outages.is_random:
        notes.append(f"{outages.text} draws nothing: one run instead of {seeds} seeds")
    first_runs = [(drive, config, tuple(methods), bool(others)) for drive in drives]
    found: list[_Drive] = []
    for one in in_parallel(_without_spells, first_runs, jobs=jobs, scheduler=scheduler):
        found.append(one)
        say(len(found) / len(drives), "without spells")
    found = _named(found)
    calls: list[tuple[_Variant, tuple[Method, ...], Shared, Shared]] = []
    for drive, one in zip(drives, found, strict=True):
        notes += [f"{one.name}: {note}" for note in one.notes]
        judge = Shared(itself, (one.made,))
        for shift in outages.shifts:
            spells, said = judged_spells(outages, one.seen, one.alignment.time, shift)
            place = f"{one.name}@{shift:g}" if several else ""
            notes += [f"{place or one.name}: {note}" for note in said]
            for seed in draws:
                variant = _Variant(
                    uuid.uuid4().hex, one.name, one.alignment, _untouched(one.starts, spells),
                    config, outages, spells, seed,
                    f"@{shift:g} seed {seed}" if outages.is_random else f"@{shift:g}",
                    out if seed == 0 else None, place, draw,
                )  # fmt: skip
                calls += [(variant, group, drive, judge) for group in _passes(methods)]
    order = {method.name: k for k, method in enumerate(methods)}
    runs: list[Run] = []
    total = len(calls)
    what = f"{len(methods)} methods on {len(found)} drive{'s' if len(found) > 1 else ''}"
    done = in_parallel(_carry_out, calls, jobs=jobs, scheduler=scheduler)
    for k, group in enumerate(done):
        runs += group
        say((k + 1) / total, what)
    _LAST.key, _LAST.prepared = "", None
    runs.sort(key=lambda run: order[run.method])
    judges = [one.judge for one in found if one.judge is not None]
    for other in others:
        runs += _wherever(other, judges, settle)
    notes += notes_of(others, settle)
    definitions = {other.name: other.sentence for other in others}
    reference = {one.name: one.track for one in found}
    return Comparison(
        tuple(runs), reference, outages.text, tuple(dict.fromkeys(notes)), definitions
    )  # fmt: skip


def _wherever(other: Other, judges: Listing[Judge], settle: float) -> list[Run]:
    """Return the figures of a result on every drive that it covers; why not where on none."""
    runs = []
    for judge in judges:
        try:
            runs.append(judged(other, judge, settle))
        except DataError as error:
            runs.append(Run(other.name, judge.name, "", reason=str(error)))
    return [run for run in runs if not run.reason] or runs


def _passes(methods: Listing[Method]) -> Iterator[tuple[Method, ...]]:
    """Yield the methods, those together that one pass through the filter serves."""
    together: dict[Method, list[Method]] = {}
    for method in methods:
        together.setdefault(dataclasses.replace(method, name="", smooth=False), []).append(method)
    yield from map(tuple, together.values())


def _untouched(starts: dict[Key, Found], spells: Listing[Spell]) -> dict[Key, Found]:
    """Return the starts that are known before the first spell begins."""
    first = spells[0].start if spells else np.inf
    return {key: found for key, found in starts.items() if found[0].known < first}


def _named(drives: list[_Drive]) -> list[_Drive]:
    """Return the drives with different names."""
    names = [d.name for d in drives]
    if len(set(names)) == len(names):
        return drives
    out = []
    for k, one in enumerate(drives):
        name = f"{one.name}-{k + 1}"
        judge = one.judge and dataclasses.replace(one.judge, name=name)
        out.append(dataclasses.replace(one, name=name, judge=judge))
    return out


@dataclass(frozen=True, eq=False)
class _Drive:
    """What is known of a drive from its run without spells.

    `made` takes the place of a reference that is missing; `judge` is there for others' results.
    """

    name: str
    seen: Seen
    alignment: AlignmentReport
    starts: dict[Key, Found]
    notes: tuple[str, ...]
    track: FloatArray
    made: Reference | None
    judge: Judge | None


def _without_spells(
    sequence: Sequence, config: Config, methods: Listing[Method], others: bool
) -> _Drive:
    """Navigate without spells."""
    prepared = Prepared(sequence)
    made = None
    if sequence.reference is None:
        smoothing = dataclasses.replace(config.filter, smooth=True)
        whole = dataclasses.replace(config, filter=smoothing)
        undisturbed, best = navigate_twice(sequence, whole, prepared)
    else:
        undisturbed = navigate(sequence, config, prepared=prepared)
    notes = [f"without spells, as configured: {_in_short(undisturbed, sequence)}"]
    if undisturbed.installation is not None:
        notes.append(f"+vehicle, as configured: {undisturbed.installation}")
    if sequence.reference is None:
        made = as_reference(
            best.trajectory, "the smoothed solution without spells: NOT independent"
        )
        notes.append("no reference: judged by the smoothed solution without spells")
    else:
        notes.append(f"judged by {sequence.reference.source}")
    for method in methods:
        if method.kind == "certified":
            try:
                prepared.start(method.config(config))
            except NavError as error:
                notes.append(f"no certified start: {error}")
            break
    judged_by = _with_judge(sequence, made)
    assert judged_by.reference is not None
    return _Drive(
        sequence.name, Seen.of(judged_by), undisturbed.alignment, prepared.starts, tuple(notes),
        thin_track(judged_by.reference.pos_e), made, Judge.of(judged_by) if others else None,
    )  # fmt: skip


def _with_judge(sequence: Sequence, made: Reference | None) -> Sequence:
    """Return a recording with the reference it is judged by."""
    return sequence if made is None else dataclasses.replace(sequence, reference=made)


def _in_short(solution: Solution, sequence: Sequence) -> str:
    if sequence.reference is None:
        return f"aligned after {solution.alignment.waited:.0f} s"
    m = evaluate(solution, sequence).metrics
    return (
        f"horizontal RMS {m['horizontal_rms_m']:.2f} m, 95 % {m['horizontal_p95_m']:.2f} m, "
        f"aligned after {solution.alignment.waited:.0f} s"
    )


def _carry_out(
    variant: _Variant, methods: tuple[Method, ...], sequence: Sequence, made: Reference | None
) -> list[Run]:
    """Run methods that share a pass; what goes wrong knowingly is in the run."""
    try:
        prepared = _prepared(variant, sequence, made)
        if methods[0].kind == "windows":
            return [_windows(prepared.sequence, variant, methods[0])]
        solved = list(_solved(variant, methods, prepared))
        return [_run(variant, *each, prepared.sequence) for each in solved]
    except NavError as error:
        return [Run(m.name, variant.drive, variant.name, reason=str(error)) for m in methods]


def _prepared(variant: _Variant, sequence: Sequence, made: Reference | None) -> Prepared:
    """Return the drive with its spells, and what all methods have in common on it."""
    if variant.key != _LAST.key or _LAST.prepared is None:
        gnss = variant.config.gnss
        whole = dataclasses.replace(_with_judge(sequence, made), name=variant.drive)
        degraded = degrade(
            whole, variant.spells, variant.outages, seed=variant.seed,
            min_cn0_dbhz=gnss.min_cn0_dbhz, elevation_mask_deg=gnss.elevation_mask_deg,
        )  # fmt: skip
        _LAST.key, _LAST.prepared = variant.key, Prepared(degraded, variant.starts)
    return _LAST.prepared


def _solved(
    variant: _Variant, methods: tuple[Method, ...], prepared: Prepared
) -> Iterator[tuple[Method, Solution]]:
    """Yield each method with its solution."""
    if len(methods) == 2 and methods[0].kind == "loose":
        smoothed = next(m for m in methods if m.smooth)
        both = navigate_twice(prepared.sequence, smoothed.config(variant.config), prepared)
        for method in methods:
            yield method, both[method.smooth]
        return
    for method in methods:
        yield method, solve(
            prepared.sequence, method, variant.config, variant.alignment, prepared
        )  # fmt: skip


def _run(variant: _Variant, method: Method, solution: Solution, degraded: Sequence) -> Run:
    """Return the figures of a solution; write its result directory if one is wanted."""
    evaluation = evaluate(solution, degraded)
    run = reduced(
        method.name, degraded.name, variant.name, solution, evaluation, variant.spells, method
    )
    if variant.out is not None:

        def draw(draft: Path) -> None:
            write_sidecar(draft, run, variant.spells, variant.outages.text)
            if variant.draw is not None:
                variant.draw(draft)

        out = variant.out / method.name / variant.place
        write_result(
            out, solution, evaluation, degraded, method.config(variant.config), draw=draw
        )  # fmt: skip
    return run


def _windows(sequence: Sequence, variant: _Variant, method: Method) -> Run:
    from ..windows.options import WindowOptions
    from ..windows.recording import align_windows, summary

    results = align_windows(sequence, WindowOptions())
    starts = np.array([r.start for r in results])
    found = summary(results)
    weak = in_spells(starts, variant.spells)
    found["windows_in_spells"] = int(weak.sum())
    found["solved_in_spells"] = int(
        sum(np.isfinite(r.heading) for r, w in zip(results, weak, strict=True) if w)
    )
    missed = np.array([abs(r.error) for r in results])[weak]
    missed = missed[np.isfinite(missed)]
    found["mae_in_spells_deg"] = float(np.degrees(missed.mean())) if missed.size else float("nan")
    return Run(method.name, sequence.name, variant.name, headings=found)
