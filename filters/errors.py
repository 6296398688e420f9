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


class NavError(Exception):
    """Base of everything certnav refuses knowingly; its text is one line, whatever a file holds."""

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
    """

    def __init__(
        self,
        problem: str,
        *,
        file: str | Path | None = None,
        line: int | None = None,
        remedy: str | None = None,
    ) -> None:
        where = "" if file is None else f"{file}:{line}: " if line is not None else f"{file}: "
        super().__init__(f"{where}{problem}" + (f" — {remedy}" if remedy else ""))
        self.problem, self.file, self.line, self.remedy = problem, file, line, remedy


class ConfigError(NavError):
    """A configuration key or value that cannot be used."""

    @classmethod
    def unknown_key(cls, key: str, known: Iterable[str], where: str = "") -> ConfigError:
        """Return the error for `key`, naming the nearest of the `known` keys."""
        candidates = sorted(known)
        near = difflib.get_close_matches(key, candidates, n=1, cutoff=0.4)
        hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(candidates)}"
        prefix = f"{where}: " if where else ""
        return cls(f"{prefix}unknown key '{key}' — {hint}")


class AlignmentError(NavError):
    """There is no initial attitude yet; the message says why and what would help."""
