"""NMEA 0183 logs as fixes: positions from GGA or GNS, with GST, RMC, VTG and ZDA where there are.

Time is UTC: the time of day of each sentence, on the date of RMC or ZDA. Heights are above the
geoid, with the separation beside them or declared. Speed and course (RMC, VTG) come without an
accuracy, and nothing tells the vertical velocity: they are read where σ is declared, with zero
for the velocity down.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import date, time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...filters.earth import C_en_at, lla_to_ecef
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from .. import gpstime
from ..observations import GnssFixes
from .nmea_sentences import FIRST_DAY, Calendar, messages, number, time_of_day, zda_date
from .receiver_logs import VERTICAL_SPEED, covariance, of_damaged

#: GGA quality; 6 and 7 are estimated and typed in, and no fixes of satellites.
_QUALITY = {1: "single", 2: "dgps", 3: "pps", 4: "fixed", 5: "float", 8: "simulated"}
_NO_FIX = (0, 6, 7)
#: GNS, one letter a constellation: the best of them is the fix's.
_MODES = {"R": "fixed", "F": "float", "P": "pps", "D": "dgps", "A": "single"}
_KNOT = 1852.0 / 3600.0
#: Slower than this a receiver may have no course [m/s]: it stands.
_AT_REST = 0.1


class _Place(NamedTuple):
    lat: float
    lon: float
    height: float
    separation: float
    satellites: int
    quality: str
    talker: str


@dataclass
class _Epochs:
    """What the sentences of a log say, by Unix time [s]."""

    places: dict[float, _Place] = field(default_factory=dict)
    deviations: dict[float, tuple[float, ...]] = field(default_factory=dict)
    #: Speed [m/s] and course [rad].
    motions: dict[float, tuple[float, float]] = field(default_factory=dict)
    left_out: Counter[str] = field(default_factory=Counter)


def read_nmea(
    path: str | Path,
    *,
    position_sigma: FloatArray | None = None,
    velocity_sigma: FloatArray | None = None,
    geoid: float | None = None,
) -> tuple[GnssFixes, tuple[str, ...]]:
    """Return the positions of an NMEA log, and velocities where their σ is declared.

    Parameters
    ----------
    path : path
    position_sigma : array_like, shape (1,) or (3,), optional
        1σ north, east, up [m] for positions without a GST sentence. Required if there are any.
    velocity_sigma : array_like, shape (1,) or (3,), optional
        1σ north, east, down [m/s] of speed and course; a single one is of north and east, and
        down has 1 m/s. Without, they are left out.
    geoid : float, optional
        Height of the geoid above the ellipsoid [m], instead of the receiver's separation.
        Required if no sentence has one.

    Returns
    -------
    fixes : GnssFixes
    notes : tuple of str

    Raises
    ------
    DataError
        No positions, no date (RMC or ZDA), or the package pynmeagps is not installed.
    ConfigError
        Positions without a deviation or without a geoid separation, and none declared.
    """
    path = Path(path)
    damaged: list[str] = []
    epochs = _Reading().of(messages(path, damaged), path)
    places, left_out = epochs.places, epochs.left_out
    if not places:
        why = "; ".join(f"{n} {what}" for what, n in left_out.items()) or "none at all"
        raise DataError(
            f"no GGA or GNS sentence with a fix found ({why})",
            file=path,
            remedy="enable GGA in the receiver: RMC holds no height",
        )
    stamps = sorted(places)
    lat, lon = np.radians([(places[t].lat, places[t].lon) for t in stamps]).T
    C_en = C_en_at(lat, lon)
    separation, of_geoid = _separations(path, stamps, places, geoid)
    sigma, of_sigma = _deviations(path, stamps, epochs.deviations, position_sigma)
    vel_n, vel_sigma, of_velocity = _velocities(stamps, epochs.motions, velocity_sigma)
    fixes = GnssFixes(
        time=gpstime.from_unix(np.array(stamps)),
        pos_e=lla_to_ecef(lat, lon, np.array([places[t].height for t in stamps]) + separation),
        pos_cov_e=covariance(C_en, sigma),
        vel_e=np.einsum("nij,nj->ni", C_en, vel_n),
        vel_cov_e=covariance(C_en, vel_sigma),
        satellites=np.array([places[t].satellites for t in stamps]),
        quality=np.array([places[t].quality for t in stamps]),
    )
    counted = ", ".join(f"{n} {what}" for what, n in left_out.items() if n)
    return fixes, (
        f"NMEA, {path.name}: {len(stamps)} positions; sentences left out: {counted or 'none'}; "
        f"{of_sigma}; {of_geoid}; {of_velocity}" + of_damaged(damaged),
    )


def _separations(
    path: Path, stamps: list[float], places: dict[float, _Place], geoid: float | None
) -> tuple[FloatArray, str]:
    """Return the geoid's height above the ellipsoid at each position, and a note."""
    if geoid is not None:
        return np.full(len(stamps), geoid), f"heights raised by {geoid:g} m, as declared (geoid_m)"
    told = np.array([places[t].separation for t in stamps])
    known = np.isfinite(told)
    if not known.any():
        raise ConfigError(
            f"{path}: none of {told.size} positions tells the geoid separation — add under [gnss]: "
            "geoid_m = 47.0  # height of the geoid above the ellipsoid there"
        )
    note = "heights raised by the geoid separation of the sentences"
    if not known.all():  # it changes by less than a metre over ten kilometres
        note += f" ({int((~known).sum())} without: as at the nearest time)"
        told = np.interp(stamps, np.array(stamps)[known], told[known])
    if not told.any():
        note += ", which is 0.0 throughout: if the receiver does not know it, declare geoid_m"
    return told, note


