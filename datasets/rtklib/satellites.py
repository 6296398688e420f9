"""Broadcast ephemerides and the satellite states RTKLIB makes of them."""

from __future__ import annotations

import functools
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyrtklib5 as rtk
from numpy.typing import ArrayLike, NDArray

from ...filters.earth import SPEED_OF_LIGHT
from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ..text.orbit_products import check_product, is_product
from ..text.rinex import check_navigation
from ..text.rinex_repair import readable_rinex
from .file_names import harmless_name

#: RTKLIB's gtime_t counts from the Unix epoch without leap seconds; offset to the GPS epoch [s].
GPS_EPOCH_GTIME = 315964800
#: Half step of the central difference for satellite velocity and clock drift [s]: truncation
#: 4e-6 m/s, rounding 1e-8 m/s. RTKLIB's own is a 1 ms forward difference, 0.28 mm/s off.
_HALF_STEP = 0.5
#: No broadcast clock is off by so much [s], or so fast [s/s]: they are a thousand times better.
_CLOCK, _CLOCK_DRIFT = 1.0, 1e-6


class SatelliteStates(NamedTuple):
    """Broadcast satellite states; NaN rows where there is no ephemeris.

    Attributes
    ----------
    pos_e, vel_e : ndarray, shape (n, 3)
        In the ECEF axes of the given instant [m], [m/s].
    clock, clock_drift : ndarray, shape (n,)
        c·δt^s [m], relativity included, group delay not, and its rate [m/s].
    healthy : ndarray of bool, shape (n,)
        False where the broadcast says unhealthy or where there is no ephemeris.
    """

    pos_e: FloatArray
    vel_e: FloatArray
    clock: FloatArray
    clock_drift: FloatArray
    healthy: NDArray[np.bool_]


def satellite_states(
    navigation: Sequence[str | Path], sat: ArrayLike, time: ArrayLike
) -> SatelliteStates:
    """Return broadcast satellite states at transmission times.

    Parameters
    ----------
    navigation : sequence of path
        RINEX navigation files.
    sat : array_like of str, shape (n,)
        'G05' …
    time : array_like, shape (n,)
        Transmission time, GPS time [s]. Its float64 step of 0.24 µs is worth 1 mm of orbit.

    Notes
    -----
    Position and clock come from RTKLIB; velocity and clock drift are their central difference
    over ±0.5 s with the ephemeris held, exact to 4e-6 m/s. The drift therefore contains the
    relativistic rate.
    """
    nav = load_navigation(navigation)
    sat, time = np.broadcast_arrays(np.asarray(sat, dtype=str), np.asarray(time, dtype=float))
    number_of = {name: rtk.satid2no(str(name)) for name in np.unique(sat)}
    for name, number in number_of.items():
        if number <= 0:
            raise DataError(f"satellite: expected constellation and number ('G05'), found '{name}'")
    numbers = np.array([number_of[name] for name in sat], dtype=np.int64)
    whole = np.floor(time)
    return states_at(nav, numbers, whole + GPS_EPOCH_GTIME, time - whole)


def gtime(time: float) -> Any:
    out = rtk.gtime_t()
    out.time = int(np.floor(time)) + GPS_EPOCH_GTIME
    out.sec = float(time - np.floor(time))
    return out


def satellite_name(number: int) -> str:
    text = rtk.Arr1Dchar(8)
    rtk.satno2id(number, text)
    return text[0]  # the binding returns the string that starts at the index


def load_navigation(paths: Sequence[str | Path]) -> Any:
    """Return RTKLIB's nav_t of the files, read once as long as they do not change.

    Precise products (SP3 orbits, RINEX clocks, antennas) may be among them, beside broadcasts: then
    satellites are where these have them, and those they do not have have no ephemeris.
    """
    if isinstance(paths, (str, Path)):
        paths = [paths]
    if not paths:
        raise DataError("no navigation file given", remedy="name the RINEX broadcast ephemerides")
    if all(Path(path).is_file() and is_product(path) for path in paths):
        raise DataError(
            "precise orbits or clocks without broadcast ephemerides, which tell the time of "
            "transmission, health and group delays",
            file=paths[0],
            remedy="give the navigation file of that day as well",
        )
    for path in paths:
        if not Path(path).is_file():
            raise DataError("navigation file not found", file=path, remedy="check the path")
    stats = [(Path(p).resolve(), Path(p).stat()) for p in paths]
    return _read_navigation(tuple((p, s.st_size, s.st_mtime_ns) for p, s in stats))


@functools.lru_cache(maxsize=8)
def _read_navigation(files: tuple[tuple[Path, int, int], ...]) -> Any:
    nav, obs, station = rtk.nav_t(), rtk.obs_t(), rtk.sta_t()
    products = [path for path, _, _ in files if is_product(path)]
    _read_products(nav, products)
    for path, _, _ in files:
        if path in products:
            continue
        check_navigation(path)
        known = nav.n, nav.ng
        with harmless_name(readable_rinex(path).path) as name:
            rtk.readrnx(name, 1, "", obs, nav, station)
        if (nav.n, nav.ng) == known:
            raise DataError("no ephemeris found", file=path, remedy="check the file's content")
        _refuse_absurd(nav, *known, path)
    rtk.uniqnav(nav)
    return nav


