"""What rover and base have in common: time, constellations and frequency bands."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyrtklib5 as rtk
from numpy.typing import NDArray

from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from .. import gpstime
from ..text.rinex_repair import readable_rinex
from .file_names import harmless_name
from .satellites import GPS_EPOCH_GTIME, satellite_name


@dataclass(frozen=True, eq=False)
class Tracked:
    """What a receiver tracked.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Its epochs [s].
    satellites : ndarray of int, shape (n,)
        How many it saw in each.
    phases : frozenset of (str, int)
        Satellites and RTKLIB's frequency bands, from 0, of which it has ranges and phases.
    """

    time: FloatArray
    satellites: NDArray[np.int64]
    phases: frozenset[tuple[str, int]]


def tracked(files: Iterable[Path]) -> Tracked:
    """Return what observation files hold, which have been checked."""
    obs, nav, station = rtk.obs_t(), rtk.nav_t(), rtk.sta_t()
    files = list(files)
    for file in files:
        with harmless_name(readable_rinex(file).path) as name:
            rtk.readrnx(name, 1, "", obs, nav, station)
    if obs.n == 0:
        raise DataError("no observations found", file=files[0], remedy="check the file's content")
    data = obs.data
    times = np.empty(obs.n)
    phases: set[tuple[int, int]] = set()
    for k in range(obs.n):
        record = data[k]
        at = record.time
        times[k] = at.time - GPS_EPOCH_GTIME + at.sec
        carrier, code, satellite = record.L, record.P, record.sat
        phases |= {(satellite, b) for b in range(rtk.NFREQ) if carrier[b] and code[b]}
    rtk.freeobs(obs)
    time, satellites = np.unique(times, return_counts=True)
    names = {number: satellite_name(number) for number, _ in phases}
    return Tracked(time, satellites, frozenset((names[n], band) for n, band in phases))


def common_bands(rover: Tracked, base: Tracked, systems: str) -> tuple[str, int]:
    """Return the constellations both have phases of, and how many of RTKLIB's bands that takes.

    Bands are L1/E1/B1/G1, L2/E5b/B2/G2, L5/E5a/B2a …; RTKLIB uses the first so many.

    Parameters
    ----------
    rover, base : Tracked
    systems : str
        Constellation letters to choose from.
    """
    shared = [(name, band) for name, band in rover.phases & base.phases if name[0] in systems]
    letters = "".join(letter for letter in systems if any(n[0] == letter for n, _ in shared))
    return letters, 1 + max((band for _, band in shared), default=-1)


def refuse_no_overlap(
    files: tuple[Path, Path], rover: Tracked, base: Tracked, max_age: float
) -> None:
    """Refuse a base station of another time than the rover's; `files` are rover and base."""
    if rover.time[0] <= base.time[-1] + max_age and base.time[0] <= rover.time[-1]:
        return
    spans = [
        f"{gpstime.to_calendar(t[0]):%Y-%m-%d %H:%M:%S}…{gpstime.to_calendar(t[-1]):%H:%M:%S}"
        for t in (rover.time, base.time)
    ]
    raise DataError(
        f"no time in common: rover {spans[0]} ({files[0].name}), base {spans[1]}",
        file=files[1],
        remedy="name the base file of the same time",
    )


def refuse_nothing_in_common(files: tuple[Path, Path], systems: str) -> None:
    """Refuse a rover and a base without a phase in common."""
    raise DataError(
        f"no carrier phase in common with the rover ({files[0].name}) in {systems}: neither "
        "satellites nor bands",
        file=files[1],
        remedy="a base with carrier phases of the rover's constellations; or gnss.systems",
    )
