"""Tests of RINEX files before RTKLIB reads them: RTKLIB skips what it cannot parse, silently.

Checked are the header, that every epoch and every ephemeris has the lines it announces, and
that observation and ephemeris lines hold numbers where the format puts them. RINEX 2 and 3.
"""

from __future__ import annotations

import re
from pathlib import Path

from ...filters.errors import DataError
from . import rinex_header as header
from .rinex_repair import CLASSIC, without_mark

# One observation: F14.3, blank or as wide, then loss-of-lock and strength; 16 columns but the last.
_FIELD = r"(?: {14}|[ \d+-]{10}\.\d{3})"
_FIELDS = rf"(?:{_FIELD}[ \d]{{2}})*(?:{_FIELD}[ \d]?)? *$"
_ROW_2 = re.compile(_FIELDS)
_ROW_3 = re.compile(r"[A-Z][ \d]\d" + _FIELDS)
# Month, day, hour, minute and second; blank in events, which need no time.
_DATE = (
    r" (?:[ 0][1-9]|1[0-2]|  ) (?:[ 0][1-9]|[12]\d|3[01]|  ) (?:[ 01]\d|2[0-3]|  )"
    r" (?:[ 0-5]\d|  ) [ 0-6]\d"
)
_EPOCH_2 = re.compile(rf" [ \d]\d{_DATE}\.[\d ]{{7}}  [0-6][ \d]{{3}}")
_EPOCH_3 = re.compile(rf"> \d{{4}}{_DATE}\.\d{{7}}  [0-6][ \d]{{3}}")
# RINEX 3 events may leave the whole date out.
_EVENT_3 = re.compile(r"> {28,30}[2-5][ \d]{0,3}")
_NUMBERS = re.compile(r"(?: {19}|[ +-]*\d*\.\d+(?:[DEde][+-]?\d+)? *)*$")
_NAV_START_2 = re.compile(r"[ \d]\d [ \d]\d")
_NAV_START_3 = re.compile(r"[GRECJSI][ \d]\d \d{4} ")
#: Longest lines: RTKLIB reads so many characters, or the numbers of an ephemeris line.
_LONGEST_OBSERVATION, _LONGEST_NAVIGATION = 1024, 100
_CUT = "the file is cut short or damaged: copy or convert it again"


def check_observations(path: Path) -> None:
    """Refuse a RINEX observation file that is missing, damaged or incomplete.

    Raises
    ------
    DataError
        With the line that is wrong.
    """
    lines, version, start = _open(path, "O")
    if version < 3.0:
        _check_observations_2(path, lines, start)
    else:
        _check_observations_3(path, lines, start)


def check_navigation(path: Path) -> None:
    """Refuse a RINEX navigation file that is missing, damaged or incomplete.

    Raises
    ------
    DataError
        With the line that is wrong. Of RINEX 4, only messages are tested that hold ephemerides
        as RINEX 3 has them.
    """
    lines, version, start = _open(path, "NGHJ")
    while not lines[-1].strip():
        lines.pop()
    if version >= 4.0:
        _check_messages(path, lines, start)
        return
    first = _NAV_START_2 if version < 3.0 else _NAV_START_3
    begins = [k for k in range(start, len(lines)) if first.match(lines[k])]
    if not begins:
        raise DataError("no ephemeris after the header", file=path, line=len(lines), remedy=_CUT)
    if begins[0] != start:
        _refuse(path, start, lines, "the start of an ephemeris")
    glonass_2 = version < 3.0 and lines[0][20:21] in "GH"
    for begin, end in zip(begins, [*begins[1:], len(lines)], strict=True):
        short = glonass_2 or (version >= 3.0 and lines[begin][0] in "RS")
        _check_ephemeris(path, lines, begin, end, (4, 5) if short else (8, 8), version)


def _check_messages(path: Path, lines: list[str], start: int) -> None:
    """Test the messages of RINEX 4, each behind a line ``> EPH G01 LNAV``."""
    begins = [k for k in range(start, len(lines)) if lines[k].startswith(">")]
    if not begins or begins[0] != start:
        _refuse(path, start, lines, "the start of a message (> EPH …)")
    for begin, end in zip(begins, [*begins[1:], len(lines)], strict=True):
        kind, message = lines[begin][2:5], lines[begin][10:].strip()
        if kind != "EPH" or message not in CLASSIC:
            continue
        if begin + 1 == end or not _NAV_START_3.match(lines[begin + 1]):
            _refuse(path, min(begin + 1, end - 1), lines, "the start of an ephemeris")
        count = {"FDMA": 5, "SBAS": 4}.get(message, 8)
        _check_ephemeris(path, lines, begin + 1, end, (count, count), 4.0)


def _check_ephemeris(
    path: Path, lines: list[str], begin: int, end: int, expected: tuple[int, int], version: float
) -> None:
    """Refuse an ephemeris of another number of lines, or with something else than numbers."""
    indent = 3 if version < 3.0 else 4
    if not expected[0] <= end - begin <= expected[1]:
        raise DataError(
            f"ephemeris {lines[begin][:indent].strip()}: expected {expected[0]} lines, "
            f"found {end - begin}",
            file=path,
            line=begin + 1,
            remedy=_CUT,
        )
    for k in range(begin + 1, end):
        if not _NUMBERS.match(lines[k][indent:].rstrip()):
            _refuse(path, k, lines, "the numbers of an ephemeris")


