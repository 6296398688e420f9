"""What a run wants to tell: a sentence and how much it matters; how times are written in it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from ..datasets.gpstime import SECONDS_PER_WEEK

#: 'lost': the solution left what its vehicle can do, and ended or started again. 'doubtful':
#: something contradicts the run or its data. 'unmet': a setting that was given is not in force.
#: 'note': what was done, and with what.
SEVERITIES = ("lost", "doubtful", "unmet", "note")


@dataclass(frozen=True)
class Note:
    """One sentence of a run.

    Parameters
    ----------
    severity : {'lost', 'doubtful', 'unmet', 'note'}
    text : str
        Without a full stop; figures with their units.

    Examples
    --------
    >>> from certnav.nav import Note
    >>> note = Note("doubtful", "gyro frozen for 8 s from SOW 180750.00")
    >>> note.doubtful, str(note)
    (True, 'doubtful: gyro frozen for 8 s from SOW 180750.00')
    """

    severity: str
    text: str

    def __post_init__(self) -> None:
        if self.severity not in SEVERITIES:
            raise ValueError(f"severity: expected one of {SEVERITIES}, found {self.severity!r}")

    def __str__(self) -> str:
        return f"{self.severity}: {self.text}" if self.doubtful else self.text

    @property
    def doubtful(self) -> bool:
        """Whether it speaks against the run."""
        return self.severity in ("lost", "doubtful")


def plain(texts: Iterable[str]) -> tuple[Note, ...]:
    """Return notes that only tell."""
    return tuple(Note("note", text) for text in texts)


_start: ContextVar[float | None] = ContextVar("start", default=None)


@contextmanager
def counted_from(start: float) -> Iterator[None]:
    """Have `clock` say how long after the start of a recording a time is.

    Parameters
    ----------
    start : float
        Of the first sample of the IMU [s].
    """
    token = _start.set(start)
    try:
        yield
    finally:
        _start.reset(token)


def clock(time: float) -> str:
    """Return a time as it is said everywhere: GPS seconds of week, and since the start.

    As 'SOW 364509.60 (+12.30 s)'; the week stands at the top of console and report. Without a
    date, the stamp as it is in the files; without a start (`counted_from`), nothing in brackets.
    """
    week, start = int(time // SECONDS_PER_WEEK), _start.get()
    since = "" if start is None else f" ({time - start:+.2f} s)"
    said = f"{time:.2f} s" if week <= 0 else f"SOW {time - week * SECONDS_PER_WEEK:.2f}"
    return said + since


def span_words(start: float, end: float) -> str:
    """Return when a recording was, for the top of what is said of it."""
    week = int(start // SECONDS_PER_WEEK)
    if week <= 0:
        return f"{start:.2f} … {end:.2f} s, no date; in brackets: s since the start"
    sow = start - week * SECONDS_PER_WEEK
    return (
        f"GPS week {week}, SOW {sow:.2f} … {end - week * SECONDS_PER_WEEK:.2f}; in brackets: "
        "s since the start"
    )


def times_in(text: str, near: float) -> list[float]:
    """Return the GPS times that `clock` wrote into a text [s], in the week of `near`.

    Where there is no date they look like durations: what follows 'from', 'to', 'at' or 'until'
    with its two decimals is a time.
    """
    week = int(near // SECONDS_PER_WEEK) * SECONDS_PER_WEEK
    if week <= 0:
        return [float(t) for t in re.findall(r"\b(?:from|to|at|until) (-?\d+\.\d\d) s\b", text)]
    return [week + float(sow) for sow in re.findall(r"SOW (\d+(?:\.\d+)?)", text)]
