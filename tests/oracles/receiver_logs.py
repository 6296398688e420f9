"""Receivers' own logs made from observations and ephemerides: what the receiver would have written.

Every message is packed from its maker's interface description; nothing of certnav or RTKLIB is
used. Observations carry the resolution of RINEX (1 mm, 1/1000 cycle and Hz, whole dB-Hz), so that a
log and its RINEX twin hold the same numbers.
"""

from __future__ import annotations

import binascii
import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

WEEK_S = 604800.0
_PI = 3.1415926535898  # of the interface specifications
#: u-blox: constellation, and signal by RINEX code (interface description, GNSS identifiers).
_UBX_SYSTEM = {"G": 0, "E": 2, "C": 3, "J": 5, "R": 6}
_UBX_SIGNAL = {
    ("G", "1C"): 0, ("G", "2L"): 3, ("E", "1C"): 0, ("E", "7Q"): 6, ("C", "2I"): 0, ("C", "7I"): 2,
    ("R", "1C"): 0, ("R", "2C"): 2, ("J", "1C"): 0, ("J", "2L"): 5,
}  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One signal at one epoch: [m], [cycles], [Hz], [dB-Hz]."""

    sat: str
    signal: str
    pseudorange: float
    carrier: float
    doppler: float
    cn0: float


Epoch = tuple[float, list[Row]]


def epochs_of(observations: Any) -> list[Epoch]:
    """Return the rows of `GnssObservations` by epoch, with the digits of RINEX.

    Carriers begin, as receivers let them, within a cycle of their pseudoranges.
    """
    o, out = observations, []
    begun: dict[tuple[str, str], float] = {}
    for time, rows in o.epochs():
        whole = []
        for k in range(rows.start, rows.stop):
            sat, signal = str(o.sat[k]), str(o.signal[k])
            cycles = float(o.pseudorange[k] / o.wavelength[k])
            if not np.isfinite(cycles + o.carrier[k]):
                continue
            whole_cycles = begun.setdefault((sat, signal), round(float(o.carrier[k]) - cycles))
            doppler = float(-o.range_rate[k] / o.wavelength[k])
            whole.append(
                Row(
                    sat, signal, round(float(o.pseudorange[k]), 3),
                    round(float(o.carrier[k]) - whole_cycles, 3), round(doppler, 3),
                    float(np.round(o.cn0[k])),
                )
            )  # fmt: skip
        out.append((time, whole))
    return out


def rinex(epochs: list[Epoch]) -> str:
    """Return the twin of a log: GPS L1 observations as RINEX 3."""
    import datetime

    def dated(time: float) -> datetime.datetime:
        return datetime.datetime(1980, 1, 6) + datetime.timedelta(microseconds=round(time * 1e6))

    first = dated(epochs[0][0])
    lines = [
        f"{3.04:9.2f}           OBSERVATION DATA    G                   RINEX VERSION / TYPE",
        f"{'G    4 C1C L1C D1C S1C':<60}SYS / # / OBS TYPES",
        f"{first:%6Y %m %d %H %M} {first.second:12.7f}     GPS".ljust(60) + "TIME OF FIRST OBS",
        f"{'':<60}END OF HEADER",
    ]
    for time, rows in epochs:
        at = dated(time)
        seconds = at.second + at.microsecond * 1e-6
        lines.append(f"> {at:%Y %m %d %H %M}{seconds:11.7f}  0{len(rows):3d}")
        for r in rows:
            values = (r.pseudorange, r.carrier, r.doppler, r.cn0)
            lines.append(r.sat + "  ".join(f"{v:14.3f}" for v in values))
    return "\n".join(lines) + "\n"


# --- u-blox ----------------------------------------------------------------------------------


def ubx(group: int, number: int, payload: bytes) -> bytes:
    """Return a UBX frame."""
    body = bytes([group, number]) + struct.pack("<H", len(payload)) + payload
    a = b = 0
    for byte in body:
        a = (a + byte) & 255
        b = (b + a) & 255
    return b"\xb5b" + body + bytes([a, b])


def rawx(time: float, rows: list[Row], half_cycles: bool = False) -> bytes:
    """Return UBX-RXM-RAWX of one epoch."""
    week = int(time // WEEK_S)
    rows = [r for r in rows if (r.sat[0], r.signal) in _UBX_SIGNAL]
    out = struct.pack("<dHbBBBxx", round(time - week * WEEK_S, 7), week, 18, len(rows), 1, 1)
    for r in rows:
        status = 3 if half_cycles else 7  # range and phase valid; half cycle resolved
        out += struct.pack(
            "<ddfBBBBHBBBBBx", r.pseudorange, r.carrier, r.doppler, _UBX_SYSTEM[r.sat[0]],
            int(r.sat[1:]), _UBX_SIGNAL[r.sat[0], r.signal],
            0, 60000, int(r.cn0), 5, 3, 5, status,
        )  # fmt: skip
    return ubx(0x02, 0x15, out)


def sfrbx(sat: str, words: list[int], frequency: int = 0) -> bytes:
    """Return UBX-RXM-SFRBX of navigation words."""
    head = struct.pack(
        "<BBBBBBBB", _UBX_SYSTEM[sat[0]], int(sat[1:]), 0, frequency, len(words), 0, 2, 0
    )
    return ubx(0x02, 0x13, head + struct.pack(f"<{len(words)}I", *words))


def ubx_log(epochs: list[Epoch], ephemerides: list[Any], **options: Any) -> list[bytes]:
    """Return the messages of a log: navigation data first, as they come within half a minute."""
    at = epochs[0][0]
    frames = [rawx(at, [])]  # tells the week
    for name, e in ephemerides:
        for number in (1, 2, 3):
            frames.append(sfrbx(name, [w << 6 for w in lnav(e, number, at)]))
    return [*frames, *(rawx(t, rows, **options) for t, rows in epochs)]


# --- GPS navigation message (IS-GPS-200, 20.3.3) -----------------------------------------------


class _Bits:
    """Bits, most significant first."""

    def __init__(self) -> None:
        self.value, self.size = 0, 0

    def put(self, value: int, size: int) -> None:
        if not -(1 << (size - 1)) <= value < (1 << size):
            raise ValueError(f"{value} does not fit into {size} bits")
        self.value = (self.value << size) | (value & ((1 << size) - 1))
        self.size += size


def _scaled(value: float, unit: float) -> int:
    return round(value / unit)


def lnav(e: Any, number: int, time: float) -> list[int]:
    """Return the ten words of 24 bits of a subframe of an ephemeris (an RTKLIB `eph_t`)."""
    b, half = _Bits(), 1.0 / _PI
    sow = time % WEEK_S
    b.put(0x8B, 8)
    b.put(0, 16)
    b.put(int(sow // 6) + 1 & 0x1FFFF, 17)
    b.put(0, 2)
    b.put(number, 3)
    b.put(0, 2)
    if number == 1:
        b.put(e.week % 1024, 10)
        for value, size in ((e.code, 2), (e.sva, 4), (e.svh, 6), (e.iodc >> 8, 2), (e.flag, 1)):
            b.put(value, size)
        b.put(0, 87)
        b.put(_scaled(e.tgd[0], 2**-31), 8)
        b.put(e.iodc & 255, 8)
        b.put(round((e.toc.time + e.toc.sec - 315964800) % WEEK_S) // 16, 16)
        for value, unit, size in ((e.f2, 2**-55, 8), (e.f1, 2**-43, 16), (e.f0, 2**-31, 22)):
            b.put(_scaled(value, unit), size)
    elif number == 2:
        b.put(e.iode, 8)
        for value, unit, size in (
            (e.crs, 2**-5, 16), (e.deln * half, 2**-43, 16), (e.M0 * half, 2**-31, 32),
            (e.cuc, 2**-29, 16), (e.e, 2**-33, 32), (e.cus, 2**-29, 16), (e.A**0.5, 2**-19, 32),
        ):  # fmt: skip
            b.put(_scaled(value, unit), size)
        b.put(round(e.toes) // 16, 16)
        b.put(0, 6)
    else:
        for value, unit, size in (
            (e.cic, 2**-29, 16), (e.OMG0 * half, 2**-31, 32), (e.cis, 2**-29, 16),
            (e.i0 * half, 2**-31, 32), (e.crc, 2**-5, 16), (e.omg * half, 2**-31, 32),
            (e.OMGd * half, 2**-43, 24),
        ):  # fmt: skip
            b.put(_scaled(value, unit), size)
        b.put(e.iode, 8)
        b.put(_scaled(e.idot * half, 2**-43), 14)
    b.put(0, 240 - b.size)
    return [(b.value >> 24 * (9 - k)) & 0xFFFFFF for k in range(10)]


# --- Septentrio, NovAtel, RTCM 3 -------------------------------------------------------------


def sbf(number: int, payload: bytes) -> bytes:
    """Return an SBF block."""
    payload += b"\0" * (-(8 + len(payload)) % 4)
    body = struct.pack("<HH", number, 8 + len(payload)) + payload
    return b"$@" + struct.pack("<H", binascii.crc_hqx(body, 0)) + body


def sbf_log(epochs: list[Epoch], ephemerides: list[Any], wavelength: float) -> list[bytes]:
    """Return MeasEpoch and GPSRawCA blocks of GPS L1."""
    out = []
    for name, e in ephemerides:
        for number in (1, 2, 3):
            words = [w << 6 for w in lnav(e, number, epochs[0][0])]
            head = struct.pack("<IHBBBBBB", *_stamp(epochs[0][0]), int(name[1:]), 1, 0, 0, 0, 0)
            out.append(sbf(4017, head + struct.pack("<10I", *words)))
    for time, rows in epochs:
        payload = struct.pack("<IHBBBBBB", *_stamp(time), len(rows), 20, 12, 0, 0, 0)
        for k, r in enumerate(rows):
            code = round(r.pseudorange * 1e3)
            carrier = round((r.carrier - r.pseudorange / wavelength) * 1e3)
            payload += struct.pack(
                "<BBBBIiHbBHBB", k, 0, int(r.sat[1:]), code >> 32, code & 0xFFFFFFFF,
                round(r.doppler * 1e4), carrier & 0xFFFF, carrier >> 16,
                round((r.cn0 - 10.0) * 4.0), 600, 0, 0,
            )  # fmt: skip
        out.append(sbf(4027, payload))
    return out


def _stamp(time: float) -> tuple[int, int]:
    """Return time of week [ms] and week."""
    return round(time % WEEK_S * 1e3), int(time // WEEK_S)


def novatel(number: int, time: float, payload: bytes) -> bytes:
    """Return a binary OEM message."""
    sow, week = _stamp(time)
    head = b"\xaaD\x12" + struct.pack(
        "<BHBBHHBBHIIHH", 28, number, 0, 32, len(payload), 0, 0, 180, week, sow, 0, 0, 0
    )
    crc = zlib.crc32(head + payload, 0xFFFFFFFF) ^ 0xFFFFFFFF
    return head + payload + struct.pack("<I", crc)


def novatel_log(epochs: list[Epoch], ephemerides: list[Any]) -> list[bytes]:
    """Return RANGE and RAWEPHEM messages of GPS L1."""
    out = []
    for name, e in ephemerides:
        frames = b"".join(
            w.to_bytes(3, "big") for number in (1, 2, 3) for w in lnav(e, number, epochs[0][0])
        )
        sow, week = _stamp(epochs[0][0])
        head = struct.pack("<III", int(name[1:]), week, sow // 1000)
        out.append(novatel(41, epochs[0][0], head + frames))
    status = 4 | 1 << 10 | 1 << 11 | 1 << 12 | 1 << 28  # phase, parity and code locked
    for time, rows in epochs:
        payload = struct.pack("<I", len(rows))
        for r in rows:
            payload += struct.pack(
                "<HHdfdffffI", int(r.sat[1:]), 0, r.pseudorange, 0.1, -r.carrier, 0.01,
                r.doppler, r.cn0, 100.0 + time - epochs[0][0], status,
            )  # fmt: skip
        out.append(novatel(43, time, payload))
    return out


def rtcm3(body: bytes) -> bytes:
    """Return an RTCM 3 frame."""
    head = b"\xd3" + len(body).to_bytes(2, "big") + body
    crc = 0
    for byte in head:  # CRC-24Q, bit by bit
        crc ^= byte << 16
        for _ in range(8):
            crc = (crc << 1) ^ (0x1864CFB if crc & 0x800000 else 0)
    return head + crc.to_bytes(3, "big")


def rtcm3_log(observations: str, navigation: str, messages: dict[str, int]) -> list[bytes]:
    """Return the messages RTKLIB encodes: MSM of each epoch by constellation, and ephemerides.

    Parameters
    ----------
    observations, navigation : str
        RINEX.
    messages : mapping of str to int
        MSM number by constellation letter.
    """
    import pyrtklib5 as rtk

    def encoded(message: int, more: int = 0) -> bytes:
        rtk.gen_rtcm3(r, message, 0, more)
        return bytes(r.buff[k] for k in range(r.nbyte))

    obs, nav, station, r = rtk.obs_t(), rtk.nav_t(), rtk.sta_t(), rtk.rtcm_t()
    for file in (navigation, observations):  # the last file's station stays
        rtk.readrnx(file, 1, "", obs, nav, station)
    rtk.sortobs(obs)
    rtk.uniqnav(nav)
    rtk.init_rtcm(r)
    for k in range(3):
        r.sta.pos[k] = station.pos[k]
    r.time = obs.data[0].time
    out = [encoded(1006)]
    for k in range(nav.n):
        if rtk.satsys(nav.eph[k].sat, rtk.Arr1Dint(1)) == rtk.SYS_GPS:
            r.nav.eph[nav.eph[k].sat - 1], r.ephsat = nav.eph[k], nav.eph[k].sat
            out.append(encoded(1019))
    groups: dict[tuple[int, float], list[int]] = {}
    for k in range(obs.n):
        groups.setdefault((obs.data[k].time.time, obs.data[k].time.sec), []).append(k)
    for rows in groups.values():
        r.time, r.obs.n = obs.data[rows[0]].time, len(rows)
        for j, k in enumerate(rows):
            r.obs.data[j] = obs.data[k]
        numbers = list(messages.values())
        out += [encoded(n, more=n != numbers[-1]) for n in numbers]
    return out


def reframed(frame: bytes) -> bytes:
    """Return a frame whose content was changed with a length and a checksum that are right."""
    if frame[:1] == b"\xb5":
        return ubx(frame[2], frame[3], frame[6:-2])
    if frame[:1] == b"$":
        return sbf(int.from_bytes(frame[4:6], "little"), frame[8:])
    if frame[:1] == b"\xd3":
        return rtcm3(frame[3:-3])
    head = frame[:8] + (len(frame) - 32).to_bytes(2, "little") + frame[10:-4]
    return head + struct.pack("<I", zlib.crc32(head, 0xFFFFFFFF) ^ 0xFFFFFFFF)
