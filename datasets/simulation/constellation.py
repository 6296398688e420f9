"""A synthetic GPS constellation: broadcast ephemerides, their evaluation, RINEX navigation.

Satellites sit in six planes like the real ones and have plausible eccentricities, harmonic
corrections, clocks and group delays. All two-hourly records of a satellite describe one orbit,
and every number is one that RINEX can print, so that a reader of the file finds the simulator's
own orbits, to the digit.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...filters.earth import EARTH_RATE, SPEED_OF_LIGHT
from ...filters.rotation import FloatArray
from .. import gpstime

#: Gravitational constant that GPS broadcast ephemerides are defined with [m³/s²] (IS-GPS-200).
GM_GPS = 3.986005e14
#: Validity step of the records [s] and what lies before and after the run.
_STEP = 7200.0
#: Satellites per plane: 31, as in orbit since 2012.
_OCCUPIED = (5, 5, 5, 5, 5, 6)
#: Klobuchar coefficients of an ordinary day: 5–15 m at mid-latitude noon.
ION_ALPHA = (1.1176e-08, 1.4901e-08, -5.9605e-08, -1.1921e-07)
ION_BETA = (9.0112e04, 1.6384e04, -1.9661e05, -6.5536e04)


@dataclass(frozen=True, eq=False)
class Ephemerides:
    """Broadcast elements of m satellites (IS-GPS-200N, table 20-II), one epoch.

    Parameters
    ----------
    sat : tuple of str
        'G01' …
    toe : float
        Reference time of orbit and clock, GPS time [s].
    sqrt_a, e, i0, omega0, omega, m0, delta_n, i_dot, omega_dot : ndarray, shape (m,)
        Kepler elements and rates [√m, –, rad, rad/s]; omega0 is the longitude of the ascending
        node at the beginning of the week.
    cuc, cus, crc, crs, cic, cis : ndarray, shape (m,)
        Harmonic corrections [rad], [m].
    af0, af1, tgd : ndarray, shape (m,)
        Clock offset [s], drift [s/s], group delay [s].
    """

    sat: tuple[str, ...]
    toe: float
    sqrt_a: FloatArray
    e: FloatArray
    i0: FloatArray
    omega0: FloatArray
    omega: FloatArray
    m0: FloatArray
    delta_n: FloatArray
    i_dot: FloatArray
    omega_dot: FloatArray
    cuc: FloatArray
    cus: FloatArray
    crc: FloatArray
    crs: FloatArray
    cic: FloatArray
    cis: FloatArray
    af0: FloatArray
    af1: FloatArray
    tgd: FloatArray

    def printable(self) -> Ephemerides:
        """Return the elements rounded to what RINEX prints."""
        names = [f.name for f in fields(self) if f.name not in ("sat", "toe")]
        rounded: dict[str, Any] = {name: _printable(getattr(self, name)) for name in names}
        return replace(self, **rounded)

    def shifted(self, toe: float) -> Ephemerides:
        """Return the same orbits and clocks referred to another time, rounded as printed."""
        dt = toe - self.toe
        n = np.sqrt(GM_GPS) / self.sqrt_a**3 + self.delta_n
        return replace(
            self,
            toe=toe,
            m0=_printable(_wrap(self.m0 + n * dt)),
            i0=_printable(self.i0 + self.i_dot * dt),
            omega0=_printable(_wrap(_node_at_week_start(self, toe))),
            af0=_printable(self.af0 + self.af1 * dt),
        )

    def state(self, dt: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return position and clock `dt` seconds after `toe` (IS-GPS-200N, table 20-IV).

        Parameters
        ----------
        dt : ndarray, shape (..., m)
            Transmission time by GPS time less `toe` [s].

        Returns
        -------
        pos_e : ndarray, shape (..., m, 3)
            In the ECEF axes of the transmission instant [m].
        clock : ndarray, shape (..., m)
            δt^s [s], relativity included, group delay not.
        """
        a = self.sqrt_a**2
        mean = self.m0 + (np.sqrt(GM_GPS / a**3) + self.delta_n) * dt
        anomaly = mean + self.e * np.sin(mean)
        for _ in range(6):  # Newton; e < 0.03 converges to rounding in three
            anomaly = anomaly - (anomaly - self.e * np.sin(anomaly) - mean) / (
                1.0 - self.e * np.cos(anomaly)
            )
        sin_e, cos_e = np.sin(anomaly), np.cos(anomaly)
        true = np.arctan2(np.sqrt(1.0 - self.e**2) * sin_e, cos_e - self.e)
        u = true + self.omega
        s2, c2 = np.sin(2.0 * u), np.cos(2.0 * u)
        r = a * (1.0 - self.e * cos_e) + self.crs * s2 + self.crc * c2
        u = u + self.cus * s2 + self.cuc * c2
        i = self.i0 + self.i_dot * dt + self.cis * s2 + self.cic * c2
        _, sow = gpstime.to_week_sow(self.toe)
        node = self.omega0 + (self.omega_dot - EARTH_RATE) * dt - EARTH_RATE * float(sow)
        x, y = r * np.cos(u), r * np.sin(u)
        cos_n, sin_n, cos_i, sin_i = np.cos(node), np.sin(node), np.cos(i), np.sin(i)
        pos_e = np.stack(
            [x * cos_n - y * cos_i * sin_n, x * sin_n + y * cos_i * cos_n, y * sin_i], axis=-1
        )
        relativity = -2.0 * np.sqrt(GM_GPS) / SPEED_OF_LIGHT**2 * self.e * self.sqrt_a * sin_e
        return pos_e, self.af0 + self.af1 * dt + relativity


