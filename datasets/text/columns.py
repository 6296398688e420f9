"""Columns of a text file by header name or by number: CSV of any separator, plain or gzipped.

Columns are numbered from 1, as in a spreadsheet or awk.
"""

from __future__ import annotations

import difflib
import gzip
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from .encoding import decode
from .separators import NAMES, decimal_points, header, holds_data, is_comment, separator_of
from .tables import LARGEST, Table, checked_lines, read_lines, read_table, starts_with_number

Column = str | int
_MISSING = ("", "nan", "na", "null", "none", "-")


@dataclass(frozen=True)
class TextFile:
    """The lines of a file with its header recognised.

    Attributes
    ----------
    file : Path
    lines : list of str
        All lines; those that are comment or header are blank, so that numbers stay.
    names : tuple of str
        The header's names, or empty.
    separator : str or None
        None: white space.
    width : int
        Number of columns of the first row; without those that a trailing separator makes.
    unfit : int
        Names in the line above the rows where they are not as many as the columns, else 0.
    """

    file: Path
    lines: list[str]
    names: tuple[str, ...]
    separator: str | None
    width: int
    unfit: int = 0

    def index(self, column: Column, key: str) -> int:
        """Return the index (from 0) of a column given by name or number (from 1)."""
        if isinstance(column, int) and not isinstance(column, bool):
            if not 1 <= column <= self.width:
                raise ConfigError(
                    f"{key}: column {column} of {self.file.name}: expected 1 … {self.width} "
                    "(columns are numbered from 1)"
                )
            return column - 1
        if not isinstance(column, str):
            raise ConfigError(f"{key}: expected a column name or number, found {column!r}")
        if self.unfit > 1:
            raise ConfigError(
                f"{key}: {self.file.name} has {self.unfit} names above {self.width} columns, which "
                f"leaves open which of them is '{column}': give its number, 1 … {self.width}"
            )
        if not self.names:
            raise ConfigError(
                f"{key}: {self.file.name} has no header, so there is no column '{column}': give "
                f"its number, 1 … {self.width}"
            )
        found = [k for k, name in enumerate(self.names) if name == column]
        if len(found) == 1:
            return found[0]
        if found:
            numbers = ", ".join(str(k + 1) for k in found)
            raise ConfigError(
                f"{key}: {self.file.name} has several columns '{column}' ({numbers}): give a number"
            )
        near = difflib.get_close_matches(column, self.names, n=1, cutoff=0.5)
        hint = f"did you mean '{near[0]}'?" if near else f"it has {', '.join(self.names)}"
        raise ConfigError(f"{key}: {self.file.name} has no column '{column}' — {hint}")


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns of one file by the key they were asked for.

    Attributes
    ----------
    table : Table
        With the line of each row.
    numbers : mapping of str to ndarray, shape (n, m)
    text : mapping of str to list of str
        Several columns of one key are joined by a space.
    """

    table: Table
    numbers: Mapping[str, FloatArray]
    text: Mapping[str, list[str]]


def open_text(path: str | Path, separator: str | None = None) -> TextFile:
    """Return the lines of a text file, gzipped or not, with header and separator recognised.

    Parameters
    ----------
    path : path
    separator : {'comma', 'semicolon', 'tab', 'space'} or one character, optional
        Default: the first of ``; , tab`` that the first row has, else white space. Where no comma
        separates, commas within numbers are decimal commas.

    Raises
    ------
    DataError
        A missing, binary or damaged file, or one without rows of numbers.
    """
    path = Path(path)
    lines = _gunzip(path) if _is_gzip(path) else read_lines(path)
    first = next((k for k, line in enumerate(lines) if holds_data(line)), None)
    if first is None:
        raise DataError("expected rows of numbers, found none", file=path)
    sep = separator_of(lines[first]) if separator is None else NAMES.get(separator, separator)
    before = [line for line in lines[:first] if line.strip()]
    kept = ["" if k < first or is_comment(line) else line for k, line in enumerate(lines)]
    if sep != ",":
        kept = decimal_points(kept, path)
    row = kept[first].split(sep)
    names, unfit = header(before, sep, row)
    width = len(names) or len(row)
    if sep is not None and names:
        kept = [_without_trailing(line, sep, width) for line in kept]
    return TextFile(path, kept, names, sep, width, unfit)


def _without_trailing(line: str, separator: str, width: int) -> str:
    """Return a row without the empty cells that stand behind the last named column."""
    if line.count(separator) < width:
        return line
    cells = line.split(separator)
    return line if any(c.strip() for c in cells[width:]) else separator.join(cells[:width])


def read_columns(
    source: TextFile,
    numbers: Mapping[str, Sequence[Column]],
    text: Mapping[str, Sequence[Column]] | None = None,
    may_miss: Sequence[str] = (),
) -> Columns:
    """Return the columns asked for.

    Parameters
    ----------
    source : TextFile
    numbers, text : mapping of str to sequence of column
        Columns to read as numbers and as text, by the key they are declared under.
    may_miss : sequence of str
        Keys whose cells may be empty or 'nan': they become NaN.

    Raises
    ------
    ConfigError
        A column that does not exist.
    DataError
        A cell that is no number, or a row of another width, with its line.
    """
    text = text or {}
    place = {
        key: [source.index(column, key) for column in columns]
        for key, columns in {**numbers, **text}.items()
    }
    strict = sorted({k for key in numbers if key not in may_miss for k in place[key]})
    loose = sorted({k for key in (*text, *may_miss) if key in place for k in place[key]})
    labels = source.names or tuple(f"column {k + 1}" for k in range(source.width))
    table = read_table(
        source.file,
        labels,
        numeric=strict,
        text=loose,
        separator=source.separator,
        is_data=lambda token: token != "",
        lines=source.lines,
    )
    if table.skipped:
        raise DataError(
            f"{labels[0]}: expected a value, found an empty cell",
            file=source.file,
            line=table.skipped[0],
            remedy="repair or delete the line",
        )
    words = dict(zip(loose, table.text, strict=True))
    value = {k: table.values[:, j] for j, k in enumerate(strict)}

    def number(k: int) -> FloatArray:
        return value[k] if k in value else _lenient(table, words[k], labels[k])

    return Columns(
        table,
        {key: np.column_stack([number(k) for k in place[key]]) for key in numbers},
        {
            key: [
                " ".join(row).strip() for row in zip(*(words[k] for k in place[key]), strict=True)
            ]
            for key in text
        },
    )


def _lenient(table: Table, words: NDArray[np.str_], label: str) -> FloatArray:
    stripped = np.char.strip(words)
    missing = np.isin(np.char.lower(stripped), _MISSING)
    try:
        value = np.where(missing, "nan", stripped).astype(float)
        bad = ~missing & ~(np.abs(value) <= LARGEST)
    except ValueError:
        value = np.empty(0)
        bad = ~missing & ~np.array([starts_with_number(w) for w in stripped])
    if bad.any():
        k = int(np.argmax(bad))
        raise DataError(
            f"{label}: expected a number or nothing, found '{stripped[k]}'",
            file=table.file,
            line=int(table.line[k]),
        )
    return value


def _is_gzip(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return stream.read(2) == b"\x1f\x8b"
    except FileNotFoundError:
        raise DataError("file not found", file=path, remedy="check the name") from None
    except IsADirectoryError:
        raise DataError("expected a file, found a folder", file=path) from None


def _gunzip(path: Path) -> list[str]:
    try:
        content = gzip.decompress(path.read_bytes())
    except (OSError, EOFError, zlib.error):
        raise DataError("damaged gzip file", file=path, remedy="copy it again") from None
    return checked_lines(path, decode(content, path).splitlines())
