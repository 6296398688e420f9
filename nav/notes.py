"""What a run wants to tell: a sentence and how much it matters; how times are written in it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from ..datasets.gpstime import SECONDS_PER_WEEK

#: 'lost': the solution left what its vehicle can do, and ended or started again. 'doubtful':
#: something contradicts the run or its data. 'note': what was done, and with what.
SEVERITIES = ("lost", "doubtful", "note")


@dataclass(frozen=True)
class Note:
    """One sentence of a run.

    Parameters
    ----------
    severity : {'lost', 'doubtful', 'note'}
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
        return self.severity != "note"


def plain(texts: Iterable[str]) -> tuple[Note, ...]:
    """Return notes that only tell."""
    return tuple(Note("note", text) for text in texts)


def clock(time: float) -> str:
    """Return a time as files print it: GPS seconds of week, or seconds where there is no date."""
    week = int(time // SECONDS_PER_WEEK)
    return f"{time:.2f} s" if week == 0 else f"SOW {time - week * SECONDS_PER_WEEK:.2f}"


def times_in(text: str, near: float) -> list[float]:
    """Return the GPS times that `clock` wrote into a text [s], in the week of `near`.

    Where there is no date they look like durations: what follows 'from', 'to', 'at' or 'until'
    with its two decimals is a time.
    """
    week = int(near // SECONDS_PER_WEEK) * SECONDS_PER_WEEK
    if week == 0:
        return [float(t) for t in re.findall(r"\b(?:from|to|at|until) (\d+\.\d\d) s\b", text)]
    return [week + float(sow) for sow in re.findall(r"SOW (\d+(?:\.\d+)?)", text)]