def _node_at_week_start(ephemerides: Ephemerides, toe: float) -> FloatArray:
    """Return Ω₀ for another toe: Ω₀ − ω_e·sow is the node's longitude at toe itself."""
    _, before = gpstime.to_week_sow(ephemerides.toe)
    _, after = gpstime.to_week_sow(toe)
    dt = toe - ephemerides.toe
    drift = (ephemerides.omega_dot - EARTH_RATE) * dt
    return ephemerides.omega0 + drift + EARTH_RATE * float(after - before)


def _wrap(angle: FloatArray) -> FloatArray:
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


def _printable(values: ArrayLike) -> FloatArray:
    """Return the values as RINEX prints them, D19.12."""
    array = np.asarray(values, dtype=float)
    return np.array([float(f"{v:.12e}") for v in array.ravel()]).reshape(array.shape)


def draw_constellation(time: float, rng: np.random.Generator) -> Ephemerides:
    """Return 31 satellites, referred to the even hour nearest to `time` (GPS time [s]).

    Five or six in each of six planes 60° apart, inclination 55°, phased from plane to plane, all
    slightly off their places as the real ones are.
    """
    toe = round(time / _STEP) * _STEP
    occupied = np.array(_OCCUPIED)
    plane = np.repeat(np.arange(occupied.size), occupied)
    slot = np.concatenate([np.arange(n) / n for n in occupied])
    m = plane.size
    argument = rng.uniform(-np.pi, np.pi, m)
    # Evenly spread in a plane, 24° further from plane to plane, ±3° off.
    latitude = 2 * np.pi * slot + np.radians(24.0) * plane
    latitude = latitude + np.radians(rng.uniform(-3.0, 3.0, m)) + rng.uniform(0.0, 2 * np.pi)
    node = np.radians(60.0) * plane + rng.uniform(0.0, 2 * np.pi)
    small = 1e-6 * rng.uniform(-1.0, 1.0, (4, m))
    drawn = Ephemerides(
        sat=tuple(f"G{k + 1:02d}" for k in range(m)),
        toe=toe,
        sqrt_a=np.sqrt(26559.7e3 + rng.normal(0.0, 3e3, m)),
        e=rng.uniform(0.001, 0.02, m),
        i0=np.radians(55.0 + rng.normal(0.0, 0.7, m)),
        omega0=_wrap(node + np.radians(rng.normal(0.0, 1.0, m))),
        omega=argument,
        m0=_wrap(latitude - argument),
        delta_n=4.5e-9 + rng.normal(0.0, 3e-10, m),
        i_dot=rng.normal(0.0, 2e-10, m),
        omega_dot=-8.0e-9 + rng.normal(0.0, 2e-10, m),
        cuc=5.0 * small[0],
        cus=5.0 * small[1],
        crc=rng.uniform(150.0, 350.0, m),
        crs=rng.uniform(-100.0, 100.0, m),
        cic=0.2 * small[2],
        cis=0.2 * small[3],
        af0=rng.uniform(-5e-4, 5e-4, m),
        af1=rng.normal(0.0, 4e-12, m),
        tgd=rng.uniform(-1.2e-8, 6e-9, m),
    )
    return drawn.printable()


