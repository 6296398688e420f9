"""Feed broken files to every reader and count what is neither read nor refused in one line.

    python scripts/fuzz.py --count 100000 --json

Sound inputs are made from a simulated drive, broken at random (`fuzz_mutations`) and read in two
worker processes that may hang or die without harm. With CERTNAV_DATA set, excerpts of real RINEX
are broken too. A case is refused when a `NavError` of one line comes out; anything else that is
no result is counted:

- traceback: another exception, or a message of several lines;
- hang: no answer within 5 s of processor time, or a minute;
- crash: the process died.

Scaled inertial data (`--units`) have to be refused by the reader, or named by ``certnav check``.
The status is 1 if anything was found. A case is made again by its seed and number: ``--only``.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import fuzz_mutations
import fuzz_readers
import fuzz_seeds
import numpy as np
from fuzz_page import text, write_section
from fuzz_seeds import Target
from fuzz_units import silent_units

from certnav.filters.errors import NavError

HANG_S = 5.0
#: On a machine busy with other things the clock on the wall may show more; at most so much.
_WALL_S = 60.0
#: Imports and compiled kernels come with the first, sound, reading.
_WARM_UP_S = 120.0
#: Address space of a worker: an absurd size becomes a MemoryError, not a dead machine.
_MEMORY = 6 << 30
#: A worker is replaced after so many cases: RTKLIB's memory is its own.
_BLOCK = 500
OUTCOMES = ("ok", "refused", "traceback", "hang", "crash")
_BAD = ("traceback", "hang", "crash")


# --- one case --------------------------------------------------------------------------------


def make_case(
    target: Target, seeds: Path, folder: Path, seed: int, number: int
) -> tuple[str, list[str]]:
    """Break files of a folder of links to a target's seed; return how, and which."""
    r = Random(f"{seed}/{target.name}/{number}")
    sound = seeds / fuzz_seeds.SHARED.get(target.name, target.name)
    number_of = min(len(target.kinds), 1 if r.random() < 0.85 else 2)
    broken, said = r.sample(sorted(target.kinds), number_of), []
    for name in broken:
        place = folder / name
        content, how = fuzz_mutations.mutate((sound / name).read_bytes(), target.kinds[name], r)
        said.append(f"{name}: {how}")
        place.unlink()
        if content == fuzz_mutations.DIRECTORY:
            place.mkdir()
        elif content != fuzz_mutations.MISSING:
            assert isinstance(content, bytes)
            place.write_bytes(content)
            # caches go by size and time, and a clock may tick slower than this
            os.utime(place, ns=(10**18 + number * 10**6,) * 2)
    return "; ".join(said), broken


def link(sound: Path, folder: Path) -> None:
    """Make a folder of links to the files of another one."""
    for file in sound.rglob("*"):
        place = folder / file.relative_to(sound)
        place.parent.mkdir(parents=True, exist_ok=True)
        if file.is_dir():
            place.mkdir(exist_ok=True)
        else:
            place.symlink_to(file)


def repair(sound: Path, folder: Path, broken: list[str]) -> None:
    """Put the links back."""
    for name in broken:
        place = folder / name
        if place.is_dir():
            place.rmdir()
        place.unlink(missing_ok=True)
        place.symlink_to(sound / name)
    shutil.rmtree(folder / "imported", ignore_errors=True)


