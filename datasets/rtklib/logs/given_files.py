"""Whatever is given where RINEX is taken: plain, packed, or a receiver's own log."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ....filters.errors import DataError, made_of
from ...receivers.bags import is_bag, ublox_log
from ...text.rinex_packing import plain_rinex
from ...text.rinex_repair import without_mark
from .raw_logs import RawLog, is_raw_log, raw_log


@dataclass(frozen=True)
class GivenFiles:
    """What a receiver observed, as plain RINEX.

    Attributes
    ----------
    observations : Path
    navigation : tuple of Path
        Ephemerides: those given, or those of the receiver's own log; empty where there are none.
    notes : tuple of str
        What was found in logs.
    """

    observations: Path
    navigation: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()


def given_files(
    observations: str | Path, navigation: Iterable[str | Path] = (), near: float | None = None
) -> GivenFiles:
    """Return what was given as plain RINEX.

    Parameters
    ----------
    observations : path
        RINEX, packed or not, a receiver's log (`raw_log`), packed or not, or a bag with one.
    navigation : iterable of path
        Likewise. None: the ephemerides in the log itself.
    near : float, optional
        See `raw_log`.

    Raises
    ------
    DataError
        Missing or damaged files, a log without observations, or one without ephemerides where
        these are asked of it.
    """
    notes: dict[str, None] = {}
    plain = _plain(observations)
    own: Path | None = None
    if _is_log(plain):
        log = _converted(plain, near, observations)
        plain, own = log.observations, log.navigation
        notes.update(dict.fromkeys(log.notes))
    found = []
    for name in navigation:
        file = _plain(name)
        if _is_log(file):
            log = _converted(file, near, name)
            notes.update(dict.fromkeys(log.notes))
            if log.navigation is None:
                raise DataError(
                    "no ephemeris in this log",
                    file=name,
                    remedy="give a navigation file (RINEX) of that day",
                )
            file = log.navigation
        found.append(file)
    if not found and own is not None:
        found = [own]
    return GivenFiles(plain, tuple(found), tuple(notes))


def _converted(log: Path, near: float | None, given: str | Path) -> RawLog:
    """Return a log as RINEX whose errors name the file that was given."""
    found = raw_log(log, near)
    made_of(found.observations, given, lines=False)
    if found.navigation is not None:
        made_of(found.navigation, given, lines=False)
    return found


def _plain(name: str | Path) -> Path:
    """Return a plain file of a packed one, or the raw log in a bag."""
    path = Path(name)
    return ublox_log(path) if path.exists() and is_bag(path) else plain_rinex(path)


def _is_log(path: Path) -> bool:
    """Return whether a file that is not RINEX is to be read as a log, or refused as one."""
    with path.open("rb") as stream:
        head = without_mark(stream.read(256))
    if head[60:80].rstrip() == b"RINEX VERSION / TYPE":
        return False
    return is_raw_log(path)


def is_observed(path: str | Path) -> bool:
    """Return whether a file is RINEX observations or a receiver's log, packed or not."""
    path = plain_rinex(path)
    with path.open("rb") as stream:
        head = without_mark(stream.read(256))
    if head[60:80].rstrip() == b"RINEX VERSION / TYPE":
        return head[20:21] == b"O"
    return is_raw_log(path)
