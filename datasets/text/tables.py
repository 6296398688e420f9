"""Columns of numbers from big text files, with the line at fault when one cannot be read.

Plain numbers are read by `datasets.text.numbers` (240 000 lines of seven columns in 0.1 s), all
else by the C parser of pandas. Only when it fails, or leaves something that is not finite, are
the lines walked in Python, to name the first that is wrong or to leave out lines that are not data.
"""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ..fields import StrArray
from .encoding import decode
from .numbers import read_numbers

if TYPE_CHECKING:
    import pandas as pd


#: No column of any recording holds larger numbers (time in ns: 2e18); their squares are finite.
LARGEST = 1e20
#: Stamps repeated by more than this share of more than a few rows are too coarse, not unsorted.
_ROUNDED, _FEW = 0.2, 10
#: Longest line of a table [characters], and longest cell of text in it.
LONGEST_LINE, _LONGEST_CELL = 16384, 256


@dataclass(frozen=True, eq=False)
class Table:
    """What `read_table` found.

    Attributes
    ----------
    file : Path
    values : ndarray, shape (n, m)
        The numeric columns in the order asked for.
    text : tuple of ndarray of str
        The text columns in the order asked for.
    line : ndarray of int, shape (n,)
        Line of each row, counted from 1.
    skipped : tuple of int
        Lines that are neither data nor blank, counted from 1.
    """

    file: Path
    values: FloatArray
    text: tuple[StrArray, ...]
    line: NDArray[np.int64]
    skipped: tuple[int, ...]

    def __len__(self) -> int:
        return self.values.shape[0]


def starts_with_number(token: str) -> bool:
    """Return whether a token is a number: what tells a line of data from a header."""
    try:
        float(token)
    except ValueError:
        return False
    return True


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file; a missing or binary file is a `DataError`."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise cannot_open(path, error) from None
    return checked_lines(path, decode(content, path).splitlines())


def checked_lines(path: Path, lines: list[str]) -> list[str]:
    """Return the lines, or refuse one that no table has: it may cost minutes and gigabytes."""
    longest = max(map(len, lines), default=0)
    if longest > LONGEST_LINE:
        raise DataError(
            f"expected a table, found a line of {longest} characters",
            file=path,
            line=1 + next(k for k, line in enumerate(lines) if len(line) == longest),
            remedy="repair or delete the line",
        )
    return lines


def check_head(path: Path, skip: int = 0) -> None:
    """Refuse a CSV, gzipped or not, whose header has not as many columns as the row below it.

    pandas would take the first columns of the rows for names of rows, and shift all others.

    Parameters
    ----------
    path : Path
    skip : int
        Lines before the header.
    """
    opener = gzip.open if path.suffix == ".gz" else open
    try:
        with opener(path, "rt", encoding="utf-8-sig", errors="replace") as stream:
            head = [stream.readline(LONGEST_LINE + 1) for _ in range(skip + 1)]
            row, number = "\n", skip + 1  # pandas leaves blank lines out
            while row and not row.strip():
                row, number = stream.readline(LONGEST_LINE + 1), number + 1
    except OSError as error:
        raise cannot_open(path, error) from None
    except (EOFError, zlib.error):
        raise DataError("damaged gzip file", file=path, remedy="copy it again") from None
    checked_lines(path, [*head, *(number - skip - 2) * [""], row])
    if not head[skip].strip():
        raise DataError("expected a header, found a blank line", file=path, line=skip + 1)
    header, found = len(head[skip].split(",")), len(row.split(","))
    if row.strip() and header != found:
        raise DataError(
            f"header of {header} columns above a row of {found}",
            file=path,
            line=skip + 1,
            remedy="repair the header",
        )


def cannot_open(path: Path, error: OSError) -> DataError:
    """Return the error for a file that is missing, a folder, or not to be read."""
    if isinstance(error, FileNotFoundError):
        return DataError("file not found", file=path, remedy="check the path")
    if isinstance(error, IsADirectoryError):
        return DataError("expected a file, found a folder", file=path)
    return DataError(f"cannot be read: {error.strerror or error}", file=path)


def read_table(
    path: str | Path,
    columns: Sequence[str],
    *,
    numeric: Sequence[int] | None = None,
    text: Sequence[int] = (),
    exact: bool = True,
    separator: str | None = None,
    is_data: Callable[[str], bool] = starts_with_number,
    lines: list[str] | None = None,
) -> Table:
    """Return columns of a text table.

    Parameters
    ----------
    path : path
    columns : sequence of str
        Name of every column, used in error messages; their number is the expected width.
    numeric, text : sequence of int
        Indices of the columns to return as numbers (default: all) and as text.
    exact : bool
        Whether a row may have more columns than `columns` (False) or not (True).
    separator : str, optional
        Default: any white space.
    is_data : callable
        Takes the first token of a line; lines for which it is false are skipped and counted.
    lines : list of str, optional
        The file's lines, when the caller has read them (and perhaps cut them short) already.

    Raises
    ------
    DataError
        Wrong column count, a token that is no number, NaN or infinity: file, line, column.
    """
    path = Path(path)
    if numeric is None and not text and separator is None and lines is None:
        plain = read_numbers(path, len(columns), exact)
        if plain is not None and max(plain[0].max(), -plain[0].min()) <= LARGEST:
            return Table(path, plain[0], (), plain[1], ())
    numeric = range(len(columns)) if numeric is None else numeric
    lines = read_lines(path) if lines is None else lines
    start = next((k for k, line in enumerate(lines) if _is_row(line, separator, is_data)), None)
    if start is None:
        raise DataError(f"expected rows of {', '.join(columns)}, found none", file=path)
    body = lines[start:]
    frame = _parse_fast(body, columns, numeric, text, exact, separator)
    skipped = [k + 1 for k in range(start) if lines[k].strip()]
    number = np.arange(start + 1, len(lines) + 1)
    if frame is not None and len(frame) != len(body):
        number = np.array([k + 1 for k in range(start, len(lines)) if lines[k].strip()])
    if frame is None or len(frame) != number.size:
        number, more = _walk(path, lines, start, columns, numeric, exact, separator, is_data)
        skipped += more
        frame = _parse_fast(
            [lines[k - 1] for k in number], columns, numeric, text, exact, separator
        )
        if frame is None:  # every line passed the walk, so this is pandas' opinion alone
            raise DataError(
                "not readable as a table of numbers",
                file=path,
                line=start + 1,
                remedy="look for quotes, or for white space that is neither blank nor tab",
            )
    parts = [frame[k].to_numpy(dtype=float) for k in numeric]
    values = np.column_stack(parts) if parts else np.empty((len(frame), 0))
    cells = [frame[k].to_numpy() for k in text]
    for j, column in zip(text, cells, strict=True):
        size = np.fromiter(map(len, column), dtype=np.int64, count=len(column))
        if size.size and size.max() > _LONGEST_CELL:  # an array takes the longest for all rows
            k = int(np.argmax(size))
            raise DataError(
                f"{columns[j]}: expected a word, found {size[k]} characters",
                file=path,
                line=int(number[k]),
                remedy="repair or delete the line",
            )
    words = tuple(column.astype(str) for column in cells)
    return Table(path, values, words, number, tuple(skipped))


