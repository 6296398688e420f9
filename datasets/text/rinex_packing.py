"""RINEX as it comes from archives: gzip, Unix compress, Hatanaka (CRINEX), or plain.

gzip is unpacked here; the other two by the package ``hatanaka`` (extra ``crx``).
"""

from __future__ import annotations

import atexit
import gzip
import re
import shutil
import tempfile
import zlib
from functools import cache
from pathlib import Path

from ...filters.errors import DataError, made_of

_GZIP, _COMPRESS, _ZIP = b"\x1f\x8b", b"\x1f\x9d", b"PK"
_CRINEX = b"CRINEX VERS   / TYPE"


def is_packed(head: bytes) -> bool:
    """Return whether the first 80 bytes of a file are of gzip, compress, zip or CRINEX."""
    return head[:2] in (_GZIP, _COMPRESS, _ZIP) or head[60:80] == _CRINEX


def unpack(content: bytes, name: str | Path) -> bytes:
    """Return plain RINEX.

    Parameters
    ----------
    content : bytes
    name : path
        For messages.

    Raises
    ------
    DataError
        Damaged, or in need of the package ``hatanaka``.
    """
    if content[:2] == _GZIP:
        try:
            content = gzip.decompress(content)
        except (OSError, EOFError, zlib.error):
            raise DataError("damaged gzip file", file=name, remedy="copy it again") from None
    if not is_packed(content[:80]):
        return content
    try:
        import hatanaka
    except ImportError:
        what = "Hatanaka-compressed" if content[60:80] == _CRINEX else "compressed"
        raise DataError(
            f"{what} RINEX needs the package hatanaka",
            file=name,
            remedy="pip install 'certnav[crx]', or unpack it first",
        ) from None
    try:
        return hatanaka.decompress(content)
    except (hatanaka.HatanakaException, ValueError, OSError, EOFError) as error:
        first = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise DataError(f"cannot be unpacked: {first}", file=name, remedy="copy it again") from None


def plain_rinex(path: str | Path) -> Path:
    """Return the path of the plain file: the file itself, or a copy unpacked for this process."""
    path = Path(path)
    try:
        with path.open("rb") as stream:
            head = stream.read(80)
    except FileNotFoundError:
        raise DataError("file not found", file=path, remedy="check the name") from None
    except IsADirectoryError:
        raise DataError("expected a file, found a folder", file=path) from None
    if not is_packed(head):
        return path
    plain = _unpacked(path.resolve(), path.stat().st_mtime_ns)
    made_of(plain, path)
    return plain


def plain_name(name: str) -> str:
    """Return what a packed file is called once it is plain: ``a.20d.Z`` → ``a.20o``."""
    name = re.sub(r"\.(gz|z)$", "", name, flags=re.IGNORECASE)
    name = re.sub(r"\.(\d\d)d$", r".\1o", name, flags=re.IGNORECASE)
    return re.sub(r"\.crx$", ".rnx", name, flags=re.IGNORECASE)


@cache
def _unpacked(path: Path, modified: int) -> Path:
    folder = Path(tempfile.mkdtemp(dir=_shelf()))
    plain = folder / plain_name(path.name)
    plain.write_bytes(unpack(path.read_bytes(), path))
    return plain


@cache
def _shelf() -> Path:
    """A folder that goes when the process ends."""
    folder = Path(tempfile.mkdtemp(prefix="certnav-rinex-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
