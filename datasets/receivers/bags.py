"""ROS bags (1 and 2, MCAP): the messages of a topic as a table, for a declaration's columns.

A declared file that is a bag has a ``topic``; its columns are the fields of the messages by their
path, as ``angular_velocity.x`` or ``position_covariance.0``, and ``stamp``, the time in the
message's header, and ``received``, that of the bag, both in seconds since 1970 (`unix`). Raw
messages of u-blox receivers (``ublox_msgs/RxmRAWX`` and ``RxmSFRBX``) become the log they were.
Bags are read by the package rosbags (extra ``bags``).
"""

from __future__ import annotations

import atexit
import shutil
import struct
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ...filters.errors import ConfigError, DataError

#: Longer arrays are images and clouds, not columns; a covariance of six has 36 numbers.
_LONGEST = 36
_ENDINGS = (".bag", ".mcap", ".db3")


def is_bag(path: Path) -> bool:
    """Return whether a file, or the folder of a ROS 2 bag, goes by a bag's name."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.suffix.lower() in _ENDINGS


def bag_table(path: str | Path, topic: str) -> Path:
    """Return the messages of a topic as a CSV file, which goes when the process ends.

    Parameters
    ----------
    path : path
        ``.bag``, ``.mcap``, ``.db3``, or the folder of a ROS 2 bag.
    topic : str
        Its name, as ``/imu/data``.

    Raises
    ------
    DataError
        A missing or damaged bag, no message, or the package rosbags is not installed.
    ConfigError
        No such topic, with those there are.
    """
    path = Path(path)
    if not path.exists():
        raise DataError("file not found", file=path, remedy="check the name")
    return _table(path.resolve(), path.stat().st_mtime_ns, topic)


def bag_topics(path: Path) -> dict[str, str]:
    """Return the topics of a bag and the types of their messages, as ``sensor_msgs/msg/Imu``.

    Raises
    ------
    DataError
        As for `bag_table`.
    """

    def topics() -> list[tuple[str, str]]:
        with _reader(path) as reader:
            return [(c.topic, c.msgtype) for c in reader.connections]

    return dict(_read(path, topics))


def ublox_log(path: str | Path) -> Path:
    """Return the raw messages of a u-blox receiver in a bag as a UBX log, kept as long.

    Raises
    ------
    DataError
        As for `bag_table`; no raw message in the bag, with the topics there are.
    """
    path = Path(path)
    return _log(path.resolve(), path.stat().st_mtime_ns)


@cache
def _log(path: Path, modified: int) -> Path:
    frames = _read(path, lambda: list(_frames(path)))
    out = Path(tempfile.mkdtemp(dir=_shelf())) / f"{path.stem}.ubx"
    out.write_bytes(b"".join(frames))
    return out


def _frames(path: Path) -> Iterator[bytes]:
    with _reader(path) as reader:
        found = [c for c in reader.connections if c.msgtype.rpartition("/")[2] in _UBLOX]
        if not found:
            known = sorted({f"{c.topic} ({c.msgtype})" for c in reader.connections})
            raise DataError(
                f"no raw messages of a receiver in this bag, which holds {', '.join(known)}",
                file=path,
                remedy="record ublox_msgs/RxmRAWX and RxmSFRBX, or name the receiver's own log",
            )
        for connection, _, raw in reader.messages(connections=found):
            message = reader.deserialize(raw, connection.msgtype)
            yield _UBLOX[connection.msgtype.rpartition("/")[2]](message)


def _rawx(m: Any) -> bytes:
    payload = struct.pack("<dHbBBBxx", m.rcvTOW, m.week, m.leapS, len(m.meas), m.recStat, m.version)
    for r in m.meas:  # ublox_msgs calls the signal reserved0
        payload += struct.pack(
            "<ddfBBBBHBBBBBx", r.prMes, r.cpMes, r.doMes, r.gnssId, r.svId, r.reserved0, r.freqId,
            r.locktime, r.cno, r.prStdev, r.cpStdev, r.doStdev, r.trkStat,
        )  # fmt: skip
    return _framed(0x15, payload)


def _sfrbx(m: Any) -> bytes:
    head = (m.gnssId, m.svId, m.reserved0, m.freqId, len(m.dwrd), m.chn, m.version, 0)
    return _framed(0x13, struct.pack(f"<8B{len(m.dwrd)}I", *head, *m.dwrd))


_UBLOX: dict[str, Callable[[Any], bytes]] = {"RxmRAWX": _rawx, "RxmSFRBX": _sfrbx}


def _framed(number: int, payload: bytes) -> bytes:
    """Return a message of class RXM with its checksum."""
    body = bytes([0x02, number]) + len(payload).to_bytes(2, "little") + payload
    sums = np.cumsum(np.frombuffer(body, np.uint8), dtype=np.int64)
    return b"\xb5b" + body + bytes([int(sums[-1]) & 255, int(sums.sum()) & 255])


def _read(path: Path, read: Callable[[], list[Any]]) -> list[Any]:
    """Return what is read of a bag; whatever a damaged one causes is a `DataError`."""
    try:
        return read()
    except (ConfigError, DataError):
        raise
    except Exception as error:  # of struct, sqlite, yaml …
        first = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise DataError(f"not readable as a bag: {first}", file=path) from None


@cache
def _table(path: Path, modified: int, topic: str) -> Path:
    rows = _read(path, lambda: list(_messages(path, topic)))
    if not rows:
        raise DataError(f"no message of topic {topic}", file=path)
    names = list(rows[0])
    kept = [row for row in rows if list(row) == names]
    if len(kept) < len(rows):
        raise DataError(
            f"topic {topic}: its messages have other fields from message {_other(rows) + 1} on",
            file=path,
        )
    out = Path(tempfile.mkdtemp(dir=_shelf())) / f"{path.stem}.csv"
    with out.open("w", encoding="utf-8") as file:
        file.write(",".join(names) + "\n")
        for row in rows:
            file.write(",".join(row.values()) + "\n")
    return out


def _other(rows: list[dict[str, str]]) -> int:
    return next(k for k, row in enumerate(rows) if list(row) != list(rows[0]))


def _reader(path: Path) -> Any:
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise DataError(
            "reading bags needs the package rosbags",
            file=path,
            remedy="pip install 'certnav[bags]'",
        ) from None
    place = path.parent if path.suffix.lower() == ".db3" else path
    # ROS 2 bags may leave the definitions of the standard messages out.
    return AnyReader([place], default_typestore=get_typestore(Stores.LATEST))


def _messages(path: Path, topic: str) -> Iterator[dict[str, str]]:
    with _reader(path) as reader:
        found = [c for c in reader.connections if c.topic == topic]
        if not found:
            known = sorted({f"{c.topic} ({c.msgtype})" for c in reader.connections})
            raise ConfigError(
                f"{path}: topic {topic!r} is not in this bag — it holds "
                + (", ".join(known) or "none")
            )
        for connection, received, raw in reader.messages(connections=found):
            message = reader.deserialize(raw, connection.msgtype)
            row: dict[str, str] = {}
            stamp = getattr(getattr(message, "header", None), "stamp", None)
            if stamp is not None:
                row["stamp"] = f"{stamp.sec}.{stamp.nanosec:09d}"
            row["received"] = f"{received // 10**9}.{received % 10**9:09d}"
            for name in message.__dataclass_fields__:
                if name not in ("header", "__msgtype__"):
                    row |= dict(_flat(name, getattr(message, name)))
            yield row


def _flat(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield the numbers of a field by their paths."""
    if hasattr(value, "__dataclass_fields__"):
        for inner in value.__dataclass_fields__:
            if inner != "__msgtype__":
                yield from _flat(f"{name}.{inner}", getattr(value, inner))
    elif isinstance(value, np.ndarray):
        if value.size <= _LONGEST and value.dtype.kind in "iufb":
            for k, number in enumerate(value.ravel()):
                yield f"{name}.{k}", repr(float(number))
    elif isinstance(value, bool | int | float):
        yield name, repr(float(value))


@cache
def _shelf() -> Path:
    """A folder that goes when the process ends."""
    folder = Path(tempfile.mkdtemp(prefix="certnav-bags-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
