"""What a receiver's file is good for: observations, ephemerides, or ready-made fixes."""

from __future__ import annotations

import json
from pathlib import Path

from ...filters.errors import NavError
from ..gpstime import to_week_sow
from ..great.files import first_observation, rinex_kind
from ..receivers.bags import bag_topics
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
    # A log may begin with more text than that: its receiver's NMEA.
    return _of_log(path, path.read_bytes()) if b"\0" in head or b"$G" in head else ""


def with_week(lines: list[str], observed: Path) -> list[str]:
    """Return drafted lines whose question for a week names that of a receiver's observations."""
    from ..rtklib import given_files

    try:
        first = first_observation(given_files(observed).observations)
    except NavError:
        return lines  # what is wrong with the file, reading it says
    week, second = (float(v) for v in to_week_sow(first))
    named = f"week = {week:.0f}: {observed.name} begins at second {second:.0f} of it"
    return [line.replace("week = …", named) for line in lines]


def bag_sections(path: Path, name: str) -> dict[str, list[str]]:
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
    out: dict[str, list[str]] = {}
    for kind, section, lines in (
        ("sensor_msgs/msg/Imu", "imu", _BAG_IMU), ("sensor_msgs/msg/NavSatFix", "gnss", _BAG_FIX),
    ):  # fmt: skip
        topics = sorted(of_type.get(kind, ()))
        if topics:
            more = f"  # or one of {', '.join(topics[1:])}" if topics[1:] else ""
            file, topic = json.dumps(name), json.dumps(topics[0])
            out[section] = [f"file = {file}", f"topic = {topic}{more}", *lines]
    if any(kind.endswith("/RxmRAWX") for kind in of_type):
        out["rinex"] = [f"observations = {json.dumps(name)}"]
    return out


_STAMP = [
    'time = "stamp"',
    'time_scale = "unix"  # of the header; without GPS time, of the computer\'s clock',
]
#: What the definitions of these messages say of their fields.
_BAG_IMU = [
    *_STAMP,
    'gyro = ["angular_velocity.x", "angular_velocity.y", "angular_velocity.z"]',
    'accel = ["linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"]',
    'gyro_unit = "rad/s"  # says the message',
    'accel_unit = "m/s2"',
    'axes = "?"  # FRD, FLU, RFU …; drivers that keep to REP 103: FLU',
]
_BAG_FIX = [
    *_STAMP,
    'position = ["latitude", "longitude", "altitude"]',
    'position_frame = "lla"',
    'angle_unit = "deg"',
    'height = "ellipsoid"  # says the message',
    'position_variance = ["position_covariance.4", "position_covariance.0", '
    '"position_covariance.8"]  # north, east, up',
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
