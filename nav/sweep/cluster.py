"""Calls spread over a Dask cluster, planned by the volume of what they share.

Everything on the cluster can be made again from what the scheduler knows: a call is a task of its
own, what calls share is one that they depend on, made by the worker that needs it first. A worker
that dies takes nothing with it but time. (joblib's own backend for Dask puts large arguments into
the memory of some workers, where they die with them.)

Calls go drive by drive, the largest first, so that no large one is left at the end, and only as
many at once as keep the workers busy: of hundreds of drives a few are in memory.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from ...filters.errors import ConfigError, NavError
from .shared import Shared

if TYPE_CHECKING:
    from distributed import Client, Future

_Result = TypeVar("_Result")
Calls = list[tuple[Any, ...]]
#: Calls in flight for each thread of the cluster: one that runs, one that is ready to.
_AHEAD = 2
#: How long to wait for the scheduler, and for a first worker [s].
_SCHEDULER, _WORKER = 5, 60


def on_cluster(function: Callable[..., _Result], calls: Calls, scheduler: str) -> Iterator[_Result]:
    """Yield ``function(*call)`` for each call, in order; see `nav.sweep.parallel.in_parallel`.

    Raises
    ------
    ConfigError
        No Dask, no scheduler at that address, or no worker.
    NavError
        What a call refuses; or a call at which worker after worker dies.
    """
    with _cluster(scheduler) as client:
        yield from _Flight(client, function, calls, scheduler)


class _Flight:
    """The calls that are on the cluster, and what they share there."""

    def __init__(
        self, client: Client, function: Callable[..., Any], calls: Calls, scheduler: str
    ) -> None:
        from distributed import as_completed

        self.client, self.function, self.calls = client, function, calls
        self.scheduler = scheduler
        self.waiting = deque(planned(calls))
        self.number: dict[str, int] = {}  # of the call, by the key of its task
        self.shared: dict[str, Future] = {}
        self.uses = Counter(part.key for call in calls for part in _shared(call))
        self.landed = as_completed(loop=client.loop)

    def __iter__(self) -> Iterator[Any]:
        results: dict[int, Any] = {}
        told = 0
        self._send()
        for future in self.landed:
            number = self.number.pop(future.key)
            results[number] = self._result(future)
            self._forget(number)
            future.release()
            self._send()
            while told in results:
                yield results.pop(told)
                told += 1

    def _send(self) -> None:
        """Put calls into flight until all workers have enough."""
        threads = sum(self.client.nthreads().values())
        while self.waiting and len(self.number) < max(_AHEAD * threads, 1):
            number = self.waiting.popleft()
            call = [self._argument(part) for part in self.calls[number]]
            future = self.client.submit(self.function, *call, pure=False)
            self.number[future.key] = number
            self.landed.add(future)

    def _argument(self, part: Any) -> Any:
        """Return an argument, or the task that makes it on the cluster."""
        if not isinstance(part, Shared):
            return part
        if part.key not in self.shared:
            self.shared[part.key] = self.client.submit(
                part.make, *part.args, key=f"shared-{part.key}", pure=False
            )
        return self.shared[part.key]

    def _forget(self, number: int) -> None:
        """Let go of what no call needs any more."""
        for part in _shared(self.calls[number]):
            self.uses[part.key] -= 1
            if not self.uses[part.key]:
                self.shared.pop(part.key).release()

    def _result(self, future: Future) -> Any:
        from distributed import KilledWorker

        try:
            return future.result()
        except NavError:
            raise
        except KilledWorker as error:
            raise NavError(
                f"--scheduler {self.scheduler}: {error.allowed_failures + 1} workers have died at "
                "the same call — too little memory? their logs say more"
            ) from None
        except ImportError as error:
            raise NavError(
                f"--scheduler {self.scheduler}: a worker lacks what this machine has ({error}) — "
                "install certnav there"
            ) from None


def planned(calls: Calls) -> list[int]:
    """Return the numbers of the calls in the order in which they are sent: largest drive first."""
    volume = {part.key: part.volume for call in calls for part in _shared(call)}
    first: dict[str, int] = {}
    for number, call in enumerate(calls):
        first.setdefault(_drive(call), number)
    return sorted(
        range(len(calls)),
        key=lambda n: (-volume.get(_drive(calls[n]), 0.0), first[_drive(calls[n])], n),
    )


def _shared(call: tuple[Any, ...]) -> list[Shared]:
    return [part for part in call if isinstance(part, Shared)]


def _drive(call: tuple[Any, ...]) -> str:
    """Return the key of the largest thing a call shares; '' where it shares nothing."""
    return max(_shared(call), key=lambda part: part.volume).key if _shared(call) else ""


@contextmanager
def _cluster(scheduler: str) -> Iterator[Client]:
    """Give a client of a cluster that has a worker."""
    try:
        import dask
        from distributed import Client
    except ImportError:
        raise ConfigError("--scheduler needs Dask: pip install 'certnav[dask]'") from None
    with ExitStack() as stack:
        # What is in memory here is sent with its task, so that it can be sent again.
        known = {"distributed.admin.large-graph-warning-threshold": "100GB"}
        stack.enter_context(dask.config.set(known))
        try:
            client = stack.enter_context(
                Client(scheduler, timeout=_SCHEDULER, set_as_default=False)
            )
        except (OSError, TimeoutError, ValueError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise ConfigError(
                f"--scheduler {scheduler}: no Dask scheduler there ({reason})"
            ) from None
        try:
            client.wait_for_workers(1, timeout=_WORKER)
        except TimeoutError:
            raise ConfigError(
                f"--scheduler {scheduler}: no worker has joined for {_WORKER} s — start some: "
                f"dask worker {scheduler}"
            ) from None
        yield client
