"""Receivers' own logs as RINEX: what RTKLIB's decoders make of UBX, SBF, RTCM 3 and NovAtel OEM.

RTKLIB is given the messages whose checksums are right and nothing else (`receivers.raw_frames`).
"""

from __future__ import annotations

import atexit
import binascii
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pyrtklib5 as rtk

from ....filters.errors import DataError
from ... import cache as shelf
from ... import gpstime
from ...formats.receiver_logs import log_bytes
from ...receivers.log_order import Ordered, in_order
from ...receivers.raw_frames import FORMATS, Frames, find_frames, has_frames
from ..satellites import GPS_EPOCH_GTIME

_STRFMT = {
    "ubx": rtk.STRFMT_UBX, "sbf": rtk.STRFMT_SEPT, "novatel": rtk.STRFMT_OEM4,
    "rtcm3": rtk.STRFMT_RTCM3,
}  # fmt: skip
_HERE = Path(__file__).resolve().parent
_PROGRAM = _HERE / "raw_to_rinex.py"
_CODE = [
    Path(__file__), _PROGRAM,
    *(_HERE.parents[1] / "receivers" / f for f in ("raw_frames.py", "log_order.py")),
]  # fmt: skip
#: So much of a file is looked at first.
_HEAD = 1 << 16
#: A decoder takes 0.1 s to start and 30 MB a second; so long that it must be caught in a loop.
_PATIENCE_S, _SLOWEST = 30.0, 1e6
#: Galileo's week 0 is GPS week 1024, BeiDou's is 1356.
_GALILEO_WEEK, _BEIDOU_WEEK, _ROLLOVER = 1024, 1356, 1024
#: RTCM messages whose epoch is GPS seconds of week in ms behind 12 bits of station; of BeiDou 14 s
#: earlier, which no date minds.
_WITH_SECONDS = (range(1001, 1005), range(1071, 1078), range(1091, 1098), range(1111, 1118),
                 range(1121, 1128))  # fmt: skip


@dataclass(frozen=True)
class RawLog:
    """A receiver's log as RINEX; the files go when the process ends.

    Attributes
    ----------
    observations : Path
        APPROX POSITION XYZ is that of RTCM's 1005 or 1006, zero without.
    navigation : Path or None
        None where the log holds no ephemeris.
    notes : tuple of str
        What was found in the log.
    """

    observations: Path
    navigation: Path | None
    notes: tuple[str, ...]


def is_raw_log(path: str | Path) -> bool:
    """Return whether a file is a receiver's log: it holds a whole message of a known format.

    Text in front of the first, as a receiver writes NMEA until it is told otherwise, may be long.
    """
    with Path(path).open("rb") as stream:
        head = stream.read(_HEAD)
        if b"\0" in head and has_frames(head):
            return True
        if b"$G" not in head and b"\0" not in head:
            return False
        return has_frames(head + stream.read())


def raw_log(path: str | Path, near: float | None = None) -> RawLog:
    """Return a receiver's log as RINEX, converted once (`datasets.cache`).

    Parameters
    ----------
    path : path
    near : float, optional
        GPS time within half a week of the log [s]. RTCM 3 tells no date; without this it is that
        of its ephemerides.

    Raises
    ------
    DataError
        No raw messages, with those to switch on; nothing in them; no date.
    """
    path = Path(path)
    if not path.is_file():
        raise DataError("file not found", file=path, remedy="check the name")
    stat = path.stat()
    return _converted(path.absolute(), stat.st_mtime_ns, stat.st_size, near)


@cache
def _converted(path: Path, modified: int, size: int, near: float | None) -> RawLog:
    made = shelf.kept(lambda: _convert(path, near), [path], (version("pyrtklib5"), near), _CODE)
    folder = Path(tempfile.mkdtemp(dir=_folder()))
    files = {}
    for kind, ending in (("observations", "obs"), ("navigation", "nav")):
        content = made[kind].tobytes()
        files[kind] = folder / f"{path.stem}.{ending}" if content else None
        if content:
            (folder / f"{path.stem}.{ending}").write_bytes(content)
    observations = files["observations"]
    assert observations is not None
    return RawLog(observations, files["navigation"], (f"{path.name}: {made['note']}",))


