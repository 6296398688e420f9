"""Command line. Everything heavy is imported inside the commands, so that --help is instant."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from filters.errors import NavError

if TYPE_CHECKING:
    from datasets.sequence import Sequence
    from nav.evaluation import Evaluation
    from nav.solution import Solution

#: The demo: a drive through street canyons, long enough for satellites to come and go.
DEMO_SEED, DEMO_DURATION = 2, 600.0


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status.

    Whatever certnav refuses knowingly is one line on standard error and status 1.
    """
    arguments = _parser().parse_args(argv)
    try:
        arguments.command(arguments)
    except NavError as error:
        print(f"certnav: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        print(f"certnav: {name}{error.strerror or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("certnav: interrupted; nothing was written", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="certnav",
        description="Loosely coupled GNSS/INS navigation of road vehicles.",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    run = commands.add_parser(
        "run",
        help="navigate a sequence and write a result directory with a report",
        description="Navigate a sequence: GNSS positions and Doppler velocities with the IMU in "
        "an error-state filter, judged against the reference if there is one.",
    )
    run.add_argument("path", type=Path, help="folder of the sequence")
    run.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML)")
    run.add_argument(
        "--set", action="append", default=[], metavar="SECTION.KEY=VALUE",
        help="override one configuration value, e.g. data.lever=figure; repeatable",
    )  # fmt: skip
    run.add_argument("--out", type=Path, metavar="DIR", help="result directory [results/NAME]")
    run.add_argument(
        "--start", type=float, metavar="T", help="GPS seconds of week (or GPS seconds)"
    )
    run.add_argument("--end", type=float, metavar="T", help="likewise")
    run.add_argument("--format", default="", metavar="LIST", help="also write pos,kml,tum,nav")
    run.set_defaults(command=_run)

    simulate = commands.add_parser(
        "simulate",
        help="simulate a city drive and write it in the GREAT layout",
        description="Simulate a car in a city: RINEX observations and navigation, IMU text and "
        "reference in the layout of the GREAT dataset, readable by `certnav run`.",
    )
    simulate.add_argument("--out", type=Path, required=True, metavar="DIR")
    simulate.add_argument("--seed", type=int, default=0)
    simulate.add_argument("--duration", type=float, default=600.0, metavar="S", help="[s]")
    simulate.add_argument(
        "--density", default="urban", help="open, suburb, urban or canyon [urban]"
    )
    simulate.add_argument("--imu", default="adis16470", help="IMU preset [adis16470]")
    simulate.add_argument("--moving-start", action="store_true", help="begin at cruising speed")
    simulate.add_argument("--exact", action="store_true", help="no noise, no reflections")
    simulate.add_argument("--overwrite", action="store_true")
    simulate.set_defaults(command=_simulate)

    demo = commands.add_parser(
        "demo",
        help="simulate a drive, navigate it, and say where the report is",
        description="Simulate a city drive in the GREAT layout, navigate it, write the report.",
    )
    demo.add_argument("--out", type=Path, default=Path("results/demo"), metavar="DIR")
    demo.set_defaults(command=_demo)
    return parser


def _run(arguments: argparse.Namespace) -> None:
    from nav.config import load_config
    from nav.formats import parse_formats

    config = load_config(arguments.config, arguments.set)
    _navigate(
        arguments.path, config, arguments.out, parse_formats(arguments.format),
        arguments.start, arguments.end,
    )  # fmt: skip


def _navigate(path, config, out, formats=(), start=None, end=None) -> None:
    """Load, navigate, evaluate, write, and print the summary."""
    from nav.results import check_replaceable

    began = time.perf_counter()
    if out is not None:
        check_replaceable(out)
    with _progress() as report:
        report(0.0, "reading")
        from datasets.load import load

        sequence = _cut(load(path, **config.data), start, end)
        out = Path("results") / sequence.name if out is None else out
        check_replaceable(out)
        read = time.perf_counter() - began

        from nav.config import to_toml
        from nav.evaluation import evaluate
        from nav.pipeline import navigate
        from nav.results import write_result

        solution = navigate(sequence, config, report)
        report(1.0, "evaluation and report")
        evaluation = evaluate(solution, sequence)
        solution.timing.update(read_s=read, total_s=time.perf_counter() - began)
        write_result(out, solution, evaluation, sequence, to_toml(config), formats)
    _print_summary(solution, evaluation, sequence, out)


def _cut(sequence: Sequence, start: float | None, end: float | None) -> Sequence:
    """Return the part between two times given as seconds of week, or as GPS seconds."""
    if start is None and end is None:
        return sequence
    from datasets.gpstime import SECONDS_PER_WEEK, to_week_sow

    first, last = sequence.span
    week = int(to_week_sow(first)[0]) if sequence.time_scale == "gps" else 0

    def full(value: float) -> float:
        return value + week * SECONDS_PER_WEEK if value < SECONDS_PER_WEEK else value

    return sequence.between(
        first if start is None else full(start), last if end is None else full(end)
    )


def _print_summary(
    solution: Solution, evaluation: Evaluation, sequence: Sequence, out: Path
) -> None:
    span = solution.trajectory.time[-1] - solution.trajectory.time[0]
    print(f"{solution.name}: {span:.0f} s navigated, {len(sequence.inertial)} IMU samples")
    print(f"  alignment   {solution.alignment.message}, after {solution.alignment.waited:.0f} s")
    counts: dict[str, list[int]] = {}
    for update in solution.updates:
        entry = counts.setdefault(update.kind, [0, 0])
        entry[0] += update.accepted
        entry[1] += 1
    for kind, (accepted, offered) in counts.items():
        print(f"  {kind:<11} {accepted} of {offered} updates used")
    m = evaluation.metrics
    if m["horizontal_rms_m"] is not None:
        print(
            f"  horizontal  RMS {m['horizontal_rms_m']:.2f} m, 95 % {m['horizontal_p95_m']:.2f} m, "
            f"worst {m['horizontal_max_m']:.2f} m"
        )
    if m["heading_rms_deg"] is not None:
        print(f"  heading     RMS {m['heading_rms_deg']:.2f}°")
    print(f"  report      {Path(out) / 'report.html'}")


def _simulate(arguments: argparse.Namespace) -> None:
    from datasets.great_writer import simulate_folder
    from datasets.simulator import SimulationConfig

    config = SimulationConfig(
        name=arguments.out.name,
        seed=arguments.seed,
        duration=arguments.duration,
        density=arguments.density,
        imu=arguments.imu,
        moving_start=arguments.moving_start,
        noise=not arguments.exact,
    )
    with _progress() as report:
        report(0.0, "simulating")
        folder = simulate_folder(config, arguments.out, overwrite=arguments.overwrite)
    print(f"{folder}: {config.duration:.0f} s of simulated driving; navigate it with")
    print(f"  certnav run {folder}")


def _demo(arguments: argparse.Namespace) -> None:
    from datasets.great_writer import simulate_folder
    from datasets.simulator import SimulationConfig
    from nav.config import Config

    out: Path = arguments.out
    drive = out.parent / f"{out.name}-drive"
    config = SimulationConfig(name="demo", seed=DEMO_SEED, duration=DEMO_DURATION)
    print(f"simulating {DEMO_DURATION:.0f} s of city driving in the GREAT layout → {drive}")
    simulate_folder(config, drive, overwrite=True)
    _navigate(drive, Config(), out)


def _progress() -> AbstractContextManager[Callable[[float, str], None]]:
    """Return a context that yields a progress callback; silent when not on a terminal."""
    if not sys.stderr.isatty():
        return nullcontext(lambda fraction, what: None)
    return _RichProgress()


class _RichProgress:
    """A progress bar on standard error."""

    def __enter__(self) -> Callable[[float, str], None]:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self._bar = Progress(
            TextColumn("{task.description:<24}"), BarColumn(), TimeElapsedColumn(),
            console=Console(stderr=True), transient=True,
        )  # fmt: skip
        self._task = self._bar.add_task("", total=1.0)
        self._bar.start()
        return lambda fraction, what: self._bar.update(
            self._task, completed=fraction, description=what
        )

    def __exit__(self, *exception: object) -> None:
        self._bar.stop()


if __name__ == "__main__":
    sys.exit(main())
