"""RINEX, broadcast orbits and single-point positioning through RTKLIB (pyrtklib5).

The only module that touches the binding: arrays go in, arrays come out. Files are tested by
`datasets.rinex` first, because RTKLIB reads a truncated file without complaint.

RTKLIB keeps one signal per frequency band and three bands a satellite; Doppler and C/N0 pass
through single precision (≤ 0.25 mHz, that is 0.05 mm/s, for Dopplers below 4 kHz).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyrtklib5 as rtk
from numpy.typing import ArrayLike, NDArray

from datasets import gpstime
from datasets.rinex import check_navigation, check_observations
from datasets.sequence import GnssFixes, GnssObservations
from filters.earth import SPEED_OF_LIGHT, ecef_to_lla
from filters.errors import ConfigError, DataError
from filters.fault_exclusion import consistent_rows
from filters.rotation import FloatArray

#: RTKLIB's gtime_t counts from the Unix epoch without leap seconds; offset to the GPS epoch [s].
_GPS_EPOCH_GTIME = 315964800
#: Half step of the central difference for satellite velocity and clock drift [s]: truncation
#: 4e-6 m/s, rounding 1e-8 m/s. RTKLIB's own is a 1 ms forward difference, 0.28 mm/s off.
_HALF_STEP = 0.5
_SYSTEMS = {"G": "GPS", "R": "GLONASS", "E": "Galileo", "C": "BeiDou", "J": "QZSS"}
_NAVSYS = {
    "G": rtk.SYS_GPS,
    "R": rtk.SYS_GLO,
    "E": rtk.SYS_GAL,
    "C": rtk.SYS_CMP,
    "J": rtk.SYS_QZS,
}
_IONOSPHERE = {"broadcast": rtk.IONOOPT_BRDC, "off": rtk.IONOOPT_OFF}
_TROPOSPHERE = {"saastamoinen": rtk.TROPOPT_SAAS, "off": rtk.TROPOPT_OFF}


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


@dataclass(frozen=True, eq=False)
class SinglePoint:
    """Single-point positions, and why the other epochs have none.

    Attributes
    ----------
    fixes : GnssFixes
        Antenna positions of quality 'single'; velocity NaN. `fixes.time` is the epoch's, by the
        receiver's clock; the position belongs to `time − clock/c` (ms for some receivers).
    clock : ndarray, shape (n,)
        Receiver clock offset c·δt_r at each fix [m], against GPS time.
    failed : tuple of (float, str)
        Time and reason of each epoch without a solution.
    satellites : tuple of tuple of str
        Satellites used by each fix.
    rejected : tuple of int
        Rows of the observations that the residual test excluded: 'pseudorange residual'.
    """

    fixes: GnssFixes
    clock: FloatArray
    failed: tuple[tuple[float, str], ...]
    satellites: tuple[tuple[str, ...], ...]
    rejected: tuple[int, ...]


def read_observations(
    path: str | Path,
    navigation: Sequence[str | Path],
    *,
    systems: str = "GREC",
    signals: str = "first",
    codes: Sequence[str] = (),
) -> GnssObservations:
    """Return the observations of a RINEX 2 or 3 file with broadcast satellite states attached.

    Parameters
    ----------
    path : path
        Observation file. Doppler is positive when approaching, as RINEX defines it; 0 and blank
        mean missing. BeiDou B1I is reported as '2I', also from RINEX 3.02, which calls it '1I'.
    navigation : sequence of path
        Broadcast ephemerides of the same days, any mixture of RINEX 2 and 3.
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
    nav = _navigation(navigation)
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
    states = _states(nav, number, whole, fraction - travel, by_satellite_clock=True)

    rejected = np.full(number.size, "", dtype="<U20")
    rejected[~states.healthy] = "unhealthy satellite"
    rejected[~np.isfinite(states.clock)] = "no ephemeris"
    rejected[np.isnan(travel)] = "no pseudorange"
    time = whole - _GPS_EPOCH_GTIME + fraction
    if not np.isfinite(states.clock).any():
        _refuse_no_overlap(path, nav, navigation, time)
    names = {int(s): _satellite_name(int(s)) for s in np.unique(number)}
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
    nav = _navigation(navigation)
    sat, time = np.broadcast_arrays(np.asarray(sat, dtype=str), np.asarray(time, dtype=float))
    number_of = {name: rtk.satid2no(str(name)) for name in np.unique(sat)}
    for name, number in number_of.items():
        if number <= 0:
            raise DataError(f"satellite: expected constellation and number ('G05'), found '{name}'")
    numbers = np.array([number_of[name] for name in sat], dtype=np.int64)
    whole = np.floor(time)
    return _states(nav, numbers, whole + _GPS_EPOCH_GTIME, time - whole)


