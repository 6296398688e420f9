"""Recordings by where they lie, loaded where they are needed, and what a reader may let pass."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...datasets.cache import kept_in
from ...datasets.loading import load
from ...datasets.physics import Refusal, collected_refusals
from ...datasets.sequence import Sequence
from ...filters.errors import DataError
from ..config import Config
from ..notes import Note
from ..vehicles import VEHICLES, would_explain
from .shared import Shared, itself

Source = str | Path | Sequence


def drive(source: Source, data: Mapping[str, Any] | None = None) -> Shared[Sequence]:
    """Return a recording as what it is loaded from: a worker opens the path itself.

    Parameters
    ----------
    source : path or Sequence
        A `Sequence` is in memory, and travels.
    data : mapping, optional
        Options of its reader.
    """
    if isinstance(source, Sequence):
        return Shared(itself, (source,), volume_of(source))
    path = Path(source).resolve()
    return Shared(_loaded, (path, dict(data or {})), volume_of(path))


def checked_drive(
    source: Source, config: Config, checked: bool, cache: Path | None = None
) -> Shared[Sequence]:
    """Return a recording as `drive` does; it is loaded as by `checked_load`.

    `cache` is a folder of `datasets.cache`, for workers that see it.
    """
    if isinstance(source, Sequence):
        return drive(source)
    path = Path(source).resolve()
    return Shared(checked_load, (path, config, checked, cache), volume_of(path))


def volume_of(source: Source) -> float:
    """Return how much data a recording is: bytes of its files, or 10 numbers an IMU sample."""
    if isinstance(source, Sequence):
        return 80.0 * (len(source.imu) if source.imu is not None else 0)
    path = Path(source)
    files = [path] if path.is_file() else [f for f in path.rglob("*") if f.is_file()]
    return float(sum(file.stat().st_size for file in files))


def _loaded(path: Path, data: dict[str, Any]) -> Sequence:
    return load(path, **data)


def checked_load(path: Path, config: Config, checked: bool, cache: Path | None = None) -> Sequence:
    """Return a recording; what a reader refuses by physics is a note of it if it is not checked.

    Raises
    ------
    DataError
        What the reader refuses.
    """
    if cache is not None:
        with kept_in(cache):
            return checked_load(path, config, checked)
    with collected_refusals() as refused:
        sequence = load(path, **config.data)
    said = waived(refused, config, checked)
    notes = (*sequence.notes, *(str(note) for note in said))
    return dataclasses.replace(sequence, notes=notes)


def waived(refused: list[Refusal], config: Config, checked: bool) -> tuple[Note, ...]:
    """Return as notes what a reader refused by physics, and may pass; refuse the rest."""
    notes = []
    for error, against in refused:
        kind = VEHICLES[config.vehicle.kind]
        if against == "course" and not kind.holds_course:
            notes.append(Note("note", f"not asked of {kind.words}: {error}"))
        elif not checked:
            notes.append(Note("doubtful", f"unchecked: {error}"))
        else:
            remedy = error.remedy or ""
            if against == "course":
                other = would_explain(lambda v: not v.holds_course, config.vehicle.kind)
                remedy = f"{remedy}; {other}"
            raise DataError(error.problem, file=error.file, line=error.line, remedy=way_out(remedy))
    return tuple(notes)


def way_out(remedy: str) -> str:
    """Return a remedy with what to do for a recording to be navigated in spite of all."""
    return f"{remedy}; to navigate it all the same: --unchecked".removeprefix("; ")
