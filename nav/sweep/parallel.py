"""Much at once: threads, the processors of this machine, or a Dask cluster.

    drives = [Shared(load, (path,), size) for path, size in found]
    calls = [(drive, method) for drive in drives for method in methods]
    for result in in_parallel(run, calls, scheduler=address): …

What many calls have in common is `Shared`: it travels as the little it is made from, and is made
where it is needed. Calls that share something should follow one another.
"""

from __future__ import annotations

import os
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from .shared import Shared, forget

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
) -> Iterator[_Result]:
    """Yield ``function(*call)`` for each call, in order; what is `Shared` in a call is its value.

    Parameters
    ----------
    function : callable
        Of a module, so that other processes find it.
    calls : iterable of tuple
        Positional arguments.
    jobs : int
        Processes on this machine; −1: as many as processors; 1: no other process at all.
    scheduler : str, optional
        Address of a Dask scheduler, instead (`nav.sweep.cluster`).

    Raises
    ------
    ConfigError
        If there is no scheduler at that address, or Dask is not installed.
    """
    calls = list(calls)
    if scheduler is not None:
        from .cluster import on_cluster

        yield from on_cluster(function, calls, scheduler)
        return
    if len(calls) <= 1 or jobs == 1:
        try:
            yield from (called(function, call) for call in calls)
        finally:
            forget()
        return
    from joblib import Parallel, delayed

    # A process that has grown by the drive it has opened is replaced: nothing is lost.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs were given")
    parallel = Parallel(n_jobs=jobs, return_as="generator", batch_size=1)
    yield from parallel(delayed(called)(function, call) for call in calls)


def called(function: Callable[..., _Result], call: tuple[Any, ...]) -> _Result:
    """Return the function of a call, with the values of what is shared."""
    return function(*(part.value() if isinstance(part, Shared) else part for part in call))
