"""What the files of GREAT do not say, asked for once for all sequences of a folder.

    asked(home, Path("declared.toml"), [home / "Dataset_campus-01", …])

drafts ``declared.toml`` with a "?" for everything that only the user can know. Filled in, each of
its sequences gets its own ``great.toml``, and every command finds there what it needs. A
``great.toml`` that somebody else wrote is never replaced: what it declares is not asked.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ...filters.errors import ConfigError
from ..placing import write_file
from ..text.toml_files import read_toml
from .catalogue import GREAT, CatalogueEntry
from .files import SIDECAR
from .installation import LEVERS, POINTS, SIDECAR_KEYS, sidecar, word_or_vector

BLANK = "?"
_MARK = "# certnav: made of"
_LEVER, _VECTOR, _POINT = "lever", "lever_antenna_frd_m", "reference_point"


def sequences_in(home: Path) -> list[CatalogueEntry]:
    """Return the sequences that have a folder ``Dataset_<name>``, in the catalogue's order."""
    return [e for e in GREAT if (home / f"Dataset_{e.name}").is_dir()]


def asked(home: Path, file: Path, folders: Iterable[Path] | None = None) -> None:
    """Give every sequence of a folder its ``great.toml``, or draft the questions.

    Parameters
    ----------
    home : path
        Folder with ``Dataset_<name>`` in it.
    file : path
        Answers: keys of ``great.toml``, for all sequences, and in a section of its name for one.
    folders : iterable of path, optional
        Those of the sequences that are meant; default: all.

    Raises
    ------
    ConfigError
        A draft has been written, an answer is missing, or a key is not known. All that is missing
        is named at once, and no ``great.toml`` has been written.
    """
    meant = sequences_in(home)
    if folders is not None:
        names = {folder.name for folder in folders}
        meant = [e for e in meant if f"Dataset_{e.name}" in names]
    entries = [e for e in meant if not _of_the_user(home, e)]
    _complain([f for e in meant if e not in entries for f in _lacking_there(home, e)])
    if not entries:
        return
    if not file.exists():
        text = draft(entries)
        file.parent.mkdir(parents=True, exist_ok=True)
        write_file(file, text.encode())
        blanks = text.count(f'= "{BLANK}"')
        raise ConfigError(
            f"{file}: drafted for {len(entries)} sequences; {blanks} answers that only you know "
            f'are still "{BLANK}" — fill them in, and give the same command again'
        )
    content, _ = read_toml(file)
    answers = {e: _answers(content, e, file) for e in entries}
    missing: list[str] = []
    for e, given in answers.items():
        missing += [f"{e.name}: {key}" for key in _open(e, given)]
    _complain([f"{file}: not answered: {', '.join(missing)}"] if missing else [])
    for e, given in answers.items():
        lines = [f"{_MARK} {file.name}", f"week = {e.week}"]
        lines += [f"{key} = {_toml(value)}" for key, value in given.items() if key != "week"]
        place = home / f"Dataset_{e.name}" / SIDECAR
        text = "\n".join(lines) + "\n"
        if not place.exists() or place.read_text(encoding="utf-8") != text:
            write_file(place, text.encode())


def draft(entries: list[CatalogueEntry]) -> str:
    """Return the questions about some sequences, as TOML with blanks."""
    figure, msf = LEVERS["figure", "mems"][0], LEVERS["msf_xml", "mems"][0]
    lines = [
        '# What the files of GREAT do not say. Replace every "?" and give the same command again.',
        "# Any key of great.toml may stand here, and in a section of its name for one sequence.",
        "",
        "# Which point the references are of is not published:",
        '# "mems", "tactical" or "antenna"',
        f'{_POINT} = "{BLANK}"',
        "",
        "# As in GREAT-MSF's configurations; it is held against the course wherever a drive turns",
        'gyro_unit = "deg/s"',
    ]
    if any(e.lever_known for e in entries):
        lines += [
            "",
            "# From the MEMS IMU to the antenna, sequences of 2020, (forward, right, down) [m]:",
            f'# "figure" {figure}, as drawn by the dataset, or',
            f'# "msf_xml" {msf}, as in GREAT-MSF\'s configuration of the same IMU and day',
            f'{_LEVER} = "{BLANK}"',
        ]
    for e in entries:
        if not e.lever_known:
            lines += [
                "",
                f"[{e.name}]",
                "# From the MEMS IMU to the antenna, [forward, right, down] in metres: see the",
                "# dataset's file Extrinsic & Intrinsic Parameters; no drawing shows it",
                f'{_VECTOR} = "{BLANK}"',
            ]
    return "\n".join(lines) + "\n"


def _answers(content: Mapping[str, Any], e: CatalogueEntry, file: Path) -> dict[str, Any]:
    """Return what a file answers about one sequence: its own section goes before what is common."""
    known = [*SIDECAR_KEYS, *(other.name for other in GREAT)]
    for key in content:
        if key not in known:
            raise ConfigError.unknown_key(key, known, where=str(file))
    own = content.get(e.name, {})
    if not isinstance(own, dict):
        raise ConfigError(f"{file}: {e.name}: expected a section, found {own!r}")
    for key in own:
        if key not in SIDECAR_KEYS:
            raise ConfigError.unknown_key(key, SIDECAR_KEYS, where=f"{file} [{e.name}]")
    common = {k: v for k, v in content.items() if not isinstance(v, dict)}
    if _VECTOR in own or not e.lever_known:  # a drawing of 2020 is of no other year
        common.pop(_LEVER, None)
    if _LEVER in own:
        common.pop(_VECTOR, None)
    given = {**common, **own}
    if given.get("week", e.week) != e.week:
        raise ConfigError(f"{file}: {e.name}: week {given['week']}, of the catalogue {e.week}")
    return given


def _open(e: CatalogueEntry, given: Mapping[str, Any]) -> list[str]:
    """Return the keys that have no answer yet, or one that cannot be."""
    out = [key for key, value in given.items() if value == BLANK]
    words = {_POINT: POINTS, _LEVER: ("figure", "msf_xml"), _VECTOR: ()}
    for key in words.keys() & given.keys() - set(out):
        try:
            word_or_vector(key, given[key], words[key])
        except ConfigError as error:
            out.append(str(error))
    if _POINT not in given:
        out.append(_POINT)
    if _LEVER not in given and _VECTOR not in given:
        out.append(_LEVER if e.lever_known else _VECTOR)
    return out


def _of_the_user(home: Path, e: CatalogueEntry) -> bool:
    place = home / f"Dataset_{e.name}" / SIDECAR
    return place.is_file() and not place.read_text(encoding="utf-8").startswith(_MARK)


def _lacking_there(home: Path, e: CatalogueEntry) -> list[str]:
    folder = home / f"Dataset_{e.name}"
    lacking = _open(e, sidecar(folder, "mems"))
    return [f"{folder / SIDECAR}: lacks {', '.join(lacking)}"] if lacking else []


def _complain(found: list[str]) -> None:
    if found:
        raise ConfigError("; ".join(found))


def _toml(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)
