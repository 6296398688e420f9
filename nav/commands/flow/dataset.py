"""Many recordings through everything there is: checked, studied, navigated, tuned, compared.

Each step writes its own directory under one folder, whole. What goes wrong with one recording, or
in one step, is kept with its reason and costs the others nothing.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ....datasets import gpstime
from ....datasets.cache import kept_in
from ....datasets.great.reader import SIMULATED
from ....datasets.placing import write_file, written_whole
from ....datasets.sequence import Sequence
from ....filters.errors import DataError, NavError
from ...check.recording import read_and_checked
from ...compare.comparison import compare
from ...compare.methods import Method
from ...compare.report import write_page
from ...config import Config
from ...spells.outages import Outages
from ...study.recording import StudyOptions, study
from ...study.report import write_study
from ...sweep.parallel import in_parallel
from ...tune.settings import tune_settings
from ...tune.settings_report import write_settings
from ..terminal.progress import silent
from .navigation import navigate_folder

Say = Callable[[float, str], None]
STUDY, TUNING, COMPARISON = "study", "tuning", "comparison"
AS_CONFIGURED, TUNED = "as configured", "tuned"
#: Steps that need not be.
SKIPPABLE = ("study", "tune", "compare")
#: Where the runs with each settings are.
RUNS = {AS_CONFIGURED: "runs", TUNED: "runs-tuned"}


@dataclass(frozen=True)
class Work:
    """What is asked.

    Parameters
    ----------
    folders : tuple of Path
        Recordings, absolute.
    config : Config
    outages : Outages
        Of the comparison and of tuning.
    methods : tuple of Method
        Of the comparison.
    jobs : int
    scheduler : str, optional
    skipped : tuple of str
        Of `SKIPPABLE`.
    """

    folders: tuple[Path, ...]
    config: Config
    outages: Outages
    methods: tuple[Method, ...]
    jobs: int = -1
    scheduler: str | None = None
    skipped: tuple[str, ...] = ()


@dataclass(frozen=True)
class Looked:
    """One recording, looked at.

    Parameters
    ----------
    name : str
    folder : Path
    page : str
        What the check has found, as HTML.
    why : str
        Why it is not navigated; '' where it is.
    figures : dict
        What it holds; empty where it cannot be read.
    simulated : bool
    """

    name: str
    folder: Path
    page: str
    why: str = ""
    figures: dict[str, Any] = field(default_factory=dict)
    simulated: bool = False


@dataclass(frozen=True)
class Ran:
    """One run: its summary, or why there is none."""

    name: str
    settings: str
    summary: dict[str, Any] = field(default_factory=dict)
    why: str = ""


@dataclass
class Outcome:
    """What has come of it so far.

    Parameters
    ----------
    looked, runs : list
    steps : list of (str, float, str)
        Name of each step, how long it took [s], and why it has failed; '' where it has not.
    tuned : str
        What tuning has decided; '' without.
    """

    looked: list[Looked] = field(default_factory=list)
    runs: list[Ran] = field(default_factory=list)
    steps: list[tuple[str, float, str]] = field(default_factory=list)
    tuned: str = ""

    @property
    def failures(self) -> list[str]:
        """Say what has gone wrong: recordings left out, runs without a result, steps."""
        out = [f"{one.name} left out: {one.why}" for one in self.looked if one.why]
        out += [f"{run.name}, {run.settings}: {run.why}" for run in self.runs if run.why]
        return out + [f"{name} failed: {why}" for name, _, why in self.steps if why]

    @property
    def simulated(self) -> list[str]:
        """Names of the recordings that are simulated."""
        return [one.name for one in self.looked if one.simulated]

    def good(self, settings: str = AS_CONFIGURED) -> list[str]:
        """Return the names of the recordings that have been navigated."""
        return [run.name for run in self.runs if run.settings == settings and not run.why]

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Keep how long a step takes, and why it has failed if it refuses something."""
        began, why = time.perf_counter(), ""
        try:
            yield
        except NavError as error:
            why = str(error)
        self.steps.append((name, time.perf_counter() - began, why))


def work_through(work: Work, out: Path, report: Say) -> Outcome:
    """Take recordings through all steps; what each has written is below `out`.

    Parameters
    ----------
    work : Work
    out : path
        A folder that exists.
    report : callable
        Told the fraction of a step that is done, and what is being done.
    """
    found = Outcome()
    with kept_in(out / ".certnav-cache"):
        with found.step("check"):
            _check(work, out, found, report)
        sound = [one for one in found.looked if not one.why]
        if "study" not in work.skipped:
            with found.step("study"):
                _study(work, sound, out, report)
        with found.step("run"):
            _run(work, AS_CONFIGURED, sound, out, found, report)
        sound = [one for one in sound if one.name in found.good()]
        if "tune" not in work.skipped:
            _tune(work, sound, out, found, report)
        if "compare" not in work.skipped:
            with found.step("compare"):
                _compare(work, sound, out, report)
    return found


