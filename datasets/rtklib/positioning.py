"""Single-point positions: RTKLIB's pntpos with a residual test that excludes faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyrtklib5 as rtk
from numpy.typing import NDArray

from ...filters.earth import SPEED_OF_LIGHT
from ...filters.errors import ConfigError
from ...filters.fault_exclusion import consistent_rows
from ...filters.rotation import FloatArray
from ..observations import GnssFixes, GnssObservations
from .atmosphere import klobuchar
from .persistence import Persistent, persistent_faults
from .satellites import GPS_EPOCH_GTIME, gtime, load_navigation

_NAVSYS = (rtk.SYS_GPS, rtk.SYS_GLO, rtk.SYS_GAL, rtk.SYS_CMP, rtk.SYS_QZS)
_IONOSPHERE = {"broadcast": rtk.IONOOPT_BRDC, "off": rtk.IONOOPT_OFF}
_TROPOSPHERE = {"saastamoinen": rtk.TROPOPT_SAAS, "off": rtk.TROPOPT_OFF}


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
    persistent : tuple of Persistent
        Satellites wrong by the same amount all the time, which that test has let pass.
    """

    fixes: GnssFixes
    clock: FloatArray
    failed: tuple[tuple[float, str], ...]
    satellites: tuple[tuple[str, ...], ...]
    rejected: tuple[int, ...]
    persistent: tuple[Persistent, ...] = ()


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
    weak_sigma: float = 0.0,
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
    weak_sigma : float
        What reflections add at 45 dB-Hz, 1σ [m]: tenfold at 25 dB-Hz, no less above. A signal
        that is weak has met something on its way.

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
    engine = _PointEngine(load_navigation(navigation), options, observations, weak_sigma)
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


#: C/N0 of a signal that nothing weakens [dB-Hz].
_STRONG = 45.0


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

    def __init__(
        self, nav: Any, options: Any, observations: GnssObservations, weak_sigma: float = 0.0
    ) -> None:
        self._nav, self._options, self._obs = nav, options, observations
        self._weak_sigma = weak_sigma
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
        point = _Point(
            pos_e,
            q[[0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(3, 3),
            SPEED_OF_LIGHT * solution.dtr[0],
            used,
            np.column_stack([-e_e, clocks]),
            residuals,
            self._sigma(used, pos_e, azimuth, elevation),
        )
        return point if self._weak_sigma == 0.0 else self._reweighted(point, letter)

    def _reweighted(self, point: _Point, letter: NDArray[np.str_]) -> _Point:
        """Return the solution with weak signals weighted down: one more step from RTKLIB's.

        RTKLIB knows a weight by C/N0 too, but takes C/N0 from the epoch before.
        """
        lost = np.maximum(_STRONG - np.nan_to_num(self._obs.cn0[point.used], nan=_STRONG), 0.0)
        sigma = np.hypot(point.sigma, self._weak_sigma * 10.0 ** (lost / 20.0))
        weighted = point.H / sigma[:, None]
        inverse = np.linalg.pinv(weighted)
        step = inverse @ (point.residuals / sigma)
        gps = int(np.argmax(np.unique(letter) == "G"))
        return point._replace(
            pos_e=point.pos_e + step[:3],
            cov_e=(inverse @ inverse.T)[:3, :3],
            clock=point.clock + float(step[3 + gps]),
            residuals=point.residuals - point.H @ step,
            sigma=sigma,
        )

    def _fill(self, record: Any, row: int) -> None:
        """Fill a blank obsd_t with the pseudorange of one row; pntpos needs nothing else."""
        obs = self._obs
        whole = np.floor(obs.time[row])
        record.time.time = int(whole) + GPS_EPOCH_GTIME
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
            at_l1 = klobuchar(self._nav, obs.time[used], pos_e, azimuth, elevation)
            ionosphere = 0.5 * at_l1 * (obs.wavelength[used] * rtk.FREQL1 / rtk.CLIGHT) ** 2
        if options.tropopt == rtk.TROPOPT_OFF:
            troposphere = np.full(used.size, 3.0)
        else:
            troposphere = 0.3 / (np.sin(elevation) + 0.1)
        orbit = [self._orbit_variance(row) for row in used]
        return np.sqrt(code + ionosphere**2 + troposphere**2 + 0.3**2 + np.array(orbit))

    def _orbit_variance(self, row: int) -> float:
        state, clock = rtk.Arr1Ddouble(6), rtk.Arr1Ddouble(2)
        variance, health = rtk.Arr1Ddouble(1), rtk.Arr1Dint(1)
        time = gtime(self._obs.time[row])
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
    options.navsys = sum(_NAVSYS)
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
    satellites = tuple(tuple(map(str, observations.sat[p.used])) for p in points)
    return SinglePoint(
        fixes,
        np.array([p.clock for p in points], dtype=float),
        tuple(failed),
        satellites,
        tuple(rejected),
        persistent_faults(
            satellites,
            [p.H for p in points],
            [p.residuals for p in points],
            [p.sigma for p in points],
        ),
    )
