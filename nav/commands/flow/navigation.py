"""One recording from its folder to its result directory, and what is said about it."""

from __future__ import annotations

import dataclasses
import logging
import sys
import time
from collections.abc import Callable
from pathlib import Path

from ....datasets.cache import kept_in
from ....datasets.gpstime import SECONDS_PER_WEEK, to_week_sow
from ....datasets.loading import load
from ....datasets.physics import collected_refusals
from ....datasets.placing import write_file
from ....datasets.sequence import Sequence
from ....filters.errors import DataError
from ...check.findings import Finding
from ...check.mounting import with_coarse_mounting
from ...check.recording import check_sequence
from ...config import Config
from ...evaluation.accuracy import Evaluation, evaluate, normalised_nis, without_reference
from ...learned import learned, with_calibration
from ...notes import Note, span_words
from ...pipeline import navigate
from ...results.directory import check_replaceable, write_result
from ...solution import Solution
from ...sweep.drives import waived, way_out
from ...vehicles import VEHICLES
from ..terminal.progress import announce_kernels, progress
from .first_run import compile_ahead

#: What a bound may be beyond a recording and still be meant for it [s].
_DAY = 86400.0
_log = logging.getLogger(__name__)


def navigate_folder(
    path: Path,
    config: Config,
    out: Path | None = None,
    formats: tuple[str, ...] = (),
    start: float | None = None,
    end: float | None = None,
    checked: bool = True,
    report_page: bool = True,
    table: bool = True,
    say: bool = True,
    calibration: Path | None = None,
    learn: Path | None = None,
    figures: str | None = None,
) -> tuple[Path, str]:
    """Load, check, navigate, evaluate, write the result directory, and print the summary.

    With `say` off nothing is printed; `calibration` is read, and `learn` written, as of
    `nav.learned`; `figures` is the format of figures for papers, which are not drawn without one.

    Returns the directory, and the status of the solution.
    """
    began = time.perf_counter()
    if out is not None:
        check_replaceable(out)
    with progress() as report, kept_in(cache_folder(out)):
        report(0.0, "reading")
        with collected_refusals() as refused:
            sequence = cut(load(path, **config.data), start, end)
        if calibration is not None:
            sequence = with_calibration(sequence, calibration)
        if announce_kernels():  # what is missing was said before anything is compiled
            report(0.0, "compiling")
            compile_ahead()
        passed_over = waived(refused, config, checked)
        out = place_of_result(sequence.name, path) if out is None else out
        check_replaceable(out)
        doubted = _checked(sequence, config, checked)
        found = (*passed_over, *(Note("doubtful", f"{f.subject}: {f.found}") for f in doubted))
        if checked and VEHICLES[config.vehicle.kind].holds_course:
            sequence, measured = with_coarse_mounting(sequence, doubted)
            found = (*found, *measured)
        read = time.perf_counter() - began
        _log.info("%s: read and checked in %.2f s", path, read)
        solution = navigate(sequence, config, report)
        solution = with_findings(solution, found)
        for what, spent in solution.timing.items():
            _log.info("%s: %s %.2f s", sequence.name, what.removesuffix("_s"), spent)
        report(1.0, "evaluation and report")
        solution, evaluation = judged(solution, sequence)
        solution.timing.update(read_s=read, total_s=time.perf_counter() - began)
        write_result(
            out, solution, evaluation, sequence, config, formats,
            draw=_drawing(report_page, figures), table=table,
        )  # fmt: skip
    if learn is not None:
        _write_learned(learn, solution)
    _log.info("%s: all of it in %.2f s", out, time.perf_counter() - began)
    if say:
        _print_summary(solution, evaluation, sequence, out)
    return out, solution.status


def place_of_result(name: str, recording: Path) -> Path:
    """Return where a result goes that no place was named for: never into the recording itself."""
    out = Path("results") / name
    return out.with_name(f"{name}-run") if out.resolve() == recording.resolve() else out


def _write_learned(file: Path, solution: Solution) -> None:
    """Write what was learned; a run that has learned nothing says so, and has its result."""
    try:
        text = learned(solution)
    except DataError as error:
        print(f"certnav: {file} not written: {error}", file=sys.stderr)
        return
    write_file(file, text.encode())


def _drawing(page: bool, figures: str | None) -> Callable[[Path], None] | None:
    """Return what draws into a result directory: the page, figures for papers, both or nothing."""
    if not page and figures is None:
        return None

    def draw(draft: Path) -> None:
        if page:
            from ...report import write_report  # slow to import

            write_report(draft)
        if figures is not None:
            from ...report import write_figures  # slow to import
            from ...results.directory import read_result

            write_figures(read_result(draft), draft / "figures", figures)

    return draw


