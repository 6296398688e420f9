"""Positions relative to a base station: RTKLIB's post-processing, fixed and float."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyrtklib5 as rtk
from numpy.typing import ArrayLike

from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ..observations import GnssFixes, GnssObservations
from ..text.orbit_products import is_product
from ..text.rinex import check_observations
from ..text.rinex_repair import readable_rinex
from .base import OwnMean, base_position, own_mean, refuse_no_position
from .common_signals import (
    Tracked,
    common_bands,
    refuse_no_overlap,
    refuse_nothing_in_common,
    tracked,
)
from .observations import _known_systems
from .postpos import AMBIGUITIES, DIRECTIONS, post_processed, relative_options
from .satellites import load_navigation
from .screened_rinex import write_screened

#: Lower bounds of a position's standard deviation [m], added in variance to RTKLIB's own on every
#: axis. Fixed: phase multipath and the antenna's phase centre, which RTKLIB's 4 mm leaves out.
#: Float: its error is that of smoothed code and stays for minutes, while RTKLIB's deviation
#: shrinks as if epochs were independent. DGPS: code multipath.
FLOORS_M = {"fixed": 0.015, "float": 0.5, "dgps": 1.5}
#: How fast a position gets worse without a new epoch of the base, 1σ per axis [m/s]: satellite
#: clocks wander by 3·10⁻¹² over half a minute, 1 mm/s of range, and geometry doubles it.
_AGEING = 2e-3


@dataclass(frozen=True, eq=False)
class RelativePositions:
    """Positions relative to a base station, and why the other epochs have none.

    Attributes
    ----------
    fixes : GnssFixes
        Antenna positions of quality 'fixed', 'float' or 'dgps', in the base position's datum;
        velocity NaN. `fixes.time` is GPS time, the receiver's clock taken off.
    failed : tuple of (float, str)
        Time by the receiver's clock and reason of each epoch of the rover without a solution.
    base_pos_e : ndarray, shape (3,)
        Where the base antenna was taken to be [m].
    base_source : str
        Who says so.
    ratio : ndarray, shape (n,)
        Of each position, the ratio of the second-best to the best integer ambiguities; 0 where
        none were looked for.
    systems : str
    frequencies : int
        Constellations and bands used.
    base_own : OwnMean or None
        Where the base's own pseudoranges have it.
    """

    fixes: GnssFixes
    failed: tuple[tuple[float, str], ...]
    base_pos_e: FloatArray
    base_source: str
    ratio: FloatArray
    systems: str
    frequencies: int
    base_own: OwnMean | None


def relative_positions(
    rover: str | Path,
    base: str | Path | Sequence[str | Path],
    navigation: Sequence[str | Path],
    *,
    base_pos_e: ArrayLike | None = None,
    elevation_mask: float = np.radians(10.0),
    systems: str = "",
    frequencies: int = 0,
    ambiguities: str = "continuous",
    direction: str = "forward",
    min_ratio: float = 3.0,
    max_age: float = 30.0,
    screened: GnssObservations | None = None,
) -> RelativePositions:
    """Return real-time-kinematic positions of a rover, epoch by epoch (RTKLIB postpos).

    Parameters
    ----------
    rover : path
        RINEX observations with carrier phase.
    base : path or sequence of path
        RINEX observations of one base station; several files, as quarter hours, are joined.
    navigation : sequence of path
        Broadcast ephemerides.
    base_pos_e : array_like, shape (3,), optional
        Antenna of the base [m]. Default: APPROX POSITION XYZ of its file plus the antenna's
        height and offset; what that position is off, every position is off.
    elevation_mask : float
        [rad].
    systems : str
        Constellation letters, as in `read_observations`; '': those rover and base share.
    frequencies : int
        Bands used, 1 (L1/E1/B1/G1) to 3; 0: those rover and base share.
    ambiguities : {'continuous', 'hold', 'off'}
        Integers fixed epoch by epoch, also fed back to the filter, or not fixed at all.
    direction : {'forward', 'backward', 'combined'}
        Ambiguities carried on in time, back from the end, or both: positions that are fixed both
        ways and contradict each other are then float. All but 'forward' know the future.
    min_ratio : float
        Ratio of the second-best to the best integer solution from which the best counts as fixed.
    max_age : float
        Largest age of the base's observations [s].
    screened : GnssObservations, optional
        The rover's observations, screened: only satellites with a usable row take part, epoch
        by epoch. RTKLIB itself does not test code residuals. RINEX 3 only.

    Returns
    -------
    RelativePositions
        Covariances are RTKLIB's plus `FLOORS_M`² on every axis, and (2 mm/s of the base's age)².
        Float positions are correlated
        over minutes, and a wrongly fixed one is decimetres to metres off whatever its
        covariance says: a gate downstream is needed.

    Raises
    ------
    DataError
        A missing or damaged file, a base without position, no common time.
    """
    rover, bases = Path(rover), _paths(base)
    navigation = _paths(navigation)
    _known_systems(systems)
    if (
        ambiguities not in AMBIGUITIES
        or direction not in DIRECTIONS
        or not 0 <= frequencies <= rtk.NFREQ
        or not min_ratio >= 1.0
    ):
        raise ConfigError(
            "RTK: expected ambiguities continuous, hold or off, direction forward, backward or "
            "combined, up to 3 frequencies and a ratio ≥ 1, found "
            f"{ambiguities!r}, {direction!r}, {frequencies!r} and {min_ratio!r}"
        )
    if not bases:
        raise DataError("no base station file given", remedy="name its RINEX observations")
    load_navigation(navigation)
    # Over a base's distance broadcasts are as good as any orbit.
    navigation = [file for file in navigation if not is_product(file)]
    for file in (rover, *bases):
        check_observations(file)
    known = base_position(bases[0], base_pos_e)
    here, there = tracked([rover]), tracked(bases)
    refuse_no_overlap((rover, bases[0]), here, there, max_age)
    letters, bands = common_bands(here, there, systems or "GREJC")
    if not letters:
        refuse_nothing_in_common((rover, bases[0]), systems or "GREJC")
    bands = min(frequencies or bands, bands)
    options = relative_options(
        elevation_mask, letters, bands, min_ratio, max_age, ambiguities, direction
    )
    plain = readable_rinex(rover).path
    given, navigation = ([readable_rinex(f).path for f in files] for files in (bases, navigation))
    own = own_mean(given, navigation, (float(there.time[0]), float(there.time[-1])))
    if known is None:
        refuse_no_position(bases[0], own)
    assert known is not None
    position_e, source = known
    for k in range(3):
        options.rb[k] = float(position_e[k])
    with tempfile.TemporaryDirectory(prefix="certnav-rtk-") as scratch:
        if screened is not None:
            left = Path(scratch) / "screened.rnx"
            write_screened(plain, left, screened)
            plain = left
        found = post_processed(Path(scratch), [[plain], given], navigation, options)
    keep = np.isin(found.fixes.quality, list(FLOORS_M))
    fixes = _with_floors(found.fixes.take(keep), found.age[keep])
    failed = _unsolved(here, there, fixes, max_age)
    return RelativePositions(
        fixes, failed, position_e, source, found.ratio[keep], letters, bands, own
    )


def _with_floors(fixes: GnssFixes, age: FloatArray) -> GnssFixes:
    if not len(fixes):
        return fixes
    floor = np.array([FLOORS_M[str(q)] for q in fixes.quality])
    variance = floor**2 + (_AGEING * age) ** 2
    cov_e = fixes.pos_cov_e + variance[:, None, None] * np.eye(3)
    return dataclasses.replace(fixes, pos_cov_e=cov_e)


def _paths(files: str | Path | Sequence[str | Path]) -> list[Path]:
    return [Path(files)] if isinstance(files, str | Path) else [Path(f) for f in files]


def _unsolved(
    rover: Tracked, base: Tracked, fixes: GnssFixes, max_age: float
) -> tuple[tuple[float, str], ...]:
    """Return the rover's epochs without a position, and why."""
    epochs, satellites, base_epochs = rover.time, rover.satellites, base.time
    solved = np.zeros(epochs.size, dtype=bool)
    if len(fixes):  # fixes are at GPS time, epochs at the receiver's: ms apart
        half = 0.5 * float(np.min(np.diff(epochs))) if epochs.size > 1 else 0.5
        place = np.clip(np.searchsorted(fixes.time, epochs), 1, max(len(fixes) - 1, 1))
        near = np.minimum(
            np.abs(fixes.time[place - 1] - epochs),
            np.abs(fixes.time[np.minimum(place, len(fixes) - 1)] - epochs),
        )
        solved = near < half
    before = np.searchsorted(base_epochs, epochs + 0.01, side="right") - 1
    age = np.where(before >= 0, epochs - base_epochs[np.maximum(before, 0)], np.inf)
    out = []
    for k in np.flatnonzero(~solved):
        if age[k] > max_age:
            why = "no base observations"
        elif satellites[k] < 4:
            why = "too few satellites"
        else:
            why = "no solution against the base"
        out.append((float(epochs[k]), why))
    return tuple(out)
