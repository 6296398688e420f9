"""Text as people have it: UTF-8, with or without a mark; UTF-16 with one; Windows-1252.

UTF-8 refuses nearly everything that is not UTF-8, so that what it reads needs no second opinion.
What it refuses is a spreadsheet's or a logger's single-byte text (a degree sign, an umlaut), or
no text at all: control characters tell the two apart.
"""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from ...filters.errors import DataError

# Escape and Ctrl-Z (the end of a DOS file) occur in texts; a zero byte does not.
_NO_TEXT = re.compile(rb"[\x00-\x08\x0e-\x19\x1c-\x1f\x7f]")
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
#: Two-byte text without a mark has a zero in about every other of so many first bytes.
_LOOKED_AT = 64
_SAVE = "save it as UTF-8"


def decode(content: bytes, file: str | Path) -> str:
    """Return the text of a file's bytes.

    Parameters
    ----------
    content : bytes
    file : path
        For messages.

    Raises
    ------
    DataError
        No text: with the line and the byte that says so.
    """
    if content[:2] in _UTF16:
        try:
            return content.decode("utf-16")
        except UnicodeDecodeError as error:
            before = content[: error.start].decode("utf-16", errors="replace").count("\n")
            raise _no_text(content, error.start, 1 + before, "UTF-16", file) from None
    if 4 * content[:_LOOKED_AT].count(0) > len(content[:_LOOKED_AT]):
        raise DataError(
            "expected text, found zero bytes: binary data, or UTF-16 without a byte order mark",
            file=file,
            line=1,
            remedy=_SAVE,
        )
    at, kind = -1, ""
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        odd = _NO_TEXT.search(content)
        if odd is not None:
            at, kind = odd.start(), "UTF-8"
    if at < 0:
        try:
            return content.decode("cp1252")
        except UnicodeDecodeError as error:  # five bytes mean nothing in Windows-1252
            at, kind = error.start, "UTF-8 or Windows-1252"
    raise _no_text(content, at, 1 + content.count(b"\n", 0, at), kind, file)


def _no_text(content: bytes, at: int, line: int, kind: str, file: str | Path) -> DataError:
    return DataError(
        f"expected {kind} text, found byte 0x{content[at]:02X} (number {at + 1} of the file)",
        file=file,
        line=line,
        remedy=f"{_SAVE}, or copy it again if it is damaged",
    )
