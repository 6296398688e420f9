"""RINEX that the standard allows, or that people have, as RTKLIB can read it.

RTKLIB takes no byte order mark and no shifted label, knows neither scale factors nor BeiDou time,
and reads every ephemeris message of RINEX 4 as if it were the classic one. A file with any of it
is read as a copy in which that is put right; what the copy holds is told.
"""

from __future__ import annotations

import atexit
import codecs
import datetime
import re
import shutil
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from ...filters.errors import DataError
from .. import gpstime
from . import rinex_header as header
from .orbit_products import product_kind

#: Time systems that are GPS time to some 10 ns, and BeiDou's, which is behind it [s].
_AS_GPS = ("GPS", "GAL", "QZS", "IRN", "SBA")
_BEIDOU = 14.0
#: Of a file that does not say: by the letter of its constellation; of a mixture it is GPS time.
_BY_LETTER = {"R": "GLO", "C": "BDT"}
#: Ephemeris messages of RINEX 4 with the content of RINEX 3.
CLASSIC = ("LNAV", "INAV", "FNAV", "IFNV", "D1", "D2", "D1D2", "FDMA", "SBAS")
_TYPES = ("SYS / # / OBS TYPES", "# / TYPES OF OBSERV")
_GLONASS = re.compile(r"R[ \d]\d \d{4} ")
# Events 2 (moving antenna) and 5 (time mark), whose lines RTKLIB takes for satellites, and 6 (cycle
# slips found by the receiver), which it takes for observations; of RINEX 3 or 2.
_EVENTS = re.compile(rb"\n(?:>.{30}|.{28})[256][ \d]{3}")
_UNIX = 315964800.0


@dataclass(frozen=True)
class Readable:
    """A RINEX file for RTKLIB: the file itself or a copy that goes when the process ends.

    Attributes
    ----------
    path : Path
    notes : tuple of str
        What the copy holds otherwise.
    """

    path: Path
    notes: tuple[str, ...] = ()


def readable_rinex(path: str | Path) -> Readable:
    """Return what RTKLIB can read of a plain RINEX file that has been checked.

    Raises
    ------
    DataError
        A time system that is none, with its line.
    """
    path = Path(path)
    stat = path.stat()
    return _readable(path.absolute(), stat.st_mtime_ns, stat.st_size)


@cache
def _readable(path: Path, modified: int, size: int) -> Readable:
    raw = path.read_bytes()
    if product_kind(raw[:128]):  # precise orbits and clocks are read as they are
        return Readable(path)
    plain = without_mark(raw)
    end = plain.find(b"END OF HEADER")
    end = plain.find(b"\n", end) + 1 or len(plain)
    head = _lines(plain[:end])
    mended = _labels(head)
    kind, version = mended[0][20:21], float(mended[0][:9])
    notes: list[str] = []
    shift = 0.0
    if kind == "O":
        shift, mended = _time_system(path, _counts(mended), notes)
    untouched = plain is raw and mended == head
    odd = b"SYS / SCALE FACTOR" in plain or _EVENTS.search(plain)
    if kind == "O" and untouched and not odd:
        return Readable(path)
    body = before = _lines(plain[end:])
    if kind == "O":
        body = _without_events(mended, body, version, path.name, notes)
        body = _scaled(mended, body, version, path.name, notes)
        if shift:
            body = [_shifted(line, version, shift) for line in body]
    elif version >= 4.0:
        mended[-1:] = [*_ionosphere(mended, body), mended[-1]]
        body = _classic(body, path.name, notes)
    elif version >= 3.0:
        body = _glonass_lines(body, 5 if version >= 3.05 else 4)
    if plain is raw and mended == head and body == before:
        return Readable(path)
    folder = Path(tempfile.mkdtemp(dir=_shelf()))
    copy = folder / "plain.rnx"
    copy.write_text("\n".join([*mended, *body]) + "\n", encoding="latin-1", errors="replace")
    return Readable(copy, tuple(notes))


def without_mark(content: bytes) -> bytes:
    """Return text in single bytes, without a byte order mark."""
    if content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return content.decode("utf-16", errors="replace").encode("latin-1", errors="replace")
    return content[3:] if content.startswith(codecs.BOM_UTF8) else content


def _lines(content: bytes) -> list[str]:
    lines = [line.rstrip("\r") for line in content.decode("latin-1").split("\n")]
    return lines[:-1] if not lines[-1] else lines


