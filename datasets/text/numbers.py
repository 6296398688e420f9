"""Tables of plain numbers from text, compiled: what a reader of big files spends its time on.

Only what is beyond doubt is read here: lines of as many decimal numbers as there are columns, or
blank ones. Of anything else (a header, a word, NaN, a missing column) nothing is read, and
`datasets.text.tables` looks at the lines one by one and says what is wrong with them.

A decimal of up to 15 digits and a power of ten up to 10²² are exact in double precision, and so
their product or quotient is the number nearest to the text (Clinger 1990, "How to read floating
point numbers accurately"). The few others are left to Python's `float`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...filters.compiled.jit import COMPILED, njit
from ...filters.rotation import FloatArray

_POWER = 10.0 ** np.arange(23)
_EXACT = np.int64(2) ** 53
#: What is read at a time [bytes].
_PIECE = 1 << 25


def read_numbers(
    path: Path, columns: int, exact: bool
) -> tuple[FloatArray, NDArray[np.int64]] | None:
    """Return the numbers of a text file and the line of each row, or None for a closer look.

    Parameters
    ----------
    path : Path
    columns : int
        How many a line has.
    exact : bool
        Whether a line must not have more; what it has more is not read.
    """
    if not COMPILED:
        return None
    try:
        most = sum(int(_count_lines(text)) for text in _pieces(path))
        values, line = np.empty((most, columns)), np.empty(most, dtype=np.int64)
        rows, above = 0, 0
        for text in _pieces(path):
            lines = int(_count_lines(text))
            hard = np.empty((lines * columns, 3), dtype=np.int64)
            part = values[rows : rows + lines]
            more, left = _parse(text, exact, part, line[rows:], hard, _POWER)
            if more < 0:
                return None
            for cell, begin, end in hard[:left]:
                part.flat[cell] = float(text[begin:end].tobytes())
            line[rows : rows + more] += above
            rows, above = rows + more, above + lines - 1  # the last line of a piece is empty
    except OSError:
        return None
    values, line = values[:rows], line[:rows]
    return (values, line) if rows and np.isfinite(values).all() else None


def _pieces(path: Path) -> Iterator[NDArray[np.uint8]]:
    """Yield a file in pieces that end with a line: of a day of data it is the larger half."""
    with path.open("rb") as file:
        rest = b""
        while block := file.read(_PIECE):
            end = block.rfind(b"\n") + 1
            if end:
                yield np.frombuffer(rest + block[:end], dtype=np.uint8)
                rest = block[end:]
            else:
                rest += block
        if rest:
            yield np.frombuffer(rest, dtype=np.uint8)


@njit(cache=True, nogil=True)
def _count_lines(text):
    count = 1
    for k in range(text.size):
        count += text[k] == 10
    return count


@njit(cache=True, nogil=True)
def _parse(text, exact, values, line, hard, power):
    """Fill `values`, and `hard` with cell, begin and end of what Python has to read.

    Returns the number of rows, −1 where something is not plain, and that of `hard`.
    """
    columns, size = values.shape[1], text.size
    at, row, column, number, left = 0, 0, 0, 1, 0
    while at < size:
        c = text[at]
        if c == 32 or c == 9:
            at += 1
            continue
        if c == 13 and at + 1 < size and text[at + 1] == 10:
            at += 1
            c = text[at]
        if c == 10:
            if column > 0:
                if column < columns:
                    return -1, 0
                row, column = row + 1, 0
            number += 1
            at += 1
            continue
        if column >= columns:
            if exact:
                return -1, 0
            while at < size and text[at] != 10 and text[at] != 13:
                at += 1
            if at < size and text[at] == 13 and (at + 1 == size or text[at + 1] != 10):
                return -1, 0  # a carriage return alone ends no line
            continue
        begin = at
        negative = c == 45
        if negative or c == 43:
            at += 1
        mantissa, digits, exponent, any_digit = np.int64(0), 0, 0, False
        point = False
        while at < size:
            c = text[at]
            if 48 <= c <= 57:
                any_digit = True
                if digits > 0 or c > 48:
                    digits += 1
                if digits < 18:
                    mantissa = 10 * mantissa + np.int64(c - 48)
                if point:
                    exponent -= 1
            elif c == 46 and not point:
                point = True
            else:
                break
            at += 1
        if not any_digit:
            return -1, 0
        if at < size and (text[at] == 101 or text[at] == 69):
            at += 1
            below = at < size and text[at] == 45
            if below or (at < size and text[at] == 43):
                at += 1
            power_of_ten, any_digit = 0, False
            while at < size and 48 <= text[at] <= 57:
                if power_of_ten < 1000:  # beyond every double
                    power_of_ten = 10 * power_of_ten + int(text[at]) - 48
                any_digit = True
                at += 1
            if not any_digit:
                return -1, 0
            exponent += -power_of_ten if below else power_of_ten
        if at < size and text[at] != 32 and text[at] != 9 and text[at] != 10 and text[at] != 13:
            return -1, 0
        if column == 0:
            line[row] = number
        if digits < 18 and mantissa <= _EXACT and -22 <= exponent <= 22:
            value = float(mantissa)
            value = value / power[-exponent] if exponent < 0 else value * power[exponent]
            values[row, column] = -value if negative else value
        else:
            hard[left, 0], hard[left, 1], hard[left, 2] = row * columns + column, begin, at
            left += 1
        column += 1
    if column > 0:
        if column < columns:
            return -1, 0
        row += 1
    return row, left
