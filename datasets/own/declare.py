"""Draft a ``sequence.toml`` from each file by itself: its columns' names and numbers.

What they show is filled in with its evidence; the rest is ``"?"``, which the reader refuses with
the line, so that no blank is ever taken for an answer. What files show of each other, `certnav
declare` measures afterwards (`nav.drafting`).
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from ...filters.errors import DataError
from ...filters.sensors import PRESETS
from ..formats.kfgins import kind_of
from ..formats.rtklib_pos import is_pos
from ..great.pvt import is_flt
from ..receivers.bags import is_bag
from ..text.columns import open_text
from . import column_roles as roles
from .blanks import BLANK
from .declaration import REFERENCE_FORMATS
from .draft import Draft, Line
from .receivers import bag_sections, kinds_of, with_week
from .tables import draft_table, reference_lines

# A frame of a known class: the two bytes of its start alone are "µb", as in µbar.
_UBX = re.compile(rb"\xb5b[\x01-\x06\x09-\x0b\x0d\x10\x13\x21\x27\x28]")
_NMEA = re.compile(rb"(?:^|[\s\xbf])\$(?:G[ABILNPQ]|B[DC]|QZ)[A-Z]{3},")


def draft_declaration(files: Sequence[str | Path]) -> str:
    """Return a draft of ``sequence.toml`` for some files, from each by itself.

    Parameters
    ----------
    files : sequence of path
        Inertial data, GNSS solution or RINEX, odometer, reference; gzipped or not.

    Returns
    -------
    str
        TOML; every key that needs an answer holds ``"?"`` and says what is asked.

    Raises
    ------
    DataError
        No files, or one that cannot be read as a table.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.datasets import draft_declaration
    >>> rows = np.hstack([0.01 * np.arange(300)[:, None], np.tile([0, 0, 0, 0, 0, -9.8], (300, 1))])
    >>> np.savetxt("imu.csv", rows, delimiter=",", header="t,gx,gy,gz,ax,ay,az", comments="")
    >>> draft = draft_declaration(["imu.csv"])
    >>> '"?"' in draft  # where only its owner knows the answer
    True
    """
    return draft_of(files).text()


def draft_of(files: Sequence[str | Path], roles_of: Mapping[str, str] | None = None) -> Draft:
    """Return the draft of some files before it is text; see `draft_declaration`.

    Parameters
    ----------
    files : sequence of path
    roles_of : mapping of str to {'gnss', 'reference'}, optional
        By their name in the draft: of files with positions, which is GNSS and which is the truth,
        where that is known better than from each file alone.
    """
    paths = [Path(f) for f in files]
    if not paths:
        raise DataError("no files named", remedy="certnav declare imu.csv gnss.csv …")
    home = _absolute(paths[0]).parent
    for path in paths:  # before any of them is read
        if path.is_dir() and not is_bag(path):
            raise DataError(
                "expected files, found a folder", file=path, remedy=f"name them: {path}/*.csv …"
            )
        if not path.exists():
            raise DataError("file not found", file=path, remedy="check the name")
    draft = Draft(home)
    rinex: dict[str, list[str]] = {"O": [], "N": []}
    observed: Path | None = None
    found: list[tuple[Path, str, list[Line]]] = []
    for path in paths:
        name = _relative(path, home)
        if is_bag(path):
            draft.sections = bag_sections(path, name) | draft.sections
            continue
        kinds = kinds_of(path)
        for kind in kinds:
            rinex[kind].append(name)
        if "O" in kinds:
            observed = path
        if not kinds:
            found.append((path, *_draft_file(path, name)))
    if rinex["O"] or rinex["N"]:
        draft.sections["rinex"] = _rinex_section(rinex)
    _share_out(draft, found, dict(roles_of or {}))
    if observed is not None and "imu" in draft.sections:
        draft.sections["imu"] = with_week(draft.sections["imu"], observed)
    _complete(draft)
    return draft


def _share_out(
    draft: Draft, found: list[tuple[Path, str, list[Line]]], roles_of: dict[str, str]
) -> None:
    """Give each file its section; of two with positions one is the reference."""
    sections = [section for _, section, _ in found]
    names = [_relative(path, draft.home) for path, _, _ in found]
    placed = [k for k, s in enumerate(sections) if s in ("gnss", "reference")]
    if not roles_of and not {"gnss", "rinex"} & {*draft.sections, *sections} and "imu" in sections:
        roles_of = {names[k]: "gnss" for k in placed[:1]}  # the only positions there are
    if not roles_of and sections.count("gnss") > 1 and "reference" not in sections:
        tables = [k for k in placed if _may_be_reference(found[k][2])]
        roles_of = {names[k]: "reference" for k in tables[-1:]}
    for (path, section, lines), name in zip(found, names, strict=True):
        role = roles_of.get(name, section) if section in ("gnss", "reference") else section
        if role != section:
            section, lines = _draft_file(path, name, role)
        if section in draft.sections:
            taken = draft.get(section, "file")
            draft.head.append(f'{name} looks like [{section}] too; "{taken}" is drafted')
            continue
        draft.sections[section] = lines


def _may_be_reference(lines: list[Line]) -> bool:
    kind = next((line.value for line in lines if line.key == "format"), "csv")
    return kind in REFERENCE_FORMATS


def _complete(draft: Draft) -> None:
    """Add what every declaration needs and no file holds."""
    if "imu" not in draft.sections:
        draft.put("imu", "file", BLANK, "inertial data; no file looked like it")
    known = ", ".join(PRESETS)
    draft.put("imu.noise", "preset", BLANK, f"{known}; or the data sheet's values instead")
    draft.put("antenna", "lever_frd_m", BLANK, "IMU to antenna, e.g. [0.5, 0.0, -1.2]")
    draft.put("antenna", "lever_sigma_m", 0.0, "how well you know it; above 0 a run estimates it")
    draft.put("vehicle", "mounting_rpy_deg", BLANK, "IMU in the car; [0.0, 0.0, 0.0] if aligned")
    if not {"gnss", "rinex"} & draft.sections.keys():
        draft.head.append("No GNSS was among the files: a run needs [gnss] or [rinex].")


def _absolute(path: Path) -> Path:
    """Return the absolute path with links as they are: the declaration lies beside the links."""
    return Path(os.path.abspath(path))


def _relative(path: Path, home: Path) -> str:
    full = _absolute(path)
    return str(full.relative_to(home)) if full.is_relative_to(home) else str(full)


def _rinex_section(rinex: dict[str, list[str]]) -> list[Line]:
    observations = rinex["O"]
    lines = [
        Line("observations", observations[0] if len(observations) == 1 else BLANK,
              "the rover's, one of " + ", ".join(observations) if len(observations) > 1 else
              "" if observations else "the rover's observations")
    ]  # fmt: skip
    navigation: object = rinex["N"] or BLANK
    lines.append(Line("navigation", navigation, "" if rinex["N"] else "broadcast ephemerides"))
    return lines


def _draft_file(path: Path, name: str, role: str = "") -> tuple[str, list[Line]]:
    """Return the section a file belongs to and its drafted lines."""
    file = Line("file", name)
    with path.open("rb") as stream:
        head = stream.read(4096)
    if _UBX.search(head):
        return "gnss", [file, Line("format", "ubx")]
    if _NMEA.search(head):
        return "gnss", [
            file,
            Line("format", "nmea"),
            Line("position_sigma_m", BLANK, "1σ, e.g. [2.0, 2.0, 4.0]; drop it if there is GST"),
            Line("velocity_sigma_mps", BLANK, "1σ of speed and course, e.g. 0.2"),
        ]
    if not head.startswith(b"\x1f\x8b"):
        if is_pos(path):
            lines = [file, Line("format", "rtklib")]
            if role == "reference":
                return "reference", [*lines, *reference_lines(attitude=False)]
            return "gnss", lines
        if is_flt(path):
            return "gnss", [file, Line("format", "great-pvt"), _week_line()]
        if b"GPSTime" in head:
            return "reference", [file, Line("format", "inertial-explorer"), *reference_lines()]
        kind = kind_of(path)
        if kind == "nav":
            return "reference", [file, Line("format", "kf-gins"), *reference_lines()]
    return draft_table(roles.sample(open_text(path)), file, role)


def _week_line() -> Line:
    return Line("week", BLANK, "GPS week of the first row, e.g. 2129; the file does not hold it")
