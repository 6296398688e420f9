"""A process of ``scripts/fuzz.py`` that reads cases and may hang or die, and its watcher."""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from oracles.cases import link, make_case, read_case, repair
from oracles.seeds import SHARED, Target

HANG_S = 5.0
#: On a machine busy with other things the clock on the wall may show more; at most so much.
_WALL_S = 60.0
#: Imports and compiled kernels come with the first, sound, reading.
_WARM_UP_S = 120.0
#: Address space of a worker: an absurd size becomes a MemoryError, not a dead machine.
_MEMORY = 6 << 30
#: A worker is replaced after four times so many cases: RTKLIB's memory is its own.
BLOCK = 500


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
            outcome, said = read_case(name, seeds / SHARED.get(name, name))
            answer(end=-1, outcome=outcome, said=said)
            warm.add(name)
        sound, folder = seeds / SHARED.get(name, name), scratch / name
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


class Worker:
    """A worker process that is replaced when it hangs or dies."""

    def __init__(self, seeds: Path, scratch: Path, seed: int) -> None:
        self._arguments = (str(seeds), str(scratch), str(seed))
        self._scratch = scratch
        scratch.mkdir(exist_ok=True)
        self._process: subprocess.Popen[bytes] | None = None
        self._buffer = b""
        self._served = 0

    def _start(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._served > 4 * BLOCK:
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


if __name__ == "__main__":
    work(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
