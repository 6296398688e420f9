"""How far it is, on standard error: a bar on a terminal, a line now and then in a log."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

#: Where nobody watches a bar there is a line so often [s].
_EVERY = 10.0
#: Set to anything, nothing is said of progress (`certnav -q`).
QUIET = "CERTNAV_QUIET"


def progress() -> AbstractContextManager[Callable[[float, str], None]]:
    """Return a context that yields a progress callback."""
    if os.environ.get(QUIET):
        return nullcontext(lambda fraction, what: None)
    return _RichProgress() if sys.stderr.isatty() else LineProgress()


@contextmanager
def silent() -> Iterator[None]:
    """Say nothing of progress: what works for others leaves that to them."""
    before = os.environ.get(QUIET)
    os.environ[QUIET] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[QUIET]
        else:
            os.environ[QUIET] = before


class LineProgress:
    """A line every ten seconds, with the time that is left of what is being done.

    Parameters
    ----------
    clock : callable
        Seconds of any origin.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock

    def __enter__(self) -> Callable[[float, str], None]:
        self._said = self._began = self._clock()
        self._what, self._from = "", 0.0
        return self._report

    def __exit__(self, *exception: object) -> None:
        pass

    def _report(self, fraction: float, what: str) -> None:
        now = self._clock()
        if what != self._what or fraction < self._from:
            self._what, self._from, self._began = what, fraction, now
        if now - self._said < _EVERY:
            return
        self._said = now
        done = fraction - self._from
        line = f"certnav: {what}"
        if done > 0.0 and fraction < 1.0:
            left = (now - self._began) * (1.0 - fraction) / done
            line += f", {fraction:.0%}, about {left:.0f} s left"
        print(line, file=sys.stderr, flush=True)


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


def announce_kernels() -> bool:
    """Say on standard error if the filter has to be compiled first, or cannot be.

    Returns whether it has to be.
    """
    from ....filters.compiled import kernels
    from ....filters.compiled.jit import COMPILED, notice

    line = notice(kernels.advance)
    if line and not os.environ.get(QUIET):
        print(f"certnav: {line}", file=sys.stderr, flush=True)
    return bool(line) and COMPILED
