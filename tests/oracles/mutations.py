"""Ways to break a file: what disks, editors, loggers, converters and hands do to it.

Every mutation is a function of the bytes and of a `random.Random`, so that a case can be made
again from its number. `mutate` picks one or a few that fit the kind of file.
"""

from __future__ import annotations

import gzip
import io
import re
from collections.abc import Callable
from functools import reduce
from operator import xor
from random import Random

import numpy as np

#: Not bytes but what stands in their place.
DIRECTORY, MISSING = "directory", "missing"

NUMBERS = (
    "nan", "inf", "-inf", "NaN", "1e308", "-1e308", "1e400", "1e20", "-1e20", "1e-320", "0",
    "-0.0", "-1", "1", "-999", "9999", "65536", "2147483648", "-2147483649", "4294967296",
    "9223372036854775808", "99999999999999999999", "604800", "604799.999", "1e5", "3.5",
)  # fmt: skip
WORDS = (
    "", " ", "?", "-", "--", "null", "None", "true", "x", "é", "١٢", "1_000", "0x10", "1,5",
    "1d5", "1.2.3", "+-3", "\x00", '"', "'", "#", "%", "$", ";", "\\", "%s", "{}", "..", "/",
)  # fmt: skip
TOML = (
    "nan", "inf", "-inf", "0", "-1", "1e308", "-1e308", "9223372036854775807", "3.5", "true", '""',
    '"?"', '"x"', "[]", "[1.0]", "[1.0, 2.0, 3.0]", '["a", "b", "c"]', "[[1.0]]", "{}", "{a = 1}",
    "1979-05-27", "07:32:00", "1979-05-27T07:32:00Z", "'\\'", '"/etc"', '"\\u0000"', "1e400",
    "[nan, nan, nan]", "[1e308, 1e308, 1e308]", '["t", 3]', "[0, 1, 2]", "[-1, 99, 2]", "0xff",
)  # fmt: skip
_FACTORS = (np.pi / 180, 180 / np.pi, 9.80665, 1 / 9.80665, 1e3, 1e-3, 1e6, 3600.0, -1.0, 0.0)
_TOKEN = re.compile(r"[^\s,;]+")


def _lines(data: bytes) -> list[str]:
    return data.decode("latin-1").split("\n")


def _joined(lines: list[str]) -> bytes:
    return "\n".join(lines).encode("utf-8" if any(not s.isascii() for s in lines) else "latin-1")


def _pick(lines: list[str], r: Random) -> int:
    """Return a line, every third time one of the first: headers are short and matter."""
    return r.randrange(min(len(lines), 15)) if r.random() < 0.35 else r.randrange(len(lines))


# --- bytes -----------------------------------------------------------------------------------


def flip_bytes(data: bytes, r: Random) -> bytes:
    out = bytearray(data)
    for _ in range(r.choice((1, 1, 2, 8, 64))):
        if out:
            out[r.randrange(len(out))] ^= 1 << r.randrange(8)
    return bytes(out)


def truncate(data: bytes, r: Random) -> bytes:
    return data[: r.randrange(len(data) + 1)] if r.random() < 0.8 else data[r.randrange(200) :]


def zero_tail(data: bytes, r: Random) -> bytes:
    """What a file system leaves after a power cut."""
    at = r.randrange(len(data) + 1)
    return data[:at] + b"\0" * (len(data) - at)


def garbage(data: bytes, r: Random) -> bytes:
    at = r.randrange(len(data) + 1)
    return data[:at] + r.randbytes(r.choice((1, 3, 40, 400))) + data[at:]


def nul_bytes(data: bytes, r: Random) -> bytes:
    at = r.randrange(len(data) + 1)
    return data[:at] + b"\0" * r.choice((1, 2, 16)) + data[at:]


def cut_out(data: bytes, r: Random) -> bytes:
    at = r.randrange(len(data) + 1)
    return data[:at] + data[at + r.choice((1, 1, 2, 10, 100, 1000)) :]


