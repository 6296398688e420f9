"""The draft of a declaration: keys with their values or blanks, and beside each its evidence."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from .blanks import BLANK, is_blank
from .declaration import NAME

#: In the order a declaration is read; a name with a point is a table in the one before.
_ORDER = (*("imu", "imu.noise", "antenna", "vehicle", "gnss", "rinex", "odometer", "reference"),)
_COLUMN = 44


class Line(NamedTuple):
    """A key with its value and why; without a key a line of comment alone."""

    key: str
    value: Any
    comment: str = ""

    @property
    def blank(self) -> bool:
        """Whether it waits for an answer, as a whole or in part."""
        return bool(self.key) and is_blank(self.value)

    def __str__(self) -> str:
        if not self.key:
            return f"# {self.comment}"
        text = f"{self.key} = {json.dumps(self.value, ensure_ascii=False)}"
        return f"{text:<{_COLUMN}}  # {self.comment}" if self.comment else text


def remark(text: str) -> Line:
    """Return a line of comment."""
    return Line("", None, text)


@dataclass
class Draft:
    """Sections of a declaration that is being drafted.

    Attributes
    ----------
    home : Path
        Where the declaration will lie: file names are relative to it.
    sections : dict of str to list of Line
    head : list of str
        Comments above all sections.
    """

    home: Path = Path()
    sections: dict[str, list[Line]] = field(default_factory=dict)
    head: list[str] = field(default_factory=list)

    def has(self, section: str, key: str) -> bool:
        """Return whether there is such a line."""
        return any(line.key == key for line in self.sections.get(section, ()))

    def get(self, section: str, key: str, default: Any = None) -> Any:
        """Return a value; that of a blank is ``"?"``."""
        return next((x.value for x in self.sections.get(section, ()) if x.key == key), default)

    def asks(self, section: str, key: str) -> bool:
        """Return whether a key is there and blank, as a whole or in part."""
        return is_blank(self.get(section, key))

    def comment(self, section: str, key: str) -> str:
        """Return what stands beside a key."""
        return next((x.comment for x in self.sections.get(section, ()) if x.key == key), "")

    def put(self, section: str, key: str, value: Any, comment: str = "", after: str = "") -> None:
        """Write a value, over the line there is, or behind the one called `after`, or last."""
        lines = self.sections.setdefault(section, [])
        keys = [line.key for line in lines]
        line = Line(key, value, comment)
        if key in keys:
            lines[keys.index(key)] = line
        elif after in keys:
            lines.insert(keys.index(after) + 1, line)
        else:
            lines.append(line)

    def drop(self, section: str, key: str) -> None:
        """Take a key away."""
        lines = self.sections.get(section, [])
        lines[:] = [line for line in lines if line.key != key]

    def leave(self, section: str, key: str, reason: str) -> None:
        """Leave a key blank and say why it was not measured."""
        before = self.comment(section, key)
        said = f"{before}; {reason}" if before else reason
        self.put(section, key, BLANK, said)

    @property
    def blanks(self) -> tuple[tuple[str, str], ...]:
        """Section and key of what waits for an answer."""
        return tuple(
            (name, x.key) for name in self._names() for x in self.sections[name] if x.blank
        )

    def tables(self, answers: Mapping[tuple[str, str], Any]) -> dict[str, dict[str, Any]]:
        """Return sections as a reader takes them, with trial answers in place of lines."""
        out = {
            name: {x.key: x.value for x in lines if x.key} for name, lines in self.sections.items()
        }
        for (section, key), value in answers.items():
            if section in out:
                out[section][key] = value
        return out

    def text(self) -> str:
        """Return the declaration as TOML."""
        count = len(self.blanks)
        todo = f'Fill in every "{BLANK}" ({count})' if count else "No blank is left"
        lines = [
            f"# {NAME}: draft by certnav declare. {todo}; nothing is guessed, and what",
            "# was measured says so. Columns by name, or by number from 1. Vectors forward, right,",
            "# down in metres.",
            *(f"# {text}" for text in self.head),
        ]
        for name in self._names():
            lines += ["", f"[{name}]", *map(str, self.sections[name])]
        return "\n".join(lines) + "\n"

    def _names(self) -> list[str]:
        return [name for name in _ORDER if name in self.sections]
