"""Tables of numbers as text, compiled: a tenth of the time Python's own formatting takes.

Only what the tables need: ``%d``, ``%.Nf`` and ``%.Ng`` with one character between them. The
digits are those of C but for ties to within rounding of the last digit. Whatever else there is
goes through Python's formatting.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...filters.compiled.jit import COMPILED, njit
from ...filters.rotation import FloatArray

_TEMPLATE = re.compile(r"%(?:(d)|\.([1-9])(f|g)|\.(1[0-5])(f))([, ]|$)")
#: Longest number: sign, 19 digits, point, and the separator.
_WIDTH = 24
_POWER = 10.0 ** np.arange(-308, 309)
_ZERO = 308  # index of 10⁰
_TRUNCATED = 100  # %d cuts decimals off
_PAIRS = np.array([[48 + k // 10, 48 + k % 10] for k in range(100)], dtype=np.uint8)


def row_blocks(template: str, table: FloatArray, rows_at_once: int = 4096) -> Iterator[bytes]:
    """Yield the table as text, one line a row, each by the %-`template` of a whole row."""
    columns = _columns(template) if COMPILED else None
    buffer = np.empty(0, dtype=np.uint8)
    if columns is not None:
        buffer = np.empty(rows_at_once * columns[0].size * _WIDTH, dtype=np.uint8)
    for start in range(0, len(table), rows_at_once):
        block = np.ascontiguousarray(table[start : start + rows_at_once], dtype=float)
        if columns is None or not _fits(block):
            yield plain(template, block)
        else:
            yield buffer[: _fill(buffer, block, *columns, _POWER)].tobytes()


def plain(template: str, table: FloatArray) -> bytes:
    """Return the same without a compiler: one ``%`` for all rows."""
    return (((template + "\n") * len(table)) % tuple(table.ravel().tolist())).encode()


def _fits(block: FloatArray) -> bool:
    """Whether whole parts fit 63 bits with room and powers of ten stay normal numbers."""
    size = np.abs(block)
    return not bool((size > 1e15).any() or ((size < 1e-290) & (size > 0.0)).any())


def _columns(template: str) -> tuple[NDArray[np.int64], NDArray[np.uint8]] | None:
    """Return digits (N for %.Nf, −N for %.Ng) and the character after each number."""
    found = list(_TEMPLATE.finditer(template))
    if "".join(m.group(0) for m in found) != template:
        return None
    digits = [
        _TRUNCATED if m[1] else int(m[2] or m[4]) if "f" in (m[3], m[5]) else -int(m[2])
        for m in found
    ]
    return np.array(digits), np.array([ord(m[6] or "\n") for m in found], dtype=np.uint8)


@njit(cache=True, nogil=True)
def _digits(out, at, value, count):
    """Write a whole number ≥ 0 with exactly so many digits; return where it ends."""
    end = at + count
    rest, k = np.uint64(value), end
    while k - at >= 2:
        rest, pair = rest // np.uint64(100), rest % np.uint64(100)
        k -= 2
        out[k], out[k + 1] = _PAIRS[pair, 0], _PAIRS[pair, 1]
    if k > at:
        out[at] = np.uint64(48) + rest % np.uint64(10)
    return end


@njit(cache=True, nogil=True)
def _whole(out, at, value):
    """Write a whole number ≥ 0; return where it ends."""
    count, limit = 1, np.int64(10)
    while value >= limit and count < 18:
        count += 1
        limit *= 10
    return _digits(out, at, value, count)


@njit(cache=True, nogil=True)
def _fixed(out, at, value, digits, power):
    """Write a value ≥ 0 with so many decimals; whole and fraction apart, to lose nothing."""
    whole = np.floor(value)
    scale = power[_ZERO + digits]
    fraction = np.rint((value - whole) * scale)
    if fraction >= scale:
        whole, fraction = whole + 1.0, 0.0
    at = _whole(out, at, np.int64(whole))
    out[at] = 46
    return _digits(out, at + 1, np.int64(fraction), digits)


@njit(cache=True, nogil=True)
def _strip(out, at):
    """Take off zeros after the point, and the point."""
    while out[at - 1] == 48:
        at -= 1
    return at - 1 if out[at - 1] == 46 else at


@njit(cache=True, nogil=True)
def _general(out, at, value, digits, power):
    """Write a value > 0 with so many significant digits, as %g."""
    exponent = int(np.floor(0.3010299956639812 * (math.frexp(value)[1] - 1)))
    if power[_ZERO + exponent] > value:
        exponent -= 1
    elif power[_ZERO + exponent + 1] <= value:
        exponent += 1
    shift = digits - 1 - exponent
    scaled = value * power[_ZERO + shift] if shift >= 0 else value / power[_ZERO - shift]
    mantissa = np.int64(np.rint(scaled))
    if mantissa >= np.int64(power[_ZERO + digits]):
        mantissa //= 10
        exponent += 1
    if -4 <= exponent < digits:
        decimals = digits - 1 - exponent
        unit = np.int64(power[_ZERO + decimals])
        at = _whole(out, at, mantissa // unit)
        if decimals == 0:
            return at
        out[at] = 46
        return _strip(out, _digits(out, at + 1, mantissa % unit, decimals))
    unit = np.int64(power[_ZERO + digits - 1])
    at = _whole(out, at, mantissa // unit)
    if digits > 1:
        out[at] = 46
        at = _strip(out, _digits(out, at + 1, mantissa % unit, digits - 1))
    out[at] = 101
    out[at + 1] = 45 if exponent < 0 else 43
    exponent = abs(exponent)
    return _digits(out, at + 2, np.int64(exponent), 3 if exponent > 99 else 2)


@njit(cache=True, nogil=True)
def _fill(out, table, digits, after, power):
    """Write a block of rows; return its length."""
    at = 0
    for i in range(table.shape[0]):
        for j in range(table.shape[1]):
            value, n = table[i, j], digits[j]
            if np.isnan(value):
                out[at], out[at + 1], out[at + 2] = 110, 97, 110
                at += 3
            else:
                if np.copysign(1.0, value) < 0.0 and not np.isnan(value):
                    if n != _TRUNCATED or value <= -1.0:  # %d knows no −0
                        out[at] = 45
                        at += 1
                    value = -value
                if np.isinf(value):
                    out[at], out[at + 1], out[at + 2] = 105, 110, 102
                    at += 3
                elif n == _TRUNCATED:
                    at = _whole(out, at, np.int64(value))
                elif n >= 0:
                    at = _fixed(out, at, value, n, power)
                elif value == 0.0:
                    out[at] = 48
                    at += 1
                else:
                    at = _general(out, at, value, -n, power)
            out[at] = after[j]
            at += 1
    return at
