"""File names RTKLIB can be given.

RTKLIB looks at the name before it looks at the content: one that ends like a packed file is put
into a shell command that unpacks it (quotes and backquotes included), ``*`` is a pattern, and
more than 1023 bytes overrun its buffers. Such a file is read by another name.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_PACKED = re.compile(r"\.(gz|z|zip|tar|crx|\d\dd)$", re.IGNORECASE)
_LONGEST = 900  # bytes; RTKLIB's buffers hold 1024 and it appends to them


@contextmanager
def harmless_name(path: Path) -> Iterator[str]:
    """Give a name of the file that RTKLIB takes as it is.

    Parameters
    ----------
    path : Path
        A plain file.

    Yields
    ------
    str
        The path itself, or that of a link or copy which goes afterwards.
    """
    text = str(path)
    plain = text.isascii() and text.isprintable() and len(text) < _LONGEST and "*" not in text
    if plain and not _PACKED.search(path.name):
        yield text
        return
    with tempfile.TemporaryDirectory(prefix="certnav-") as folder:
        other = Path(folder) / "file.rnx"
        try:
            other.symlink_to(path.resolve())
        except OSError:  # no links on this file system
            shutil.copyfile(path, other)
        yield str(other)
