"""Simulated weak GNSS: the same spells, the same satellites, for every method that is compared.

What is taken away, and when, is one short text::

    SPEC   = SPELLS [":" KEEP] ["@" SHIFTS]
    SPELLS = DURATION "/" PERIOD     DURATION s at the end of every PERIOD s
           | FROM "-" TO             once, seconds from the beginning of the data; TO may be "end"
    KEEP   = N | N "-" M             N satellites, or a number drawn for each spell; default 0
             ["high" | "low"]        the highest or the lowest ones; default: drawn at random
           | "canyon" [DEGREES]      what a street leaves whose houses rise so high at right
                                     angles to the drive; default 60
    SHIFTS = S {"," S}               moves periodic spells by S s; several: one variant each

``60/180`` is the usual test of 60 s in every 180 s without any GNSS; ``60/180:2-3@0,60,120`` leaves
two or three satellites and covers the whole drive in three variants; ``10-end:2`` leaves two from
second 10 on.

A satellite that is drawn stays for the spell; where it is lost, the next in the order drawn takes
its place, so that N really remain. Observations are marked, never removed. Positions and
velocities that a set carries stand for a full sky and have no place for a mark: they are left out
within spells, and the notes say how many.
"""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...datasets.observations import GnssObservations
from ...datasets.sequence import Sequence
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ...velocity.range_rate import with_elevation
from ...velocity.tracks import Track, tracks

#: What marked observations say.
REASON = "outage (simulated)"
#: Speed below which a drive has no direction; the last one is held [m/s].
_MIN_SPEED = 1.0

_NUMBER = r"\d+(?:\.\d+)?"
_SPEC = re.compile(
    rf"(?:(?P<duration>{_NUMBER})/(?P<period>{_NUMBER})|(?P<start>{_NUMBER})-(?P<end>{_NUMBER}|end))"
    rf"(?::(?:(?P<least>\d+)(?:-(?P<most>\d+))?(?P<order>high|low)?"
    rf"|(?P<canyon>canyon(?P<mask>{_NUMBER})?)))?"
    rf"(?:@(?P<shifts>{_NUMBER}(?:,{_NUMBER})*))?"
)
_EXAMPLES = "for example 60/180, 60/180:2@0,60,120, 60/180:2-3high, 60/180:canyon50 or 10-end:3"


@dataclass(frozen=True)
class Outages:
    """When satellites are taken away, and which are left.

    Parameters
    ----------
    text : str
        As it was written.
    duration, period : float
        Of periodic spells [s]; NaN for a single one.
    start, end : float
        Of a single spell, from the beginning of the data [s]; NaN for periodic ones.
    least, most : int
        Satellites left; equal unless the number is drawn for each spell.
    order : {'random', 'high', 'low', 'canyon'}
        Which ones.
    mask_deg : float
        Of 'canyon': elevation of the houses at right angles to the drive.
    shifts : tuple of float
        One variant each [s].
    """

    text: str
    duration: float = float("nan")
    period: float = float("nan")
    start: float = float("nan")
    end: float = float("nan")
    least: int = 0
    most: int = 0
    order: str = "random"
    mask_deg: float = 60.0
    shifts: tuple[float, ...] = (0.0,)

    @property
    def is_random(self) -> bool:
        """Whether a seed makes a difference."""
        return self.least != self.most or (self.order == "random" and self.most > 0)

    @property
    def keeps_some(self) -> bool:
        """Whether any satellite may be left."""
        return self.order == "canyon" or self.most > 0

    def spells(self, first: float, last: float, earliest: float, shift: float = 0.0) -> FloatArray:
        """Return beginning and end of each spell, shape (k, 2), GPS time [s].

        Parameters
        ----------
        first, last : float
            Of the data [s].
        earliest : float
            Periodic spells that would begin before it are left out; alignment must be complete.
        shift : float
            Of periodic spells [s].

        Raises
        ------
        ConfigError
            If no spell fits, or the single one begins before `earliest`.
        """
        if np.isfinite(self.start):
            begin, stop = first + self.start, min(first + self.end, last)
            if begin < earliest:
                raise ConfigError(
                    f"--outages {self.text}: begins at second {self.start:g}, but the solution "
                    f"begins at second {earliest - first:.1f}: begin later"
                )
            out = np.array([[begin, stop]])[[begin < stop]]
        else:
            count = int(np.ceil((last - first) / self.period)) + 1
            ends = first + shift % self.period + self.period * np.arange(count + 1)
            out = np.column_stack([ends - self.duration, ends])
            out = out[(out[:, 0] >= earliest) & (out[:, 1] <= last)]
        if not out.size:
            raise ConfigError(
                f"--outages {self.text}: no spell fits between second {earliest - first:.1f}, when "
                f"the filter has settled, and the end at second {last - first:.1f}"
            )
        return out