def repeat_block(data: bytes, r: Random) -> bytes:
    at = r.randrange(len(data) + 1)
    block = data[at : at + r.choice((1, 20, 300))]
    return data[:at] + block * r.choice((2, 3, 50)) + data[at:]


def encoding(data: bytes, r: Random) -> bytes:
    text = data.decode("latin-1")
    return r.choice(
        (
            lambda: b"\xef\xbb\xbf" + data,
            lambda: text.encode("utf-16"),
            lambda: text.encode("utf-16-le"),
            lambda: b"\xff\xfe" + data,
            lambda: data.replace(b"\n", b"\r\n"),
            lambda: data.replace(b"\n", b"\r"),
            lambda: data.replace(b"\n", b"\n\r\n"),
            lambda: data.replace(b" ", b"\xc2\xa0"),
            lambda: data.replace(b"\n", b"\x0b") if r.random() < 0.5 else data + b"\x1a",
        )
    )()


def replace_all(data: bytes, r: Random) -> bytes | str:
    noise = r.randbytes(500)
    return r.choice((b"", b"\n", b" \n\n ", b"\0" * 100, b"-", DIRECTORY, MISSING, noise))


# --- lines -----------------------------------------------------------------------------------


def delete_lines(data: bytes, r: Random) -> bytes:
    lines = _lines(data)
    at = _pick(lines, r)
    del lines[at : at + r.choice((1, 1, 2, 10, len(lines)))]
    return _joined(lines)


def duplicate_lines(data: bytes, r: Random) -> bytes:
    lines = _lines(data)
    at = _pick(lines, r)
    lines[at:at] = lines[at : at + r.choice((1, 1, 2, 10))] * r.choice((1, 1, 2, 40))
    return _joined(lines)


def swap_lines(data: bytes, r: Random) -> bytes:
    lines = _lines(data)
    if r.random() < 0.1:
        lines.reverse()
        return _joined(lines)
    i, j = _pick(lines, r), _pick(lines, r)
    lines[i], lines[j] = lines[j], lines[i]
    return _joined(lines)


