"""Arranging downloaded GREAT archives: what arrived goes where the reader looks for it.

The archives' inner names are not documented and every sequence's archive is called ``IMU.zip``, so
files are told by content (`datasets.great.inspection`). The sequence comes from a name where there
is one, of the file, the archive or the folder it was saved in, and from day of week and duration
where there is none. Nothing is moved into place before
everything has been looked at.
"""

from __future__ import annotations

import filecmp
import re
import shutil
import struct
import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from ...filters.errors import DataError
from .. import gpstime
from .catalogue import GREAT, CatalogueEntry, named_in
from .files import first_observation, is_rinex_name, rinex_kind
from .inspection import Inspected, first_ephemeris, inspect

RAW = "GNSS_RAW_DATA"
_NOT_USED = (".jpg", ".jpeg", ".png", ".bin", ".pcd", ".bag", ".pdf", ".md", ".yaml", ".xml")
_WORDS = {"mems": ("mems", "adis", "smallimu"), "tactical": ("tactical", "starneto")}
_HOMES = {
    "mems": ("IMU", "MEMS_imu_data.txt"),
    "tactical": ("IMU", "Tactical_imu_data.txt"),
    "reference": ("Groundtruth", "groundtruth.txt"),
}
_WANTED = {
    "mems": "MEMS IMU",
    "tactical": "tactical IMU (optional)",
    "reference": "reference solution",
    "observations": "rover observations (GNSS_RAW_DATA)",
    "navigation": "broadcast ephemerides (GNSS_RAW_DATA)",
}
_DAY = 86400.0
#: What `zipfile` says of archives whose lists of contents are wrong.
_DAMAGED = (
    *(zipfile.BadZipFile, OSError, ValueError, OverflowError, struct.error),
    *(NotImplementedError, EOFError, zlib.error, RuntimeError),
)


@dataclass(frozen=True)
class ImportReport:
    """What `import_archives` did.

    Attributes
    ----------
    placed : tuple of (str, Path)
        Where each file came from, and its place.
    left_out : tuple of (str, str)
        What was not taken, and why.
    missing : dict of str to tuple of str
        What each sequence in the folder still lacks.
    """

    placed: tuple[tuple[str, Path], ...]
    left_out: tuple[tuple[str, str], ...]
    missing: dict[str, tuple[str, ...]]

    def text(self) -> str:
        """Return the report for the command line."""
        lines = [f"  {source} → {place}" for source, place in self.placed]
        reasons: dict[str, int] = {}
        for _, why in self.left_out:
            reasons[why] = reasons.get(why, 0) + 1
        lines += [f"  left out: {count} files, {why}" for why, count in reasons.items()]
        for name, lacking in self.missing.items():
            state = "still missing: " + ", ".join(lacking) if lacking else "complete"
            lines.append(f"{name}: {state}")
        if self.missing:
            lines.append(
                "before a run, declare in great.toml of each sequence (or with --set data.…): "
                'lever = "figure" or "msf_xml" or lever_antenna_frd_m = […], and '
                'reference_point = "mems", "tactical" or "antenna"'
            )
        return "\n".join(lines)


def import_archives(archives: Iterable[str | Path], to: str | Path) -> ImportReport:
    """Arrange downloaded archives in the layout `datasets.great.reader.read_great` reads.

    Parameters
    ----------
    archives : iterable of path
        Zip archives (also nested), plain files such as a reference solution, and folders of both.
    to : path
        Folder of the dataset: gets ``Dataset_<name>/…`` and ``GNSS_RAW_DATA/…``. It may hold
        earlier imports.

    Raises
    ------
    DataError
        A damaged, encrypted or malicious archive, a file whose sequence cannot be told, or one
        that would replace a different file. Nothing has been put in place then.
    """
    home = Path(to)
    files = [file for archive in archives for file in _downloaded(Path(archive))]
    for archive in files:
        if not archive.is_file():
            raise DataError("no such file", file=archive, remedy="name the downloaded archives")
    created = not home.exists()
    home.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryDirectory(prefix=".certnav-import-", dir=home) as scratch:
            staged, left_out = _stage(files, Path(scratch))
            plan = _plan(staged, home)
            _refuse_conflicts(plan)
            for _, file, place in plan:
                place.parent.mkdir(parents=True, exist_ok=True)
                if not place.exists():
                    file.replace(place)
    except BaseException:
        if created and not any(home.iterdir()):
            home.rmdir()
        raise
    placed = tuple((source, place.relative_to(home)) for source, _, place in plan)
    return ImportReport(placed, tuple(left_out), still_missing(home))


