"""Lines of sight and range rates: what a Doppler measurement says about the receiver's velocity.

Signs: `e` is the unit vector from receiver to satellite, range rates are positive when receding,
``range_rate = −λD``. Axes are ECEF at reception; the satellite's state is given in ECEF at
transmission and rotated here by ω_ie·τ.

Exact for straight light: with v^s, v_r the *inertial* velocities in reception axes,

    ρ̇ = e·(v^s(1 − ρ̇/c) − v_r),                          light-time factor of the emission epoch
    R(1 + δṫ_r) = ρ̇ + cδṫ_r − cδṫ^s(1 − ρ̇/c),            R counted by the receiver's own clock

so that ``e·v_r − κ·cδṫ_r = e·v^s − k(R + cδṫ^s)/(1 + δṫ^s)`` with k = 1 + e·v^s/c and
κ = k(1 − R/c)/(1 + δṫ^s), |κ − 1| of order 1e-6. Ionosphere and troposphere rates are not
modelled (mm/s).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..datasets.observations import GnssObservations
from ..filters.earth import EARTH_RATE, OMEGA_IE_SKEW, SPEED_OF_LIGHT, C_en_of
from ..filters.errors import ConfigError
from ..filters.rotation import FloatArray
from .linearised import at_one_place, by_position, rows_at


class LineOfSight(NamedTuple):
    """Geometry between receiver and satellites, in ECEF axes at reception.

    Attributes
    ----------
    e_e : ndarray, shape (n, 3)
        Unit vectors from receiver to satellite.
    range : ndarray, shape (n,)
        Geometric distance the signal travelled [m].
    sat_pos_e : ndarray, shape (n, 3)
        Where the satellite was at transmission [m].
    sat_vel_i : ndarray, shape (n, 3)
        Its inertial velocity at transmission [m/s].

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import line_of_sight
    >>> pos_e, sat_e = np.array([6378137.0, 0.0, 0.0]), np.array([[26560e3, 0.0, 0.0]])  # overhead
    >>> sight = line_of_sight(pos_e, sat_e, np.array([[0.0, 2000.0, 3000.0]]))
    >>> sight.range.round(0), sight.e_e.round(3) + 0.0
    (array([20181863.]), array([[1., 0., 0.]]))
    """

    e_e: FloatArray
    range: FloatArray
    sat_pos_e: FloatArray
    sat_vel_i: FloatArray

    def __repr__(self) -> str:
        return f"LineOfSight({np.size(self.range)} satellites)"


#: Elevation over which what low signals have too much of falls to 1/e [rad].
_LOW = np.radians(10.0)


def low_share(elevation: ArrayLike) -> FloatArray:
    """Return e^(−elevation/10°): 1 at the horizon, 0 where the elevation [rad] is not known."""
    elevation = np.asarray(elevation, dtype=float)
    up = np.where(np.isnan(elevation), np.inf, np.maximum(elevation, 0.0))
    return np.asarray(np.exp(-up / _LOW), dtype=float)


@dataclass(frozen=True)
class DopplerNoise:
    """Range-rate noise as a function of C/N0.

    σ² = floor² + (sigma_45 · 10^((45 − C/N0)/decade_db))²: thermal noise of a frequency loop
    falls with the square root of the carrier power; the floor stands for oscillator and
    dynamics. The defaults fit the u-blox M8 in the car of comma2k19 above 40 dB-Hz (MAD
    0.06 m/s at 45 dB-Hz); below, multipath adds a factor of two. A static u-blox F9P under open
    sky (INSTINCT) has sigma_45 = 0.017 and floor = 0.01 m/s from 26 to 48 dB-Hz.

    Parameters
    ----------
    sigma_45 : float
        Thermal part at 45 dB-Hz [m/s].
    floor : float
        [m/s].
    unknown_cn0 : float
        C/N0 assumed for rows that have none [dB-Hz].
    decade_db : float
        C/N0 over which the first part changes tenfold [dB]: 20 for thermal noise, less where
        weak signals are reflections. `velocity.doppler_noise` fits it.
    low : float
        How much larger σ is at the horizon than C/N0 alone says: times 1 + low·e^(−elevation/10°).

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import DopplerNoise
    >>> DopplerNoise(sigma_45=0.06, floor=0.04).sigma(np.array([25.0, 45.0])).round(3)  # [m/s]
    array([0.601, 0.072])
    """

    sigma_45: float = 0.06
    floor: float = 0.04
    unknown_cn0: float = 35.0
    decade_db: float = 20.0
    low: float = 0.0

    def __post_init__(self) -> None:
        if not (self.sigma_45 >= 0.0 and self.floor > 0.0):
            raise ConfigError(
                "Doppler noise: expected sigma_45 ≥ 0 and floor > 0 m/s, "
                f"found {self.sigma_45!r} and {self.floor!r}"
            )
        if not self.decade_db > 0.0:
            raise ConfigError(f"Doppler noise: expected decade_db > 0, found {self.decade_db!r}")
        if not 0.0 <= self.low < np.inf:
            raise ConfigError(f"Doppler noise: expected low ≥ 0, found {self.low!r}")

    def sigma(self, cn0: ArrayLike, elevation: ArrayLike | None = None) -> FloatArray:
        """Return 1σ [m/s] of range rates with `cn0` [dB-Hz].

        `elevation` [rad] counts where it is known and `low` is not zero.
        """
        cn0 = np.asarray(cn0, dtype=float)
        known = np.where(np.isnan(cn0), self.unknown_cn0, cn0)
        sigma = np.hypot(self.floor, self.sigma_45 * 10.0 ** ((45.0 - known) / self.decade_db))
        if elevation is None or self.low == 0.0:
            return sigma
        return np.asarray(sigma * (1.0 + self.low * low_share(elevation)), dtype=float)


@dataclass(frozen=True, eq=False)
class DopplerRows:
    """Doppler as linear equations in velocity: ``z == e_e @ v_e − cδṫ_r``, exactly.

    Attributes
    ----------
    row : ndarray of int, shape (n,)
        Index into the observations the rows came from.
    sat : ndarray of str, shape (n,)
    e_e : ndarray, shape (n, 3)
        Line of sight divided by κ: a unit vector to a few 1e-6, such that the coefficient of
        the clock drift is −1 in every row and differences of rows are free of it.
    z : ndarray, shape (n,)
        [m/s]; eq. (5) of DDIA-VE with Earth rotation, light time and both clocks' scale in it.
    sigma : ndarray, shape (n,)
        1σ of `z` [m/s].
    z_by_pos : ndarray, shape (n, 3), or None
        ∂z/∂p: what an error of the position does to `z`, 0.1 … 0.3 (m/s)/km [1/s]. None in rows
        made by hand: nothing is known of their geometry.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import DopplerRows
    >>> e_e, drift = np.eye(3), 30.0  # satellites along the axes, clock drift 30 m/s
    >>> z = e_e @ [10.0, 2.0, -1.0] - drift
    >>> rows = DopplerRows(np.arange(3), np.array(["G01", "G02", "G03"]), e_e, z, np.full(3, 0.05))
    >>> len(rows), rows.z
    (3, array([-20., -28., -31.]))
    """

    row: NDArray[np.int64]
    sat: NDArray[np.str_]
    e_e: FloatArray
    z: FloatArray
    sigma: FloatArray
    z_by_pos: FloatArray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "row", np.asarray(self.row, dtype=np.int64))
        object.__setattr__(self, "sat", np.asarray(self.sat, dtype=np.str_))
        for name in ("e_e", "z", "sigma"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
        if self.z_by_pos is not None:
            object.__setattr__(self, "z_by_pos", np.asarray(self.z_by_pos, dtype=float))

    def __len__(self) -> int:
        return self.z.size

    def __repr__(self) -> str:
        if not len(self):
            return "DopplerRows(0 rows)"
        low, high = self.sigma.min(), self.sigma.max()
        return f"DopplerRows({len(self)} rows, sigma {low:.3g}…{high:.3g} m/s)"

    def take(self, rows: slice | NDArray) -> DopplerRows:
        """Return the given rows (a slice, a mask or indices)."""
        by_pos = None if self.z_by_pos is None else self.z_by_pos[rows]
        return DopplerRows(
            self.row[rows], self.sat[rows], self.e_e[rows], self.z[rows], self.sigma[rows], by_pos
        )


def line_of_sight(pos_e: ArrayLike, sat_pos_e: ArrayLike, sat_vel_e: ArrayLike) -> LineOfSight:
    """Return the geometry of signals received at `pos_e`.

    Parameters
    ----------
    pos_e : array_like, shape (3,) or (n, 3)
        Receiver, ECEF at reception [m].
    sat_pos_e, sat_vel_e : array_like, shape (n, 3)
        Satellite, ECEF at transmission [m], [m/s].

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import line_of_sight
    >>> pos_e, sat_e = np.array([6378137.0, 0.0, 0.0]), np.array([[26560e3, 0.0, 0.0]])  # overhead
    >>> sight = line_of_sight(pos_e, sat_e, np.array([[0.0, 2000.0, 3000.0]]))
    >>> sight.range.round(0), sight.e_e.round(3) + 0.0
    (array([20181863.]), array([[1., 0., 0.]]))
    """
    pos_e = np.asarray(pos_e, dtype=float)
    sat_pos_e = np.asarray(sat_pos_e, dtype=float)
    sat_vel_i = np.asarray(sat_vel_e, dtype=float) + sat_pos_e @ OMEGA_IE_SKEW.T
    delta = sat_pos_e - pos_e
    for _ in range(3):  # each pass gains a factor ω·r/c ≈ 1e-6
        angle = EARTH_RATE / SPEED_OF_LIGHT * _length(delta)
        delta = _rotated(sat_pos_e, angle) - pos_e
    distance = _length(delta)
    return LineOfSight(
        delta / distance[..., None], distance, delta + pos_e, _rotated(sat_vel_i, angle)
    )


def _rotated(vector: FloatArray, angle: FloatArray) -> FloatArray:
    """Return vectors of ECEF at transmission in ECEF at reception, the Earth having turned."""
    s, c = np.sin(angle), np.cos(angle)
    x, y = vector[..., 0], vector[..., 1]
    out = np.array(vector)
    out[..., 0], out[..., 1] = c * x + s * y, c * y - s * x
    return out


def _length(vector: FloatArray) -> FloatArray:
    """Return the norm along the last axis, without what `numpy.linalg.norm` asks first."""
    return np.asarray(np.sqrt(np.add.reduce(vector * vector, axis=-1)))


def predicted_range_rate(
    pos_e: ArrayLike,
    vel_e: ArrayLike,
    clock_drift: ArrayLike,
    sat_pos_e: ArrayLike,
    sat_vel_e: ArrayLike,
    sat_clock_drift: ArrayLike,
) -> FloatArray:
    """Return the range rate −λD a receiver counts [m/s], shape (n,).

    Parameters
    ----------
    pos_e, vel_e : array_like, shape (3,) or (n, 3)
        Antenna, ECEF [m], [m/s].
    clock_drift : array_like, shape () or (n,)
        Receiver c·δṫ_r [m/s].
    sat_pos_e, sat_vel_e : array_like, shape (n, 3)
        Satellite, ECEF at transmission [m], [m/s].
    sat_clock_drift : array_like, shape (n,)
        c·δṫ^s, relativistic rate included [m/s].

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.velocity import predicted_range_rate
    >>> pos_e, sat_e = np.array([6378137.0, 0.0, 0.0]), np.array([[26560e3, 0.0, 0.0]])  # overhead
    >>> hung = sat_e, np.zeros((1, 3)), np.zeros(1)  # no motion of the satellite, no clock drift
    >>> up, down = (predicted_range_rate(pos_e, [v, 0.0, 0.0], 0.0, *hung) for v in (5.0, -5.0))
    >>> (up - down).round(3)  # positive when receding [m/s]
    array([-10.])
    """
    sight = line_of_sight(pos_e, sat_pos_e, sat_vel_e)
    pos_e, vel_e = np.asarray(pos_e, dtype=float), np.asarray(vel_e, dtype=float)
    vel_i = vel_e + pos_e @ OMEGA_IE_SKEW.T
    satellite = np.sum(sight.e_e * sight.sat_vel_i, axis=-1)
    rate = (satellite - np.sum(sight.e_e * vel_i, axis=-1)) / (1.0 + satellite / SPEED_OF_LIGHT)
    receiver, sent = np.asarray(clock_drift, dtype=float), np.asarray(sat_clock_drift, dtype=float)
    counted = rate + receiver - sent * (1.0 - rate / SPEED_OF_LIGHT)
    return counted / (1.0 + receiver / SPEED_OF_LIGHT)


def doppler_rows(
    observations: GnssObservations, pos_e: ArrayLike, noise: DopplerNoise | None = None
) -> DopplerRows:
    """Return one equation per usable row with a range rate.

    Parameters
    ----------
    observations : GnssObservations
        Any number of epochs.
    pos_e : array_like, shape (3,) or (n, 3)
        Antenna, ECEF [m], one for all or one per row of `observations`. 10 m of error costs
        about 2 mm/s.
    noise : DopplerNoise, optional
        Default: `DopplerNoise()`.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> from certnav.velocity import doppler_rows
    >>> drive = simulate(SimulationConfig(duration=20.0, density="open", noise=False))
    >>> observations, pos_e = drive.observations, drive.reference.pos_e[0]
    >>> rows = doppler_rows(observations, pos_e)
    >>> rows.e_e.shape == (len(rows), 3), float(np.linalg.norm(rows.e_e, axis=1).min().round(4))
    (True, 1.0)
    """
    row = np.flatnonzero(observations.has_range_rate)
    pos_e = np.asarray(pos_e, dtype=float)
    o = observations
    if row.size < len(o):
        o = o.take(row)
        pos_e = pos_e[row] if pos_e.ndim == 2 else pos_e
    if pos_e.ndim == 1:
        e_e, z, moved = at_one_place(
            pos_e, o.sat_pos_e, o.sat_vel_e, o.range_rate, o.sat_clock_drift
        )
    else:
        sight = line_of_sight(pos_e, o.sat_pos_e, o.sat_vel_e)
        e_e, z = rows_at(sight, pos_e, o.range_rate, o.sat_clock_drift)
        moved = by_position(sight, pos_e)
    sigma = (noise or DopplerNoise()).sigma(o.cn0, o.elevation) * o.noise_factor
    return DopplerRows(row, o.sat, e_e, z, sigma, moved)


def elevation_azimuth(e_e: ArrayLike, pos_e: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return elevation and azimuth [rad] of lines of sight, shape (n,) each.

    Parameters
    ----------
    e_e : array_like, shape (n, 3)
        From receiver to satellite, ECEF.
    pos_e : array_like, shape (3,) or (n, 3)
        Receiver [m].

    Returns
    -------
    elevation : ndarray
        Above the ellipsoid's horizon.
    azimuth : ndarray
        Clockwise from north, [0, 2π).
    """
    e_n = np.einsum("...ji,...j->...i", C_en_of(pos_e), np.asarray(e_e, dtype=float))
    elevation = np.arctan2(-e_n[..., 2], np.hypot(e_n[..., 0], e_n[..., 1]))
    return elevation, np.arctan2(e_n[..., 1], e_n[..., 0]) % (2.0 * np.pi)


def with_elevation(observations: GnssObservations, pos_e: ArrayLike) -> GnssObservations:
    """Return the observations with elevation and azimuth seen from `pos_e` filled in.

    Parameters
    ----------
    pos_e : array_like, shape (3,) or (n, 3)
        Antenna, ECEF [m], one for all or one per row.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> from certnav.velocity import with_elevation
    >>> drive = simulate(SimulationConfig(duration=20.0, density="open", noise=False))
    >>> observations, pos_e = drive.observations, drive.reference.pos_e[0]
    >>> seen = with_elevation(observations, pos_e)
    >>> bool(np.degrees(seen.elevation).min() > 0.0)
    True
    """
    sight = line_of_sight(pos_e, observations.sat_pos_e, observations.sat_vel_e)
    elevation, azimuth = elevation_azimuth(sight.e_e, pos_e)
    return observations.with_columns(elevation=elevation, azimuth=azimuth)
