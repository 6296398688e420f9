"""Much at once: threads, the processors of this machine, or a Dask cluster."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack
from typing import Any, TypeVar

from ..filters.errors import ConfigError

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def in_order(function: Callable[[_Item], _Result], items: Iterable[_Item]) -> Iterator[_Result]:
    """Yield the function of each item in turn, as many computed at once as there are processors.

    Worth it where the function is compiled or numpy's: they let other threads run. Never many
    results wait, so that what is written bit by bit stays small.
    """
    threads = os.cpu_count() or 1
    with ThreadPoolExecutor(threads) as pool:
        waiting: deque = deque()
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def in_parallel(
    function: Callable[..., _Result],
    calls: Iterable[tuple[Any, ...]],
    *,
    jobs: int = -1,
    scheduler: str | None = None,
    shared: Iterable[Any] = (),
) -> Iterator[_Result]:
    """Yield ``function(*call)`` for each call, in order.

    Parameters
    ----------
    function : callable
        Of a module, so that other processes find it.
    calls : iterable of tuple
        Positional arguments.
    jobs : int
        Processes on this machine; −1: as many as processors; 1: no other process at all.
    scheduler : str, optional
        Address of a Dask scheduler, instead.
    shared : iterable
        Objects that are arguments of many calls. A cluster is sent each of them once; on this
        machine, processes read the same copy of large arrays anyway.

    Raises
    ------
    ConfigError
        If there is no scheduler at that address, or Dask is not installed.
    """
    calls = list(calls)
    if scheduler is None and (len(calls) <= 1 or jobs == 1):
        yield from (function(*call) for call in calls)
        return
    from joblib import Parallel, delayed

    with ExitStack() as stack:
        processes: int | None = jobs
        if scheduler is not None:
            stack.enter_context(_cluster(scheduler, list(shared)))
            processes = None
        parallel = Parallel(n_jobs=processes, return_as="generator", batch_size=1)
        yield from parallel(delayed(function)(*call) for call in calls)


def _cluster(scheduler: str, shared: list[Any]) -> AbstractContextManager:
    """Return a context in which joblib works on a Dask cluster."""
    import joblib

    try:
        from distributed import Client
    except ImportError:
        raise ConfigError("--scheduler needs Dask: pip install 'certnav[dask]'") from None
    stack = ExitStack()
    try:
        client = stack.enter_context(Client(scheduler, timeout=5, set_as_default=False))
    except (OSError, TimeoutError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ConfigError(f"--scheduler {scheduler}: no Dask scheduler there ({reason})") from None
    stack.enter_context(
        joblib.parallel_config(backend="dask", client=client, scatter=shared or None)
    )
    return stack
