"""Work for sweeps, where worker processes find it; and a cluster of such processes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

TESTS = Path(__file__).resolve().parents[1]


def made(folder: Path, name: str, size: int) -> np.ndarray:
    """Return an array that follows from a name; leave a mark of who has made it."""
    with (folder / f"{name}.made").open("a") as file:
        file.write(f"{os.getpid()}\n")
    return np.random.default_rng(sum(name.encode())).normal(size=size)


def worked(folder: Path, array: np.ndarray, number: int) -> tuple[int, float]:
    """Take a little while; leave a mark of who has done it; return number and result."""
    time.sleep(0.1)
    with (folder / f"call-{number}.done").open("a") as file:
        file.write(f"{os.getpid()}\n")
    return number, float(array[number % array.size] + array.sum())


def deadly(number: int) -> int:
    """Kill the process that calls it."""
    os._exit(number)


def marks(folder: Path, pattern: str) -> list[int]:
    """Return the processes that have left marks, in no order."""
    return [int(pid) for file in folder.glob(pattern) for pid in file.read_text().split()]


@contextmanager
def cluster(folder: Path, workers: int = 2) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """Give the address of a Dask scheduler and its workers: one process each, nobody restarts them.

    They are started elsewhere, so that nothing is found by a relative path.
    """
    told = folder / "scheduler.json"
    environment = os.environ | {
        "PYTHONPATH": str(TESTS), "PYTHONWARNINGS": "ignore", "OPENBLAS_NUM_THREADS": "1",
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
    }  # fmt: skip
    log = (folder / "dask.log").open("w")
    started: list[subprocess.Popen] = []

    def start(*command: str) -> subprocess.Popen:
        process = subprocess.Popen(
            [sys.executable, "-m", *command, "--scheduler-file", str(told)],
            cwd=folder, env=environment, stdout=log, stderr=log,
        )  # fmt: skip
        started.append(process)
        return process

    try:
        start("distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard", "--host",
              "127.0.0.1")  # fmt: skip
        for _ in range(workers):
            start("distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny",
                  "--no-dashboard", "--host", "127.0.0.1")  # fmt: skip
        from distributed import Client

        with Client(scheduler_file=str(told), timeout=120, set_as_default=False) as client:
            client.wait_for_workers(workers, timeout=120)
            address = client.scheduler.address
        yield address, started[1:]
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()
        log.close()