def long_line(data: bytes, r: Random) -> bytes:
    lines = _lines(data)
    at = _pick(lines, r)
    unit = r.choice(("9", "x", "1 ", "1,", " ", "0.", lines[at] + " "))
    lines[at] += unit * min(200_000 // max(len(unit), 1), 100_000)
    return _joined(lines)


def edit_line(data: bytes, r: Random) -> bytes:
    """Insert, delete or replace a character: columns of fixed width move."""
    lines = _lines(data)
    at = _pick(lines, r)
    line, k = lines[at], r.randrange(len(lines[at]) + 1)
    new = r.choice("0123456789 -+.,;:eED>GREC\t\"'#%[]=x")
    lines[at] = r.choice(
        (line[:k] + new + line[k:], line[:k] + line[k + 1 :], line[:k] + new + line[k + 1 :])
    )
    return _joined(lines)


def other_digits(data: bytes, r: Random) -> bytes:
    """Replace digits by digits: the form stays right, the content does not."""
    lines = _lines(data)
    at = _pick(lines, r)
    share = r.choice((0.02, 0.1, 0.5))
    lines[at] = "".join(
        r.choice("0123456789") if c.isdigit() and r.random() < share else c for c in lines[at]
    )
    return _joined(lines)


# --- tokens and columns ----------------------------------------------------------------------


def _value(r: Random) -> str:
    return r.choice(NUMBERS) if r.random() < 0.65 else r.choice(WORDS)


def replace_token(data: bytes, r: Random) -> bytes:
    lines = _lines(data)
    for _ in range(r.choice((1, 1, 1, 3))):
        at = _pick(lines, r)
        tokens = list(_TOKEN.finditer(lines[at]))
        if tokens:
            token, value = r.choice(tokens), _value(r)
            if r.random() < 0.4:  # of the same width
                value = value.rjust(token.end() - token.start())[: token.end() - token.start()]
            lines[at] = lines[at][: token.start()] + value + lines[at][token.end() :]
    return _joined(lines)


def _separator(lines: list[str]) -> str | None:
    line = lines[len(lines) // 2]
    return next((s for s in (";", ",", "\t") if s in line), None)


def columns(data: bytes, r: Random) -> bytes:
    """Swap, drop, repeat, overwrite, scale or shift a column in all lines or from one on."""
    lines = _lines(data)
    separator = _separator(lines)
    width = len(lines[len(lines) // 2].split(separator))
    i, j, what = r.randrange(max(width, 1)), r.randrange(max(width, 1)), r.randrange(7)
    value, factor = _value(r), r.choice(_FACTORS)
    start = 0 if r.random() < 0.6 else _pick(lines, r)
    for k in range(start, len(lines)):
        tokens = lines[k].split(separator)
        if len(tokens) <= max(i, j):
            continue
        if what == 0:
            tokens[i], tokens[j] = tokens[j], tokens[i]
        elif what == 1:
            del tokens[i]
        elif what == 2:
            tokens.insert(i, tokens[j])
        elif what == 3:
            tokens[i] = value
        elif what == 4:
            tokens[i] = tokens[j]
        else:
            try:
                number = float(tokens[i])
            except ValueError:
                continue
            tokens[i] = repr(number * factor if what == 5 else number + 1e3 * factor)
        lines[k] = (separator or " ").join(tokens)
    return _joined(lines)


def delimiter(data: bytes, r: Random) -> bytes:
    old = r.choice((b",", b";", b" ", b"\t", b".", b"\n"))
    return data.replace(old, r.choice((b",", b";", b"\t", b" ", b"  ", b"|", b"")))


# --- formats with a structure of their own ---------------------------------------------------


def toml_value(data: bytes, r: Random) -> bytes:
    lines = _lines(data)
    keys = [k for k, line in enumerate(lines) if "=" in line]
    if not keys:
        return flip_bytes(data, r)
    at = r.choice(keys)
    key, _, _ = lines[at].partition("=")
    what = r.random()
    if what < 0.7:
        lines[at] = f"{key}= {r.choice(TOML)}"
    elif what < 0.8:
        lines[at] = lines[at].replace(key.strip(), key.strip()[:-1] or "x")
    elif what < 0.9:
        tables = [k for k, line in enumerate(lines) if line.startswith("[")] or [at]
        k = r.choice(tables)
        lines[k] = r.choice(("", "[x]", "[[imu]]", "[", f"{lines[k]}]", "imu = 3", "[a.b.c.d]"))
    else:
        lines.insert(r.randrange(len(lines)), r.choice((lines[at], "x = 1", "[", "a.b = 2", "=")))
    return _joined(lines)


def array(data: bytes, r: Random) -> bytes:
    """Break an array in numpy's format, but keep the format."""
    value = np.load(io.BytesIO(data))
    what = r.randrange(9)
    if what == 0 and value.size:
        value = value.astype(float)
        value.flat[r.randrange(value.size)] = float(r.choice(NUMBERS))
    elif what == 1:
        value = value[: r.choice((0, 1, 2, max(len(value) - 1, 0)))]
    elif what == 2:
        value = value.reshape(-1) if value.ndim > 1 else value[:, None]
    elif what == 3:
        value = value.astype(r.choice(("f4", "i4", "U8", "S4", "c16", "?", "u1", ">f8", "M8[s]")))
    elif what == 4:
        value = value * r.choice(_FACTORS)
    elif what == 5:
        value = value[::-1]
    elif what == 6:
        value = np.concatenate([value, value])
    elif what == 7 and value.ndim == 2:
        value = value[:, np.array(r.sample(range(value.shape[1]), value.shape[1]))]
    else:
        value = np.array(r.choice((3.0, np.nan))) if r.random() < 0.5 else value[..., None]
    stream = io.BytesIO()
    np.save(stream, np.asarray(value))
    return stream.getvalue()


def nmea(data: bytes, r: Random) -> bytes:
    """Break sentences and give them sums that are right."""
    text = r.choice((replace_token, edit_line, other_digits, columns))(data, r)
    out = []
    for line in text.split(b"\n"):
        body, star, _ = line.strip().lstrip(b"$").rpartition(b"*")
        out.append(b"$%s*%02X\r" % (body, reduce(xor, body, 0)) if star else line)
    return b"\n".join(out)


def ubx(data: bytes, r: Random) -> bytes:
    """Break the payload of a message and give it a checksum that is right."""
    starts = [m.start() for m in re.finditer(b"\xb5\x62", data)]
    if not starts:
        return flip_bytes(data, r)
    out, at = bytearray(data), r.choice(starts)
    length = int.from_bytes(out[at + 4 : at + 6], "little")
    if at + 8 + length > len(out) or not length:
        return flip_bytes(data, r)
    for _ in range(r.choice((1, 2, 6))):
        k = at + 6 + r.randrange(length)
        width = r.choice((1, 2, 4))
        fill = r.choice((b"\0", b"\xff", b"\x7f", b"\x80")) if r.random() < 0.7 else r.randbytes(1)
        out[k : min(k + width, at + 6 + length)] = fill * (min(k + width, at + 6 + length) - k)
    a = b = 0
    for byte in out[at + 2 : at + 6 + length]:
        a = (a + byte) & 255
        b = (b + a) & 255
    out[at + 6 + length : at + 8 + length] = bytes((a, b))
    return bytes(out)


def raw_message(data: bytes, r: Random) -> bytes:
    """Break a message of a raw log, in any maker's format, under a checksum that is right."""
    from certnav.datasets.receivers.raw_frames import find_frames

    from .receiver_logs import reframed

    frame = r.choice(find_frames(data).frames)
    out = bytearray(data[frame.start : frame.stop])
    for _ in range(r.choice((1, 2, 6, 20))):
        k = r.randrange(4, len(out) - 4)
        width = min(r.choice((1, 1, 2, 4)), len(out) - 4 - k)
        fill = r.choice((b"\0", b"\xff", b"\x7f", b"\x80")) if r.random() < 0.5 else r.randbytes(1)
        out[k : k + width] = fill * width
    if r.random() < 0.2:
        del out[r.randrange(12, len(out) - 4) : -4]
    return data[: frame.start] + reframed(bytes(out)) + data[frame.stop :]


def inside_gzip(data: bytes, r: Random) -> bytes:
    broken = _text(gzip.decompress(data), r)
    return broken if isinstance(broken, str) else gzip.compress(broken, 1)


_BINARY: tuple[Callable, ...] = (
    flip_bytes, flip_bytes, truncate, zero_tail, garbage, nul_bytes, cut_out, repeat_block,
    replace_all,
)  # fmt: skip
_TEXT: tuple[Callable, ...] = (
    flip_bytes, truncate, zero_tail, garbage, nul_bytes, cut_out, repeat_block, encoding,
    replace_all, delete_lines, delete_lines, duplicate_lines, swap_lines, long_line, edit_line,
    edit_line, other_digits, other_digits, replace_token, replace_token, replace_token, columns,
    columns, delimiter,
)  # fmt: skip
_KINDS: dict[str, tuple[Callable, ...]] = {
    "text": _TEXT,
    "binary": _BINARY,
    "toml": (*_TEXT, *12 * (toml_value,)),
    "npy": (*_BINARY, *14 * (array,)),
    "nmea": (*_TEXT, *20 * (nmea,)),
    "ubx": (*_BINARY, *14 * (ubx,)),
    "raw": (*_BINARY, *28 * (raw_message,)),
    "gzip": (*_BINARY, *20 * (inside_gzip,)),
}


def _text(data: bytes, r: Random) -> bytes | str:
    return r.choice(_TEXT)(data, r)


def mutate(data: bytes, kind: str, r: Random) -> tuple[bytes | str, str]:
    """Return broken bytes (or `DIRECTORY`, `MISSING`) and the names of what was done."""
    names = []
    broken: bytes | str = data
    for _ in range(r.choice((1, 1, 1, 2, 3))):
        step = r.choice(_KINDS[kind])
        try:
            after = step(broken, r)
        except Exception:
            continue  # too broken already for a mutation that knows the format
        names.append(step.__name__)
        broken = after
        if isinstance(broken, str):
            break
    return broken, "+".join(names)