def single_point(
    observations: GnssObservations,
    navigation: Sequence[str | Path],
    *,
    elevation_mask: float = 0.0,
    min_cn0: float = 0.0,
    ionosphere: str = "broadcast",
    troposphere: str = "saastamoinen",
    raim: bool = True,
    significance: float = 1e-3,
    code_sigma: float = 0.9,
) -> SinglePoint:
    """Return single-point positions from the usable rows, epoch by epoch (RTKLIB pntpos).

    Parameters
    ----------
    observations : GnssObservations
        Rejected rows take no part; of several signals of a satellite the first row counts.
    navigation : sequence of path
        Broadcast ephemerides.
    elevation_mask : float
        [rad].
    min_cn0 : float
        [dB-Hz]; rows without C/N0 pass.
    ionosphere : {'broadcast', 'off'}
        Klobuchar model of the navigation file, or none.
    troposphere : {'saastamoinen', 'off'}
    raim : bool
        Test the residuals and exclude faulty satellites (`filters.fault_exclusion`); an epoch
        whose faults cannot be told apart fails as 'inconsistent pseudoranges'. RTKLIB EX itself
        accepts solutions that fail its test.
    significance : float
        Probability that the test accuses a fault-free epoch.
    code_sigma : float
        Pseudorange noise at the zenith, 1σ [m]; it grows by √(1 + 1/sin elevation).

    Returns
    -------
    SinglePoint
        The covariance is that of RTKLIB's weighted least squares, times max(1, chi²/dof) of the
        residuals. It takes as independent and Gaussian: code noise as given (GLONASS ×1.5),
        broadcast accuracy (URA), half of the modelled ionospheric delay (5 m when off), 0.3 m
        at the zenith for the troposphere (3 m when off), and 0.3 m of code bias. Common errors
        (ionosphere, URA over minutes) make successive fixes correlated: averaging them gains
        less than their covariance says. Satellites whose broadcast accuracy is 'no prediction'
        are left out by RTKLIB.
    """
    options = _spp_options(elevation_mask, ionosphere, troposphere, code_sigma)
    engine = _PointEngine(_navigation(navigation), options, observations)
    take = observations.usable & ~(observations.cn0 < min_cn0)
    take &= np.isfinite(observations.pseudorange)
    found: list[_Point] = []
    failed: list[tuple[float, str]] = []
    rejected: list[int] = []
    for time, rows in observations.epochs():
        index = np.flatnonzero(take[rows]) + rows.start
        _, first = np.unique(observations.sat[index], return_index=True)
        index = index[np.sort(first)]
        point = engine.solve(index)
        if raim and isinstance(point, _Point):
            keep = consistent_rows(point.H, point.residuals, point.sigma, significance)
            if keep is None:
                point = "inconsistent pseudoranges"
            elif not keep.all():
                rejected += point.used[~keep].tolist()
                point = engine.solve(point.used[keep])
        if isinstance(point, _Point):
            found.append(point)
        else:
            failed.append((time, point))
    return _single_point(found, failed, rejected, observations)


