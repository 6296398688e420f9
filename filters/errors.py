"""Errors a navigation engineer can act on, each one line long.

They live in the lowest package so that every other package can raise them; the command
line prints ``str(error)`` and exits with status 1.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path

#: An error is one line; of longer ones the middle is left out.
_LONGEST, _TAIL = 600, 200
#: Copies made for a program's sake: what they are made of, and whether its lines are theirs.
_MADE_OF: dict[str, tuple[str, bool]] = {}


def made_of(copy: str | Path, original: str | Path, lines: bool = True) -> None:
    """Let errors about a copy name the file that the user knows.

    Parameters
    ----------
    copy, original : path
    lines : bool
        Whether they have the same lines: unpacked, not converted.
    """
    _MADE_OF[str(copy)] = as_given(original), lines


def as_given(file: str | Path) -> str:
    """Return the file that a copy was made of; itself if it is none."""
    return _MADE_OF.get(str(file), (str(file), True))[0]


def is_converted(file: str | Path) -> bool:
    """Return whether a file was converted from one of another kind."""
    return not _MADE_OF.get(str(file), ("", True))[1]


class NavError(Exception):
    """Base of everything certnav refuses knowingly; its text is one line, whatever a file holds.

    Examples
    --------
    >>> from certnav.filters import NavError, imu_preset
    >>> try:
    ...     imu_preset("adis16740")
    ... except NavError as error:
    ...     print(error)
    IMU preset: unknown key 'adis16740' — did you mean 'adis16470'?
    """

    def __str__(self) -> str:
        text = super().__str__()
        if len(text) > _LONGEST:
            text = f"{text[: _LONGEST - _TAIL]} … {text[-_TAIL:]}"
        if text.isprintable():
            return text
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class DataError(NavError):
    """Input that cannot be read or that contradicts physics.

    Parameters
    ----------
    problem : str
        What was expected and what was found.
    file : path, optional
        The file at fault.
    line : int, optional
        Its line, counted from 1.
    remedy : str, optional
        What to do about it.

    Examples
    --------
    >>> from certnav.filters import DataError
    >>> raise DataError("expected 7 columns, found 6", file="imu.txt", line=12, remedy="cut it")
    Traceback (most recent call last):
        ...
    certnav.filters.errors.DataError: imu.txt:12: expected 7 columns, found 6 — cut it
    """

    def __init__(
        self,
        problem: str,
        *,
        file: str | Path | None = None,
        line: int | None = None,
        remedy: str | None = None,
    ) -> None:
        if file is not None:
            line = None if is_converted(file) else line
            file = as_given(file)
        where = "" if file is None else f"{file}:{line}: " if line is not None else f"{file}: "
        super().__init__(f"{where}{problem}" + (f" — {remedy}" if remedy else ""))
        self.problem, self.file, self.line, self.remedy = problem, file, line, remedy


class ConfigError(NavError):
    """A configuration key or value that cannot be used.

    Examples
    --------
    >>> from certnav.filters import ConfigError
    >>> raise ConfigError.unknown_key("smooht", ["smooth", "gate"], where="filter")
    Traceback (most recent call last):
        ...
    certnav.filters.errors.ConfigError: filter: unknown key 'smooht' — did you mean 'smooth'?
    """

    @classmethod
    def unknown_key(cls, key: str, known: Iterable[str], where: str = "") -> ConfigError:
        """Return the error for `key`, naming the nearest of the `known` keys."""
        candidates = sorted(known)
        near = difflib.get_close_matches(key, candidates, n=1, cutoff=0.4)
        hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(candidates)}"
        prefix = f"{where}: " if where else ""
        return cls(f"{prefix}unknown key '{key}' — {hint}")


class AlignmentError(NavError):
    """There is no initial attitude yet; the message says why and what would help.

    Examples
    --------
    >>> from certnav.filters import AlignmentError, NavError
    >>> issubclass(AlignmentError, NavError)
    True
    >>> raise AlignmentError("the car has not moved yet: drive faster than 3 m/s")
    Traceback (most recent call last):
        ...
    certnav.filters.errors.AlignmentError: the car has not moved yet: drive faster than 3 m/s
    """
