"""Where the time of whole commands goes: stages of run, check, compare and tune on recordings.

    python scripts/profile_commands.py [--only NAME,…] [--hours H] [--days D] [--json FILE]
    python scripts/profile_commands.py --stages OUT.json -- run PATH --out DIR

Every command is a process of its own, warm (it has run once before) unless it says "first". What
is told is processor time of one process, each stage without the stages within it, and the peak of
its memory. A machine that is busy with other work changes these by a tenth or two; the clock on the
wall it changes by anything, and it is not told.

demo       the drive of `certnav demo`: 600 s, 100 Hz, the GREAT layout with RINEX
comma2k19  a minute of a car with raw GNSS, if CERTNAV_DATA is set
hour       an hour like the demo drive's; with --rate 200 at 200 Hz
text       20 minutes at 200 Hz in KF-GINS's text, `--only nav` at every sample
day        --days of 100 Hz and 1 Hz positions and velocities in the same text, to `.nav` and report
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is imported

#: Where a stage begins: what is called there, and in which module it is looked up.
STAGES = {
    "read": [("nav.commands.flow.navigation", "load"), ("datasets.loading", "load")],
    "check": [
        ("nav.commands.flow.navigation", "_checked"),
        ("nav.commands.flow.navigation", "with_coarse_mounting"),
        ("nav.check.recording", "check_sequence"),
    ],
    "GNSS": [("nav.pipeline", "gnss_timeline"), ("nav.engine.prepared", "gnss_timeline")],
    "alignment": [
        ("nav.engine.legs", "found_start"), ("nav.engine.velocity_noise.fitted", "found_start"),
        ("nav.engine.fix_noise.fitted", "found_start"), ("nav.engine.prepared", "found_start"),
    ],
    "noise": [
        ("nav.pipeline", "with_fitted_velocities"), ("nav.pipeline", "with_fitted_noise"),
        ("nav.engine.prepared", "with_fitted_velocities"),
        ("nav.engine.prepared", "with_fitted_noise"),
    ],
    "filter": [("nav.commands.flow.navigation", "navigate"), ("nav.pipeline", "legs")],
    "write": [
        ("nav.commands.flow.navigation", "judged"),
        ("nav.commands.flow.navigation", "write_result"),
    ],
    "report": [("nav.report", "write_report")],
}  # fmt: skip
#: Stages that are found by other means, before and after those.
FOUND = ("imports", "kernels", "compile")
#: Options of runs that draw no page.
_PAGELESS = ("check", "--no-report", "--only")
#: Columns of the table.
COLUMNS = (*FOUND, *STAGES, "other", "all", "MB")


def peak_memory() -> float:
    """Return the peak of this process's memory [MB].

    What `resource` says of a process begins with the memory of the one that started it, which has
    just simulated a drive; Linux knows better.
    """
    status = Path("/proc/self/status")
    if status.exists():
        found = re.search(r"VmHWM:\s+(\d+) kB", status.read_text(encoding="ascii"))
        if found:
            return int(found[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


class Stopwatch:
    """Processor time by stages: a stage does not count while one within it runs.

    So with the growth of the peak of memory: it is of the stage in which it happened.
    """

    def __init__(self) -> None:
        self.spent = dict.fromkeys((*FOUND, *STAGES, "other"), 0.0)
        self.grown = dict.fromkeys(self.spent, 0.0)
        self._stack, self._since, self._peak = ["other"], 0.0, 0.0

    def enter(self, stage: str) -> None:
        """Begin a stage."""
        self._switch()
        self._stack.append(stage)

    def leave(self) -> None:
        """Be back in the stage before."""
        self._switch()
        self._stack.pop()

    def _switch(self) -> None:
        now = time.process_time()
        took, self._since = now - self._since, now
        self.spent[self._stack[-1]] += took
        if took < 1e-3:  # imports of what is there by the ten thousand: asking takes longer
            return
        peak = peak_memory()
        self.grown[self._stack[-1]] += peak - self._peak
        self._peak = peak

    def timed(self, stage: str, function: Callable) -> Callable:
        """Return the function as a stage; of a generator, what its steps take."""

        def call(*positional, **named):
            self.enter(stage)
            try:
                out = function(*positional, **named)
            finally:
                self.leave()
            return self._steps(stage, out) if isinstance(out, Iterator) else out

        return call

    def _steps(self, stage: str, steps: Iterator) -> Iterator:
        while True:
            self.enter(stage)
            try:
                step = next(steps, self)
            finally:
                self.leave()
            if step is self:
                return
            yield step


def stages(out: Path, command: list[str]) -> int:
    """Run a command in this process and write what its stages have taken [s]; its status."""
    import builtins
    import importlib

    watch = Stopwatch()
    imported, depth = builtins.__import__, 0

    def timed_import(*positional, **named):
        nonlocal depth
        if depth:
            return imported(*positional, **named)
        depth += 1
        watch.enter("imports")
        try:
            return imported(*positional, **named)
        finally:
            watch.leave()
            depth -= 1

    builtins.__import__ = timed_import
    cli = importlib.import_module("certnav.nav.commands.cli")
    alone = command[0] in ("run", "check")
    for stage, places in STAGES.items():
        for module, name in places:
            # What the command does not import is not to be imported for the stopwatch's sake.
            if module == ("nav.engine.prepared" if alone else "nav.commands.flow.navigation"):
                continue
            if module == "nav.report" and not (alone and set(command).isdisjoint(_PAGELESS)):
                continue
            home = importlib.import_module(f"certnav.{module}")
            setattr(home, name, watch.timed(stage, getattr(home, name)))
    _watch_kernels(watch)
    status = cli.main(command)
    watch.enter("other")
    figures: dict = {name: round(spent, 3) for name, spent in watch.spent.items()}
    figures["MB"] = round(peak_memory(), 1)
    figures["grown_MB"] = {name: round(grown, 1) for name, grown in watch.grown.items() if grown}
    out.write_text(json.dumps(figures), encoding="utf-8")
    return status


def _watch_kernels(watch: Stopwatch) -> None:
    """Let kernels that are compiled or loaded from numba's cache be stages."""
    try:
        from numba.core import caching, event
    except ImportError:
        return

    class Compiling(event.Listener):
        def on_start(self, event: object) -> None:
            watch.enter("compile")

        def on_end(self, event: object) -> None:
            watch.leave()

    event.register("numba:compile", Compiling())
    load = caching.Cache.load_overload
    caching.Cache.load_overload = watch.timed("kernels", load)


