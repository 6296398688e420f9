"""Precise products: a recording's satellite states from SP3 orbits and clock files.

    observations, note = precise_observations(observations, ["igs21771.sp3", "igs21771.clk"])

They take the place of the broadcast states, for Doppler and velocities; broadcast ones stay where
the products have none, and so does what the broadcast says of health. Single-point positions use
them where they are among the navigation files, and leave out satellites without: the products'
clocks count from another instant than the broadcast ones, metres off.

An SP3 file has the satellite's centre of mass, 1 to 3 m behind the antenna that sends. A file of
antennas (ANTEX) among the products puts that right; without, ranges are a metre off one another.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyrtklib5 as rtk
from numpy.typing import NDArray

from ...filters.earth import SPEED_OF_LIGHT
from ...filters.errors import DataError
from ..observations import GnssObservations
from .satellites import GPS_EPOCH_GTIME, load_products, states_at

#: Broadcast orbits are metres off, their clock rates millimetres a second. So much apart, one of
#: both is of another day or damaged [m], [m/s].
_APART, _APART_RATE = 200.0, 0.5


def precise_observations(
    observations: GnssObservations, files: Sequence[str | Path]
) -> tuple[GnssObservations, str]:
    """Return the observations with satellite states of precise products, and what was replaced.

    Parameters
    ----------
    observations : GnssObservations
        With broadcast states.
    files : sequence of path
        SP3 orbits (a, c or d), one or more; RINEX clock files, which are optional: an SP3 file has
        clocks, too, but fewer; ANTEX, optional.

    Raises
    ------
    DataError
        A file that is none of these, damaged, of another time, or far from the broadcast orbits.
    """
    paths = [Path(file) for file in files]
    nav, names = load_products(paths), ", ".join(path.name for path in paths)
    if not nav.ne:
        raise DataError(
            "no orbits: clocks alone are no ephemerides",
            file=files[0],
            remedy="name an SP3 file, too",
        )
    number = np.array([rtk.satid2no(str(sat)) for sat in observations.sat], dtype=np.int64)
    travel = observations.pseudorange / SPEED_OF_LIGHT
    whole = np.floor(observations.time)
    states = states_at(
        nav, number, whole + GPS_EPOCH_GTIME, observations.time - whole - travel,
        by_satellite_clock=True,
    )  # fmt: skip
    # RTKLIB has exactly no clock where the products have none.
    known = np.isfinite(states.pos_e).all(1) & (states.clock != 0.0)
    if not known.any():
        raise DataError(
            "precise ephemerides of none of the satellites at the time of the observations "
            f"({names})",
            file=files[0],
            remedy="wrong day, or fewer than eleven epochs around the drive",
        )
    both = known & np.isfinite(observations.sat_pos_e).all(1)
    apart = np.linalg.norm(states.pos_e - observations.sat_pos_e, axis=1)[both]
    rates = np.abs(states.clock_drift - observations.sat_clock_drift)[both]
    if both.any() and (np.median(apart) > _APART or np.nanmedian(rates) > _APART_RATE):
        raise DataError(
            f"precise orbits lie {np.median(apart):.3g} m from the broadcast ones, their clocks "
            f"run {np.nanmedian(rates):.2g} m/s apart ({names})",
            file=files[0],
            remedy="of another day, or damaged",
        )
    replaced = dataclasses.replace(
        observations,
        sat_pos_e=np.where(known[:, None], states.pos_e, observations.sat_pos_e),
        sat_vel_e=np.where(known[:, None], states.vel_e, observations.sat_vel_e),
        sat_clock=np.where(known, states.clock, observations.sat_clock),
        sat_clock_drift=np.where(known, states.clock_drift, observations.sat_clock_drift),
    )
    antennas = sum(nav.pcvs[k].sat > 0 for k in range(rtk.MAXSAT))
    kind = f"antennas of {antennas} satellites" if antennas else "of centres of mass: no ANTEX"
    share = f"{int(known.sum())} of {known.size} rows, else broadcast"
    return replaced, (
        f"satellites from precise ephemerides ({names}; {kind}) in {share}"
        + _without(observations.sat, known)
    )


def _without(sat: NDArray[np.str_], known: NDArray[np.bool_]) -> str:
    """Return which satellites the products lack, throughout or for a while."""
    has, lacks = set(sat[known].tolist()), set(sat[~known].tolist())
    said = ""
    for names, words in ((lacks - has, "none of"), (lacks & has, "not always of")):
        said += f"; {words} {', '.join(sorted(names))}" if names else ""
    return said
