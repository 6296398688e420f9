"""Which file is which in a GREAT folder.

Two layouts exist: GREAT-Dataset (``Dataset_<name>/IMU``, ``…/Groundtruth``, and the raw GNSS of
all sequences in one archive ``GNSS_RAW_DATA`` beside them) and the samples of GREAT-MSF
(``GNSS/{Rover,Base,Product}``, ``IMU``, ``groundtruth`` or ``groudtruth`` or ``ref``). The case
of folders and extensions varies from figure to script to archive, so names are compared without
case, and RINEX files are told by their first line.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...filters.errors import ConfigError, DataError
from .. import gpstime
from ..text import rinex_header as header
from ..text.rinex_repair import without_mark

if TYPE_CHECKING:
    from ..rtklib import GivenFiles

SIDECAR = "great.toml"
#: The program in the headers of simulated RINEX.
SIMULATOR = "certnav simulator"
_REFERENCE_FOLDERS = ("groundtruth", "groudtruth", "ref", "reference")
_IMU_WORDS = {"mems": ("mems", "adis", "smallimu"), "tactical": ("tactical", "starneto")}
_NOT_SEARCHED = ("image", "lidar", "model", "xml", "result", "results")
_RINEX_NAME = re.compile(r"\.(\d\d[onpgl]|obs|rnx|nav|crx)$|^brd[cm]", re.IGNORECASE)
_RAW_ARCHIVE = "gnss_raw_data"


@dataclass(frozen=True)
class GreatFiles:
    """The files of one sequence.

    Attributes
    ----------
    imu : Path
    reference : Path or None
    observations : tuple of Path
        Rover observation files, all candidates.
    navigation : tuple of Path
    base : tuple of Path
        Observation files of base stations, all candidates.
    """

    imu: Path
    reference: Path | None
    observations: tuple[Path, ...]
    navigation: tuple[Path, ...]
    base: tuple[Path, ...] = ()


def is_great(folder: Path) -> bool:
    """Return whether the folder has an IMU folder with text and GNSS or reference beside it."""
    if _member(folder, SIDECAR) is not None:
        return True
    imu = _member(folder, "imu")
    beside = (*_REFERENCE_FOLDERS, "gnss")
    return (
        imu is not None
        and bool(_texts(imu))
        and any(_member(folder, name) is not None for name in beside)
    )


def find_files(
    folder: Path, *, imu: str, reference_point: object, named: Mapping[str, Path]
) -> GreatFiles:
    """Return the files of a sequence in either layout.

    Parameters
    ----------
    folder : Path
    imu : {'mems', 'tactical'}
    reference_point : object
        Chooses between ``…_GNSS.txt`` ('antenna') and ``…_ADIS.txt`` where a set has both.
    named : mapping
        'imu', 'reference': files the caller has chosen; they are not searched for.

    Raises
    ------
    DataError
        No IMU text.
    ConfigError
        Several candidates, naming them.
    """
    files = list(_walk(folder))
    archive = _member(folder.resolve().parent, _RAW_ARCHIVE)
    if archive is not None:
        files += list(_walk(archive))
    observations, navigation = rinex_files(files)
    return GreatFiles(
        imu=named["imu"] if "imu" in named else _imu_file(folder, imu),
        reference=named["reference"]
        if "reference" in named
        else _reference_file(folder, reference_point),
        observations=tuple(observations),
        navigation=tuple(navigation),
        base=tuple(base_files(files)),
    )


def rinex_files(files: list[Path]) -> tuple[list[Path], list[Path]]:
    """Return the rover observation files and the navigation files among `files`.

    Files below a folder whose name contains ``base`` are reference stations, not rovers. Where
    there is no RINEX of a rover, its receiver's log is taken (Septentrio SBF, u-blox UBX), with its
    ephemerides where there are no others.
    """
    observations: list[Path] = []
    navigation: list[Path] = []
    for file in files:
        if not is_rinex_name(file.name):
            continue
        kind = rinex_kind(file)
        if kind == "O" and "base" not in file.parent.name.lower():
            observations.append(file)
        elif kind == "N":
            navigation.append(file)
    if observations:
        return observations, navigation
    logs = [_as_rinex(file) for file in _logs(files) if "base" not in file.parent.name.lower()]
    own = [file for log in logs for file in log.navigation]
    return [log.observations for log in logs], navigation or own


def _logs(files: list[Path]) -> list[Path]:
    return [file for file in files if file.suffix.lower() in (".sbf", ".ubx")]


def _as_rinex(file: Path) -> GivenFiles:
    from ..rtklib import given_files  # RTKLIB is slow to import

    return given_files(file)


def base_files(files: list[Path]) -> list[Path]:
    """Return the observations below a folder whose name contains ``base``: RINEX, else logs."""
    below = [file for file in files if "base" in file.parent.name.lower()]
    rinex = [f for f in below if is_rinex_name(f.name) and rinex_kind(f) == "O"]
    return rinex or [_as_rinex(file).observations for file in _logs(below)]


def base_stations(
    candidates: tuple[Path, ...], start: float, end: float
) -> dict[str, tuple[Path, ...]]:
    """Return the files that may hold observations between `start` and `end` [s], by station."""
    begins = sorted((first_observation(file), file) for file in candidates)
    # Quarter-hour files as well as daily ones: a file ends where the station's next one begins.
    stations: dict[str, list[tuple[float, Path]]] = {}
    for at, file in begins:
        stations.setdefault(_marker(file), []).append((at, file))
    found = {}
    for name, listed in stations.items():
        until = [*(at for at, _ in listed[1:]), np.inf]
        there = [
            file
            for (at, file), stop in zip(listed, until, strict=True)
            if start - 86400.0 <= at <= end and stop >= start
        ]
        if there:
            found[name] = tuple(there)
    return found


def _marker(path: Path) -> str:
    with path.open(encoding="ascii", errors="replace") as stream:
        for line in stream:
            label = line[60:80].strip().upper()
            if label == "MARKER NAME":
                return line[:60].strip() or path.name
            if label == "END OF HEADER":
                break
    return path.name


def is_rinex_name(name: str) -> bool:
    """Return whether a file of that name is looked into for RINEX."""
    return _RINEX_NAME.search(name) is not None


def rinex_kind(path: Path) -> str:
    """Return 'O' for RINEX observations, 'N' for navigation, '' for anything else."""
    with path.open("rb") as stream:
        line = without_mark(stream.readline(1024)).decode("latin-1")
    if header.split(line)[1] != "RINEX VERSION / TYPE":
        return ""
    letter = line[20:21].upper()
    return "N" if letter in ("N", "G", "L", "E") else letter  # RINEX 2 names GLONASS, Galileo nav


def is_simulated(path: Path) -> bool:
    """Return whether `datasets.great.writer` wrote these observations."""
    with path.open(encoding="ascii", errors="replace") as stream:
        for line in stream:
            content, label = header.split(line)
            if label == "PGM / RUN BY / DATE":
                return content.startswith(SIMULATOR)
            if label == "END OF HEADER":
                break
    return False


def first_observation(path: Path) -> float:
    """Return TIME OF FIRST OBS, or the first epoch where it is missing, as GPS time [s]."""
    ended = False
    with path.open(encoding="ascii", errors="replace") as stream:
        for number, line in enumerate(stream, start=1):
            label = header.split(line)[1]
            if label == "TIME OF FIRST OBS" or ended:
                tokens = line[:43].lstrip("> ").split()
                try:
                    year, month, day, hour, minute = (int(v) for v in tokens[:5])
                    year += 2000 if ended and year < 80 else 0  # RINEX 2 epochs have two digits
                    return gpstime.from_calendar(year, month, day, hour, minute, float(tokens[5]))
                except (ValueError, IndexError):
                    raise DataError(
                        f"TIME OF FIRST OBS: expected a date, found '{line[:43].strip()}'",
                        file=path,
                        line=number,
                    ) from None
            ended = label == "END OF HEADER"
    raise DataError("TIME OF FIRST OBS missing from the header", file=path)


def choose_observations(candidates: tuple[Path, ...], start: float, end: float) -> Path:
    """Return the one rover file that begins before `end` and within a day of `start` [s].

    Raises
    ------
    ConfigError
        None or several, naming them.
    """
    if len(candidates) == 1:
        return candidates[0]
    begins = {file: first_observation(file) for file in candidates}
    fitting = [file for file, at in begins.items() if start - 86400.0 <= at <= end]
    if len(fitting) == 1:
        return fitting[0]
    names = ", ".join(file.name for file in (fitting or candidates))
    problem = "several rover files overlap the IMU" if fitting else "no rover file overlaps the IMU"
    raise ConfigError(f"{problem} ({names}): name the file with rinex=…")


def _imu_file(folder: Path, imu: str) -> Path:
    home = _member(folder, "imu")
    texts = _texts(home) if home is not None else []
    if not texts:
        raise DataError("no IMU text found", file=folder / "IMU", remedy="name it with imu_file=…")
    named = [t for t in texts if any(word in t.name.lower() for word in _IMU_WORDS[imu])]
    if len(named) == 1:
        return named[0]
    names = ", ".join(t.name for t in (named or texts))
    problem = f"several files of the {imu} IMU" if named else f"no file of the {imu} IMU"
    raise ConfigError(f"{folder}: {problem} ({names}): name the file with imu_file=…")


def _reference_file(folder: Path, reference_point: object) -> Path | None:
    homes = [home for name in _REFERENCE_FOLDERS if (home := _member(folder, name)) is not None]
    texts = [text for home in homes for text in _texts(home)]
    if len(texts) <= 1:
        return texts[0] if texts else None
    suffix = "_gnss" if reference_point == "antenna" else "_adis"
    named = [text for text in texts if text.stem.lower().endswith(suffix)]
    if len(named) == 1:
        return named[0]
    names = ", ".join(text.name for text in texts)
    raise ConfigError(
        f"{folder}: several references ({names}): name the file with reference_file=…"
    )


def _member(folder: Path, name: str) -> Path | None:
    """Return the member of a folder with that name in any case."""
    if not folder.is_dir():
        return None
    return next((m for m in sorted(folder.iterdir()) if m.name.lower() == name), None)


def _texts(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return sorted(f for f in folder.iterdir() if f.is_file() and f.suffix.lower() == ".txt")


def _walk(folder: Path) -> Iterator[Path]:
    for root, folders, names in os.walk(folder):
        folders[:] = sorted(f for f in folders if f.lower() not in _NOT_SEARCHED)
        yield from (Path(root) / name for name in sorted(names))
