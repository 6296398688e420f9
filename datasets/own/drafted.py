"""The declaration of a receiver's and an IMU's file named on the command line, or its draft."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from ...filters.errors import ConfigError, DataError
from ..placing import write_file
from .blanks import BLANK
from .declaration import read_declaration
from .declare import draft_of
from .draft import Draft


def declaration_of(log: Path, imu: Path, drafted: Callable[[list[Path]], Draft] = draft_of) -> Path:
    """Return the declaration of a drive whose files are named one by one: ``LOG.toml`` beside it.

    Where there is none it is drafted, and what only the user can know is asked.

    Parameters
    ----------
    log : Path
        RINEX observations, or a receiver's log: raw messages, or fixes (UBX NAV-PVT, NMEA).
    imu : Path
    drafted : callable
        What drafts.

    Raises
    ------
    DataError
        A missing file.
    ConfigError
        A draft has been written whose blanks have to be filled in; or the declaration that is
        there is of other files.
    """
    for file in (log, imu):
        if file.is_dir():
            raise DataError(
                "expected a file, found a folder",
                file=file,
                remedy="--imu goes with one file of a receiver; a folder is named without it",
            )
        if not file.is_file():
            raise DataError("file not found", file=file, remedy="check the name")
    file = log.with_name(f"{log.name.partition('.')[0]}.toml")
    if not file.exists():
        found = drafted([log, imu])
        draft = f"name = {json.dumps(file.stem)}\n" + found.text()
        try:
            write_file(file, draft.encode())
        except OSError as error:
            raise DataError(
                f"the draft of a declaration cannot be written: {error.strerror}",
                file=file,
                remedy="certnav declare --out writes it elsewhere; then certnav run THAT.toml",
            ) from None
        if found.blanks:
            keys = ", ".join(key for _, key in found.blanks)
            raise ConfigError(
                f"{file}: drafted for {log.name} and {imu.name}; {len(found.blanks)} answers that "
                f'only you know are still "{BLANK}" ({keys}) — fill them in, and give the same '
                "command again"
            )
    declared = read_declaration(file)
    receiver = ("rinex", "observations") if "rinex" in declared.sections else ("gnss", "file")
    for (section, key), given in ((receiver, log), (("imu", "file"), imu)):
        values = declared.sections[section].values if section in declared.sections else {}
        name = values.get(key)
        if not isinstance(name, str) or (file.parent / name).resolve() != given.resolve():
            raise ConfigError(
                f"{file}: [{section}] {key}: expected {given}, found {name!r} — move this "
                "declaration away for a draft of the files you named, or leave --imu out and name "
                "it instead of them"
            )
    return file
