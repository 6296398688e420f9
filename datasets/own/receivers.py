"""What a receiver's file is good for: observations, ephemerides, or ready-made fixes."""

from __future__ import annotations

from pathlib import Path

from ..great.files import rinex_kind
from ..receivers.raw_frames import FORMATS, find_frames
from ..text.rinex_packing import is_packed, unpack

#: UBX-NAV-PVT holds fixes (`formats.ubx`).
_NAV_PVT = 0x0107
#: More text than that before the first message is no receiver's log.
_HEAD = 1 << 16


def kinds_of(path: Path) -> str:
    """Return 'O' for RINEX observations or raw ones of a log, 'N' for ephemerides, or 'ON', or ''.

    Raises
    ------
    DataError
        A receiver's log with neither raw observations nor fixes, with the messages to switch on.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    if head[60:80] == b"CRINEX VERS   / TYPE":
        return "O"
    if is_packed(head[:80]):
        content = unpack(path.read_bytes(), path)
        line = content[:81].decode("latin-1")
        if line[60:80] == "RINEX VERSION / TYPE":
            return line[20:21] if line[20:21] in "ON" else ""
        return _of_log(path, content)
    kind = rinex_kind(path)
    if kind:
        return kind if kind in ("O", "N") else ""
    return _of_log(path, path.read_bytes()) if b"\0" in head else ""


def _of_log(path: Path, content: bytes) -> str:
    frames = find_frames(content)
    name = frames.raw_format()
    if name:
        numbers = frames.count(name)
        return "ON" if any(n in numbers for n in FORMATS[name].navigation) else "O"
    if frames.frames and not frames.count("ubx")[_NAV_PVT] and b"$G" not in content:
        from ..rtklib.logs.raw_logs import raw_log

        raw_log(path)  # refuses, and says what to switch on
    return ""