@cache
def _shelf() -> Path:
    """A folder that goes when the process ends."""
    folder = Path(tempfile.mkdtemp(prefix="certnav-rinex-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _labels(head: list[str]) -> list[str]:
    """Return header lines with their labels in column 61."""
    out = []
    for line in head:
        content, label = header.split(line)
        moved = label and not line[header.WIDTH :].startswith(label)
        out.append(header.joined(content, label) if moved else line)
    return out


def _counts(head: list[str]) -> list[str]:
    """Return the header with the numbers of observation types that were left blank."""
    out = list(head)
    for k, line in enumerate(head):
        content, label = header.split(line)
        if label not in _TYPES:
            continue
        modern = label == _TYPES[0]
        at = slice(3, 6) if modern else slice(0, 6)
        first = content[:1].strip() if modern else k == 0 or header.split(head[k - 1])[1] != label
        if not first or content[at].strip():
            continue
        names = 0
        for more in head[k:]:
            other, name = header.split(more)
            if name != label or (names and (other[:1].strip() if modern else other[:6].strip())):
                break
            names += len(other[7 if modern else 6 :].split())
        out[k] = f"{line[: at.start]}{names:{at.stop - at.start}d}{line[at.stop :]}"
    return out


def _time_system(path: Path, head: list[str], notes: list[str]) -> tuple[float, list[str]]:
    """Return the seconds to add to become GPS time, and the header that says GPS."""
    letter = head[0][40:41]
    at = next((k for k, ln in enumerate(head) if header.split(ln)[1] == "TIME OF FIRST OBS"), None)
    told = head[at][48:51].strip().upper() if at is not None else ""
    system = told or _BY_LETTER.get(letter, "GPS")
    if system in _AS_GPS:
        return 0.0, head
    if system in ("BDT", "BDS"):
        shift = _BEIDOU
    elif system in ("GLO", "UTC"):
        shift = _leap_seconds(path, head, at)
    else:
        raise DataError(
            f"TIME OF FIRST OBS: expected the time system {', '.join(_AS_GPS[:4])}, GLO, UTC or "
            f"BDT, found '{told}'",
            file=path,
            line=None if at is None else at + 1,
            remedy="write the right one there; GPS if the receiver is on GPS time",
        )
    out = list(head)
    date = head[at][:48] if at is not None else ""
    line = f"{date:<48}GPS{'':9}TIME OF FIRST OBS"
    if at is None:
        out.insert(len(head) - 1, line)
    else:
        out[at] = line
    notes.append(f"{path.name}: epochs of {system} moved by {shift:g} s to GPS time")
    return shift, out


def _leap_seconds(path: Path, head: list[str], at: int | None) -> float:
    """Return GPS time minus UTC at the first observation [s]."""
    if at is None:
        raise DataError(
            "no TIME OF FIRST OBS, and GLONASS observations are in UTC",
            file=path,
            line=len(head),
            remedy="add the line with its time system (GLO or GPS)",
        )
    try:
        year, month, day, hour, minute = (int(v) for v in head[at][:30].split()[:5])
        utc = gpstime.from_calendar(year, month, day, hour, minute)
    except (ValueError, OverflowError):
        raise DataError(
            f"TIME OF FIRST OBS: expected a date, found '{head[at][:43].strip()}'",
            file=path,
            line=at + 1,
        ) from None
    return float(gpstime.from_unix(utc + _UNIX)) - utc


def _shifted(line: str, version: float, shift: float) -> str:
    """Return an epoch line later by whole seconds; other lines and undated events as they are."""
    if version >= 3.0:
        if not line.startswith(">") or not line[2:29].strip():
            return line
        years, century, end = slice(2, 6), 0, 18
    else:
        if not re.match(r" [ \d]\d [ \d]\d [ \d]\d [ \d]\d [ \d]\d[ \d]{3}\.\d{7}  [0-6]", line):
            return line
        years, century, end = slice(1, 3), 1900, 15
    year = int(line[years]) + century
    year += 100 if century and year < 1980 else 0
    month, day, hour, minute = (int(line[k : k + 2]) for k in range(years.stop + 1, end, 3))
    whole, fraction = line[end : end + 11].split(".")
    date = datetime.datetime(year, month, day, hour, minute)
    date += datetime.timedelta(seconds=int(whole) + shift)
    stamp = f"{date.year % 100 if century else date.year:0{years.stop - years.start}d}"
    stamp += f" {date:%m %d %H %M} {date.second:2d}.{fraction}"
    return line[: years.start] + stamp + line[end + 11 :]


def _without_events(
    head: list[str], body: list[str], version: float, name: str, notes: list[str]
) -> list[str]:
    """Return the epochs, and the events that change the header."""
    modern = version >= 3.0
    flag, count = (31, slice(32, 35)) if modern else (28, slice(29, 32))
    names = (header.split(line) for line in head)
    types = sum(len(content[6:].split()) for content, label in names if label == _TYPES[1])
    out, slips, k = [], 0, 0
    while k < len(body):
        event, number = body[k][flag : flag + 1], int(body[k][count].strip() or 0)
        lines = 1 + number
        if not modern and event in ("0", "1", "6"):
            lines = 1 + max(-(-number // 12) - 1, 0) + number * -(-types // 5)
        slips += event == "6"
        if event not in ("2", "5", "6"):
            out += body[k : k + lines]
        k += lines
    if slips:
        notes.append(f"{name}: {slips} records of cycle slips left out")
    return out


def _scaled(
    head: list[str], body: list[str], version: float, name: str, notes: list[str]
) -> list[str]:
    """Return observations divided by their scale factors (RINEX 3 and later)."""
    label = "SYS / SCALE FACTOR"
    if version < 3.0 or not any(label in line for line in (*head, *body)):
        return body
    types: dict[str, list[str]] = {}
    factors: dict[str, dict[str, float]] = {}
    _factors(head, types, factors)
    out, k = [], 0
    while k < len(body):
        line = body[k]
        out.append(line)
        count = int(line[32:35]) if line.startswith(">") and line[32:35].strip() else 0
        rows = body[k + 1 : k + 1 + count]
        if "2" <= line[31:32] <= "5":
            _factors(rows, types, factors)
            rows = [row for row in rows if header.split(row)[1] != label]
            out[-1] = f"{line[:32]}{len(rows):3d}{line[35:]}"
            out += rows
        else:
            for row in rows:
                of = factors.get(row[:1], {})
                out.append(_divided(row, [of.get(t, 1.0) for t in types.get(row[:1], [])]))
        k += 1 + count
    told = sorted({f"{s} 1/{f:g}" for s, of in factors.items() for f in of.values()})
    notes.append(f"{name}: observations divided by their scale factors ({', '.join(told)})")
    return out


def _factors(
    lines: list[str], types: dict[str, list[str]], factors: dict[str, dict[str, float]]
) -> None:
    """Read observation types and scale factors from header lines."""
    system, of, factor = "", "", 1.0
    for line in lines:
        content, label = header.split(line)
        if label == "SYS / # / OBS TYPES":
            if content[0].strip():
                system = content[0]
                types[system] = []
            types.setdefault(system, []).extend(content[7:].split())
        elif label == "SYS / SCALE FACTOR":
            if content[0].strip():
                of, factor = content[0], float(content[1:6].strip() or 1)
                factors.setdefault(of, {})
            named = content[10:].split()
            if content[0].strip() and not named:
                named = types.get(of, [])
            factors.setdefault(of, {}).update(dict.fromkeys(named, factor))


def _divided(row: str, factors: list[float]) -> str:
    """Return a satellite's line with each value divided, with as many digits as fit."""
    for k, factor in enumerate(factors):
        at = slice(3 + 16 * k, 17 + 16 * k)
        if factor == 1.0 or not row[at].strip():
            continue
        value = float(row[at]) / factor
        digits = max(3, min(6, 12 - len(f"{value:.0f}")))
        row = f"{row[: at.start]}{value:14.{digits}f}{row[at.stop :]}"
    return row


def _ionosphere(head: list[str], body: list[str]) -> list[str]:
    """Return header lines with the first GPS ionosphere message of RINEX 4, if it is not there."""
    if any(line.startswith(("GPSA", "GPSB")) for line in head):
        return []
    for k, line in enumerate(body):
        if line.startswith("> ION G") and line[10:].strip() == "LNAV" and k + 3 < len(body):
            text = [body[k + 1][23:], body[k + 2][4:], body[k + 3][4:]]
            cells = [t[19 * c : 19 * c + 19].strip() for t, n in zip(text, (3, 4, 1), strict=True)
                     for c in range(n)]  # fmt: skip
            try:
                value = [float(c.replace("D", "E")) for c in cells]
            except ValueError:
                return []
            rows = [("GPSA", value[:4]), ("GPSB", value[4:])]
            return [
                header.joined(f"{name} " + "".join(f"{v:12.4E}" for v in four), "IONOSPHERIC CORR")
                for name, four in rows
            ]
    return []


def _classic(body: list[str], name: str, notes: list[str]) -> list[str]:
    """Return RINEX 4 navigation with only the ephemerides that RTKLIB reads rightly."""
    out: list[str] = []
    left_out: dict[str, int] = {}
    keep = True
    for line in body:
        if line.startswith(">"):
            kind, message = line[2:5], line[10:].strip()
            keep = kind == "EPH" and message in CLASSIC
            if kind == "EPH" and not keep:
                left_out[message] = left_out.get(message, 0) + 1
        if keep:
            out.append(line)
    if left_out:
        counted = ", ".join(f"{n} {message}" for message, n in left_out.items())
        notes.append(f"{name}: ephemerides of other messages left out: {counted}")
    return out


def _glonass_lines(body: list[str], wanted: int) -> list[str]:
    """Return GLONASS ephemerides of as many lines as RTKLIB expects in this version.

    RINEX 3.05 added a fifth; converters write it in earlier versions, or not in later ones.
    """
    out: list[str] = []
    have = 0  # lines of the GLONASS ephemeris that is being read
    for line in (*body, None):
        continues = line is not None and line[:4].strip() == "" and line.strip() != ""
        if have and not continues:
            out += ["    " + 4 * " 0.000000000000E+00"] * (wanted - have)
            have = 0
        if line is None:
            break
        if _GLONASS.match(line):
            have = 1
        elif have:
            have += 1
            if have > wanted:
                continue
        out.append(line)
    return out
