"""What many calls have in common: it travels as the little it is made from."""

from __future__ import annotations

import threading
import uuid
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar, cast

_Item = TypeVar("_Item")
#: So many shared things a thread keeps: a drive and what it is judged by.
_KEPT = 2


class _Kept(threading.local):
    """What this thread has made last."""

    def __init__(self) -> None:
        self.values: OrderedDict[str, Any] = OrderedDict()


_kept = _Kept()


def forget() -> None:
    """Let go of what this thread has made."""
    _kept.values.clear()


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