def _study(work: Work, chosen: list[Looked], out: Path, report: Say) -> None:
    whole = study(
        [one.folder for one in chosen], StudyOptions(), data=dict(work.config.data),
        jobs=work.jobs, scheduler=work.scheduler, progress=report,
    )  # fmt: skip
    write_study(whole, out / STUDY)


def _tune(work: Work, chosen: list[Looked], out: Path, found: Outcome, report: Say) -> None:
    """Tune; where other settings are recommended, navigate with them, too."""
    settings = None
    with found.step("tune"):
        settings = tune_settings(
            [one.folder for one in chosen], config=work.config, outages=work.outages,
            jobs=work.jobs, scheduler=work.scheduler, progress=report,
        )  # fmt: skip
        write_settings(settings, out / TUNING)
        found.tuned = f"{settings.candidates[settings.chosen].name}: {settings.decided}"
    if settings is not None and settings.config != work.config:
        with found.step("run, tuned"):
            tuned = replace(work, config=settings.config)
            _run(tuned, TUNED, chosen, out, found, report)


def _check(work: Work, out: Path, found: Outcome, report: Say) -> None:
    calls = [(folder, work.config) for folder in work.folders]
    for one in in_parallel(looked_at, calls, jobs=work.jobs, scheduler=work.scheduler):
        found.looked.append(one)
        report(len(found.looked) / len(calls), f"check: {one.name}")
    (out / "checks").mkdir(exist_ok=True)
    for one in found.looked:
        write_file(out / "checks" / f"{one.name}.html", one.page.encode())


def _run(
    work: Work, settings: str, chosen: list[Looked], out: Path, found: Outcome, report: Say
) -> None:
    calls = [
        (one.name, one.folder, work.config, out / RUNS[settings] / one.name, settings)
        for one in chosen
    ]
    for done, run in enumerate(
        in_parallel(ran, calls, jobs=work.jobs, scheduler=work.scheduler), 1
    ):
        found.runs.append(run)
        report(done / len(calls), f"run: {run.name}")


def _compare(work: Work, chosen: list[Looked], out: Path, report: Say) -> None:
    if not chosen:
        raise DataError("no recording has been navigated: nothing to compare")
    with written_whole(out / COMPARISON) as draft:
        whole = compare(
            [one.folder for one in chosen], work.methods, work.outages, work.config,
            cache=out / ".certnav-cache", jobs=work.jobs, scheduler=work.scheduler, progress=report,
        )  # fmt: skip
        write_page(whole, draft)


def looked_at(folder: Path, config: Config) -> Looked:
    """Return what a recording holds and what its check has found: a unit of work."""
    from ...check.page import build_page  # slow to import

    found, sequence = read_and_checked(folder, config.data, config.vehicle.kind)
    page = build_page(found, sequence)
    why = "; ".join(finding.line for finding in found.of("fatal"))
    if sequence is None:
        return Looked(folder.name, folder, page, why)
    simulated = SIMULATED in sequence.notes
    return Looked(sequence.name, folder, page, why, holdings(sequence), simulated)


def holdings(sequence: Sequence) -> dict[str, Any]:
    """Return what a recording holds, in figures: of a data section's table."""
    first, last = sequence.span
    out: dict[str, Any] = {"begin": first, "duration_s": last - first}
    if sequence.time_scale == "gps":
        out["begin"] = f"{gpstime.to_calendar(first):%Y-%m-%d %H:%M:%S}"
    if sequence.imu is not None:
        out["imu_hz"] = 1.0 / float(np.median(np.diff(sequence.imu.time)))
    seen = sequence.observations
    if seen is not None:
        usable = seen.usable & seen.has_range_rate
        _, per_epoch = np.unique(seen.time, return_inverse=True)
        count = np.bincount(per_epoch, weights=usable)
        out |= {
            "epochs": int(count.size), "satellites": float(np.median(count)),
            "below_four": float(np.mean(count < 4)),
            "systems": "".join(np.unique(seen.sat.astype("U1"))),
        }  # fmt: skip
    if sequence.reference is not None:
        way = np.linalg.norm(np.diff(sequence.reference.pos_e, axis=0), axis=1)
        out["distance_km"] = float(way.sum()) / 1e3
        out["reference"] = sequence.reference.source
    return out


def ran(name: str, folder: Path, config: Config, out: Path, settings: str) -> Ran:
    """Navigate one recording into its result directory: a unit of work."""
    try:
        with silent():
            navigate_folder(folder, config, out, say=False)
    except NavError as error:
        return Ran(name, settings, why=str(error))
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    return Ran(name, settings, summary)
