"""What a run needs of compiled kernels, compiled by several processes before it begins.

numba compiles one function at a time in a process, so further processes fill its cache with their
share and end. It is a matter of time alone: a process that fails leaves its kernels to be compiled
when they are called, as does a signature that is missing here. Two that compile the same kernel
write the same files, since each kernel has one signature.

    python -m certnav.nav.commands.flow.first_run MODULE…

compiles the kernels of modules, and says nothing.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import subprocess
import sys
from collections.abc import Iterator

#: This module, and the package that those below are named in.
_THIS = f"{__package__}.first_run"
_PACKAGE = _THIS.split(".nav.")[0]

#: Kernels that Python calls in a run with default settings, by module, with the types of their
#: arguments: 1, 2, 3, 4 arrays of floats of so many axes; i1 of integers, b1 of booleans, u1 of
#: bytes, all C-contiguous; r1, r2, of floats, read-only; f, i numbers.
KERNELS = {
    "filters.compiled.kernels": {"advance": "1 r2 r2 i f f 1 1 2 1 2 2 1 2 1 f"},
    "filters.compiled.rows": {"record": "1 f 1 1 2 1 2"},
    "filters.measurement_update": {
        "_whiten": "2 1 2 2 2 2 1", "_joseph": "2 1 2 2 1 2", "_turn": "2 1 2",
    },
    "alignment.solver.kernels": {
        "bottoms": "2 1 i i 3 1", "guess": "2 2 2 1", "distinct": "3 1 i",
    },
    "alignment.solver.margin_kernels": {"feasible": "2", "barrier": "2 1 f f f f"},
    "alignment.in_motion.track_kernels": {
        "integrate": "1 r2 r2 2 2 i 1 1 3", "compose": "3 1 1 3", "responses": "2 3 3 3 i1 3",
    },
    "alignment.in_motion.window_kernels": {
        "without_clock": "i1 b1 2 1 1 2 i 1 f 1 3 2 1",
        "scores": "i1 b1 2 1 1 2 i 1 f 3 2 1 1 2 1",
        "fold": "2 2 i",
        "forward_substitute": "2 2",
    },
    "velocity.linearised": {"_fill": "1 r2 r2 r1 r1 2"},
    "nav.engine.fix_noise.likelihood": {"log_likelihood": "1 1 2 2 3 f f f 1 1"},
    "nav._frames": {"ned_covariances": "2 3 3 4 i"},
    "nav.results.text": {"_fill": "u1 2 i1 u1 1"},
}  # fmt: skip
#: How long each module takes, in tenths of all of it.
_SHARES = {
    "filters.compiled.kernels": 2.7, "alignment.solver.kernels": 2.1,
    "alignment.solver.margin_kernels": 1.5, "alignment.in_motion.window_kernels": 1.4,
    "alignment.in_motion.track_kernels": 1.2, "filters.measurement_update": 0.6,
    "nav.results.text": 0.5,
}  # fmt: skip
#: That of the others, and of a process before it compiles.
_SMALL, _START = 0.2, 0.5
_MOST_PROCESSES = 4
#: How long another process is waited for, when ours is done [s].
_PATIENCE = 120.0


def compile_ahead() -> None:
    """Compile the kernels of a run on as many processors as there are, this process among them."""
    shares = _shared_out(min(_processors(), _MOST_PROCESSES))
    with _others(shares[1:]):
        compile_kernels(shares[0])


def _processors() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _shared_out(processes: int) -> list[list[str]]:
    """Return modules for each process, the largest first to whoever has least; ours have begun."""
    shares: list[list[str]] = [[] for _ in range(processes)]
    load = [0.0] + [_START] * (processes - 1)
    for module in sorted(KERNELS, key=lambda name: -_SHARES.get(name, _SMALL)):
        least = load.index(min(load))
        shares[least].append(module)
        load[least] += _SHARES.get(module, _SMALL)
    return shares


@contextlib.contextmanager
def _others(shares: list[list[str]]) -> Iterator[None]:
    """Have other processes compile their shares meanwhile; end with all of them ended."""
    processes: list[subprocess.Popen[bytes]] = []
    try:
        for share in filter(None, shares):
            with contextlib.suppress(OSError):
                processes.append(
                    subprocess.Popen(
                        [sys.executable or "", "-P", "-m", _THIS, *share], stdin=subprocess.DEVNULL,
                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                    )
                )  # fmt: skip
        yield
        for process in processes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_PATIENCE)
    finally:
        for process in processes:
            process.kill()  # nothing, if it has ended
            process.wait()


def compile_kernels(modules: list[str]) -> None:
    """Compile, or take from the cache, what `KERNELS` has of these modules."""
    for name in modules:
        module = importlib.import_module(f"{_PACKAGE}.{name}")
        for kernel, types in KERNELS[name].items():
            # Whatever is wrong with it comes up where it is called, with what it is called with.
            with contextlib.suppress(Exception):
                getattr(module, kernel).compile(_signature(types))


def _signature(types: str) -> tuple[object, ...]:
    """Return numba's types of the arguments of a kernel."""
    from numba import types as of

    scalars = {"f": of.float64, "i": of.int64, "b": of.boolean, "u": of.uint8}
    return tuple(
        scalars[each]
        if each in scalars
        else of.Array(scalars.get(each[0], of.float64), int(each[-1]), "C", readonly=each[0] == "r")
        for each in types.split()
    )


if __name__ == "__main__":
    gc.set_threshold(100_000)  # as of every command
    compile_kernels(sys.argv[1:])
    gc.freeze()