def _deviations(
    path: Path,
    stamps: list[float],
    told: dict[float, tuple[float, ...]],
    declared: FloatArray | None,
) -> tuple[FloatArray, str]:
    sigma = np.array([told.get(t, (np.nan,) * 3) for t in stamps])
    bare = ~np.isfinite(sigma).all(axis=1)
    if bare.any():
        if declared is None:
            raise ConfigError(
                f"{path}: {int(bare.sum())} of {bare.size} positions come without GST — add under "
                "[gnss]: position_sigma_m = [2.0, 2.0, 4.0]"
            )
        sigma[bare] = declared
    n = int(bare.sum())
    return sigma, f"deviations of {bare.size - n} from GST, of {n} as declared"


def _velocities(
    stamps: list[float], motions: dict[float, tuple[float, float]], declared: FloatArray | None
) -> tuple[FloatArray, FloatArray, str]:
    """Return velocities north, east, down, their deviations, and a note."""
    n = len(stamps)
    nothing = np.full((n, 3), np.nan)
    if not motions:
        return nothing, nothing, "no speed and course (RMC, VTG)"
    if declared is None:
        return nothing, nothing, (
            f"{len(motions)} speeds and courses left out, for they have no σ: declare "
            "velocity_sigma_mps = 0.2 under [gnss] to use them"
        )  # fmt: skip
    speed, course = np.array([motions.get(t, (np.nan, np.nan)) for t in stamps]).T
    vel_n = np.column_stack([speed * np.cos(course), speed * np.sin(course), 0.0 * speed])
    down = declared[2] if len(declared) == 3 else max(float(declared[0]), VERTICAL_SPEED)
    sigma = np.tile([declared[0], declared[1 % len(declared)], down], (n, 1))
    sigma[np.isnan(speed)] = np.nan
    found = int(np.isfinite(speed).sum())
    return vel_n, sigma, f"{found} velocities from speed and course, zero down with σ {down:g} m/s"