def _is_row(line: str, separator: str | None, is_data: Callable[[str], bool]) -> bool:
    tokens = line.split(separator, 1)
    return bool(tokens) and is_data(tokens[0].strip())


def _parse_fast(body, columns, numeric, text, exact, separator) -> pd.DataFrame | None:
    """Return the parsed rows, or None when something in them needs a closer look."""
    import pandas as pd  # slow to import

    width = len(body[0].split(separator))
    if width < len(columns) or (exact and width != len(columns)):
        return None
    wanted = {**dict.fromkeys(numeric, np.float64), **dict.fromkeys(text, str)}
    types = dict.fromkeys(range(width), str) | wanted
    try:
        frame = pd.read_csv(
            io.BytesIO("\n".join(body).encode()),  # a StringIO would hold four bytes a character
            engine="c",
            sep=separator or r"\s+",
            header=None,
            dtype=types if exact else wanted,
            usecols=None if exact else sorted(wanted),
            names=None if exact else range(width),
            index_col=False,
            na_filter=False,
            skip_blank_lines=True,
        )
    except (ValueError, pd.errors.ParserError):
        return None
    if not {*numeric, *text} <= set(frame.columns):  # quotes, or white space only Python knows
        return None
    return frame if (np.abs(frame[list(numeric)].to_numpy()) <= LARGEST).all() else None


def _walk(path, lines, start, columns, numeric, exact, separator, is_data):
    """Return the numbers of the rows and of the skipped lines, or raise at the first bad row."""
    rows, skipped = [], []
    for k in range(start, len(lines)):
        if not lines[k].strip():
            continue
        if not _is_row(lines[k], separator, is_data):
            skipped.append(k + 1)
            continue
        tokens = lines[k].split(separator)
        if len(tokens) < len(columns) or (exact and len(tokens) != len(columns)):
            raise DataError(
                f"expected {len(columns)} columns ({' '.join(columns)}), found {len(tokens)}",
                file=path,
                line=k + 1,
                remedy="repair or delete the line",
            )
        for j in numeric:
            if not starts_with_number(tokens[j]) or not abs(float(tokens[j])) <= LARGEST:
                raise DataError(
                    f"{columns[j]}: expected a finite number, found '{tokens[j].strip()[:40]}'",
                    file=path,
                    line=k + 1,
                    remedy="repair or delete the line",
                )
        rows.append(k + 1)
    return np.array(rows), skipped


def increasing(table: Table, time: FloatArray, name: str) -> None:
    """Refuse times that do not strictly increase, naming the line."""
    step = np.diff(time)
    bad = np.flatnonzero(step <= 0.0)
    if not bad.size:
        return
    k = int(bad[0]) + 1
    repeated = float((step == 0.0).mean())
    if step.min() == 0.0 and repeated > _ROUNDED and step.size > _FEW:
        coarse = f", in steps of {np.median(step[step > 0.0]):.4g} s" if (step > 0.0).any() else ""
        raise DataError(
            f"{name}: {100 * repeated:.0f} % of the rows repeat the stamp before{coarse}: rounded "
            "by a spreadsheet?",
            file=table.file,
            line=int(table.line[k]),
            remedy="export it again with all its decimals; if the rows are evenly spaced, "
            "own files may declare rate_hz instead",
        )
    raise DataError(
        f"{name}: expected increasing time, found {time[k]:.5f} after {time[k - 1]:.5f}",
        file=table.file,
        line=int(table.line[k]),
        remedy="sort the file or remove the repeated rows",
    )


def sampling_note(time: FloatArray, what: str) -> str:
    """Return one line on rate, duration and dropped epochs of a time series [s]."""
    if time.size < 2:
        return f"{what}: {time.size} rows"
    step = np.diff(time)
    usual = float(np.median(step))
    gaps = step > 1.5 * usual
    lost = int(np.round(step[gaps] / usual - 1.0).sum())
    line = f"{what}: {time.size} rows, {1.0 / usual:.4g} Hz, {time[-1] - time[0]:.1f} s"
    if not lost:
        return line
    return f"{line}; {lost} dropped in {int(gaps.sum())} gaps, longest {step.max():.2f} s"
