"""Read a solution whatever program it is of: the content says."""

from __future__ import annotations

import gzip
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path

from ...filters.errors import ConfigError, DataError
from ..text.tables import cannot_open
from .columns import is_columns, read_columns
from .rtklib import is_rtklib, read_ginav_truth, read_rtklib
from .solution import ForeignSolution
from .trajectories import (
    is_great_flt,
    is_great_ins,
    is_kfgins_nav,
    is_tum,
    read_great_flt,
    read_great_ins,
    read_kfgins_nav,
    read_tum,
)

_GZIP = b"\x1f\x8b"
#: No result of a drive is larger as text [bytes].
_LARGEST = 2_000_000_000
_Reader = Callable[[Path, int | None], ForeignSolution]
#: Name, how it is recognised, how it is read; the first that recognises a file reads it.
FORMATS: tuple[tuple[str, Callable[[Path], bool], _Reader], ...] = (
    ("RTKLIB or GINav .pos", is_rtklib, lambda path, week: read_rtklib(path)),
    ("GREAT-MSF .ins", is_great_ins, read_great_ins),  # its header names AmbStatus, too
    ("GREAT-PVT .flt", is_great_flt, read_great_flt),
    ("CSV with time_gps_s and lat_deg …", is_columns, lambda path, week: read_columns(path)),
    ("KF-GINS .nav", is_kfgins_nav, read_kfgins_nav),
    ("TUM", is_tum, lambda path, week: read_tum(path)),
)


def read_solution(path: str | Path, *, week: int | None = None) -> ForeignSolution:
    """Return the solution in a file, gzipped or not.

    Parameters
    ----------
    path : path
    week : int, optional
        GPS week of the first row, for files that hold none.

    Raises
    ------
    DataError
        Not recognised, or damaged: file, line, what was expected and found.
    ConfigError
        A file without GPS week, and none given.
    """
    path = Path(path)
    if path.suffix.lower() == ".mat":
        return read_ginav_truth(path)
    try:
        with path.open("rb") as stream:
            packed = stream.read(2) == _GZIP
    except OSError as error:
        raise cannot_open(path, error) from None
    if not packed:
        return _read(path, week)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / path.name.removesuffix(".gz")
        file.write_bytes(_unpacked(path))
        try:
            return _read(file, week)
        except DataError as error:
            raise DataError(
                error.problem, file=path, line=error.line, remedy=error.remedy
            ) from None
        except ConfigError as error:
            raise ConfigError(str(error).replace(str(file), str(path))) from None


def _unpacked(path: Path) -> bytes:
    try:
        with gzip.open(path) as stream:
            content = stream.read(_LARGEST + 1)
    except (OSError, EOFError, zlib.error):
        raise DataError("damaged gzip file", file=path, remedy="copy it again") from None
    if len(content) > _LARGEST:
        raise DataError(f"expected at most {_LARGEST:.0e} bytes of text, found more", file=path)
    return content


def _read(file: Path, week: int | None) -> ForeignSolution:
    read = next((read for _, is_it, read in FORMATS if is_it(file)), None)
    if read is None:
        names = "; ".join(name for name, *_ in FORMATS)
        raise DataError(f"not recognised (looked for {names})", file=file)
    return read(file, week)