def _downloaded(path: Path) -> list[Path]:
    """Return a file, or all files of a folder of downloads."""
    if not path.is_dir():
        return [path]
    return sorted(f for f in path.rglob("*") if f.is_file() and not f.name.startswith("."))


@dataclass(frozen=True)
class _Staged:
    source: str  # archive and name inside
    folder: str  # in which the archive lies
    inner: PurePosixPath
    file: Path
    found: Inspected


def _stage(archives: list[Path], scratch: Path) -> tuple[list[_Staged], list[tuple[str, str]]]:
    """Unpack what may be of use and inspect it."""
    staged: list[_Staged] = []
    left_out: list[tuple[str, str]] = []
    for source, folder, inner, file in _unpacked(archives, scratch, left_out):
        found = inspect(file)
        if found.kind:
            staged.append(_Staged(source, folder, inner, file, found))
        else:
            left_out.append((source, "not RINEX, IMU text or reference"))
    if not staged:
        names = ", ".join(a.name for a in archives)
        raise DataError(
            f"nothing of a GREAT sequence found in {names or 'no archives'}",
            remedy="expected IMU.zip, GNSS_RAW_DATA, or a reference solution",
        )
    return staged, left_out


def _unpacked(
    archives: list[Path], scratch: Path, left_out: list[tuple[str, str]]
) -> Iterator[tuple[str, str, PurePosixPath, Path]]:
    """Yield the files of archives, nested ones included.

    That is: source, folder of the archive, name inside, file in scratch.
    """
    names = [a.name for a in archives]
    queue = []
    for a in archives:
        folder = a.resolve().parent.name
        source = a.name if names.count(a.name) == 1 else f"{folder}/{a.name}"
        queue.append((source, folder, PurePosixPath(a.name), a))
    number = 0
    while queue:
        source, folder, inner, file = queue.pop(0)
        if not zipfile.is_zipfile(file):
            if file.parent != scratch:  # a file of the user: copied, never moved
                number += 1
                copy = scratch / str(number)
                shutil.copyfile(file, copy)
                file = copy
            yield source, folder, inner, file
            continue
        with _open(file, source) as archive:
            for member in archive.infolist():
                if member.is_dir():
                    continue
                name = _safe_name(member.filename, source)
                where = f"{source}:{name}"
                if name.suffix.lower() in _NOT_USED or name.name.lower() == "timestamps.txt":
                    left_out.append((where, "images, point clouds and the like"))
                    continue
                number += 1
                target = scratch / str(number)
                _extract(archive, member, target, where)
                queue.append((where, folder, inner.parent / inner.stem / name, target))


def _open(file: Path, source: str) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(file)
    except _DAMAGED as error:
        raise DataError(
            f"damaged archive: {error}", file=source, remedy="download it again"
        ) from None


def _extract(archive: zipfile.ZipFile, member: zipfile.ZipInfo, target: Path, where: str) -> None:
    if member.flag_bits & 1:
        raise DataError("encrypted archive", file=where, remedy="unpack it with its password first")
    try:
        with archive.open(member) as stream, target.open("wb") as out:
            shutil.copyfileobj(stream, out, 1 << 20)
    except _DAMAGED as error:
        raise DataError(
            f"damaged archive: {error}", file=where, remedy="download it again"
        ) from None