def measured(command: list[str], folder: Path, cache: Path | None = None) -> dict:
    """Run a command in a process of its own; return its stages and peak memory [s], [MB]."""
    out, environment = folder / "stages.json", dict(os.environ)
    out.unlink(missing_ok=True)
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = str(cache)
    process = subprocess.Popen(
        [sys.executable, __file__, "--stages", str(out), "--", *command],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment, cwd=folder,
    )  # fmt: skip
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if not out.exists():
        raise SystemExit(f"profile: failed: certnav {' '.join(command)}")
    figures = json.loads(out.read_text(encoding="utf-8"))
    return figures | {"all": usage.ru_utime + usage.ru_stime}


def great_drive(folder: Path, duration: float, rate: float) -> Path:
    """Simulate a drive in the GREAT layout, if it is not there yet."""
    from certnav.datasets.great.writer import simulate_folder
    from certnav.datasets.simulation.simulator import SimulationConfig

    if not folder.exists():
        config = SimulationConfig(name=folder.name, seed=2, duration=duration, imu_rate=rate)
        simulate_folder(config, folder)
    return folder


def text_drive(folder: Path, duration: float, rate: float) -> Path:
    """Simulate a drive in KF-GINS's text, an hour at a time, if it is not there yet."""
    import benchmark_peers
    import numpy as np
    from benchmark import write_text

    if folder.exists():
        return folder
    benchmark_peers.RATE = rate
    import benchmark

    benchmark.RATE = rate
    data = benchmark_peers.simulated(duration)
    write_text(data, folder)
    assert np.isfinite(data.imu.time[-1])
    return folder


TEXT_OPTIONS = [
    "--set", "data.lever=[-0.65,-0.05,-0.15]", "--set", 'data.imu_preset="adis16470"',
    "--set", "data.week=2284",
]  # fmt: skip