def parse_outages(text: str) -> Outages:
    """Return the outages of a SPEC (see the module).

    Raises
    ------
    ConfigError
        If it is none.
    """
    match = _SPEC.fullmatch(text.strip().replace(" ", ""))
    if match is None:
        raise ConfigError(f"--outages {text}: not understood; {_EXAMPLES}")
    part = match.groupdict()
    values: dict[str, float] = {}
    if part["duration"] is not None:
        values = {"duration": float(part["duration"]), "period": float(part["period"])}
        if not 0.0 < values["duration"] < values["period"]:
            raise ConfigError(
                f"--outages {text}: expected 0 < DURATION < PERIOD, found "
                f"{values['duration']:g}/{values['period']:g}"
            )
    else:
        end = float("inf") if part["end"] == "end" else float(part["end"])
        values = {"start": float(part["start"]), "end": end}
        if not values["start"] < end:
            raise ConfigError(f"--outages {text}: expected FROM before TO; {_EXAMPLES}")
        if part["shifts"]:
            raise ConfigError(f"--outages {text}: only periodic spells can be shifted (@)")
    least = int(part["least"] or 0)
    most = int(part["most"]) if part["most"] else least
    if most < least:
        raise ConfigError(f"--outages {text}: expected N-M with N ≤ M, found {least}-{most}")
    mask = float(part["mask"]) if part["mask"] else 60.0
    if not 0.0 < mask < 90.0:
        raise ConfigError(f"--outages {text}: expected a canyon of 0…90°, found {mask:g}°")
    order = "canyon" if part["canyon"] is not None else part["order"] or "random"
    shifts = tuple(float(s) for s in part["shifts"].split(",")) if part["shifts"] else (0.0,)
    return Outages(
        text, least=least, most=most, order=order, mask_deg=mask, shifts=shifts, **values
    )


def degrade(
    sequence: Sequence,
    spells: FloatArray,
    outages: Outages,
    *,
    seed: int = 0,
    min_cn0_dbhz: float = 35.0,
    elevation_mask_deg: float = 10.0,
) -> Sequence:
    """Return the sequence with GNSS taken away within the spells.

    Parameters
    ----------
    sequence : Sequence
    spells : ndarray, shape (k, 2)
        Beginning (inclusive) and end (exclusive) of each, GPS time [s].
    outages : Outages
        Which satellites are left.
    seed : int
        Of the draw.
    min_cn0_dbhz, elevation_mask_deg : float
        What the run will ask of a satellite: one that will be screened out anyway is not drawn.

    Returns
    -------
    Sequence
        Observations marked with `REASON`; carried fixes left out; both counted in the notes.

    Raises
    ------
    ConfigError
        If satellites are to be left where there are no observations.
    """
    parts: dict[str, object] = {}
    notes = [f"simulated weak GNSS {outages.text}: {len(spells)} spells, seed {seed}"]
    observations = sequence.observations
    if observations is None and outages.keeps_some:
        raise ConfigError(
            f"--outages {outages.text}: leaves satellites, but {sequence.name} has no satellite "
            "observations: leave none, for example 60/180"
        )
    if observations is not None:
        keep = np.zeros(len(observations), dtype=bool)
        if outages.keeps_some:
            keep = _kept(
                sequence, observations, spells, outages, seed, min_cn0_dbhz, elevation_mask_deg
            )
        cut = in_spells(observations.time, spells) & ~keep
        parts["observations"] = observations.mark(cut, REASON)
        notes.append(f"{int((cut & observations.usable).sum())} observations marked '{REASON}'")
    if sequence.fixes is not None:
        cut = in_spells(sequence.fixes.time, spells)
        parts["fixes"] = sequence.fixes.take(~cut)
        notes.append(f"{int(cut.sum())} carried positions left out within spells")
    return dataclasses.replace(sequence, notes=(*sequence.notes, "; ".join(notes)), **parts)  # type: ignore[arg-type]


