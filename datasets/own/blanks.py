"""Blanks of a declaration: what `certnav declare` leaves where only the user can know."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ...filters.errors import ConfigError

#: The mark.
BLANK = "?"


def is_blank(value: Any) -> bool:
    """Whether a value waits for an answer, as a whole or in part."""
    return bool(value == BLANK or (isinstance(value, list) and BLANK in value))


def refuse_blanks(file: Path, text: str, content: Mapping[str, Any]) -> None:
    """Refuse (`ConfigError`) a declaration with blanks: the first with its line, and all others."""

    def blanks(table: Mapping[str, Any], prefix: str) -> Iterable[tuple[str, str]]:
        for key, value in table.items():
            if isinstance(value, Mapping):
                yield from blanks(value, f"{prefix}.{key}" if prefix else key)
            elif is_blank(value):
                yield prefix, key

    left = list(blanks(content, ""))
    if left:
        section, key = left[0]
        line = _line_of(text, section, key)
        hint = text.splitlines()[line - 1].partition("#")[2].strip() if line else ""
        others = [f"{key} in line {_line_of(text, section, key)}" for section, key in left[1:]]
        more = f" (and {len(others)} more: {', '.join(others)})" if others else ""
        raise ConfigError(
            f"{file}:{line}: [{section}] {key} is still '{BLANK}'{more} — fill it in"
            + (f": {hint}" if hint else "")
        )


def _line_of(text: str, section: str, key: str) -> int:
    """Return the line of a key, counted from 1; 0 if it is written in an unusual way."""
    current = ""
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*\[([^\[\]]+)\]", line)
        if header:
            current = header[1].strip()
        elif current == section and re.match(rf"\s*[\"']?{re.escape(key)}[\"']?\s*=", line):
            return number
    return 0