def cases(arguments: argparse.Namespace, folder: Path) -> Iterator[tuple[str, list[str], bool]]:
    """Yield name, command, and whether it is a first run, of what is asked for."""

    def wanted(name: str) -> bool:
        return not arguments.only or name in arguments.only.split(",")

    out = ["--out", str(folder / "result")]
    if wanted("demo"):
        demo = str(great_drive(folder / "demo-drive", 600.0, 100.0))
        yield "demo: run", ["run", demo, *out], False
        yield "demo: run --no-report", ["run", demo, *out, "--no-report"], False
        yield "demo: check", ["check", demo], False
        yield "demo: compare lc4,lc+rows", [
            "compare", demo, "--methods", "lc4,lc+rows", "--outages", "60/300:2@0",
            "--out", str(folder / "comparison"), "--jobs", "1",
        ], False  # fmt: skip
        yield "demo: tune, one threshold", [
            "tune", demo, "--snr", "35", "--k", "0.1", "--outages", "60/300:2@0",
            "--out", str(folder / "tuning"), "--jobs", "1",
        ], False  # fmt: skip
    if wanted("first"):
        demo = str(great_drive(folder / "demo-drive", 600.0, 100.0))
        yield "demo: first run", ["run", demo, *out, "--no-report"], True
    data = os.environ.get("CERTNAV_DATA")
    if wanted("comma2k19") and data:
        path = str(Path(data) / "comma2k19-example1")
        yield "comma2k19: run", ["run", path, *out], False
        yield "comma2k19: check", ["check", path], False
    if wanted("hour"):
        seconds = round(3600 * arguments.hours)
        path = great_drive(folder / f"great-{seconds}-{arguments.rate:g}", seconds, arguments.rate)
        name = f"{arguments.hours:g} h at {arguments.rate:g} Hz, RINEX"
        yield f"{name}: run", ["run", str(path), *out], False
        yield f"{name}: check", ["check", str(path)], False
    if wanted("text"):
        path = text_drive(folder / "text-1200-200", 1200.0, 200.0)
        whole = ["--only", "nav", "--set", "filter.output_rate_hz=0"]
        yield (
            "240,000 samples, text to .nav",
            ["run", str(path), *out, *TEXT_OPTIONS, *whole],
            False,
        )
    if wanted("day"):
        for share in (float(part) for part in arguments.days.split(",")):
            path = text_drive(folder / f"text-{share:g}d-100", 86400.0 * share, 100.0)
            yield (
                f"{share:g} d at 100 Hz, fixes: run",
                ["run", str(path), *out, *TEXT_OPTIONS, *arguments.day_options.split()],
                False,
            )


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="demo,first,comma2k19,hour,text,day [all]")
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--rate", type=float, default=100.0, help="of the hour's IMU [Hz]")
    parser.add_argument("--days", default="0.0625,0.25,1", help="1×, 4× and 16×")
    parser.add_argument("--day-options", default="", help="further options of the day's runs")
    parser.add_argument("--repeat", type=int, default=1, help="the best of so many is told")
    parser.add_argument("--folder", type=Path, help="where drives are kept [a temporary one]")
    parser.add_argument("--json", type=Path, help="write the figures, too")
    parser.add_argument("--stages", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("command", nargs="*", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.stages is not None:
        return stages(arguments.stages, arguments.command)
    figures = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if arguments.folder is None else arguments.folder.resolve()
        folder.mkdir(parents=True, exist_ok=True)
        print("| processor time [s] | " + " | ".join(COLUMNS) + " |")
        print("|---|" + "---:|" * len(COLUMNS), flush=True)
        for name, command, first in cases(arguments, folder):
            cache = Path(scratch) / "cache" if first else None
            runs = [measured(command, folder, cache) for _ in range(arguments.repeat)]
            row = min(runs, key=lambda run: run["all"])
            figures[name] = row
            cells = " | ".join(_cell(row, key) for key in COLUMNS)
            print(f"| {name} | {cells} |", flush=True)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    return 0


def _cell(row: dict[str, float], key: str) -> str:
    value = row[key]
    if key == "MB":
        return f"{value:.0f}"
    return f"{value:.2f}" if value >= 0.005 else ""


if __name__ == "__main__":
    sys.exit(main())
