"""Simulated weak GNSS: the same spells, the same satellites, for everyone who is to be compared.

A satellite that is drawn stays for the spell; where it is lost, the next in the order drawn takes
its place, so that N really remain. Observations are marked, never removed. Positions and
velocities that a set carries stand for a full sky and have no place for a mark: they are left out
within spells, and the notes say how many.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence as Listing

import numpy as np
from numpy.typing import NDArray

from ...datasets.observations import GnssObservations
from ...datasets.sequence import Sequence
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ...velocity.range_rate import with_elevation
from ...velocity.tracks import Track, tracks
from .outages import Outages, Spell, in_spells

#: What marked observations say.
REASON = "outage (simulated)"
#: Speed below which a drive has no direction; the last one is held [m/s].
_MIN_SPEED = 1.0


def degrade(
    sequence: Sequence,
    spells: Listing[Spell],
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
    spells : sequence of Spell
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


def _kept(
    sequence: Sequence,
    observations: GnssObservations,
    spells: Listing[Spell],
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
        inside = in_spells(seen.time, [spell])
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
