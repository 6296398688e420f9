"""Tests of precise orbits, clocks and antennas before RTKLIB reads them: SP3, RINEX, ANTEX."""

from __future__ import annotations

import re
from pathlib import Path

from ...filters.errors import DataError

#: RTKLIB interpolates orbits over eleven epochs.
_FEWEST_EPOCHS = 11
_NUMBER = r"[ \d+-]*\.\d+"
_DATE = r" *\d{4} +\d{1,2} +\d{1,2} +\d{1,2} +\d{1,2} +\d+\.\d*"
_SP3_EPOCH = re.compile(r"\*" + _DATE)
_SP3_ROW = re.compile(rf"[PV][A-Z ][ \d]\d(?:{_NUMBER}){{4}}")
_CLOCK_ROW = re.compile(rf"(?:AS|AR|CR|DR|MS) \S+ +{_DATE[2:]} +\d+ +[-+\d.]")
_OF_SATELLITE = re.compile(r"[A-Z]\d\d ")
_REMEDY = "the file is cut short or damaged: copy it again"


def product_kind(head: bytes) -> str:
    """Return 'sp3', 'clk' (RINEX clocks), 'atx' (ANTEX) or '' by the beginning of a file."""
    if re.match(rb"#[a-d][PV]\d{4} ", head):
        return "sp3"
    line = head[:81].decode("latin-1")
    if line[60:80] == "ANTEX VERSION / SYST":
        return "atx"
    return "clk" if line[60:80].rstrip() == "RINEX VERSION / TYPE" and line[20:21] == "C" else ""


def is_product(path: str | Path) -> bool:
    """Return whether a file holds precise orbits, clocks or antennas."""
    with Path(path).open("rb") as stream:
        return bool(product_kind(stream.read(128)))


def check_product(path: Path) -> str:
    """Refuse precise products that are damaged; return 'sp3', 'clk' or 'atx'.

    Raises
    ------
    DataError
        With the line that is wrong; a file that is no product.
    """
    content = path.read_bytes()
    kind = product_kind(content[:128])
    lines = [line.rstrip("\r") for line in content.decode("latin-1").split("\n")]
    checks = {"sp3": _check_orbits, "clk": _check_clocks, "atx": _check_antennas}
    if not kind:
        raise DataError(
            "expected SP3 orbits, RINEX clocks or antennas (ANTEX)",
            file=path,
            line=1,
            remedy="broadcast ephemerides stay where they are: name products alone",
        )
    checks[kind](path, lines)
    return kind


def _check_orbits(path: Path, lines: list[str]) -> None:
    announced = next((line[3:6].strip() for line in lines if line.startswith("+ ")), "")
    epochs = rows = 0
    for number, line in enumerate(lines, start=1):
        ends = line.startswith(("* ", "*2", "EOF"))
        if ends and epochs and str(rows) != announced:  # RTKLIB counts lines, and loses its place
            expected = f"{announced or 'a number of'} satellites in the epoch before"
            _refuse(path, number, expected, f"{rows} of them")
        if ends:
            rows = 0
            epochs += not line.startswith("EOF")
        if ends and not line.startswith("EOF") and not _SP3_EPOCH.match(line):
            _refuse(path, number, "an epoch (*  year month day …)", line)
        if epochs and line[:1] in ("P", "V"):
            rows += line[0] == "P"
            if not _SP3_ROW.match(line):
                _refuse(path, number, "a satellite, its coordinates and its clock", line)
    if epochs < _FEWEST_EPOCHS:
        raise DataError(
            f"expected at least {_FEWEST_EPOCHS} epochs of orbits, found {epochs}",
            file=path,
            remedy=_REMEDY,
        )


def _check_clocks(path: Path, lines: list[str]) -> None:
    end = next((k for k, line in enumerate(lines) if line[60:73] == "END OF HEADER"), None)
    if end is None:
        raise DataError("expected 'END OF HEADER'", file=path, line=len(lines), remedy=_REMEDY)
    clocks = 0
    for number, line in enumerate(lines[end + 1 :], start=end + 2):
        if line[:3] in ("AS ", "AR "):
            clocks += line[:3] == "AS "
            if not _CLOCK_ROW.match(line):
                _refuse(path, number, "a satellite, its epoch and its clock", line)
    if not clocks:
        raise DataError("no satellite clock found", file=path, remedy=_REMEDY)


def _check_antennas(path: Path, lines: list[str]) -> None:
    begun = found = 0
    for number, line in enumerate(lines, start=1):
        label = line[60:80].rstrip()
        begun += (label == "START OF ANTENNA") - (label == "END OF ANTENNA")
        found += label == "TYPE / SERIAL NO" and _OF_SATELLITE.match(line[20:]) is not None
        if begun not in (0, 1):
            _refuse(path, number, "antennas that end before others start", line)
        if label == "NORTH / EAST / UP" and not re.match(rf"(?:{_NUMBER}){{3}}", line):
            _refuse(path, number, "offsets north, east, up", line)
    if begun or not found:
        problem = "expected END OF ANTENNA" if begun else "no antenna of a satellite found"
        raise DataError(problem, file=path, line=len(lines), remedy=_REMEDY)


def _refuse(path: Path, number: int, expected: str, line: str) -> None:
    raise DataError(
        f"expected {expected}, found {line[:40].strip()!r}", file=path, line=number, remedy=_REMEDY
    )
