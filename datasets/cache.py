"""What is slow to read, read once and kept: arrays in a folder, found again by content.

    with kept_in(folder):
        sequence = load(path)

A file there is named by a hash of everything it was made from: the contents of all input files,
the arguments, and the source of the code that made it. It begins with a hash of its own contents;
where that does not fit, it is not used but made again. The folder may be deleted at any time.
"""

from __future__ import annotations

import hashlib
import io
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .placing import write_file

_MAGIC = b"certnav cache 1\n"
_log = logging.getLogger(__name__)

Arrays = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class _Keeper:
    """A folder, and what is to be written into it."""

    folder: Path
    fresh: dict[Path, Arrays] = field(default_factory=dict)


_keeper: ContextVar[_Keeper | None] = ContextVar("keeper", default=None)


@contextmanager
def kept_in(folder: str | Path) -> Iterator[None]:
    """Keep what is read inside this context in `folder`, which is made when it is needed.

    It is written at the end: what ends in an error leaves nothing behind.
    """
    keeper = _Keeper(Path(folder))
    token = _keeper.set(keeper)
    try:
        yield
    finally:
        _keeper.reset(token)
    for entry, arrays in keeper.fresh.items():
        _write(entry, arrays)


def kept(
    make: Callable[[], Arrays],
    files: Iterable[Path],
    arguments: object,
    code: Iterable[Path],
) -> Arrays:
    """Return what `make` returns, from the folder if it is there; outside `kept_in`, make it.

    Parameters
    ----------
    make : callable
        Returns arrays by name, none of objects.
    files : iterable of Path
        Everything `make` reads; their contents count, their names do not.
    arguments : object
        What else the result depends on; its ``repr`` counts.
    code : iterable of Path
        Source files whose change makes the result another one.
    """
    keeper = _keeper.get()
    if keeper is None:
        return make()
    try:
        key = _key(files, arguments, code)
    except OSError:
        return make()  # whose message is the one to read
    entry = keeper.folder / f"{key}.certnav"
    arrays = keeper.fresh.get(entry) or _read(entry)
    if arrays is None:
        arrays = keeper.fresh[entry] = make()
    return arrays


def _key(files: Iterable[Path], arguments: object, code: Iterable[Path]) -> str:
    whole = hashlib.sha256(_MAGIC + repr(arguments).encode())
    for file in (*files, *code):
        with Path(file).open("rb") as stream:
            whole.update(hashlib.file_digest(stream, "sha256").digest())
    return whole.hexdigest()[:40]


def _read(entry: Path) -> Arrays | None:
    """Return what is in an entry; None where there is none, or not what was written there."""
    try:
        content = entry.read_bytes()
    except OSError:
        return None
    size = len(_MAGIC) + 32
    body = memoryview(content)[size:]
    if content[:size] != _MAGIC + hashlib.sha256(body).digest():
        _log.warning("%s is damaged: made again", entry)
        return None
    with np.load(io.BytesIO(body), allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def _write(entry: Path, arrays: Arrays) -> None:
    """Write an entry whole or not at all; a folder that cannot be written keeps nothing."""
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **arrays)
    body = stream.getbuffer()
    try:
        entry.parent.mkdir(parents=True, exist_ok=True)
        write_file(entry, _MAGIC + hashlib.sha256(body).digest(), body)
    except OSError as error:
        _log.warning("%s: nothing kept (%s)", entry.parent, error.strerror)