def load_products(files: Sequence[Path]) -> Any:
    """Return RTKLIB's nav_t of precise products alone: SP3, RINEX clocks, antennas (ANTEX)."""
    nav = rtk.nav_t()
    _read_products(nav, files)
    return nav


def _read_products(nav: Any, files: Sequence[Path]) -> None:
    antennas = rtk.pcvs_t()
    for path in files:
        if not path.is_file():
            raise DataError("no such file", file=path, remedy="check data.precise")
        kind, known = check_product(path), (nav.ne, nav.nc, antennas.n)
        # RTKLIB goes by the ending of the name.
        with tempfile.TemporaryDirectory(prefix="certnav-") as folder:
            copy = Path(folder) / f"product.{kind}"
            shutil.copyfile(path, copy)
            if kind == "sp3":
                rtk.readsp3(str(copy), nav, 0)
            elif kind == "clk":
                rtk.readrnxc(str(copy), nav)
            else:
                rtk.readpcv(str(copy), antennas)
        if (nav.ne, nav.nc, antennas.n) == known:
            raise DataError(
                "no orbit, clock or antenna found", file=path, remedy="check the file's content"
            )
    if not nav.ne:
        return
    at = nav.peph[nav.ne // 2].time.time
    for k in range(antennas.n):
        antenna = antennas.pcv[k]
        begin, end = antenna.ts.time, antenna.te.time  # 0: open
        if antenna.sat and begin <= at and (at <= end or not end):
            nav.pcvs[antenna.sat - 1] = antenna


def ephemerides_used(nav: Any) -> int:
    """Return RTKLIB's choice of ephemerides: precise where there are orbits, else broadcast."""
    return rtk.EPHOPT_PREC if nav.ne else rtk.EPHOPT_BRDC


def _refuse_absurd(nav: Any, first: int, first_glonass: int, path: Path) -> None:
    """Refuse clocks that are none: RTKLIB would integrate a GLONASS orbit for years."""
    kepler = [nav.eph[k] for k in range(first, nav.n)]
    glonass = [nav.geph[k] for k in range(first_glonass, nav.ng)]
    clocks = [(e.sat, e.f0, e.f1) for e in kepler] + [(e.sat, e.taun, e.gamn) for e in glonass]
    for satellite, bias, drift in clocks:
        if not (abs(bias) < _CLOCK and abs(drift) < _CLOCK_DRIFT):
            raise DataError(
                f"ephemeris of {satellite_name(satellite)}: expected a clock off by less than "
                f"{_CLOCK:g} s, found {bias:.3g} s and {drift:.3g} s/s",
                file=path,
                remedy="the file is damaged: copy or convert it again",
            )


def states_at(
    nav: Any,
    number: NDArray[np.int64],
    whole: FloatArray,
    fraction: FloatArray,
    by_satellite_clock: bool = False,
) -> SatelliteStates:
    """Return states at gtime `whole + fraction` (split, so that no digit is lost).

    Of the precise ephemerides where `nav` holds some, which say nothing of health. With
    `by_satellite_clock` the times are the satellites' own: the states are of t − δt^s.
    """
    n = number.size
    samples = np.full((n, 3, 4), np.nan)
    healthy = np.zeros(n, dtype=bool)
    state, clock = rtk.Arr1Ddouble(6), rtk.Arr1Ddouble(2)
    variance, health = rtk.Arr1Ddouble(1), rtk.Arr1Dint(1)
    select, at = rtk.gtime_t(), rtk.gtime_t()
    satpos, source = rtk.satpos, ephemerides_used(nav)
    nothing = rtk.Arr1Ddouble(6), rtk.Arr1Ddouble(2), rtk.Arr1Ddouble(1)
    for k in np.flatnonzero(np.isfinite(fraction)):
        satellite = int(number[k])
        carry = np.floor(fraction[k])
        second, rest = int(whole[k] + carry), float(fraction[k] - carry)
        select.time, select.sec = second, rest
        for j, offset in enumerate((0.0, -_HALF_STEP, _HALF_STEP)):
            at.time, at.sec = second, rest + offset
            if not satpos(at, select, satellite, source, nav, state, clock, variance, health):
                break
            samples[k, j] = state[0], state[1], state[2], clock[0]
            if j == 0 and by_satellite_clock:
                rest -= clock[0]
            if j == 0 and source != rtk.EPHOPT_BRDC:  # which know nothing of health
                satpos(at, select, satellite, rtk.EPHOPT_BRDC, nav, *nothing, health)
            healthy[k] = health[0] == 0
    samples[~np.isfinite(samples).all((1, 2))] = np.nan
    healthy &= np.isfinite(samples[:, 0, 0])
    rate = (samples[:, 2] - samples[:, 1]) / (2.0 * _HALF_STEP)
    centre = samples[:, 0]
    if by_satellite_clock:  # the first sample is δt^s ≤ 1 ms late; its curvature is 0.3 µm
        centre = centre - rate * centre[:, 3:]
    centre[:, 3] *= SPEED_OF_LIGHT
    rate[:, 3] *= SPEED_OF_LIGHT
    return SatelliteStates(centre[:, :3], rate[:, :3], centre[:, 3], rate[:, 3], healthy)