@cache
def _folder() -> Path:
    """A folder that goes when the process ends."""
    folder = Path(tempfile.mkdtemp(prefix="certnav-raw-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _convert(path: Path, near: float | None) -> dict[str, np.ndarray]:
    frames = find_frames(log_bytes(path))
    name = frames.raw_format() or _refuse_no_observations(path, frames)
    at = _rtcm_epoch(path, frames, near) if name == "rtcm3" else None
    ordered = in_order(frames, name)
    with tempfile.TemporaryDirectory(prefix="certnav-raw-") as scratch:
        log, obs, nav = (Path(scratch) / f"log.{ending}" for ending in ("raw", "obs", "nav"))
        end = _end_of_sbf(ordered.frames) if name == "sbf" else b""
        log.write_bytes(ordered.frames.only(name) + end)
        _decode(path, name, log, [obs, nav], at)
        observations, navigation = (_rinex(file, _station(frames)) for file in (obs, nav))
    if not observations:
        raise DataError(
            f"{FORMATS[name].name}: its {', '.join(_named(frames, name, 'observations'))} messages "
            "hold no observation",
            file=path,
            remedy="log where the receiver sees satellites",
        )
    note = "; ".join(
        [
            *_found(frames, name, observations, navigation),
            *_of_order(ordered),
            *_of_others(frames, name),
        ]
    )
    return {
        "observations": np.frombuffer(observations, np.uint8),
        "navigation": np.frombuffer(navigation, np.uint8),
        "note": np.array(note),
    }


def _decode(path: Path, name: str, log: Path, out: list[Path], at: float | None) -> None:
    """Let RTKLIB decode a log in a process of its own: broken messages have ended it."""
    near = [] if at is None else [repr(at + GPS_EPOCH_GTIME)]
    program = [sys.executable, "-P", str(_PROGRAM), str(_STRFMT[name]), str(log), *map(str, out)]
    patience = _PATIENCE_S + log.stat().st_size / _SLOWEST
    try:
        status = subprocess.run(
            [*program, *near], timeout=patience, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        ).returncode  # fmt: skip
    except subprocess.TimeoutExpired:
        status = -1
    if status:
        raise DataError(
            f"{FORMATS[name].name}: a damaged message has stopped RTKLIB's decoder",
            file=path,
            remedy="convert the log to RINEX with its maker's program",
        )


def _end_of_sbf(frames: Frames) -> bytes:
    """Return the block EndOfMeas, without which RTKLIB keeps the last epoch to itself."""
    measured = FORMATS["sbf"].observations
    last = [f for f in frames.frames if f.format == "sbf" and f.number in measured][-1]
    stamp = frames.content[last.start + 8 : last.start + 14]
    body = struct.pack("<HH", 5922, 16) + stamp + bytes(2)
    return b"$@" + struct.pack("<H", binascii.crc_hqx(body, 0)) + body


def _station(frames: Frames) -> tuple[float, ...]:
    """Return where RTCM says that the antenna of a base is [m]; zeros where it does not."""
    for f in frames.frames:
        if f.format == "rtcm3" and f.number in (1005, 1006):
            body = frames.content[f.start + 3 : f.stop - 3]
            raw = [_bits(body, start, 38) for start in (34, 74, 114)]
            return tuple(1e-4 * (v - (1 << 38 if v >> 37 else 0)) for v in raw)
    return 0.0, 0.0, 0.0


def _rinex(file: Path, station: tuple[float, ...]) -> bytes:
    """Return a file without comments, which name the log; nothing if only a header is there.

    RTKLIB writes a position of its own computing where nobody has told one: it is put right.
    """
    if not file.is_file():
        return b""
    lines = file.read_bytes().split(b"\n")
    ends = [k for k, line in enumerate(lines) if line[60:73] == b"END OF HEADER"]
    if not ends or not any(line.strip() for line in lines[ends[0] + 1 :]):
        return b""
    where = "".join(f"{v:14.4f}" for v in station).ljust(60) + "APPROX POSITION XYZ"
    lines = [line for line in lines if line[60:67] != b"COMMENT"]
    return b"\n".join(
        where.encode() if line[60:79] == b"APPROX POSITION XYZ" else line for line in lines
    )


def _refuse_no_observations(path: Path, frames: Frames) -> str:
    """Refuse a log without raw messages, and say which ones to switch on."""
    counts = Counter(f.format for f in frames.frames)
    if not counts:
        raise DataError(
            "neither RINEX nor a receiver's log (UBX, SBF, RTCM 3, NovAtel OEM binary): no message "
            "with a right checksum found",
            file=path,
            remedy="name RINEX observations, or the receiver's binary log",
        )
    name = counts.most_common(1)[0][0]
    known = FORMATS[name]
    navigation = " + ".join(_named(frames, name, "navigation"))
    raise DataError(
        f"{counts[name]} {known.name} messages and none of raw observations"
        + (f" (of ephemerides: {navigation})" if navigation else ""),
        file=path,
        remedy=f"switch on in the receiver: {known.switch_on}",
    )


def _named(frames: Frames, name: str, kind: str) -> list[str]:
    """Return the names of the messages of a kind that are in the log."""
    known = getattr(FORMATS[name], kind)
    return [known[number] for number in sorted(frames.count(name)) if number in known]


# --- the date of RTCM ------------------------------------------------------------------------


def _rtcm_epoch(path: Path, frames: Frames, near: float | None) -> float:
    """Return the GPS time of the first epoch of RTCM 3 [s]."""
    seconds, dates = None, []
    for f in frames.frames:
        if f.format != "rtcm3":
            continue
        body = frames.content[f.start + 3 : f.stop - 3]
        if seconds is None and any(f.number in numbers for numbers in _WITH_SECONDS):
            seconds = _bits(body, 24, 30) * 1e-3
        elif near is None and (date := _ephemeris_date(f.number, body)) is not None:
            dates.append(date)
    if near is None and dates:
        near = float(np.median(dates))
    if seconds is None or near is None:
        raise DataError(
            "RTCM 3 without a date: its epochs are seconds of an unnamed week, and no ephemeris "
            "(1019, 1042, 1045, 1046) tells which",
            file=path,
            remedy="log 1019, or convert it to RINEX with the date (convbin -tr)",
        )
    whole = round((near - seconds) / gpstime.SECONDS_PER_WEEK)
    return whole * gpstime.SECONDS_PER_WEEK + seconds


def _ephemeris_date(number: int, body: bytes) -> float | None:
    """Return the time of clock of an ephemeris as GPS time [s]."""
    if number == 1019:
        # Ten bits: of the weeks it may be the last that is not to come (a file's date may be any).
        week, clock = _bits(body, 18, 10), _bits(body, 56, 16) * 16.0
        now = gpstime.from_unix(time.time()) / gpstime.SECONDS_PER_WEEK
        week += _ROLLOVER * max(int((now + 1.0 - week) // _ROLLOVER), 0)
    elif number == 1042:
        week, clock = _bits(body, 18, 13) + _BEIDOU_WEEK, _bits(body, 54, 17) * 8.0
    elif number in (1045, 1046):
        week, clock = _bits(body, 18, 12) + _GALILEO_WEEK, _bits(body, 62, 14) * 60.0
    else:
        return None
    return week * gpstime.SECONDS_PER_WEEK + clock


def _bits(body: bytes, start: int, size: int) -> int:
    """Return an unsigned number, most significant bit first; 0 beyond the end."""
    stop = start + size
    whole = int.from_bytes(body[: -(-stop // 8)].ljust(-(-stop // 8), b"\0"), "big")
    return whole >> (-stop % 8) & ((1 << size) - 1)


# --- what is said of it ----------------------------------------------------------------------


def _found(frames: Frames, name: str, observations: bytes, navigation: bytes) -> list[str]:
    """Return what a log holds."""
    known, count = FORMATS[name], frames.count(name)
    measured = ", ".join(
        f"{count[n]} {word}" for n, word in sorted(known.observations.items()) if n in count
    )
    epochs, half, lost, phases = _carrier(observations)
    ephemerides = Counter(
        chr(line[0])
        for line in navigation.split(b"END OF HEADER", 1)[-1].split(b"\n")
        if line[:1].isalpha()
    )
    broadcast = ", ".join(f"{letter} {n}" for letter, n in sorted(ephemerides.items()))
    return [
        f"{known.name}, {measured}",
        _rate(epochs),
        f"signals {_signals(observations)}",
        f"ephemerides {broadcast}" if broadcast else _no_ephemeris(known.switch_on),
        f"half cycles unresolved in {100 * half / max(phases, 1):.1f} % of {phases} phases",
        f"{lost} losses of lock",
    ]


def _of_order(ordered: Ordered) -> list[str]:
    """Return what was done to put a log in the order of its time."""
    said = []
    if ordered.moved:
        said.append(f"{ordered.moved} epochs that were behind later ones put before them")
    if ordered.repeated:
        said.append(f"{ordered.repeated} epochs of a time there is already left out")
    return said


def _of_others(frames: Frames, name: str) -> list[str]:
    """Return what was passed over."""
    damaged = frames.damaged[name]
    others = Counter(f.format for f in frames.frames if f.format != name)
    return [f"{damaged} damaged messages left out"] * bool(damaged) + [
        f"{n} {FORMATS[other].name} messages passed over" for other, n in others.items()
    ]


def _no_ephemeris(switch_on: str) -> str:
    return f"no ephemeris: give a navigation file, or log more of {switch_on}"


def _rate(epochs: list[float]) -> str:
    if len(epochs) < 2:
        return f"{len(epochs)} epoch"
    step = np.diff(np.array(epochs))
    usual = float(np.median(step))
    gaps = int((step > 1.5 * usual).sum())
    text = (
        f"{len(epochs)} epochs at {1.0 / usual:.4g} Hz" if usual > 0.0 else f"{len(epochs)} epochs"
    )
    return text + (f" with {gaps} gaps, the longest {step.max():.1f} s" if gaps else "")


def _signals(observations: bytes) -> str:
    """Return the signals of each constellation: 'G 1C 2L, E 1C 7Q'."""
    out: dict[str, list[str]] = {}
    letter = ""
    for line in observations.split(b"END OF HEADER", 1)[0].decode("latin-1").split("\n"):
        if line[60:].strip() == "SYS / # / OBS TYPES":
            letter = line[0].strip() or letter
            out.setdefault(letter, []).extend(t[1:] for t in line[7:60].split() if t[0] == "C")
    return ", ".join(f"{letter} {' '.join(codes)}" for letter, codes in out.items())


def _carrier(observations: bytes) -> tuple[list[float], int, int, int]:
    """Return the epochs' times, phases with half a cycle open, losses of lock, and phases."""
    columns: dict[str, list[int]] = {}
    epochs: list[float] = []
    half = lost = phases = 0
    head, _, body = observations.decode("latin-1").partition("END OF HEADER")
    letter = ""
    for line in head.split("\n"):
        if line[60:].strip() == "SYS / # / OBS TYPES":
            letter = line[0].strip() or letter
            columns.setdefault(letter, []).extend(t[0] == "L" for t in line[7:60].split())
    at = {
        letter: [3 + 16 * k + 14 for k, phase in enumerate(flags) if phase]
        for letter, flags in columns.items()
    }
    for line in body.split("\n")[1:]:
        if line.startswith(">"):
            year, month, day, hour, minute = (int(v) for v in line[1:18].split())
            seconds = float(line[18:29])
            epochs.append(gpstime.from_calendar(year, month, day, hour, minute, seconds))
            continue
        for k in at.get(line[:1], ()):
            if line[k - 14 : k].strip():
                phases += 1
                flag = int(line[k]) if line[k : k + 1].isdigit() else 0
                half += flag >> 1 & 1
                lost += flag & 1
    return epochs, half, lost, phases