def troposphere_delay(time: ArrayLike, pos_e: ArrayLike, elevation: ArrayLike) -> FloatArray:
    """Return the Saastamoinen slant delay of the standard atmosphere [m], shape (n,).

    Parameters
    ----------
    time : array_like, shape (n,)
        GPS time [s].
    pos_e : array_like, shape (3,) or (n, 3)
        Receiver [m].
    elevation : array_like, shape (n,)
        [rad].
    """
    time, lla, elevation = _geometry(time, pos_e, elevation)
    position, azel = rtk.Arr1Ddouble(3), rtk.Arr1Ddouble(2)
    out = np.empty(time.size)
    for k in range(time.size):
        position[0], position[1], position[2] = lla[k]
        azel[0], azel[1] = 0.0, elevation[k]
        out[k] = rtk.tropmodel(_gtime(time[k]), position, azel, 0.7)
    return out


def ionosphere_delay(
    navigation: Sequence[str | Path],
    time: ArrayLike,
    pos_e: ArrayLike,
    azimuth: ArrayLike,
    elevation: ArrayLike,
) -> FloatArray:
    """Return the Klobuchar code delay at GPS L1 [m], shape (n,).

    Parameters
    ----------
    navigation : sequence of path
        The first file with GPS coefficients provides them; without any, RTKLIB's default set.
    time, pos_e, elevation
        As for `troposphere_delay`.
    azimuth : array_like, shape (n,)
        Clockwise from north [rad].

    Other frequencies: times (λ/λ_L1)².
    """
    return _klobuchar(_navigation(navigation), time, pos_e, azimuth, elevation)


def _klobuchar(
    nav: Any, time: ArrayLike, pos_e: ArrayLike, azimuth: ArrayLike, elevation: ArrayLike
) -> FloatArray:
    time, lla, azimuth, elevation = _geometry(time, pos_e, azimuth, elevation)
    position, azel = rtk.Arr1Ddouble(3), rtk.Arr1Ddouble(2)
    out = np.empty(time.size)
    for k in range(time.size):
        position[0], position[1], position[2] = lla[k]
        azel[0], azel[1] = azimuth[k], elevation[k]
        out[k] = rtk.ionmodel(_gtime(time[k]), nav.ion_gps, position, azel)
    return out


def _geometry(time: ArrayLike, pos_e: ArrayLike, *angles: ArrayLike) -> list[FloatArray]:
    lla = ecef_to_lla(pos_e)
    arrays = np.broadcast_arrays(
        *(np.asarray(a, dtype=float) for a in (time, *angles)), lla[..., 0]
    )
    n = arrays[0].size
    lla = np.broadcast_to(lla, (n, 3)) if lla.ndim == 1 else lla
    return [np.atleast_1d(arrays[0]), lla.reshape(n, 3), *map(np.atleast_1d, arrays[1:-1])]


def _known_systems(systems: str) -> None:
    for letter in systems:
        if letter not in _SYSTEMS:
            raise ConfigError(
                f"systems: expected letters of {', '.join(f'{k} {v}' for k, v in _SYSTEMS.items())}"
                f", found '{letter}'"
            )


def _gtime(time: float) -> Any:
    out = rtk.gtime_t()
    out.time = int(np.floor(time)) + _GPS_EPOCH_GTIME
    out.sec = float(time - np.floor(time))
    return out


def _satellite_name(number: int) -> str:
    text = rtk.Arr1Dchar(8)
    rtk.satno2id(number, text)
    return text[0]  # the binding returns the string that starts at the index


@functools.lru_cache(maxsize=8)
def _read_navigation(files: tuple[tuple[Path, int, int], ...]) -> Any:
    nav, obs, station = rtk.nav_t(), rtk.obs_t(), rtk.sta_t()
    for path, _, _ in files:
        check_navigation(path)
        before = nav.n + nav.ng
        rtk.readrnx(str(path), 1, "", obs, nav, station)
        if nav.n + nav.ng == before:
            raise DataError("no ephemeris found", file=path, remedy="check the file's content")
    rtk.uniqnav(nav)
    return nav


