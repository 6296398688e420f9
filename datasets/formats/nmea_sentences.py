"""Sentences of NMEA 0183 as they stand in logs, their numbers, and the date they lack."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from datetime import date, timedelta
from pathlib import Path
from typing import Any

from .. import gpstime
from ..text.encoding import decode
from .receiver_logs import GPS_EPOCH_UNIX, decoded, log_bytes, needs

_SENTENCE = re.compile(
    rb"\$((?:G[A-Z]|B[CD]|QZ)(GGA|GNS|RMC|VTG|GST|ZDA),[^$*\r\n\x00]*)(\*[0-9A-Fa-f]{2})?"
)
_DAY = 86400.0
#: No receiver's date is earlier: the GPS epoch.
FIRST_DAY = date(1980, 1, 6)


def number(m: Any, key: str) -> float:
    """Return a field as a number, NaN where it is empty."""
    value = getattr(m, key, "")
    return float(value) if isinstance(value, int | float) else math.nan


def zda_date(m: Any) -> date | None:
    try:
        return date(int(m.year), int(m.month), int(m.day))
    except (ValueError, TypeError, OverflowError, AttributeError):  # empty, missing, no such day
        return None


class Calendar:
    """Date of the sentences: from RMC or ZDA, moved on where the time of day starts again."""

    def __init__(self) -> None:
        self.known = False
        self._day, self._time = date(1980, 1, 6), 0.0

    def set(self, day: date, time_of_day: float) -> None:
        self.known, self._day, self._time = True, day, time_of_day

    def unix(self, time_of_day: float) -> float:
        """Return Unix time: within half a day of the last dated sentence."""
        day = self._day
        if time_of_day < self._time - _DAY / 2:
            day += timedelta(days=1)
        elif time_of_day > self._time + _DAY / 2:
            day -= timedelta(days=1)
        seconds = gpstime.from_calendar(day.year, day.month, day.day) + time_of_day
        return seconds + GPS_EPOCH_UNIX


def time_of_day(m: Any) -> float:
    t = m.time
    return float(t.hour * 3600 + t.minute * 60 + t.second + t.microsecond * 1e-6)


def messages(path: Path, damaged: list[str]) -> Iterator[Any]:
    """Yield the sentences of positions, velocities, deviations and dates, whatever is between them.

    Where most of a log's sentences come without a checksum, it was switched off; then a sentence
    counts that has as many fields as the others of its kind. In another log it is cut short.
    """
    try:
        from pynmeagps import NMEAReader
        from pynmeagps import exceptions as refused
    except ImportError:
        raise needs("pynmeagps", path) from None
    content = log_bytes(path)
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        content = decode(content, path).encode()
    found = _SENTENCE.findall(content)
    without = sum(not check for _, _, check in found)
    fields: dict[bytes, int] = {}
    if 2 * without > len(found):
        counts = Counter((kind, body.count(b",")) for body, kind, check in found if not check)
        for (kind, n), _ in counts.most_common():
            fields.setdefault(kind, n)
    sentences = iter(found)

    def following() -> Any:
        body, kind, check = next(sentences)
        if not check:
            if body.count(b",") != fields.get(kind):
                raise ValueError(f"{body[:20]!r}: no checksum")
            total = 0
            for byte in body:
                total ^= byte
            check = f"*{total:02X}".encode()
        try:
            return NMEAReader.parse(b"$" + body + check + b"\r\n")
        except (refused.NMEAParseError, refused.NMEAMessageError, refused.NMEATypeError) as error:
            raise ValueError(str(error)) from None

    yield from decoded(following, damaged)
