"""Labels of RINEX header lines, which some converters do not put where they belong."""

from __future__ import annotations

import re

#: Labels that mean something to a reader of observations or ephemerides.
LABELS = (
    "RINEX VERSION / TYPE",
    "PGM / RUN BY / DATE",
    "COMMENT",
    "MARKER NAME",
    "MARKER NUMBER",
    "MARKER TYPE",
    "OBSERVER / AGENCY",
    "REC # / TYPE / VERS",
    "ANT # / TYPE",
    "APPROX POSITION XYZ",
    "ANTENNA: DELTA H/E/N",
    "ANTENNA: DELTA X/Y/Z",
    "WAVELENGTH FACT L1/2",
    "# / TYPES OF OBSERV",
    "SYS / # / OBS TYPES",
    "SIGNAL STRENGTH UNIT",
    "INTERVAL",
    "TIME OF FIRST OBS",
    "TIME OF LAST OBS",
    "RCV CLOCK OFFS APPL",
    "SYS / SCALE FACTOR",
    "SYS / PHASE SHIFT",
    "GLONASS SLOT / FRQ #",
    "GLONASS COD/PHS/BIS",
    "LEAP SECONDS",
    "# OF SATELLITES",
    "PRN / # OF OBS",
    "ION ALPHA",
    "ION BETA",
    "DELTA-UTC: A0,A1,T,W",
    "IONOSPHERIC CORR",
    "TIME SYSTEM CORR",
    "END OF HEADER",
)
_LABEL = re.compile(f"({'|'.join(map(re.escape, LABELS))})\\s*$")
#: Columns of a header line before its label.
WIDTH = 60


def split(line: str) -> tuple[str, str]:
    """Return the content of a header line, 60 columns, and its label, '' if it has no known one.

    A label that begins earlier or later than in column 61 is found all the same.
    """
    found = _LABEL.search(line)
    if found is None:
        return line[:WIDTH], ""
    at = WIDTH if line[WIDTH:].startswith(found[1]) else found.start()
    return line[:at].rstrip()[:WIDTH].ljust(WIDTH), found[1]


def joined(content: str, label: str) -> str:
    """Return a header line with its label where it belongs."""
    return f"{content[:WIDTH]:<{WIDTH}}{label}"


def end_of(lines: list[str]) -> int | None:
    """Return the index of the first line after the header, None where nothing ends it."""
    return next((k + 1 for k, line in enumerate(lines) if split(line)[1] == "END OF HEADER"), None)
