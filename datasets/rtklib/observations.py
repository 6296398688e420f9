"""RINEX observations with the satellites' states attached."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyrtklib5 as rtk
from numpy.typing import NDArray

from ...filters.earth import SPEED_OF_LIGHT
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from .. import gpstime
from ..observations import GnssObservations
from ..text.orbit_products import is_product
from ..text.rinex import check_observations
from ..text.rinex_repair import readable_rinex
from .file_names import harmless_name
from .satellites import GPS_EPOCH_GTIME, load_navigation, satellite_name, states_at

_SYSTEMS = {"G": "GPS", "R": "GLONASS", "E": "Galileo", "C": "BeiDou", "J": "QZSS"}


def read_observations(
    path: str | Path,
    navigation: Sequence[str | Path],
    *,
    systems: str = "GREJC",
    signals: str = "first",
    codes: Sequence[str] = (),
) -> GnssObservations:
    """Return the observations of a RINEX 2, 3 or 4 file with broadcast satellite states attached.

    Parameters
    ----------
    path : path
        Observation file. Doppler is positive when approaching, as RINEX defines it; 0 and blank
        mean missing. BeiDou B1I is reported as '2I', also from RINEX 3.02, which calls it '1I'.
    navigation : sequence of path
        Broadcast ephemerides of the same days, any mixture of RINEX 2, 3 and 4. Precise products
        among them are left to `precise_observations`.
    systems : str
        Constellation letters to keep: G GPS, R GLONASS, E Galileo, C BeiDou, J QZSS.
    signals : {'first', 'all'}
        One row per satellite, its L1/E1/B1/G1 signal, or one per frequency band.
    codes : sequence of str
        Signals to read instead of RTKLIB's choice within their band (GPS 1C before 1P, Galileo
        1C before 1B before 1X, …), as 'E1B'. Such a band then has that signal or nothing.

    Returns
    -------
    GnssObservations
        Satellite states at transmission, t_rx − P/c − δt^s. Rows that cannot be used are
        rejected with 'no ephemeris', 'unhealthy satellite' or 'no pseudorange'.

    Raises
    ------
    DataError
        Missing, truncated or garbled file; no ephemeris for any observation.
    """
    if signals not in ("first", "all"):
        raise ConfigError(f"signals: expected 'first' or 'all', found {signals!r}")
    _known_systems(systems)
    broadcast = [file for file in navigation if not (Path(file).is_file() and is_product(file))]
    nav = load_navigation(broadcast or navigation)
    path = Path(path)
    check_observations(path)
    records = _observation_records(path, systems, codes, 1 if signals == "first" else rtk.NFREQ)
    whole, fraction, number, code, pseudorange, carrier, doppler, cn0, lock = records
    frequency = np.array(
        [rtk.sat2freq(int(s), int(c), nav) for s, c in zip(number, code, strict=True)]
    )
    # A GLONASS channel is known from the ephemeris only; without it the row is rejected anyway.
    known = frequency > 0.0
    wavelength = SPEED_OF_LIGHT / np.where(known, frequency, rtk.FREQ1_GLO)
    travel = _satellite_pseudorange(whole + fraction, number, pseudorange) / SPEED_OF_LIGHT
    states = states_at(nav, number, whole, fraction - travel, by_satellite_clock=True)

    rejected = np.full(number.size, "", dtype="<U20")
    rejected[~states.healthy] = "unhealthy satellite"
    rejected[~np.isfinite(states.clock)] = "no ephemeris"
    rejected[np.isnan(travel)] = "no pseudorange"
    time = whole - GPS_EPOCH_GTIME + fraction
    if not np.isfinite(states.clock).any():
        _refuse_no_overlap(path, nav, navigation, time)
    names = {int(s): satellite_name(int(s)) for s in np.unique(number)}
    signal_names = {int(c): rtk.code2obs(int(c)) for c in np.unique(code)}
    nothing = np.full(number.size, np.nan)
    return GnssObservations(
        time=time,
        sat=np.array([names[int(s)] for s in number], dtype="<U3"),
        signal=np.array([signal_names[int(c)] for c in code], dtype="<U2"),
        wavelength=wavelength,
        pseudorange=pseudorange,
        carrier=carrier,
        range_rate=np.where(known, -wavelength * doppler, np.nan),
        cn0=cn0,
        loss_of_lock=lock,
        sat_pos_e=states.pos_e,
        sat_vel_e=states.vel_e,
        sat_clock=states.clock,
        sat_clock_drift=states.clock_drift,
        elevation=nothing,
        azimuth=nothing,
        rejected=rejected,
    )


def _known_systems(systems: str) -> None:
    for letter in systems:
        if letter not in _SYSTEMS:
            raise ConfigError(
                f"systems: expected letters of {', '.join(f'{k} {v}' for k, v in _SYSTEMS.items())}"
                f", found '{letter}'"
            )


def _observation_records(path: Path, systems: str, codes: Sequence[str], bands: int) -> tuple:
    """Return gtime seconds (whole, fraction), satellite, code, P, L, D, C/N0, lock per row."""
    obs, nav, station = rtk.obs_t(), rtk.nav_t(), rtk.sta_t()
    options = " ".join(f"-{code[0]}L{code[1:]}" for code in codes)
    with harmless_name(readable_rinex(path).path) as name:
        rtk.readrnx(name, 1, options, obs, nav, station)
    if obs.n == 0:
        raise DataError("no observations found", file=path, remedy="check the file's content")
    rtk.sortobs(obs)
    wanted = {n for n in range(1, rtk.MAXSAT + 1) if satellite_name(n)[:1] in systems}
    rows = []
    data = obs.data
    for k in range(obs.n):
        record = data[k]
        satellite = record.sat
        if satellite not in wanted:
            continue
        time, code = record.time, record.code
        P, L, D, S, lock = record.P, record.L, record.D, record.SNR, record.LLI
        for b in range(bands):
            if code[b]:
                rows.append(
                    (time.time, time.sec, satellite, code[b], P[b], L[b], D[b], S[b], lock[b])
                )
    rtk.freeobs(obs)
    if not rows:
        wished = ", ".join(_SYSTEMS[letter] for letter in systems)
        raise DataError(f"no observations of {wished}", file=path, remedy="ask for other systems")
    table = np.array(rows, dtype=float)
    order = np.argsort(table[:, 0] + table[:, 1] - GPS_EPOCH_GTIME, kind="stable")
    columns = table[order].T
    integers = [columns[i].astype(np.int64) for i in (2, 3, 8)]
    measured = [np.where(columns[i] == 0.0, np.nan, columns[i]) for i in (4, 5, 6, 7)]
    return (columns[0], columns[1], *integers[:2], *measured, integers[2])


def _satellite_pseudorange(
    time: FloatArray, satellite: NDArray[np.int64], pseudorange: FloatArray
) -> FloatArray:
    """Return one pseudorange per satellite and epoch, so that all its signals share one state."""
    key = np.stack([time, satellite], axis=1)
    _, group = np.unique(key, axis=0, return_inverse=True)
    known = np.flatnonzero(np.isfinite(pseudorange))[::-1]  # the first signal is written last
    shared = np.full(int(group.max()) + 1, np.nan)
    shared[group[known]] = pseudorange[known]
    return shared[group]


def _refuse_no_overlap(
    path: Path, nav: Any, navigation: Sequence[str | Path], time: FloatArray
) -> None:
    toe = [nav.eph[k].toe.time for k in range(nav.n)] + [
        nav.geph[k].toe.time for k in range(nav.ng)
    ]
    span = [_date(t) for t in (time[0], time[-1])]
    known = [_date(t - GPS_EPOCH_GTIME) for t in (min(toe), max(toe))]
    files = ", ".join(Path(p).name for p in navigation)
    raise DataError(
        f"no ephemeris for any observation: observations {span[0]}…{span[1]}, "
        f"ephemerides {known[0]}…{known[1]} ({files})",
        file=path,
        remedy="wrong week or wrong navigation file",
    )


def _date(time: float) -> str:
    """Return a date for a message; damaged ephemerides may hold any."""
    try:
        return f"{gpstime.to_calendar(time):%Y-%m-%d %H:%M}"
    except OverflowError:
        return f"GPS second {time:.4g}"
