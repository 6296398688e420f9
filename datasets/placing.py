"""Directories and files that appear whole: written beside their place and put there in one move.

    with written_whole(out) as draft:
        (draft / "a.csv").write_text(…)

A directory is written under a name of its own, ``.NAME.PID-….new``, its files are flushed to the
disk, and it is exchanged with what is at its place: by one system call where there is one (Linux),
so that there is the old or the new directory at any time; elsewhere by two renames, between which
there is none, and the old one is found as ``.NAME.PID-….old``. A process that is killed on the way
leaves the old directory or the new one, and perhaps a draft, which `clean` of the next run takes
away. A file is replaced by one rename.
"""

from __future__ import annotations

import ctypes
import errno
import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

#: Checksums of all other files, in the form ``sha256sum --check`` reads.
SEAL = "SHA256SUMS"
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2


@contextmanager
def written_whole(out: str | Path) -> Iterator[Path]:
    """Give an empty directory to write into, which stands at `out` when the context ends.

    What is raised in the context leaves `out` as it was, and no draft.

    Parameters
    ----------
    out : path
        What is there is replaced; whether that may be is for the caller to know.

    Yields
    ------
    Path
        The draft, beside `out`.
    """
    out = Path(out).resolve()  # what a link points to is replaced, not the link
    clean(out)
    draft = new_draft(out)
    try:
        yield draft
        place(draft, out)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise


def write_file(path: Path, *parts: bytes | memoryview) -> None:
    """Write a file whole or not at all: under another name, then in one move."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".new")
    draft = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.writelines(parts)
        _open_to_others(draft, 0o666)
        draft.replace(path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def new_draft(out: Path) -> Path:
    """Make an empty directory beside `out`, to be filled and then placed."""
    out.parent.mkdir(parents=True, exist_ok=True)
    prefix = f".{out.name}.{os.getpid()}-"
    draft = Path(tempfile.mkdtemp(prefix=prefix, suffix=".new", dir=out.parent))
    _open_to_others(draft, 0o777)
    return draft


def place(draft: Path, out: Path) -> None:
    """Flush a draft to the disk and put it at `out`; what was there is removed."""
    for path in sorted(draft.rglob("*"), reverse=True):  # what is in a directory before itself
        _flush(path)
    _flush(draft)
    if not out.exists():
        draft.rename(out)
    elif exchange(draft, out):
        shutil.rmtree(draft)  # the earlier one by now
    else:
        aside = draft.with_suffix(".old")
        out.rename(aside)
        try:
            draft.rename(out)
        except BaseException:
            aside.rename(out)
            raise
        shutil.rmtree(aside)
    _flush(out.parent)


def exchange(a: Path, b: Path) -> bool:
    """Exchange two paths in one step; return whether the system can do that."""
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    if not renameat2(_AT_FDCWD, os.fsencode(a), _AT_FDCWD, os.fsencode(b), _RENAME_EXCHANGE):
        return True
    code = ctypes.get_errno()
    if code in (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP):  # not on this file system
        return False
    raise OSError(code, os.strerror(code), str(b))


def seal(directory: Path) -> None:
    """Write the checksums of all files of a directory."""
    lines = [f"{_checksum(file)}  {file.name}\n" for file in sorted(directory.iterdir())]
    (directory / SEAL).write_text("".join(lines), encoding="utf-8")


def broken_seals(directory: Path) -> list[str]:
    """Return the names of files that are missing, changed or added since `seal`; all: [SEAL]."""
    try:
        lines = (directory / SEAL).read_text(encoding="utf-8").splitlines()
    except OSError:
        return [SEAL]
    expected = {line[66:]: line[:64] for line in lines}
    there = {file.name: file for file in directory.iterdir() if file.name != SEAL}
    return sorted(
        name
        for name in expected.keys() | there.keys()
        if name not in there or _checksum(there[name]) != expected.get(name)
    )


def current(out: Path) -> Path:
    """Return `out`, or where it stands while it is being replaced, or stood when that was cut."""
    if out.exists():
        return out
    aside = sorted(_beside(out, "old"), key=lambda path: path.stat().st_mtime)
    return aside[-1] if aside else out


def clean(out: Path) -> None:
    """Remove what killed processes have left beside `out`; what was moved aside goes back."""
    for suffix in ("old", "new"):
        for path in _beside(out, suffix):
            if _alive(int(path.name.removeprefix(f".{out.name}.").split("-")[0])):
                continue
            if suffix == "old" and not out.exists():
                path.rename(out)
            else:
                shutil.rmtree(path, ignore_errors=True)


def _beside(out: Path, suffix: str) -> list[Path]:
    pattern = re.compile(rf"\.{re.escape(out.name)}\.\d+-[^.]*\.{suffix}")
    if not out.parent.is_dir():
        return []
    return [path for path in out.parent.iterdir() if pattern.fullmatch(path.name)]


def _alive(pid: int) -> bool:
    """Whether a process may still be writing; on systems that cannot tell, it may."""
    if os.name != "posix":
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _open_to_others(path: Path, mode: int) -> None:
    """Give what `tempfile` made for one user the mode that anything new has."""
    umask = os.umask(0)
    os.umask(umask)
    path.chmod(mode & ~umask)


def _checksum(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _flush(path: Path) -> None:
    """Make a file or a directory survive a power failure."""
    if os.name != "posix" and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
