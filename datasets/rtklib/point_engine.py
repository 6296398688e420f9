"""RTKLIB's pntpos for one epoch, linearised, with what its pseudoranges are worth."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pyrtklib5 as rtk
from numpy.typing import NDArray

from ...filters.earth import SPEED_OF_LIGHT
from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray
from ..observations import GnssObservations
from .atmosphere import klobuchar
from .satellites import GPS_EPOCH_GTIME, gtime

_NAVSYS = (rtk.SYS_GPS, rtk.SYS_GLO, rtk.SYS_GAL, rtk.SYS_CMP, rtk.SYS_QZS)
_IONOSPHERE = {"broadcast": rtk.IONOOPT_BRDC, "off": rtk.IONOOPT_OFF}
_TROPOSPHERE = {"saastamoinen": rtk.TROPOPT_SAAS, "off": rtk.TROPOPT_OFF}
#: C/N0 of a signal that nothing weakens [dB-Hz].
_STRONG = 45.0


#: What broadcast orbits and clocks and code biases leave of a range for hours, 1σ [m]: signal in
#: space errors of GPS, Galileo and BeiDou are 0.2 … 1 m (GLONASS ×1.5, as for its code).
_STAYING = 1.0
#: Of what the ionospheric model may be off by, the share in which satellites differ: most of it is
#: a factor for the whole sky, which goes into height and clock.
_NOT_SHARED = 0.4


class Point(NamedTuple):
    """One pntpos solution, linearised: residuals = H·δx + ε for the rows it used.

    Parameters
    ----------
    pos_e, cov_e : ndarray, shape (3,), (3, 3)
    clock : float
        Receiver c·δt_r [m].
    used : ndarray of int, shape (n,)
        Rows of the observations.
    H : ndarray, shape (n, 3 + clocks)
    residuals, sigma : ndarray, shape (n,)
        [m]; 1σ of everything.
    noise, staying : ndarray, shape (n,)
        1σ of what an epoch has for itself and of what stays for minutes, apart from what all
        satellites share [m].
    """

    pos_e: FloatArray
    cov_e: FloatArray
    clock: float
    used: NDArray[np.int64]
    H: FloatArray
    residuals: FloatArray
    sigma: FloatArray
    noise: FloatArray
    staying: FloatArray


class PointEngine:
    """pntpos with its buffers, fed by rows of the observations."""

    def __init__(
        self, nav: Any, options: Any, observations: GnssObservations, weak_sigma: float = 0.0
    ) -> None:
        self._nav, self._options, self._obs = nav, options, observations
        self._weak_sigma = weak_sigma
        self._number = {s: rtk.satid2no(str(s)) for s in np.unique(observations.sat)}
        code = {s: rtk.obs2code(str(s)) for s in np.unique(observations.signal)}
        whole = np.floor(observations.time)
        #: Of each row, as RTKLIB takes it: seconds and the part of one, satellite, signal, range,
        #: C/N0.
        self._rows = list(
            zip(
                (whole.astype(np.int64) + GPS_EPOCH_GTIME).tolist(),
                (observations.time - whole).tolist(),
                [self._number[s] for s in observations.sat.tolist()],
                [code[s] for s in observations.signal.tolist()],
                observations.pseudorange.tolist(),
                np.nan_to_num(observations.cn0).tolist(),
                strict=True,
            )
        )
        self._message, self._skyview = rtk.Arr1Dchar(128), rtk.Arr1Ddouble(2 * rtk.MAXOBS)
        self._status = rtk.Arr1Dssat_t(rtk.MAXSAT)

    def solve(self, index: NDArray[np.int64]) -> Point | str:
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
        point = Point(
            pos_e,
            q[[0, 3, 5, 3, 1, 4, 5, 4, 2]].reshape(3, 3),
            SPEED_OF_LIGHT * solution.dtr[0],
            used,
            np.column_stack([-e_e, clocks]),
            residuals,
            *self._sigma(used, pos_e, azimuth, elevation),
        )
        return point if self._weak_sigma == 0.0 else self._reweighted(point, letter)

    def _reweighted(self, point: Point, letter: NDArray[np.str_]) -> Point:
        """Return the solution with weak signals weighted down: one more step from RTKLIB's.

        RTKLIB knows a weight by C/N0 too, but takes C/N0 from the epoch before.
        """
        lost = np.maximum(_STRONG - np.nan_to_num(self._obs.cn0[point.used], nan=_STRONG), 0.0)
        weak = self._weak_sigma * 10.0 ** (lost / 20.0)
        sigma = np.hypot(point.sigma, weak)
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
            noise=np.hypot(point.noise, weak),
        )

    def _fill(self, record: Any, row: int) -> None:
        """Fill a blank obsd_t with the pseudorange of one row; pntpos needs nothing else."""
        seconds, part, record.sat, record.code[0], record.P[0], record.SNR[0] = self._rows[row]
        record.time.time, record.time.sec = seconds, part
        record.rcv = 1

    def _sigma(
        self,
        used: NDArray[np.int64],
        pos_e: FloatArray,
        azimuth: FloatArray,
        elevation: FloatArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the 1σ that pntpos gives its pseudoranges [m], which it does not hand out.

        Then what of it is noise of the epoch, and how much may stay: see `Point`.
        """
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
        sigma = np.sqrt(code + ionosphere**2 + troposphere**2 + 0.3**2 + np.array(orbit))
        staying = np.hypot(_STAYING * system, _NOT_SHARED * ionosphere)
        return sigma, np.sqrt(code), staying

    def _orbit_variance(self, row: int) -> float:
        state, clock = rtk.Arr1Ddouble(6), rtk.Arr1Ddouble(2)
        variance, health = rtk.Arr1Ddouble(1), rtk.Arr1Dint(1)
        time = gtime(self._obs.time[row])
        number = self._number[self._obs.sat[row]]
        source = self._options.sateph
        rtk.satpos(time, time, number, source, self._nav, state, clock, variance, health)
        return variance[0]


def spp_options(elevation_mask: float, ionosphere: str, troposphere: str, code_sigma: float) -> Any:
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