def cache_folder(out: Path | None) -> Path:
    """Return where readers keep what is slow to read: beside the result."""
    return (Path("results/result") if out is None else out).parent / ".certnav-cache"


def with_findings(solution: Solution, found: tuple[Note, ...]) -> Solution:
    """Return the solution with what the checks said; what they doubt makes it doubtful."""
    status = "doubtful" if found and solution.status == "ok" else solution.status
    return dataclasses.replace(solution, notes=(*found, *solution.notes), status=status)


def judged(solution: Solution, sequence: Sequence) -> tuple[Solution, Evaluation]:
    """Return the solution with its evaluation; one that cannot be made is a note, not a loss."""
    try:
        return solution, evaluate(solution, sequence)
    except DataError as error:
        said = Note("doubtful", f"not compared with the reference: {error}")
        notes = (*solution.notes, said)
        nis = normalised_nis(solution.updates)
        return dataclasses.replace(solution, notes=notes), without_reference(nis)


def _checked(sequence: Sequence, config: Config, checked: bool) -> list[Finding]:
    """Return what is doubtful; refuse what is fatal, unless it is not to be checked."""
    findings = check_sequence(sequence, config.gnss, config.vehicle.kind) if checked else []
    for finding in findings:
        if finding.severity == "fatal":
            raise DataError(
                f"{sequence.name}: {finding.subject}: {finding.found}",
                remedy=finding.remedy if sequence.imu is None else way_out(finding.remedy),
            )
    return [finding for finding in findings if finding.severity == "doubtful"]


def cut(sequence: Sequence, start: float | None, end: float | None) -> Sequence:
    """Return the part between two times given as seconds of week, or as GPS seconds."""
    if start is None and end is None:
        return sequence
    first, last = sequence.span
    week = int(to_week_sow(first)[0]) if sequence.time_scale == "gps" else 0

    def full(value: float) -> float:
        return value + week * SECONDS_PER_WEEK if value < SECONDS_PER_WEEK else value

    begin = first if start is None else full(start)
    stop = last if end is None else full(end)
    # What is no time of the recording's week, and far outside, was meant otherwise.
    given = [v for v in (start, end) if v is not None and v >= SECONDS_PER_WEEK]
    foreign = any(not first - _DAY <= v <= last + _DAY for v in given)
    if foreign or begin >= min(stop, last) or stop <= first:
        recorded = span_words(first, last).partition(";")[0]
        raise DataError(
            f"--start, --end: expected a part of {sequence.name} ({recorded}), found "
            f"{begin if start is None else start:.10g} … {stop if end is None else end:.10g}"
        )
    return sequence.between(begin, stop)


def _print_summary(
    solution: Solution, evaluation: Evaluation, sequence: Sequence, out: Path
) -> None:
    span = solution.trajectory.time[-1] - solution.trajectory.time[0]
    for note in solution.notes:
        if note.severity == "lost":
            print(f"{solution.status.upper()} {note.text}")
    print(f"{solution.name}: {span:.0f} s navigated, {len(sequence.inertial)} IMU samples")
    imu = sequence.inertial
    print(f"  time        {span_words(float(imu.time[0]), float(imu.time[-1]))}")
    print(f"  alignment   {solution.alignment.message}, after {solution.alignment.waited:.0f} s")
    counts: dict[str, list[int]] = {}
    for update in solution.updates:
        entry = counts.setdefault(update.kind, [0, 0])
        entry[0] += update.accepted
        entry[1] += 1
    for kind, (accepted, offered) in counts.items():
        print(f"  {kind:<11} {accepted} of {offered} updates used")
    if (rtk := solution.resolution) is not None:
        print(f"  RTK         {rtk.shares}")
    if solution.installation is not None:
        for line in (str(solution.installation), *solution.installation.antenna.lines()):
            print(f"  {line}")
    m = evaluation.metrics
    if m["horizontal_rms_m"] is not None:
        print(
            f"  horizontal  RMS {m['horizontal_rms_m']:.2f} m, 95 % {m['horizontal_p95_m']:.2f} m, "
            f"worst {m['horizontal_max_m']:.2f} m"
        )
    if m["heading_rms_deg"] is not None:
        print(f"  heading     RMS {m['heading_rms_deg']:.2f}°")
    for note in solution.notes:
        if note.severity in ("doubtful", "unmet"):
            print(f"  {note}")
    page = Path(out) / "report.html"
    print(f"  report      {page}" if page.exists() else f"  result      {out}")