def read_case(name: str, folder: Path, random: Random | None = None) -> tuple[str, str]:
    """Read a folder; return the outcome and what it said."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with np.errstate(all="ignore"):
                fuzz_readers.READ[name](folder)
                if name == "config" and random is not None:
                    _assign(folder, random)
    except NavError as error:
        text = str(error)
        if "\n" in text or "\r" in text or not text:
            return "traceback", f"message of several lines: {text!r}"[:300]
        return "refused", text
    except BaseException as error:
        frames = traceback.extract_tb(error.__traceback__)
        own = [f for f in frames if not any(p in f.filename for p in ("packages/", "lib/python"))]
        where = " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in reversed(own[-3:]))
        return "traceback", f"{type(error).__name__}: {str(error)[:120]!r} at {where}"
    return "ok", ""


def _assign(folder: Path, r: Random) -> None:
    """Set one value of the configuration as ``--set`` does."""
    from certnav.nav.config import Config, load_config

    sections = ("alignment", "filter", "gnss", "vehicle", "data")
    section = r.choice(sections)
    fields = list(vars(getattr(Config(), section))) if section != "data" else ["lever", "week"]
    value = r.choice(fuzz_mutations._TOML + fuzz_mutations._WORDS + fuzz_mutations._NUMBERS)
    text = f"{section}.{r.choice(fields)}={value}"
    if r.random() < 0.3:
        text = fuzz_mutations.flip_bytes(text.encode(), r).decode("latin-1")
    load_config(None, [text])


def work(seeds: Path, scratch: Path, seed: int) -> None:
    """Serve cases: a line ``target first count`` in, a line of JSON a case out."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "w")
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)  # RTKLIB's children talk
    os.dup2(silence, 2)
    targets = {t.name: t for t in json_targets(seeds)}
    warm: set[str] = set()

    def answer(**what: Any) -> None:
        answers.write(json.dumps(what) + "\n")
        answers.flush()

    for order in sys.stdin:
        name, first, count = order.split()
        target = targets[name]
        if name not in warm:
            answer(begin=-1)
            outcome, said = read_case(name, seeds / fuzz_seeds.SHARED.get(name, name))
            answer(end=-1, outcome=outcome, said=said)
            warm.add(name)
        sound, folder = seeds / fuzz_seeds.SHARED.get(name, name), scratch / name
        if not folder.is_dir():
            link(sound, folder)
        for number in range(int(first), int(first) + int(count)):
            how, broken = make_case(target, seeds, folder, seed, number)
            answer(begin=number, how=how)
            began = time.perf_counter()
            outcome, said = read_case(name, folder, Random(f"{seed}/set/{number}"))
            answer(end=number, outcome=outcome, said=said, how=how,
                   seconds=round(time.perf_counter() - began, 3))  # fmt: skip
            repair(sound, folder, broken)
        answer(done=True)


def json_targets(seeds: Path) -> list[Target]:
    """Return the targets that the parent has written down."""
    return [Target(**t) for t in json.loads((seeds / "targets.json").read_text())]


# --- the parent ------------------------------------------------------------------------------


