"""What a downloaded file is, told by its content.

RINEX by its first line, IMU text by seven columns and its rate (100 Hz MEMS, 200 Hz tactical), the
reference by week and ECEF position.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...filters.rotation import FloatArray
from .. import gpstime
from ..text.rinex_packing import is_packed, unpack
from ..text.tables import starts_with_number
from .files import rinex_kind

_DAY = 86400.0


@dataclass(frozen=True)
class Inspected:
    """What a file is, by its content.

    Attributes
    ----------
    kind : str
        'mems', 'tactical', 'reference', 'observations', 'navigation', or '' if none of them.
    start, end : float
        Seconds of week covered by IMU text and reference; NaN for the others.
    week : int
        Of a reference; 0 where the file has none.
    """

    kind: str
    start: float = np.nan
    end: float = np.nan
    week: int = 0


def inspect(file: Path) -> Inspected:
    """Return what a file is. Packed RINEX is unpacked in place."""
    with file.open("rb") as stream:
        head = stream.read(1 << 16)
    if is_packed(head[:80]) and head[:2] != b"PK":
        file.write_bytes(unpack(file.read_bytes(), file.name))
    rinex = {"O": "observations", "N": "navigation"}.get(rinex_kind(file))
    if rinex:
        return Inspected(rinex)
    first = _rows(head)
    if len(first) < 2:
        return Inspected("")
    with file.open("rb") as stream:
        stream.seek(max(0, file.stat().st_size - (1 << 14)))
        last = _rows(stream.read(), first[0].size)
    if not last:
        return Inspected("")
    width = first[0].size
    if width == 7:
        step = float(np.median(np.diff([row[0] for row in first])))
        kind = "mems" if 0.007 < step < 0.015 else "tactical" if 0.003 < step <= 0.007 else ""
        inside = 0.0 <= first[0][0] <= 8.0 * _DAY
        return Inspected(kind, first[0][0], last[-1][0]) if kind and inside else Inspected("")
    week, radius = first[0][0], float(np.linalg.norm(first[0][2:5])) if width > 14 else 0.0
    if week == round(week) and 1000 <= week <= 4000 and 6.3e6 < radius < 6.5e6:
        return Inspected("reference", first[0][1], last[-1][1], int(week))
    return Inspected("")


def _rows(raw: bytes, width: int = 0) -> list[FloatArray]:
    """Return the leading numbers of complete lines that start with some, all of one width."""
    lines = raw.decode("latin-1").splitlines()[: -1 if not raw.endswith(b"\n") else None]
    rows = []
    for line in lines:
        tokens = line.replace(",", " ").split()
        if len(tokens) < 7 or not starts_with_number(tokens[0]):
            continue
        numbers = [float(t) for t in tokens if starts_with_number(t)]
        if len(numbers) == len(tokens) or len(numbers) > 14:
            rows.append(np.array(numbers))
    rows = [row for row in rows if not width or row.size == width or row.size > 14]
    return [row for row in rows if row.size == rows[0].size or row.size > 14]


def first_ephemeris(file: Path) -> float | None:
    """Return the epoch of the first ephemeris [s]; RINEX 2 and 3."""
    with file.open(encoding="ascii", errors="replace") as stream:
        for line in stream:
            if line[60:].startswith("END OF HEADER"):
                break
        line = stream.readline()
    # RINEX 3: "G05 2020 10 27 …"; RINEX 2: " 5 20 10 27 …"
    date = re.match(r"[A-Z][ \d]\d (\d{4}) ([ \d]\d) ([ \d]\d)", line) or re.match(
        r"[ \d]{2} ([ \d]\d) ([ \d]\d) ([ \d]\d)", line
    )
    if date is None:
        return None
    year, month, day = (int(part) for part in date.groups())
    if year < 100:
        year += 2000 if year < 80 else 1900
    try:
        return gpstime.from_calendar(year, month, day)
    except ValueError:
        return None