def _navigation(paths: Sequence[str | Path]) -> Any:
    """Return RTKLIB's nav_t of the files, read once as long as they do not change."""
    if isinstance(paths, (str, Path)):
        paths = [paths]
    if not paths:
        raise DataError("no navigation file given", remedy="name the RINEX broadcast ephemerides")
    for path in paths:
        if not Path(path).is_file():
            raise DataError("navigation file not found", file=path, remedy="check the path")
    stats = [(Path(p).resolve(), Path(p).stat()) for p in paths]
    return _read_navigation(tuple((p, s.st_size, s.st_mtime_ns) for p, s in stats))


def _observation_records(path: Path, systems: str, codes: Sequence[str], bands: int) -> tuple:
    """Return gtime seconds (whole, fraction), satellite, code, P, L, D, C/N0, lock per row."""
    obs, nav, station = rtk.obs_t(), rtk.nav_t(), rtk.sta_t()
    options = " ".join(f"-{code[0]}L{code[1:]}" for code in codes)
    rtk.readrnx(str(path), 1, options, obs, nav, station)
    if obs.n == 0:
        raise DataError("no observations found", file=path, remedy="check the file's content")
    rtk.sortobs(obs)
    wanted = {n for n in range(1, rtk.MAXSAT + 1) if _satellite_name(n)[:1] in systems}
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
    order = np.argsort(table[:, 0] + table[:, 1] - _GPS_EPOCH_GTIME, kind="stable")
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


def _states(
    nav: Any,
    number: NDArray[np.int64],
    whole: FloatArray,
    fraction: FloatArray,
    by_satellite_clock: bool = False,
) -> SatelliteStates:
    """Return states at gtime `whole + fraction` (split, so that no digit is lost).

    `by_satellite_clock`: the times are the satellites' own, the states are of t − δt^s.
    """
    n = number.size
    samples = np.full((n, 3, 4), np.nan)
    healthy = np.zeros(n, dtype=bool)
    state, clock = rtk.Arr1Ddouble(6), rtk.Arr1Ddouble(2)
    variance, health = rtk.Arr1Ddouble(1), rtk.Arr1Dint(1)
    select, at = rtk.gtime_t(), rtk.gtime_t()
    satpos = rtk.satpos
    for k in np.flatnonzero(np.isfinite(fraction)):
        satellite = int(number[k])
        carry = np.floor(fraction[k])
        second, rest = int(whole[k] + carry), float(fraction[k] - carry)
        select.time, select.sec = second, rest
        for j, offset in enumerate((0.0, -_HALF_STEP, _HALF_STEP)):
            at.time, at.sec = second, rest + offset
            if not satpos(at, select, satellite, 0, nav, state, clock, variance, health):
                break
            samples[k, j] = state[0], state[1], state[2], clock[0]
            if j == 0 and by_satellite_clock:
                rest -= clock[0]
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


def _refuse_no_overlap(
    path: Path, nav: Any, navigation: Sequence[str | Path], time: FloatArray
) -> None:
    toe = [nav.eph[k].toe.time for k in range(nav.n)] + [
        nav.geph[k].toe.time for k in range(nav.ng)
    ]
    span = [gpstime.to_calendar(t) for t in (time[0], time[-1])]
    known = [gpstime.to_calendar(t - _GPS_EPOCH_GTIME) for t in (min(toe), max(toe))]
    files = ", ".join(Path(p).name for p in navigation)
    raise DataError(
        f"no ephemeris for any observation: observations {span[0]:%Y-%m-%d %H:%M}…"
        f"{span[1]:%Y-%m-%d %H:%M}, ephemerides {known[0]:%Y-%m-%d %H:%M}…"
        f"{known[1]:%Y-%m-%d %H:%M} ({files})",
        file=path,
        remedy="wrong week or wrong navigation file",
    )