def in_spells(time: FloatArray, spells: FloatArray) -> NDArray[np.bool_]:
    """Return True where `time` is in a spell, its end excluded, shape (n,)."""
    inside = np.zeros(np.shape(time), dtype=bool)
    for start, end in spells:
        inside |= (time >= start) & (time < end)
    return inside


def _kept(
    sequence: Sequence,
    observations: GnssObservations,
    spells: FloatArray,
    outages: Outages,
    seed: int,
    min_cn0_dbhz: float,
    elevation_mask_deg: float,
) -> NDArray[np.bool_]:
    """Return the observations that stay within spells."""
    where = _whereabouts(sequence)
    pos_e = np.column_stack([np.interp(observations.time, where.time, p) for p in where.pos_e.T])
    seen = with_elevation(observations, pos_e)
    good = seen.has_range_rate & ~(seen.cn0 < min_cn0_dbhz)
    good &= seen.elevation >= np.radians(elevation_mask_deg)
    if outages.order == "canyon":
        across = np.abs(np.sin(seen.azimuth - _course(where, seen.time)))
        houses = np.arctan(np.tan(np.radians(outages.mask_deg)) * across)
        return np.asarray(seen.elevation >= houses)
    keep = np.zeros(len(seen), dtype=bool)
    for number, spell in enumerate(spells):
        rng = np.random.default_rng([seed, number])
        inside = in_spells(seen.time, spell[None])
        rank, count = _order(seen, good & inside, outages, rng)
        chosen = np.flatnonzero(good & inside)
        for time in np.unique(seen.time[chosen]):
            here = chosen[seen.time[chosen] == time]
            best = np.unique(rank[here])[:count]
            keep[here[np.isin(rank[here], best)]] = True
    return keep


def _order(
    seen: GnssObservations, rows: NDArray[np.bool_], outages: Outages, rng: np.random.Generator
) -> tuple[NDArray[np.int64], int]:
    """Return each row's rank among the satellites of a spell, and how many are to stay."""
    count = int(rng.integers(outages.least, outages.most + 1))
    names, member = np.unique(seen.sat[rows], return_inverse=True)
    if outages.order == "random":
        order = rng.permutation(names.size)
    else:
        total = np.bincount(member, seen.elevation[rows], names.size)
        mean = total / np.maximum(np.bincount(member, minlength=names.size), 1)
        order = np.argsort(-mean if outages.order == "high" else mean)
    place = np.empty(names.size, dtype=np.int64)
    place[order] = np.arange(names.size)
    rank = np.full(len(seen), names.size, dtype=np.int64)
    rank[rows] = place[member]
    return rank, count


def _whereabouts(sequence: Sequence) -> Track:
    """Return where the vehicle was, by the best there is; a kilometre would do."""
    known = tracks(sequence)
    found = known.reference or known.gnss or known.coarse
    if found is None:
        raise DataError(
            f"{sequence.name}: no position, so no elevation of satellites to choose by",
            remedy="leave none, for example --outages 60/180",
        )
    return found


def _course(where: Track, time: FloatArray) -> FloatArray:
    """Return the direction of the drive at `time`, the last one held at rest [rad]."""
    course = where.course(_MIN_SPEED)
    moving = np.isfinite(course)
    if not moving.any():
        raise DataError(f"{where.name}: never moves, so there is no street to put houses along")
    last = np.searchsorted(where.time[moving], time, side="right") - 1
    return course[moving][np.maximum(last, 0)]
