"""Kill ``certnav run`` at random moments and look at what is left of the result directory.

    python scripts/kill_loop.py --count 200

A short drive is simulated once. Runs with ``--no-report`` write its result to one directory, each
with an output rate of its own by which the result can be told; each is killed (SIGKILL) at a moment
drawn over its whole duration, or, every second one, within the moments in which it writes. (They
are forked from a process that has imported everything: so kills fall into work, not imports.) After
each kill the directory must be whole by its checksums, read back, and be that of the run before or
of the killed one. Meanwhile a reader looks all the time and must find a whole result. At the
end a run that is left alone must leave nothing beside its result. The status is 1 if any does not.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.placing import broken_seals, current
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.filters.errors import NavError
from certnav.nav.commands.cli import main as main_of_certnav
from certnav.nav.results.directory import read_result


@dataclass
class Tally:
    """What was found.

    Attributes
    ----------
    found : Counter
        After a kill: 'none yet', 'old', 'new'; moments of the kill: 'while writing'.
    faults : list of str
    looks : int
        How often the reader looked.
    """

    found: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    looks: int = 0


def start(drive: Path, out: Path, number: int) -> int:
    """Fork a run whose result can be told by its number; return the process."""
    process = os.fork()
    if process:
        return process
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = main_of_certnav(
            ["run", str(drive), "--out", str(out), "--no-report",
             "--set", f"filter.output_rate_hz={rate(number)}",
             "--set", "alignment.method=level+course"]
        )  # fmt: skip
    except BaseException:
        status = 70
    os._exit(status)


def ended(process: int) -> bool:
    """Whether a process has ended; it stays to be waited for."""
    return os.waitid(os.P_PID, process, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def run_to_end(drive: Path, out: Path, number: int) -> float:
    """Let a run alone; return how long it took [s]."""
    began = time.perf_counter()
    _, status = os.waitpid(start(drive, out, number), 0)
    if status:
        raise RuntimeError(f"a run that was left alone ended with status {status}")
    return time.perf_counter() - began


def rate(number: int) -> float:
    """Return the output rate that marks a run [Hz]."""
    return round(5.0 + 0.001 * number, 3)


def number_of(out: Path) -> int | None:
    """Return the number of the run that wrote a whole result; None if there is none.

    Raises
    ------
    ValueError
        What is wrong with it.
    """
    if not current(out).exists():
        return None
    broken = broken_seals(current(out))
    if broken:
        raise ValueError(f"not whole: {', '.join(broken)}")
    try:
        result = read_result(out)
    except NavError as error:
        raise ValueError(str(error)) from error
    marked = [line for line in result.config_text.splitlines() if "output_rate_hz" in line]
    written = float(marked[0].split("=")[1])
    time_s = result.solution.trajectory.time
    if abs((time_s[-1] - time_s[0]) / (time_s.size - 1) * written - 1.0) > 0.1:
        raise ValueError(f"configuration says {written} Hz, solution.csv is of another run")
    return round((written - 5.0) / 0.001)


def drafts(out: Path) -> set[str]:
    """Return what stands beside the result by its name."""
    return {p.name for p in out.parent.glob(f".{out.name}.*")}


def kill_one(drive: Path, out: Path, number: int, duration: float, draw: random.Random) -> bool:
    """Start a run and kill it; return whether it was writing."""
    before = drafts(out)
    process = start(drive, out, number)
    if number % 2:
        time.sleep(draw.uniform(0.0, 1.1 * duration))
    else:
        while not ended(process) and not drafts(out) - before:
            time.sleep(0.0002)
        time.sleep(draw.uniform(0.0, 0.1))
    was_writing = not ended(process) and bool(drafts(out) - before)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return was_writing


def watch(out: Path, log: Path) -> None:
    """Look at the result until killed: there once, it must stay, and read back whole."""
    seen, looks = False, 0
    while True:
        there = current(out).exists()
        said = "gone" if seen and not there else ""
        seen |= there
        try:
            if there:
                read_result(out)
        except NavError as error:
            said = str(error)
        looks += 1
        with log.open("a", encoding="utf-8") as stream:
            stream.write(f"{looks} {said}\n")
        time.sleep(0.02)


def kill_loop(count: int, seed: int, work: Path) -> Tally:
    """Kill so many runs and return what was found."""
    draw, tally = random.Random(seed), Tally()
    config = SimulationConfig(name="kill", seed=1, duration=60.0, density="open", gnss_rate=1.0)
    drive = simulate_folder(config, work / "drive")
    out = work / "results" / "kill"
    out.parent.mkdir()
    duration = max(run_to_end(drive, work / "first", 0) for _ in range(2))
    log = work / "reader.txt"
    log.touch()
    reader = os.fork()
    if not reader:
        try:
            watch(out, log)
        finally:
            os._exit(70)
    standing = None
    try:
        for number in range(1, count + 1):
            tally.found["while writing"] += kill_one(drive, out, number, duration, draw)
            try:
                found = number_of(out)
            except ValueError as error:
                tally.faults.append(f"kill {number}: {error}")
                continue
            if found not in (standing, number):
                tally.faults.append(f"kill {number}: found run {found}, expected {standing}")
            kind = "none yet" if found is None else "new" if found == number else "old"
            tally.found[kind] += 1
            standing = found
            if number % 20 == 0:
                print(f"{number} of {count}: {dict(tally.found)}", file=sys.stderr)
        run_to_end(drive, out, count + 1)
    finally:
        os.kill(reader, signal.SIGKILL)
        os.waitpid(reader, 0)
    looks = [line.split(maxsplit=1) for line in log.read_text(encoding="utf-8").splitlines()]
    tally.looks = len(looks)
    tally.faults += [f"reader: {look[1]}" for look in looks if len(look) > 1]
    if number_of(out) != count + 1:
        tally.faults.append("the last run, left alone, is not what is there")
    if drafts(out):
        tally.faults.append(f"left beside the result: {sorted(drafts(out))}")
    return tally


def main() -> int:
    """Run the loop and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200, metavar="N", help="kills [200]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        tally = kill_loop(arguments.count, arguments.seed, Path(work))
    if arguments.json:
        print(json.dumps({"found": tally.found, "faults": tally.faults, "looks": tally.looks}))
    else:
        print(f"{arguments.count} runs killed: {dict(tally.found)}; the reader looked")
        print(f"{tally.looks} times; {len(tally.faults)} faults")
        for fault in tally.faults:
            print(f"  {fault}")
    return 1 if tally.faults else 0


if __name__ == "__main__":
    sys.exit(main())
