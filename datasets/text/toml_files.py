"""TOML as people write it: what is not, is refused in one line before it costs minutes.

The parser of the standard library takes time that grows with the square of a dotted key's
length, and raises errors of several kinds.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from ...filters.errors import DataError
from .encoding import decode

#: Longest line, and most characters in all.
_LINE, _SIZE = 4096, 1 << 20


def read_toml(file: Path) -> tuple[dict[str, Any], str]:
    """Return the content of a TOML file, and its text.

    Raises
    ------
    DataError
        Missing, a folder, binary, absurdly long, or not TOML.
    """
    try:
        text = decode(file.read_bytes(), file).replace("\r\n", "\n")
    except FileNotFoundError:
        raise DataError("no such file", file=file, remedy="check the path") from None
    except OSError as error:
        raise DataError(f"cannot be read: {error.strerror or error}", file=file) from None
    try:
        return parse_toml(text), text
    except ValueError as error:
        raise DataError(f"not readable as TOML: {error}", file=file) from None


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

    Raises
    ------
    ValueError
        With a message of one line.
    """
    if len(text) > _SIZE:
        raise ValueError(f"{len(text)} characters, expected some hundred")
    longest = max(text.splitlines(), key=len, default="")
    if len(longest) > _LINE:
        raise ValueError(f"a line of {len(longest)} characters: {longest[:20]!r} …")
    try:
        content = tomllib.loads(text)
        _refuse_huge_integers(content)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    return content


def _refuse_huge_integers(value: Any) -> None:
    """Refuse integers of more than the 64 bits TOML has: no float holds some of them."""
    if isinstance(value, int):
        if not -(2**63) <= value < 2**63:
            raise ValueError("an integer of more than 64 bits")
        return
    for part in value.values() if isinstance(value, dict) else value:
        if isinstance(part, int | list | dict):
            _refuse_huge_integers(part)
