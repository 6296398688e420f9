"""Logs put together in the order of their time: decoders drop what steps back.

`cat` takes files as a folder lists them, and receivers stamp their first epochs by a clock that is
not set yet. A log falls into runs in which time does not step back; they are put in order, and an
epoch that two of them have is read once.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from ..gpstime import SECONDS_PER_WEEK
from .raw_frames import FORMATS, Frame, Frames

#: Septentrio's week and time of week that mean nothing.
_NO_WEEK, _NO_TIME = 0xFFFF, 0xFFFFFFFF


class Ordered(NamedTuple):
    """A log in the order of its time.

    Attributes
    ----------
    frames : Frames
    moved : int
        Observation messages that were behind later ones, and have been put before them.
    repeated : int
        Those of a time that another part of the log has, left out.
    """

    frames: Frames
    moved: int = 0
    repeated: int = 0


def in_order(frames: Frames, name: str) -> Ordered:
    """Return the messages of one format in the order of their observations' time.

    Parameters
    ----------
    frames : Frames
    name : str
        One of `FORMATS`. RTCM 3 tells no week, and is left as it is.
    """
    known = FORMATS[name].observations
    runs: list[list[tuple[Frame, float | None]]] = [[]]
    latest = -float("inf")
    for frame in frames.frames:
        if frame.format != name:
            continue
        time = _observed_at(frames.content, frame) if frame.number in known else None
        if time is not None:
            if time < latest:
                runs.append([])
            latest = time
        runs[-1].append((frame, time))
    if len(runs) == 1:
        return Ordered(frames)
    order = sorted(range(len(runs)), key=lambda k: (_first(runs[k]), k))
    kept: list[Frame] = []
    moved = repeated = 0
    reached, seen = -float("inf"), -1
    for k in order:
        times = [t for _, t in runs[k] if t is not None]
        behind = sum(t <= reached for t in times)
        repeated += behind
        moved += (len(times) - behind) * (k < seen)
        kept += [frame for frame, t in runs[k] if t is None or t > reached]
        reached, seen = max([reached, *times]), max(seen, k)
    return Ordered(Frames(frames.content, tuple(kept), frames.damaged), moved, repeated)


def _first(run: list[tuple[Frame, float | None]]) -> float:
    return next((t for _, t in run if t is not None), -float("inf"))


def _observed_at(content: bytes, frame: Frame) -> float | None:
    """Return the time of an observation message [GPS s]; None where it tells none."""
    at = frame.start
    if frame.format == "ubx" and frame.number == 0x0215 and frame.stop - at >= 24:
        seconds, week = struct.unpack_from("<dH", content, at + 6)
    elif frame.format == "ubx" and frame.number == 0x0210 and frame.stop - at >= 16:
        milliseconds, week = struct.unpack_from("<iH", content, at + 6)
        seconds = 1e-3 * milliseconds
    elif frame.format == "sbf":
        milliseconds, week = struct.unpack_from("<IH", content, at + 8)
        if week == _NO_WEEK or milliseconds == _NO_TIME:
            return None
        seconds = 1e-3 * milliseconds
    elif frame.format == "novatel":
        week, milliseconds = struct.unpack_from("<HI", content, at + 14)
        seconds = 1e-3 * milliseconds
    else:
        return None
    return week * SECONDS_PER_WEEK + seconds if 0.0 <= seconds <= SECONDS_PER_WEEK else None
