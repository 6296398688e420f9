"""Much at once: threads, the processors of this machine, or a Dask cluster.

    drives = [Shared(load, (path,), size) for path, size in found]
    calls = [(drive, method) for drive in drives for method in methods]
    for result in in_parallel(run, calls, scheduler=address): …

What many calls have in common is `Shared`: it travels as the little it is made from, and is made
where it is needed. Calls that share something should follow one another.
"""

from __future__ import annotations

import os
import threading
import uuid
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar, cast

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")
#: So many shared things a thread keeps: a drive and what it is judged by.
_KEPT = 2


class _Kept(threading.local):
    """What this thread has made last."""

    def __init__(self) -> None:
        self.values: OrderedDict[str, Any] = OrderedDict()


_kept = _Kept()


def itself(value: _Item) -> _Item:
    """Return what is given: to share something that is in memory."""
    return value


@dataclass(frozen=True, eq=False)
class Shared(Generic[_Item]):
    """Something that many calls have in common, as the little it is made from.

    Parameters
    ----------
    make : callable
        Of a module, so that other processes find it.
    args : tuple
        Its arguments.
    volume : float
        How much data it is, in bytes; the largest come first on a cluster.
    key : str
        What tells it from others.
    """

    make: Callable[..., _Item]
    args: tuple[Any, ...]
    volume: float = 0.0
    key: str = field(default_factory=lambda: uuid.uuid4().hex)

    def value(self) -> _Item:
        """Return it; made anew unless it is among the last that this thread has made."""
        values = _kept.values
        if self.key not in values:
            while len(values) >= _KEPT:
                values.popitem(last=False)
            values[self.key] = self.make(*self.args)
        values.move_to_end(self.key)
        return cast(_Item, values[self.key])


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
            _kept.values.clear()
        return
    from joblib import Parallel, delayed

    parallel = Parallel(n_jobs=jobs, return_as="generator", batch_size=1)
    yield from parallel(delayed(called)(function, call) for call in calls)


def called(function: Callable[..., _Result], call: tuple[Any, ...]) -> _Result:
    """Return the function of a call, with the values of what is shared."""
    return function(*(part.value() if isinstance(part, Shared) else part for part in call))
