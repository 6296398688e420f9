"""A copy of a RINEX 3 file without the satellites that screening has rejected.

RTKLIB's differential positioning does not test its code residuals the way `single_point` does,
so what that test, or anything else, has excluded must not reach it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...filters.errors import DataError
from .. import gpstime
from ..observations import GnssObservations


def write_screened(source: Path, out: Path, observations: GnssObservations) -> None:
    """Write the satellites with a usable row in `observations`, epoch by epoch.

    The first line of a satellite after one that was left out is flagged as having lost lock: the
    flag of a real slip may have been in what was left out.

    Parameters
    ----------
    source, out : Path
    observations : GnssObservations
        Read from `source`; satellites or epochs it does not hold are left out too.

    Raises
    ------
    DataError
        RINEX 2, whose layout this does not write.
    """
    lines = source.read_text(encoding="latin-1").splitlines()
    if float(lines[0][:9]) < 3.0:
        raise DataError(
            "screening before RTK needs RINEX 3, found RINEX 2",
            file=source,
            remedy="convert it, for example with gfzrnx or convbin",
        )
    keep = _usable(observations)
    start = next(k for k, line in enumerate(lines) if line[60:].startswith("END OF HEADER")) + 1
    carrier = _carrier_columns(lines[:start])
    body: list[str] = []
    skipped: set[str] = set()
    k = start
    while k < len(lines) and lines[k].startswith(">"):
        head, count = lines[k], int(lines[k][32:35])
        rows = lines[k + 1 : k + 1 + count]
        k += 1 + count
        if head[31] not in "01":  # events hold header lines, not satellites
            body += [head, *rows]
            continue
        usable = keep.get(_tick(head, source), set())
        kept = []
        for row in rows:
            name = row[0] + row[1:3].replace(" ", "0")
            if name not in usable:
                skipped.add(name)
            elif name in skipped:
                skipped.remove(name)
                kept.append(_flagged(row, carrier.get(row[0], ())))
            else:
                kept.append(row)
        if kept:
            body += [f"{head[:32]}{len(kept):3d}{head[35:]}", *kept]
    text = "\n".join([*lines[:start], *body]) + "\n"
    out.write_text(text, encoding="latin-1")


def _usable(observations: GnssObservations) -> dict[int, set[str]]:
    usable = observations.usable
    ticks = np.round(observations.time * 1e3).astype(np.int64)
    out: dict[int, set[str]] = {}
    for tick, name in zip(ticks[usable].tolist(), observations.sat[usable].tolist(), strict=True):
        out.setdefault(tick, set()).add(name)
    return out


def _tick(head: str, source: Path) -> int:
    """Return the epoch of an epoch line [ms]."""
    try:
        year, month, day, hour, minute = (int(v) for v in head[1:18].split())
        time = gpstime.from_calendar(year, month, day, hour, minute, float(head[18:29]))
    except (ValueError, OverflowError):
        raise DataError(
            f"expected the date of an epoch, found '{head[1:29].strip()}'",
            file=source,
            remedy="the file is damaged: copy or convert it again",
        ) from None
    return round(time * 1e3)


def _carrier_columns(header: list[str]) -> dict[str, tuple[int, ...]]:
    """Return per system the columns of the loss-of-lock flags of its carrier phases."""
    types: dict[str, list[str]] = {}
    system = ""
    for line in header:
        if line[60:].strip() == "SYS / # / OBS TYPES":
            system = line[0].strip() or system
            types.setdefault(system, []).extend(line[7:60].split())
    return {
        letter: tuple(3 + 16 * k + 14 for k, name in enumerate(names) if name[0] == "L")
        for letter, names in types.items()
    }


def _flagged(row: str, columns: tuple[int, ...]) -> str:
    """Return the row with bit 0 of the loss-of-lock flag set on every phase it holds."""
    for at in columns:
        if row[at - 14 : at].strip():
            row = row.ljust(at + 1)
            flag = int(row[at]) if row[at].isdigit() else 0
            row = f"{row[:at]}{flag | 1}{row[at + 1 :]}"
    return row