class _Point(NamedTuple):
    """One pntpos solution, linearised: residuals = H·δx + ε for the rows it used."""

    pos_e: FloatArray
    cov_e: FloatArray
    clock: float
    used: NDArray[np.int64]
    H: FloatArray
    residuals: FloatArray
    sigma: FloatArray


class _PointEngine:
    """pntpos with its buffers, fed by rows of the observations."""

    def __init__(self, nav: Any, options: Any, observations: GnssObservations) -> None:
        self._nav, self._options, self._obs = nav, options, observations
        self._number = {s: rtk.satid2no(str(s)) for s in np.unique(observations.sat)}
        self._code = {s: rtk.obs2code(str(s)) for s in np.unique(observations.signal)}
        self._message, self._skyview = rtk.Arr1Dchar(128), rtk.Arr1Ddouble(2 * rtk.MAXOBS)
        self._status = rtk.Arr1Dssat_t(rtk.MAXSAT)

    def solve(self, index: NDArray[np.int64]) -> _Point | str:
        """Return the solution from the rows `index` of one epoch, or why there is none."""
        if not 4 <= index.size <= rtk.MAXOBS:
            return f"{index.size} satellites"
        records = rtk.Arr1Dobsd_t(int(index.size))
        for k, row in enumerate(index):
            self._fill(records[k], row)
        solution = rtk.sol_t()  # position zero: pntpos starts from the Earth's centre
        if not rtk.pntpos(
            records.ptr,
            int(index.size),
            self._nav,
            self._options,
            solution,
            self._skyview,
            self._status.ptr,
            self._message,
        ):
            return self._message[0].strip()
        pos_e = np.array(list(solution.rr)[:3])
        q = np.array(list(solution.qr))  # xx yy zz xy yz zx
        states = [self._status[self._number[self._obs.sat[row]] - 1] for row in index]
        valid = np.array([bool(s.vs) for s in states])
        used = index[valid]
        states = [s for s in states if s.vs]
        residuals = np.array([s.resp[0] for s in states])
        azimuth, elevation = np.array([(s.azel[0], s.azel[1]) for s in states]).T
        sight = self._obs.sat_pos_e[used] - pos_e
        e_e = sight / np.linalg.norm(sight, axis=1, keepdims=True)
        letter = self._obs.sat[used].astype("<U1")
        letter[letter == "J"] = "G"  # QZSS runs on the clock of GPS
        clocks = letter[:, None] == np.unique(letter)
        return _Point(
            pos_e,
            q[[0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(3, 3),
            SPEED_OF_LIGHT * solution.dtr[0],
            used,
            np.column_stack([-e_e, clocks]),
            residuals,
            self._sigma(used, pos_e, azimuth, elevation),
        )

    def _fill(self, record: Any, row: int) -> None:
        """Fill a blank obsd_t with the pseudorange of one row; pntpos needs nothing else."""
        obs = self._obs
        whole = np.floor(obs.time[row])
        record.time.time = int(whole) + _GPS_EPOCH_GTIME
        record.time.sec = float(obs.time[row] - whole)
        record.sat = self._number[obs.sat[row]]
        record.rcv = 1
        record.code[0] = self._code[obs.signal[row]]
        record.P[0] = float(obs.pseudorange[row])
        record.SNR[0] = float(np.nan_to_num(obs.cn0[row]))

    def _sigma(
        self,
        used: NDArray[np.int64],
        pos_e: FloatArray,
        azimuth: FloatArray,
        elevation: FloatArray,
    ) -> FloatArray:
        """Return the 1σ that pntpos gives its pseudoranges [m]; it does not hand them out."""
        obs, options = self._obs, self._options
        sine = np.sin(np.maximum(elevation, np.radians(5.0)))
        system = np.where(np.char.startswith(obs.sat[used], "R"), rtk.EFACT_GLO, 1.0)
        code = system**2 * options.err[1] ** 2 * (1.0 + 1.0 / sine)
        if options.ionoopt == rtk.IONOOPT_OFF:
            ionosphere = np.full(used.size, 5.0)
        else:
            klobuchar = _klobuchar(self._nav, obs.time[used], pos_e, azimuth, elevation)
            ionosphere = 0.5 * klobuchar * (obs.wavelength[used] * rtk.FREQL1 / rtk.CLIGHT) ** 2
        if options.tropopt == rtk.TROPOPT_OFF:
            troposphere = np.full(used.size, 3.0)
        else:
            troposphere = 0.3 / (np.sin(elevation) + 0.1)
        orbit = [self._orbit_variance(row) for row in used]
        return np.sqrt(code + ionosphere**2 + troposphere**2 + 0.3**2 + np.array(orbit))

    def _orbit_variance(self, row: int) -> float:
        state, clock = rtk.Arr1Ddouble(6), rtk.Arr1Ddouble(2)
        variance, health = rtk.Arr1Ddouble(1), rtk.Arr1Dint(1)
        time = _gtime(self._obs.time[row])
        number = self._number[self._obs.sat[row]]
        rtk.satpos(time, time, number, rtk.EPHOPT_BRDC, self._nav, state, clock, variance, health)
        return variance[0]


def _spp_options(
    elevation_mask: float, ionosphere: str, troposphere: str, code_sigma: float
) -> Any:
    for name, value, known in (
        ("ionosphere", ionosphere, _IONOSPHERE),
        ("troposphere", troposphere, _TROPOSPHERE),
    ):
        if value not in known:
            raise ConfigError(f"{name}: expected one of {', '.join(known)}, found {value!r}")
    if not 0.0 <= elevation_mask < np.pi / 2 or not code_sigma > 0.0:
        raise ConfigError(
            "single point: expected elevation_mask in [0, π/2) rad and code_sigma > 0 m, "
            f"found {elevation_mask!r} and {code_sigma!r}"
        )
    options = rtk.prcopt_t()
    options.mode = rtk.PMODE_SINGLE
    options.nf = 1
    options.navsys = sum(_NAVSYS.values())
    options.elmin = elevation_mask
    options.sateph = rtk.EPHOPT_BRDC
    options.ionoopt = _IONOSPHERE[ionosphere]
    options.tropopt = _TROPOSPHERE[troposphere]
    # code σ² = eratio² (err[1]² + err[2]²/sin(el)); RTKLIB's own 300 × 3 mm is 0.9 m
    options.eratio[0] = 1.0
    options.err[0], options.err[1], options.err[2] = 100.0, code_sigma, code_sigma
    return options


def _single_point(
    points: list[_Point],
    failed: list[tuple[float, str]],
    rejected: list[int],
    observations: GnssObservations,
) -> SinglePoint:
    n = len(points)
    factor = np.ones(n)
    for k, point in enumerate(points):
        dof = len(point.used) - np.linalg.matrix_rank(point.H)
        if dof > 0:
            factor[k] = max(1.0, np.sum((point.residuals / point.sigma) ** 2) / dof)
    cov_e = np.array([p.cov_e for p in points], dtype=float).reshape(n, 3, 3)
    fixes = GnssFixes(
        time=np.array([observations.time[p.used[0]] for p in points], dtype=float),
        pos_e=np.array([p.pos_e for p in points], dtype=float).reshape(n, 3),
        pos_cov_e=cov_e * factor[:, None, None],
        vel_e=np.full((n, 3), np.nan),
        vel_cov_e=np.full((n, 3, 3), np.nan),
        satellites=np.array([len(p.used) for p in points], dtype=np.int64),
        quality=np.full(n, "single"),
    )
    return SinglePoint(
        fixes,
        np.array([p.clock for p in points], dtype=float),
        tuple(failed),
        tuple(tuple(map(str, observations.sat[p.used])) for p in points),
        tuple(rejected),
    )
