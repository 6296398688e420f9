"""Positions relative to a base station: RTKLIB's postpos, kinematic, fixed and float."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyrtklib5 as rtk
from numpy.typing import ArrayLike, NDArray

from ...filters.earth import C_en_of
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from .. import gpstime
from ..formats.rtklib_pos import read_pos
from ..observations import GnssFixes, GnssObservations
from ..text import rinex_header as header
from ..text.rinex import check_observations
from ..text.rinex_repair import readable_rinex
from .file_names import harmless_name
from .observations import _known_systems
from .satellites import GPS_EPOCH_GTIME, load_navigation
from .screened_rinex import write_screened

#: Lower bounds of a position's standard deviation [m], added in variance to RTKLIB's own on every
#: axis. Fixed: phase multipath and the antenna's phase centre, which RTKLIB's 4 mm leaves out.
#: Float: its error is that of smoothed code and stays for minutes, while RTKLIB's deviation
#: shrinks as if epochs were independent. DGPS: code multipath.
FLOORS_M = {"fixed": 0.015, "float": 0.5, "dgps": 1.5}
_NAVSYS = {
    "G": rtk.SYS_GPS, "R": rtk.SYS_GLO, "E": rtk.SYS_GAL, "C": rtk.SYS_CMP, "J": rtk.SYS_QZS
}  # fmt: skip
_HOLD = {"continuous": rtk.ARMODE_CONT, "hold": rtk.ARMODE_FIXHOLD, "off": rtk.ARMODE_OFF}


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
    """

    fixes: GnssFixes
    failed: tuple[tuple[float, str], ...]
    base_pos_e: FloatArray
    base_source: str


def relative_positions(
    rover: str | Path,
    base: str | Path | Sequence[str | Path],
    navigation: Sequence[str | Path],
    *,
    base_pos_e: ArrayLike | None = None,
    elevation_mask: float = np.radians(10.0),
    systems: str = "GREC",
    frequencies: int = 1,
    ambiguities: str = "continuous",
    min_ratio: float = 3.0,
    max_age: float = 30.0,
    screened: GnssObservations | None = None,
) -> RelativePositions:
    """Return real-time-kinematic positions of a rover, epoch by epoch (RTKLIB postpos, forward).

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
        Constellation letters, as in `read_observations`.
    frequencies : int
        Bands used, 1 (L1/E1/B1/G1) to 3.
    ambiguities : {'continuous', 'hold', 'off'}
        Integers fixed epoch by epoch, also fed back to the filter, or not fixed at all.
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
        Covariances are RTKLIB's plus `FLOORS_M`² on every axis. Float positions are correlated
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
    if ambiguities not in _HOLD or not 1 <= frequencies <= rtk.NFREQ or not min_ratio >= 1.0:
        raise ConfigError(
            "RTK: expected ambiguities continuous, hold or off, 1 to 3 frequencies and a ratio "
            f"≥ 1, found {ambiguities!r}, {frequencies!r} and {min_ratio!r}"
        )
    if not bases:
        raise DataError("no base station file given", remedy="name its RINEX observations")
    load_navigation(navigation)
    for file in (rover, *bases):
        check_observations(file)
    position_e, source = _base_position(bases[0], base_pos_e)
    epochs, satellites = _epochs([rover])
    base_epochs, _ = _epochs(bases)
    _refuse_no_overlap(rover, bases[0], epochs, base_epochs, max_age)
    rover = readable_rinex(rover).path
    bases, navigation = ([readable_rinex(f).path for f in files] for files in (bases, navigation))
    options = _options(elevation_mask, systems, frequencies, min_ratio, max_age)
    options.modear = _HOLD[ambiguities]
    options.refpos, options.rovpos = rtk.POSOPT_POS_XYZ, rtk.POSOPT_POS_XYZ
    for k in range(3):
        options.rb[k] = float(position_e[k])
    with tempfile.TemporaryDirectory(prefix="certnav-rtk-") as scratch:
        taken = Path(scratch) / "rover.obs"
        if screened is None:
            shutil.copyfile(rover, taken)
        else:
            write_screened(rover, taken, screened)
        fixes = _postpos(taken, bases, navigation, options)
    failed = _unsolved(epochs, satellites, base_epochs, fixes, max_age)
    return RelativePositions(fixes, failed, position_e, source)


def _paths(files: str | Path | Sequence[str | Path]) -> list[Path]:
    return [Path(files)] if isinstance(files, str | Path) else [Path(f) for f in files]


def _base_position(file: Path, declared: ArrayLike | None) -> tuple[FloatArray, str]:
    """Return the base's antenna [m] and where that comes from."""
    if declared is not None:
        position, source = np.asarray(declared, dtype=float), "declared"
        if position.shape != (3,):
            raise ConfigError(f"base position: expected X, Y, Z in metres, found {declared!r}")
        remedy, line = "give ECEF X, Y, Z in metres", None
    else:
        position, line = _header_position(file)
        source, remedy = f"APPROX POSITION of {file.name}", "declare the base's position"
    if not 6.3e6 < np.linalg.norm(position) < 6.5e6:
        raise DataError(
            f"base position {np.round(position, 3)} m is not on the Earth",
            file=file, line=line, remedy=remedy,
        )  # fmt: skip
    return position, source


