"""Messages in receivers' own logs: UBX, SBF, RTCM 3 and NovAtel OEM, found by their checksums.

Logs are mixtures: NMEA among UBX, a base station's RTCM among the rover's SBF. What is no message
with a right checksum is passed over, byte by byte, so that one damaged message costs no other.
"""

from __future__ import annotations

import binascii
import re
import zlib
from collections import Counter
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

_START = re.compile(rb"\xb5b|\$@|\xd3[\x00-\x03]|\xaaD\x12")


class RawFormat(NamedTuple):
    """A maker's raw messages.

    Attributes
    ----------
    name : str
    observations, navigation : mapping of int to str
        Names of the messages that hold pseudoranges and phases, and of those that hold
        ephemerides, by their numbers.
    switch_on : str
        What a receiver has to log, for messages.
    """

    name: str
    observations: dict[int, str]
    navigation: dict[int, str]
    switch_on: str


#: By priority: a log with several is the rover's in the first of them.
FORMATS: dict[str, RawFormat] = {
    "ubx": RawFormat(
        "u-blox UBX",
        {0x0215: "RXM-RAWX", 0x0210: "RXM-RAW", 0x0310: "TRK-MEAS"},
        {0x0213: "RXM-SFRBX", 0x0211: "RXM-SFRB", 0x030F: "TRK-SFRBX"},
        "UBX-RXM-RAWX and UBX-RXM-SFRBX",
    ),
    "sbf": RawFormat(
        "Septentrio SBF",
        {4027: "MeasEpoch", 5889: "GenMeasEpoch"},
        {
            4017: "GPSRawCA", 4022: "GALRawFNAV", 4023: "GALRawINAV", 4026: "GLORawCA",
            4047: "BDSRaw", 4066: "QZSRawL1CA", 5891: "GPSNav", 4002: "GALNav", 4004: "GLONav",
            4081: "BDSNav", 4095: "QZSNav",
        },
        "SBF MeasEpoch with GPSRawCA, GALRawINAV, GLORawCA, BDSRaw (or GPSNav, GALNav, GLONav, "
        "BDSNav)",
    ),
    "novatel": RawFormat(
        "NovAtel OEM",
        {43: "RANGE", 140: "RANGECMP", 1273: "RANGECMP2", 2537: "RANGECMP4"},
        {
            7: "GPSEPHEM", 41: "RAWEPHEM", 723: "GLOEPHEMERIS", 1122: "GALEPHEMERIS",
            1696: "BDSEPHEMERIS", 1336: "QZSSEPHEMERIS", 1331: "QZSSRAWEPHEM",
        },
        "RANGEB (or RANGECMPB) with GPSEPHEMB, GLOEPHEMERISB, GALEPHEMERISB, BDSEPHEMERISB",
    ),
    "rtcm3": RawFormat(
        "RTCM 3",
        {
            **{n: str(n) for n in (1001, 1002, 1003, 1004, 1009, 1010, 1011, 1012)},
            **{base + k: str(base + k) for base in (1070, 1080, 1090, 1110, 1120)
               for k in range(4, 8)},
        },
        {n: str(n) for n in (1019, 1020, 1042, 1044, 1045, 1046)},
        "RTCM MSM4 or better (1074, 1084, 1094, 1124; MSM5 and MSM7 have Doppler), 1019, 1020, "
        "1042, 1046, and 1005 or 1006 of a base",
    ),
}  # fmt: skip


class Frame(NamedTuple):
    """One message: its format, its number, and where it begins and ends in the log."""

    format: str
    number: int
    start: int
    stop: int


@dataclass(frozen=True, eq=False)
class Frames:
    """The messages of a log.

    Attributes
    ----------
    content : bytes
        The log.
    frames : tuple of Frame
    damaged : Counter of str
        Beginnings of messages whose checksum is wrong, or whose end is missing, by format.
    """

    content: bytes
    frames: tuple[Frame, ...]
    damaged: Counter[str]

    def count(self, format: str) -> Counter[int]:
        """Return how many messages of each number there are in a format."""
        return Counter(f.number for f in self.frames if f.format == format)

    def only(self, format: str) -> bytes:
        """Return the log without what is not of that format."""
        return b"".join(self.content[f.start : f.stop] for f in self.frames if f.format == format)

    def raw_format(self) -> str:
        """Return the format of the observations in the log, '' if there are none."""
        numbers = {(f.format, f.number) for f in self.frames}
        for name, known in FORMATS.items():
            if any((name, number) in numbers for number in known.observations):
                return name
        return ""