def _open(path: Path, kinds: str) -> tuple[list[str], float, int]:
    """Return the lines, the version and the index of the first line after the header."""
    wanted = "observation" if kinds == "O" else "navigation"
    if not path.is_file():
        raise DataError(f"{wanted} file not found", file=path, remedy="check the path")
    raw = path.read_bytes()
    if raw[:2] in (b"\x1f\x8b", b"\x1f\x9d") or raw[:2] == b"PK":
        raise DataError("compressed file", file=path, remedy="unpack it first")
    lines = without_mark(raw).decode("latin-1").split("\n")
    lines = [line.rstrip("\r") for line in (lines[:-1] if not lines[-1] else lines)]
    label = header.split(lines[0])[1] if lines else ""
    if lines and lines[0][60:80].strip() == "CRINEX VERS   / TYPE":
        raise DataError("Hatanaka-compressed RINEX", file=path, remedy="convert it with CRX2RNX")
    version = _number(lines[0][:9]) if label == "RINEX VERSION / TYPE" else None
    if version is None or not 2.0 <= version < 5.0:
        found = repr(lines[0][:80].strip()) if lines else "an empty file"
        raise DataError(
            f"expected 'RINEX VERSION / TYPE' with version 2 to 4, found {found}",
            file=path,
            line=1,
            remedy=f"name a RINEX {wanted} file",
        )
    kind = lines[0][20:21]
    if kind not in kinds:
        raise DataError(
            f"expected a RINEX {wanted} file (type {'O' if kinds == 'O' else 'N'}), "
            f"found type {kind!r}",
            file=path,
            line=1,
            remedy="observation and navigation files exchanged?",
        )
    limit = _LONGEST_OBSERVATION if kinds == "O" else _LONGEST_NAVIGATION
    for k, line in enumerate(lines):
        if len(line) > limit:
            raise DataError(
                f"expected lines of up to {limit} characters, found {len(line)}",
                file=path,
                line=k + 1,
                remedy=_CUT,
            )
    end = header.end_of(lines)
    if end is None:
        _refuse_endless(path, lines, version)
    assert end is not None
    if not any(line.strip() for line in lines[end:]):
        raise DataError("nothing after the header", file=path, line=end, remedy=_CUT)
    return lines, version, end


def _refuse_endless(path: Path, lines: list[str], version: float) -> None:
    """Refuse a file without END OF HEADER at the line where the header seems to end."""
    marks = (_EPOCH_2, _NAV_START_2) if version < 3.0 else (_EPOCH_3, _NAV_START_3)
    for k, line in enumerate(lines):
        if any(mark.match(line) for mark in marks) and not header.split(line)[1]:
            raise DataError(
                f"expected 'END OF HEADER' before {line[:30].strip()!r}",
                file=path,
                line=k + 1,
                remedy="add the line END OF HEADER (from column 61) above it",
            )
    raise DataError("expected 'END OF HEADER'", file=path, line=len(lines), remedy=_CUT)


def _check_observations_3(path: Path, lines: list[str], start: int) -> None:
    k = start
    while k < len(lines) and not _only_blank(lines, k):
        if not _EPOCH_3.match(lines[k]) and not _EVENT_3.match(lines[k]):
            _refuse(path, k, lines, "an epoch line (> year month day …)")
        end = k + 1 + _count(path, lines, k, 32, event="2" <= lines[k][31] <= "5")
        if end > len(lines):
            _refuse_short(path, k, end - k - 1, len(lines) - k - 1, "records")
        if lines[k][31] <= "1" or lines[k][31] == "6":
            for row in range(k + 1, end):
                if not _ROW_3.match(lines[row]):
                    _refuse(path, row, lines, "a satellite and its observations")
        k = end


def _check_observations_2(path: Path, lines: list[str], start: int) -> None:
    types = sum(
        len(content[6:].split())
        for content, label in map(header.split, lines[:start])
        if label == "# / TYPES OF OBSERV"
    )
    per_satellite = -(-types // 5)
    k = start
    while k < len(lines) and not _only_blank(lines, k):
        if not _EPOCH_2.match(lines[k]) and lines[k][:26].strip():
            _refuse(path, k, lines, "an epoch line (year month day …)")
        special = "2" <= lines[k][28:29] <= "5"
        count = _count(path, lines, k, 29, event=special)
        extra = 0 if special else max(-(-count // 12) - 1, 0)
        body = k + 1 + extra
        end = body + (count if special else count * per_satellite)
        if end > len(lines):
            _refuse_short(path, k, end - k - 1, len(lines) - k - 1, "lines")
        if not special:
            for row in range(body, end):
                if not _ROW_2.match(lines[row]):
                    _refuse(path, row, lines, "observations of 16 columns each")
        k = end


def _count(path: Path, lines: list[str], k: int, at: int, event: bool) -> int:
    """Return the number of satellites, or of lines, that an epoch line announces."""
    text = lines[k][at : at + 3].strip()
    if event and not text:
        return 0
    if not text.isdigit():
        _refuse(path, k, lines, "a number of satellites in the epoch line")
    return int(text)


def _only_blank(lines: list[str], start: int) -> bool:
    return not lines[start].strip() and not any(line.strip() for line in lines[start:])


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _refuse(path: Path, index: int, lines: list[str], expected: str) -> None:
    found = lines[index].strip()
    found = found[:40] + ("…" if len(found) > 40 else "")
    raise DataError(f"expected {expected}, found {found!r}", file=path, line=index + 1, remedy=_CUT)


def _refuse_short(path: Path, index: int, expected: int, found: int, what: str) -> None:
    raise DataError(
        f"last epoch announces {expected} {what}, found {found}",
        file=path,
        line=index + 1,
        remedy=_CUT,
    )
