"""What separates the columns of a row, where its decimals begin, and the names above them."""

from __future__ import annotations

import csv
import re
from pathlib import Path

from ...filters.errors import DataError
from .tables import starts_with_number

#: Separators by name; None is white space.
NAMES = {"comma": ",", "semicolon": ";", "tab": "\t", "space": None}
_DATE = re.compile(r"\d+[-/:.]\d+[-/:.]\d")
_DECIMAL_COMMA = re.compile(r"(?:(?<=\d)|(?<![^\s;+-])),(?=\d)")
_WHITE_SPACE_AND_COMMAS = re.compile(r"\s*[+-]?\d+(?:,\d+)?(?:\s+[+-]?\d+(?:,\d+)?)+\s*")
#: 1.234,5 and 1,234.5: one of the two is no decimal mark, and nothing says which.
_THOUSANDS = re.compile(r"(?<![\d.,])\d{1,3}(?:\.\d{3})+,\d|(?<![\d.,])\d{1,3}(?:,\d{3})+\.\d")


def is_comment(line: str) -> bool:
    """Return whether a line begins with a comment's sign."""
    return line.lstrip()[:1] in ("#", "%")


def holds_data(line: str) -> bool:
    """Return whether a line is a row: mostly numbers, no comment."""
    if is_comment(line) or not line.strip():
        return False
    tokens = [t.strip() for t in line.replace(";", ",").replace("\t", ",").split(",")]
    if len(tokens) == 1 or _WHITE_SPACE_AND_COMMAS.fullmatch(line):
        tokens = line.replace(",", ".").split()
    known = [t for t in tokens if t]
    return sum(starts_with_number(t) or bool(_DATE.match(t)) for t in known) > len(known) / 2


def separator_of(row: str) -> str | None:
    """Return the first of ``; , tab`` that a row has, None for white space.

    Commas between tabs or blanks are decimals where each stands alone in its cell, between digits.
    """
    if ";" in row:
        return ";"
    cells = row.split("\t")
    if len(cells) > 1 and all(
        cell.count(",") == len(_DECIMAL_COMMA.findall(cell)) <= 1 for cell in cells
    ):
        return "\t"
    if _WHITE_SPACE_AND_COMMAS.fullmatch(row):
        return None
    return "," if "," in row else "\t" if len(cells) > 1 else None


def decimal_points(lines: list[str], path: Path) -> list[str]:
    """Return rows that no comma separates with decimal points for decimal commas.

    Raises
    ------
    DataError
        Numbers with both marks, with the line.
    """
    out = []
    for k, line in enumerate(lines):
        if "," in line:
            both = _THOUSANDS.search(line)
            if both:
                raise DataError(
                    f"expected numbers without thousands separators, found '{both[0]}…'",
                    file=path,
                    line=k + 1,
                    remedy="export the file without them",
                )
            line = _DECIMAL_COMMA.sub(".", line)
        out.append(line)
    return out


def header(before: list[str], separator: str | None, row: list[str]) -> tuple[tuple[str, ...], int]:
    """Return the names above the rows, and how many there are where they do not fit.

    Parameters
    ----------
    before : list of str
        The lines above the rows that are not blank.
    separator : str or None
    row : list of str
        The cells of the first row. Those behind the last name may be empty: a separator at the
        end of the lines. Others may not, for nothing tells whether the names begin at the first
        column (as people write) or at the second (as R does).

    Returns
    -------
    names : tuple of str
        Of the last line that fits; empty if none does.
    unfit : int
        The number of names in the line above the rows where none fits, else 0.
    """
    unfit = 0
    for line in reversed(before):
        cleaned = line.strip(" \r\n").lstrip("#%").lstrip(" ") if is_comment(line) else line
        names = cleaned.split() if separator is None else _cells(cleaned, separator)
        names = [name.strip().strip('"') for name in names]
        short = len(names)
        while short and not names[short - 1]:
            short -= 1
        if len(names) == len(row) and any(cell.strip() for cell in row[short:]):
            return tuple(names), 0
        if short and short <= len(row) and not any(cell.strip() for cell in row[short:]):
            return tuple(names[:short]), 0
        unfit = unfit or short
    return (), unfit


def _cells(line: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:  # such as a cell of more than 128 KiB: no header has one
        return []