def _header_position(file: Path) -> tuple[FloatArray, int]:
    """Return the antenna's position from a RINEX header, and the line it stands in."""
    marker, line, offset = None, 0, np.zeros(3)
    with file.open(encoding="latin-1") as stream:
        for number, text in enumerate(stream, start=1):
            label = header.split(text)[1]
            if label == "END OF HEADER":
                break
            if label not in ("APPROX POSITION XYZ", "ANTENNA: DELTA H/E/N"):
                continue
            try:
                value = np.array([float(text[14 * k : 14 * k + 14]) for k in range(3)])
            except ValueError:
                raise DataError(
                    f"{label}: expected three numbers, found '{text[:42].strip()}'",
                    file=file, line=number,
                ) from None  # fmt: skip
            if label.startswith("APPROX"):
                marker, line = value, number
            else:
                offset = value
    if marker is None or not marker.any():
        raise DataError(
            "no position of the base station: its header has no APPROX POSITION XYZ",
            file=file,
            remedy="declare the base's ECEF position in metres",
        )
    if np.linalg.norm(marker) < 6e6:  # refused by the caller
        return marker, line
    up, east, north = offset
    return marker + C_en_of(marker) @ np.array([north, east, -up]), line


def _epochs(files: list[Path]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the epochs of observation files [s] and how many satellites each has."""
    obs, nav, station = rtk.obs_t(), rtk.nav_t(), rtk.sta_t()
    for file in files:
        with harmless_name(readable_rinex(file).path) as name:
            rtk.readrnx(name, 1, "", obs, nav, station)
    if obs.n == 0:
        raise DataError("no observations found", file=files[0], remedy="check the file's content")
    data = obs.data
    times = [data[k].time for k in range(obs.n)]
    time = np.array([t.time - GPS_EPOCH_GTIME + t.sec for t in times])
    rtk.freeobs(obs)
    return np.unique(time, return_counts=True)


def _refuse_no_overlap(
    rover: Path, base: Path, epochs: FloatArray, base_epochs: FloatArray, max_age: float
) -> None:
    if epochs[0] <= base_epochs[-1] + max_age and base_epochs[0] <= epochs[-1]:
        return
    spans = [
        f"{gpstime.to_calendar(t[0]):%Y-%m-%d %H:%M:%S}…{gpstime.to_calendar(t[-1]):%H:%M:%S}"
        for t in (epochs, base_epochs)
    ]
    raise DataError(
        f"no time in common: rover {spans[0]} ({rover.name}), base {spans[1]}",
        file=base,
        remedy="name the base file of the same time",
    )


def _options(
    elevation_mask: float,
    systems: str,
    frequencies: int,
    min_ratio: float,
    max_age: float,
) -> Any:
    """Return RTKLIB's options: kinematic, broadcast orbits, no model of the motion.

    Without a motion model an epoch owes to the earlier ones its ambiguities only; the inertial
    filter downstream has a better model than RTKLIB's constant acceleration.
    """
    options = _copied(rtk.prcopt_t(), rtk.prcopt_default)
    options.mode, options.dynamics = rtk.PMODE_KINEMA, 0
    options.navsys = sum(_NAVSYS[letter] for letter in systems)
    options.nf = frequencies
    options.elmin = elevation_mask
    options.sateph = rtk.EPHOPT_BRDC
    options.ionoopt, options.tropopt = rtk.IONOOPT_BRDC, rtk.TROPOPT_SAAS
    options.thresar[0] = min_ratio
    options.maxtdiff = max_age
    options.glomodear = 0  # inter-channel biases between receivers of two makers
    options.bdsmodear = 1
    options.outsingle = 0
    return options


def _copied(target: Any, default: Any) -> Any:
    """Return `target` with the numbers of `default`, which is shared and must not be edited."""
    for name in dir(default):
        value = getattr(default, name)
        if name.startswith("_") or name == "ptr":
            continue
        if isinstance(value, int | float):
            setattr(target, name, value)
        elif name in ("err", "eratio", "std", "prn", "thresar", "maxinno", "sep"):
            array = getattr(target, name)
            for k in range(1 if name == "sep" else len(value)):
                array[k] = value[k]
    return target


def _postpos(rover: Path, bases: list[Path], navigation: list[Path], options: Any) -> GnssFixes:
    """Run RTKLIB in the rover copy's folder: names with % and * would be patterns to it."""
    scratch = rover.parent
    for k, file in enumerate(bases):
        shutil.copyfile(file, scratch / f"base{k:04d}.obs")
    for k, file in enumerate(navigation):
        shutil.copyfile(file, scratch / f"navigation{k:04d}.nav")
    # One pattern, one receiver: RTKLIB takes every further name for another receiver.
    names = [str(rover), str(scratch / "base*.obs")]
    names += [str(scratch / f"navigation{k:04d}.nav") for k in range(len(navigation))]
    out = scratch / "solution.pos"
    form = _copied(rtk.solopt_t(), rtk.solopt_default)
    form.posf, form.times, form.timef, form.timeu = rtk.SOLF_XYZ, rtk.TIMES_GPST, 0, 6
    form.outhead, form.sstat, form.trace = 1, 0, 0
    status = rtk.postpos(
        rtk.gtime_t(), rtk.gtime_t(), 0.0, 0.0, options, form, rtk.filopt_t(), names, len(names),
        str(out), "", "",
    )  # fmt: skip
    if status != 0 or not out.is_file():
        raise DataError("RTKLIB gave up on these files", file=rover, remedy="run rnx2rtkp on them")
    if not any(line[:1].isdigit() for line in out.read_text().replace(" ", "").splitlines()):
        none = np.empty((0, 3)), np.empty((0, 3, 3))
        count, quality = np.empty(0, dtype=np.int64), np.empty(0, dtype="U8")
        return GnssFixes(np.empty(0), *none, *none, count, quality)
    fixes = read_pos(out)
    fixes = fixes.take(np.isin(fixes.quality, list(FLOORS_M)))
    floor = np.array([FLOORS_M[str(q)] for q in fixes.quality])
    cov_e = fixes.pos_cov_e + floor[:, None, None] ** 2 * np.eye(3)
    return GnssFixes(
        fixes.time, fixes.pos_e, cov_e, fixes.vel_e, fixes.vel_cov_e, fixes.satellites,
        fixes.quality,
    )  # fmt: skip


def _unsolved(
    epochs: FloatArray,
    satellites: NDArray[np.int64],
    base_epochs: FloatArray,
    fixes: GnssFixes,
    max_age: float,
) -> tuple[tuple[float, str], ...]:
    """Return the rover's epochs without a position, and why."""
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