def referred_to(ephemerides: Ephemerides, time: float) -> Ephemerides:
    """Return the same orbits and clocks referred to the even hour nearest to `time` [s]."""
    toe = float(round(time / _STEP) * _STEP)
    return ephemerides if toe == ephemerides.toe else ephemerides.shifted(toe)


def write_navigation(path: Path, ephemerides: Ephemerides, start: float, end: float) -> None:
    """Write a RINEX 3.04 GPS navigation file with records every two hours over the run.

    Parameters
    ----------
    path : Path
    ephemerides : Ephemerides
    start, end : float
        GPS time of the run [s]; the records reach at least two hours further on both sides.
    """
    first = np.floor(start / _STEP) - 1
    last = np.ceil(end / _STEP) + 1
    lines = [
        _header(
            f"{'3.04':>9}{'':11}{'N: GNSS NAV DATA':<20}{'G: GPS':<20}", "RINEX VERSION / TYPE"
        ),
        _header(f"{'certnav simulator':<20}", "PGM / RUN BY / DATE"),
        _header("GPSA " + "".join(f"{v:12.4E}" for v in ION_ALPHA), "IONOSPHERIC CORR"),
        _header("GPSB " + "".join(f"{v:12.4E}" for v in ION_BETA), "IONOSPHERIC CORR"),
        _header(f"{18:6d}", "LEAP SECONDS"),
        _header("", "END OF HEADER"),
    ]
    for k in np.arange(first, last + 1):
        record = referred_to(ephemerides, float(k * _STEP))
        for j in range(len(record.sat)):
            lines += _record(record, j)
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _header(content: str, label: str) -> str:
    return f"{content:<60}{label:<20}"


def _record(eph: Ephemerides, j: int) -> list[str]:
    """Return the eight lines of one broadcast record (RINEX 3.04, table A6)."""
    week, sow = gpstime.to_week_sow(eph.toe)
    date = gpstime.to_calendar(eph.toe)
    issue = float(int(eph.toe / _STEP) % 240)
    healthy, ura, fit, sent = 0.0, 2.0, 4.0, float(sow) - 3600.0
    rows = [
        [issue, eph.crs[j], eph.delta_n[j], eph.m0[j]],
        [eph.cuc[j], eph.e[j], eph.cus[j], eph.sqrt_a[j]],
        [float(sow), eph.cic[j], eph.omega0[j], eph.cis[j]],
        [eph.i0[j], eph.crc[j], eph.omega[j], eph.omega_dot[j]],
        [eph.i_dot[j], 1.0, float(week), 0.0],
        [ura, healthy, eph.tgd[j], issue],
        [sent, fit],
    ]
    clock = "".join(f"{v:19.12E}" for v in (eph.af0[j], eph.af1[j], 0.0))
    body = ["    " + "".join(f"{v:19.12E}" for v in row) for row in rows]
    return [f"{eph.sat[j]} {date:%Y %m %d %H %M %S}{clock}", *body]