class Worker:
    """A worker process that is replaced when it hangs or dies."""

    def __init__(self, seeds: Path, scratch: Path, seed: int) -> None:
        self._arguments = ("--worker", str(seeds), str(scratch), str(seed))
        self._scratch = scratch
        scratch.mkdir(exist_ok=True)
        self._process: subprocess.Popen[bytes] | None = None
        self._buffer = b""
        self._served = 0

    def _start(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._served > 4 * _BLOCK:
            self.close()
        if self._process is None:
            self._served = 0
            self._buffer = b""
            self._process = subprocess.Popen(
                [sys.executable, __file__, *self._arguments],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            )  # fmt: skip
        return self._process

    def close(self) -> None:
        """End the process, also one that hangs."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for stream in (self._process.stdin, self._process.stdout):
                if stream is not None:
                    with contextlib.suppress(OSError):
                        stream.close()
            self._process = None

    def _line(self, timeout: float) -> dict[str, Any] | None:
        """Return the next answer; None after the timeout; raise EOFError if the process died."""
        assert self._process is not None and self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        began, spent = time.monotonic(), self._processor_time()
        while b"\n" not in self._buffer:
            left = max(timeout - (self._processor_time() - spent), 0.0)
            if left <= 0 or time.monotonic() - began > max(_WALL_S, timeout):
                return None
            if not select.select([descriptor], [], [], max(left, 0.05))[0]:
                continue
            more = os.read(descriptor, 1 << 16)
            if not more:
                raise EOFError
            self._buffer += more
        line, self._buffer = self._buffer.split(b"\n", 1)
        return dict(json.loads(line))

    def _processor_time(self) -> float:
        """Return the processor time of the worker [s]; of this clock where there is no /proc."""
        assert self._process is not None
        try:
            fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return time.monotonic()
        return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")

    def run(self, name: str, first: int, count: int) -> Iterator[dict[str, Any]]:
        """Yield the outcome of each case, whatever becomes of the process."""
        number, end = first, first + count
        while number < end:
            process = self._start()
            assert process.stdin is not None
            process.stdin.write(f"{name} {number} {end - number}\n".encode())
            process.stdin.flush()
            current, timeout, how = -2, _WARM_UP_S, ""
            while True:
                try:
                    found = self._line(timeout)
                except EOFError:
                    found = {"end": current, "outcome": "crash", "said": self._status()}
                if found is None:
                    found = {"end": current, "outcome": "hang", "said": f"> {timeout:g} s"}
                if "done" in found:
                    number = end
                    break
                if "begin" in found:
                    current, how = found["begin"], found.get("how", "")
                    timeout = HANG_S if current >= 0 else _WARM_UP_S
                    continue
                timeout = _WARM_UP_S
                self._served += 1
                if found["end"] < 0 and found["outcome"] != "ok":
                    raise RuntimeError(f"{name}: the sound input is not read: {found['said']}")
                if found["end"] >= 0:
                    yield {"how": how, **found}
                    number = found["end"] + 1
                if found["outcome"] in ("crash", "hang"):
                    self.close()
                    shutil.rmtree(self._scratch, ignore_errors=True)
                    self._scratch.mkdir()
                    break

    def _status(self) -> str:
        assert self._process is not None
        return f"status {self._process.wait()}"


def fuzz(
    targets: list[Target], seeds: Path, count: int, seed: int, seconds: float, workers: int
) -> dict[str, Any]:
    """Return counts per reader, and examples of what is wrong."""
    shares = {t.name: t.weight / sum(t.weight for t in targets) for t in targets}
    rest = {name: max(1, round(count * share)) for name, share in shares.items()}
    at = dict.fromkeys(rest, 0)
    reader = {t.name: t.reader for t in targets}
    counts: dict[str, Counter[str]] = {t.reader: Counter() for t in targets}
    examples: dict[str, dict[str, Any]] = {}
    slow: list[tuple[float, str]] = []
    lock, end = threading.Lock(), time.monotonic() + seconds
    unsound: list[RuntimeError] = []

    def next_block() -> tuple[str, int, int] | None:
        with lock:
            # the target that is behind most: whenever time runs out, all have had their share
            name = max(rest, key=lambda n: rest[n] / (rest[n] + at[n]))
            if rest[name] == 0 or unsound or time.monotonic() > end:
                return None
            size = min(rest[name], _BLOCK)
            size = max(1, min(size, int(0.1 * (rest[name] + at[name])) + 1))
            first = at[name]
            at[name] += size
            rest[name] -= size
            return name, first, size

    def serve(k: int) -> None:
        worker = Worker(seeds, seeds.parent / f"scratch-{k}", seed)
        try:
            while (block := next_block()) is not None:
                name, first, size = block
                for found in worker.run(name, first, size):
                    with lock:
                        counts[reader[name]][found["outcome"]] += 1
                        slow.append((found.get("seconds", 0.0), f"{name}/{found['end']}"))
                        slow.sort(reverse=True)
                        del slow[5:]
                        if found["outcome"] in _BAD:
                            where = found["said"].rpartition(" at ")[2]
                            key = (
                                f"{name}: {where}"
                                if " at " in found["said"]
                                else (f"{name}: {found['outcome']}")
                            )
                            example = examples.setdefault(
                                key,
                                {"outcome": found["outcome"], "case": f"{name}/{found['end']}",
                                 "said": found["said"], "how": found.get("how", ""), "count": 0},
                            )  # fmt: skip
                            example["count"] += 1
                            if example["count"] == 1:  # a long run is watched
                                print(json.dumps(example, ensure_ascii=False), file=sys.stderr)
        except RuntimeError as error:
            unsound.append(error)
        finally:
            worker.close()

    threads = [threading.Thread(target=serve, args=(k,)) for k in range(workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if unsound:
        raise SystemExit(str(unsound[0]))
    total = sum(counts.values(), Counter())
    return {
        "tried": sum(total.values()),
        "tracebacks": total["traceback"],
        "hangs": total["hang"],
        "crashes": total["crash"],
        "read": total["ok"],
        "refused": total["refused"],
        "readers": {
            name: {o: c[o] for o in OUTCOMES} for name, c in counts.items() if sum(c.values())
        },
        "slowest": [f"{case} {s:.2f} s" for s, case in slow],
        "examples": list(examples.values())[:40],
    }


# --- command line ----------------------------------------------------------------------------


def main() -> int:
    """Run the cases and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1000, metavar="N", help="cases [1000]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=1e9, metavar="S", help="stop after")
    parser.add_argument("--workers", type=int, default=2, choices=(1, 2))
    parser.add_argument("--target", action="append", help="only these seeds; repeatable")
    parser.add_argument("--only", metavar="TARGET/NUMBER", help="make one case again, and keep it")
    parser.add_argument("--no-units", action="store_true", help="leave the scaled drives out")
    parser.add_argument("--out", type=Path, metavar="FILE", help="put the section into this page")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--worker", nargs=3, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        seeds, scratch, seed = arguments.worker
        work(Path(seeds), Path(scratch), int(seed))
        return 0
    memory = Path("/dev/shm")
    place = memory if memory.is_dir() and os.access(memory, os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="certnav-fuzz-", dir=place) as home:
        seeds = Path(home) / "seeds"
        seeds.mkdir()
        targets = fuzz_seeds.make_seeds(seeds, fuzz_seeds.data_folder())
        (seeds / "targets.json").write_text(json.dumps([vars(t) for t in targets]))
        if arguments.only:
            return _again(targets, seeds, arguments.only, arguments.seed)
        if arguments.target:
            targets = [t for t in targets if t.name in arguments.target]
        began = time.monotonic()
        found = fuzz(
            targets, seeds, arguments.count, arguments.seed, arguments.seconds, arguments.workers
        )
        if not arguments.no_units:
            found |= silent_units(Path(home) / "units")
        found["seconds"] = round(time.monotonic() - began, 1)
    if arguments.out:
        write_section(arguments.out, found, arguments.seed)
    print(json.dumps(found, indent=1, ensure_ascii=False) if arguments.json else text(found))
    wrong = ("tracebacks", "hangs", "crashes", "units_silent")
    return int(any(found.get(key) for key in wrong) or bool(found.get("alarms")))


def _again(targets: list[Target], seeds: Path, only: str, seed: int) -> int:
    name, _, number = only.partition("/")
    target = next(t for t in targets if t.name == name)
    folder = Path(tempfile.mkdtemp(prefix=f"{name}-{number}-"))
    link(seeds / fuzz_seeds.SHARED.get(name, name), folder)
    print(make_case(target, seeds, folder, seed, int(number))[0])
    for pointer in [f for f in folder.rglob("*") if f.is_symlink()]:
        content = pointer.read_bytes()
        pointer.unlink()
        pointer.write_bytes(content)
    print(folder)
    outcome, said = read_case(name, folder, Random(f"{seed}/set/{number}"))
    print(outcome, said)
    if outcome == "traceback":
        fuzz_readers.READ[name](folder)
    return int(outcome in _BAD)


if __name__ == "__main__":
    sys.exit(main())
