"""What a receiver's file is good for: observations, ephemerides, or ready-made fixes."""

from __future__ import annotations

from pathlib import Path

from ...filters.errors import NavError
from ..gpstime import to_week_sow
from ..great.files import first_observation, rinex_kind
from ..receivers.bags import bag_topics
from ..receivers.raw_frames import FORMATS, find_frames
from ..text.rinex_packing import is_packed, unpack
from .blanks import BLANK
from .draft import Line

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
    # A log may begin with more text than that: its receiver's NMEA.
    return _of_log(path, path.read_bytes()) if b"\0" in head or b"$G" in head else ""


def with_week(lines: list[Line], observed: Path) -> list[Line]:
    """Return drafted lines whose question for a week names that of a receiver's observations."""
    from ..rtklib import given_files

    try:
        first = first_observation(given_files(observed).observations)
    except NavError:
        return lines  # what is wrong with the file, reading it says
    week, second = (float(v) for v in to_week_sow(first))
    named = f"week = {week:.0f}: {observed.name} begins at second {second:.0f} of it"
    return [x._replace(comment=x.comment.replace("week = …", named)) for x in lines]


def bag_sections(path: Path, name: str) -> dict[str, list[Line]]:
    """Return drafted lines by section for the topics of a bag whose messages say what they hold.

    Parameters
    ----------
    path : Path
    name : str
        What the declaration calls it.
    """
    of_type: dict[str, list[str]] = {}
    for topic, kind in bag_topics(path).items():
        of_type.setdefault(kind, []).append(topic)
    out: dict[str, list[Line]] = {}
    for kind, section, lines in (
        ("sensor_msgs/msg/Imu", "imu", _BAG_IMU), ("sensor_msgs/msg/NavSatFix", "gnss", _BAG_FIX),
    ):  # fmt: skip
        topics = sorted(of_type.get(kind, ()))
        if topics:
            more = f"or one of {', '.join(topics[1:])}" if topics[1:] else ""
            out[section] = [Line("file", name), Line("topic", topics[0], more), *lines]
    if any(kind.endswith("/RxmRAWX") for kind in of_type):
        out["rinex"] = [Line("observations", name)]
    return out


_STAMP = [
    Line("time", "stamp"),
    Line("time_scale", "unix", "of the header; without GPS time, of the computer's clock"),
]
#: What the definitions of these messages say of their fields.
_BAG_IMU = [
    *_STAMP,
    Line("gyro", [f"angular_velocity.{x}" for x in "xyz"]),
    Line("accel", [f"linear_acceleration.{x}" for x in "xyz"]),
    Line("gyro_unit", "rad/s", "says the message"),
    Line("accel_unit", "m/s2"),
    Line("axes", BLANK, "FRD, FLU, RFU …; drivers that keep to REP 103: FLU"),
]
_BAG_FIX = [
    *_STAMP,
    Line("position", ["latitude", "longitude", "altitude"]),
    Line("position_frame", "lla"),
    Line("angle_unit", "deg"),
    Line("height", "ellipsoid", "says the message"),
    Line("position_variance", [f"position_covariance.{k}" for k in (4, 0, 8)], "north, east, up"),
]


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