def find_frames(content: bytes) -> Frames:
    """Return the messages of a log whose checksums are right."""
    frames: list[Frame] = []
    damaged: Counter[str] = Counter()
    at = 0
    while (match := _START.search(content, at)) is not None:
        start = match.start()
        name, read = _READ[content[start]]
        found = read(content, start)
        if found is None:
            damaged[name] += 1
            at = start + 1
        else:
            number, stop = found
            frames.append(Frame(name, number, start, stop))
            at = stop
    return Frames(content, tuple(frames), damaged)


def has_frames(content: bytes) -> bool:
    """Return whether there is any message whose checksum is right."""
    starts = _START.finditer(content)
    return any(_READ[content[m.start()]][1](content, m.start()) is not None for m in starts)


def _ubx(content: bytes, start: int) -> tuple[int, int] | None:
    stop = start + 8 + int.from_bytes(content[start + 4 : start + 6], "little")
    if stop > len(content):
        return None
    body = np.frombuffer(content, np.uint8, stop - start - 4, start + 2)
    sums = np.cumsum(body, dtype=np.int64)  # 64 kB at most: sums of sums fit
    right = (int(sums[-1]) & 255, int(sums.sum()) & 255) == (content[stop - 2], content[stop - 1])
    return (content[start + 2] << 8 | content[start + 3], stop) if right else None


def _sbf(content: bytes, start: int) -> tuple[int, int] | None:
    crc, number, length = (
        int.from_bytes(content[start + k : start + k + 2], "little") for k in (2, 4, 6)
    )
    stop = start + length
    if length < 16 or length % 4 or stop > len(content):
        return None
    right = binascii.crc_hqx(content[start + 4 : stop], 0) == crc
    return (number & 0x1FFF, stop) if right else None


def _rtcm3(content: bytes, start: int) -> tuple[int, int] | None:
    length = int.from_bytes(content[start + 1 : start + 3], "big")
    stop = start + length + 6
    if length < 2 or stop > len(content):
        return None
    right = crc24q(content[start : stop - 3]) == int.from_bytes(content[stop - 3 : stop], "big")
    return (int.from_bytes(content[start + 3 : start + 5], "big") >> 4, stop) if right else None


def _novatel(content: bytes, start: int) -> tuple[int, int] | None:
    if start + 28 > len(content):
        return None
    number, length = (int.from_bytes(content[start + k : start + k + 2], "little") for k in (4, 8))
    end = start + content[start + 3] + length
    if content[start + 3] < 28 or end + 4 > len(content):
        return None
    crc = (
        zlib.crc32(content[start:end], 0xFFFFFFFF) ^ 0xFFFFFFFF
    )  # neither inverted before nor after
    right = crc == int.from_bytes(content[end : end + 4], "little")
    return (number, end + 4) if right else None


_READ = {
    0xB5: ("ubx", _ubx),
    0x24: ("sbf", _sbf),
    0xD3: ("rtcm3", _rtcm3),
    0xAA: ("novatel", _novatel),
}


def crc24q(content: bytes) -> int:
    """Return the checksum of RTCM 3 (polynomial 0x1864CFB, beginning with 0)."""
    table, crc = _crc24q_table(), 0
    for byte in content:
        crc = (crc << 8 & 0xFFFFFF) ^ table[crc >> 16 ^ byte]
    return crc


@cache
def _crc24q_table() -> tuple[int, ...]:
    out = []
    for byte in range(256):
        crc = byte << 16
        for _ in range(8):
            crc = crc << 1 ^ (0x1864CFB if crc & 0x800000 else 0)
        out.append(crc)
    return tuple(out)