def _safe_name(name: str, source: str) -> PurePosixPath:
    """Return a member's name, or refuse the archive if it leads out of its folder."""
    path = PurePosixPath(name.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts or re.match(r"[A-Za-z]:", str(path)):
        raise DataError(
            f"member '{name}' leads outside the archive's folder",
            file=source,
            remedy="do not use this archive",
        )
    return path


def _plan(staged: list[_Staged], home: Path) -> list[tuple[str, Path, Path]]:
    """Return source, staged file and place of everything."""
    known: list[tuple[CatalogueEntry, Inspected]] = []
    plan, open_ones = [], []
    for item in staged:
        if item.found.kind in ("observations", "navigation"):
            plan.append((item.source, item.file, home / RAW / _raw_place(item.inner)))
            continue
        entry = _entry_by_name(item) or _entry_by_span(item.found)
        if entry is None:
            open_ones.append(item)
            continue
        known.append((entry, item.found))
        plan.append((item.source, item.file, _place(home, entry, item)))
    for item in open_ones:
        near = {e.name: e for e, found in known if _overlap(found, item.found) > 0.5}
        if len(near) != 1:
            days = _of_day(item.found)
            names = ", ".join(e.name for e in days) or "no sequence"
            raise DataError(
                f"{item.found.end - item.found.start:.0f} s from second of week "
                f"{item.found.start:.0f}: fits {names}; which one cannot be told",
                file=item.source,
                remedy="put the sequence's name into the archive's, such as campus-01-IMU.zip, or "
                "save it in a folder of that name",
            )
        plan.append((item.source, item.file, _place(home, next(iter(near.values())), item)))
    return plan


def _raw_place(inner: PurePosixPath) -> PurePosixPath:
    """Return the path inside GNSS_RAW_DATA, without leading folders of that name."""
    parts = list(inner.parts)
    while len(parts) > 1 and parts[0].lower().replace(" ", "_").startswith("gnss_raw_data"):
        parts.pop(0)
    name = re.sub(r"\.(gz|Z)$", "", parts[-1])
    name = re.sub(r"\.(\d\d)d$", r".\1o", re.sub(r"\.crx$", ".rnx", name, flags=re.I), flags=re.I)
    if not is_rinex_name(name):  # the reader looks at such names only
        name += ".rnx"
    return PurePosixPath(*parts[:-1], name)


def _place(home: Path, entry: CatalogueEntry, item: _Staged) -> Path:
    folder, name = _HOMES[item.found.kind]
    return home / f"Dataset_{entry.name}" / folder / name


def _entry_by_name(item: _Staged) -> CatalogueEntry | None:
    """Return the sequence that a part of the name gives; its day has to be the file's."""
    for part in (*reversed(item.inner.parts), item.source, item.folder):
        entry = named_in(part)
        if entry is None:
            continue
        if entry not in _of_day(item.found):
            week = f"week {item.found.week}, " if item.found.week else ""
            raise DataError(
                f"named {entry.name} ({entry.date}), but the data are of {week}second of week "
                f"{item.found.start:.0f}",
                file=item.source,
                remedy="wrong file, or wrong name",
            )
        return entry
    return None


def _of_day(found: Inspected) -> list[CatalogueEntry]:
    """Return the sequences of the day a file is of."""
    day = int(found.start // _DAY)
    return [e for e in GREAT if e.day == day and found.week in (0, e.week)]


def _entry_by_span(found: Inspected) -> CatalogueEntry | None:
    """Return the one sequence of that day whose duration fits within 2 % and the next by far."""
    length = found.end - found.start
    fitting = [e for e in _of_day(found) if abs(length / e.duration_s - 1.0) < 0.02]
    only = _of_day(found)
    if len(only) == 1:  # urban-02: alone on its day of week
        return only[0]
    return fitting[0] if len(fitting) == 1 else None


def _overlap(a: Inspected, b: Inspected) -> float:
    """Return the share of the shorter span that both cover."""
    common = min(a.end, b.end) - max(a.start, b.start)
    return common / max(min(a.end - a.start, b.end - b.start), 1e-9)


def _refuse_conflicts(plan: list[tuple[str, Path, Path]]) -> None:
    taken: dict[Path, tuple[str, Path]] = {}
    for source, file, place in plan:
        if place in taken and not filecmp.cmp(file, taken[place][1], shallow=False):
            raise DataError(
                f"{taken[place][0]} and {source} are different files for {place}",
                remedy="import one of them",
            )
        taken[place] = (source, file)
        if place.exists() and not filecmp.cmp(file, place, shallow=False):
            raise DataError(
                f"{source} would replace a different file",
                file=place,
                remedy="delete the old one, or import into another folder",
            )


def still_missing(home: str | Path) -> dict[str, tuple[str, ...]]:
    """Return what each sequence present in a dataset folder lacks."""
    home = Path(home)
    raw = sorted(f for f in (home / RAW).rglob("*") if f.is_file())
    kinds = [(file, rinex_kind(file)) for file in raw]
    begins = [first_observation(f) for f, k in kinds if k == "O" and not _is_base(f)]
    eph = [t for f, k in kinds if k == "N" and (t := first_ephemeris(f)) is not None]
    out = {}
    for e in GREAT:
        folder = home / f"Dataset_{e.name}"
        if not folder.is_dir():
            continue
        lacking = [k for k, (sub, name) in _HOMES.items() if not (folder / sub / name).is_file()]
        midnight = float(gpstime.from_week_sow(e.week, e.day * _DAY))
        if not any(midnight <= t < midnight + _DAY for t in begins):
            lacking.append("observations")
        if not any(midnight - _DAY < t < midnight + 1.5 * _DAY for t in eph):
            lacking.append("navigation")
        out[e.name] = tuple(_WANTED[k] for k in lacking)
    return out


def _is_base(file: Path) -> bool:
    return "base" in file.parent.name.lower()