class _Reading:
    """One pass over the sentences of a log, in the order of the file."""

    def __init__(self) -> None:
        self._epochs = _Epochs()
        self._clock = Calendar()
        self._waiting: list[Any] = []  # sentences before the first date
        self._at: float | None = None  # time of day of the last sentence that has one
        self._vtg: Any = None  # velocity without a time, before the sentence it belongs to
        self._vtg_first: bool | None = None

    def of(self, messages: Iterator[Any], path: Path) -> _Epochs:
        for m in messages:
            if m.msgID == "VTG":
                self._velocity_without_time(m)
            elif isinstance(getattr(m, "time", None), time):
                self._timed(m)
        if self._waiting and not self._clock.known:
            raise DataError(
                "no date found (RMC or ZDA sentence)",
                file=path,
                remedy="enable RMC in the receiver",
            )
        return self._epochs

    def _timed(self, m: Any) -> None:
        if self._vtg_first is None:
            self._vtg_first = False
        self._at = time_of_day(m)
        if m.msgID in ("RMC", "ZDA"):
            day = getattr(m, "date", None) if m.msgID == "RMC" else zda_date(m)
            if isinstance(day, date) and day >= FIRST_DAY:
                self._clock.set(day, self._at)
        self._waiting.append((m, self._at))
        if self._vtg is not None:
            self._waiting.append((self._vtg, self._at))
            self._vtg = None
        self._release()

    def _velocity_without_time(self, m: Any) -> None:
        """Give VTG the time of the sentence before it, or after it where epochs begin with VTG."""
        if self._vtg_first is None:
            self._vtg_first = True
        if self._vtg_first:
            self._vtg = m
        elif self._at is not None:
            self._waiting.append((m, self._at))
            self._release()

    def _release(self) -> None:
        if not self._clock.known:
            return
        for m, of_day in self._waiting:
            at = self._clock.unix(of_day)
            if m.msgID in ("GGA", "GNS"):
                self._place(m, at)
            elif m.msgID == "GST":
                values = [number(m, key) for key in ("stdLat", "stdLong", "stdAlt")]
                if all(v > 0.0 for v in values):
                    self._epochs.deviations[at] = tuple(values)
            elif m.msgID in ("RMC", "VTG"):
                self._motion(m, at)
        self._waiting.clear()

    def _place(self, m: Any, at: float) -> None:
        left_out, places = self._epochs.left_out, self._epochs.places
        satellites = number(m, "numSV")
        quality = _quality(m)
        if not quality or satellites == 0:
            left_out["without a fix"] += 1
            return
        lat, lon, height = (number(m, key) for key in ("lat", "lon", "alt"))
        if not math.isfinite(lat + lon + height):
            left_out["without latitude, longitude or height"] += 1
            return
        place = _Place(
            *(lat, lon, height, number(m, "sep")),
            satellites=int(satellites) if math.isfinite(satellites) else -1,
            quality=quality,
            talker=f"{m.msgID}{m.talker}",
        )
        other = places.get(at)
        if other is not None:
            left_out["of a time there is already (repeated, or of another talker)"] += 1
            if _rank(other.talker) >= _rank(place.talker):
                return
        places[at] = place

    def _motion(self, m: Any, at: float) -> None:
        if m.msgID == "RMC":
            if getattr(m, "status", "") != "A":
                return
            speed, course = number(m, "spd") * _KNOT, number(m, "cog")
        else:
            speed, course = number(m, "sogk") / 3.6, number(m, "cogt")
            if math.isnan(speed):
                speed = number(m, "sogn") * _KNOT
            if at in self._epochs.motions:
                return
        if speed < _AT_REST and math.isnan(course):
            course = 0.0
        if math.isfinite(speed + course):
            self._epochs.motions[at] = speed, math.radians(course)


def _rank(talker: str) -> int:
    """Return which of two sentences of one time counts: of all constellations, and GGA first."""
    return 2 * (talker[3:] == "GN") + (talker[:3] == "GGA")


def _quality(m: Any) -> str:
    """Return the kind of fix, '' if there is none."""
    if m.msgID == "GNS":
        modes = str(getattr(m, "posMode", ""))
        return next((word for letter, word in _MODES.items() if letter in modes), "")
    quality = number(m, "quality")
    if not math.isfinite(quality) or int(quality) in _NO_FIX:
        return ""
    return _QUALITY.get(int(quality), f"Q={int(quality)}")
