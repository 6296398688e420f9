"""A progress bar on standard error, or nothing where nobody watches."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext


def progress() -> AbstractContextManager[Callable[[float, str], None]]:
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


def announce_kernels() -> None:
    """Say on standard error if the filter has to be compiled first, or cannot be."""
    from ...filters.compiled import kernels
    from ...filters.compiled.jit import notice

    if line := notice(kernels.advance):
        print(f"certnav: {line}", file=sys.stderr, flush=True)
