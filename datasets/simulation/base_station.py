"""A simulated base station: a second receiver with its own clock, standing under the open sky.

It sees the constellation and the atmosphere that the rover sees, so that what both have in
common cancels in differences between them, and what they have not — noise, ambiguities, clocks —
remains.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...filters.earth import C_en_at, lla_to_ecef
from ...filters.rotation import FloatArray
from ..observations import GnssObservations
from .constellation import Ephemerides
from .signals import ReceiverClock, observe_open_sky

#: Height of the antenna above the origin of the drive [m]: a roof.
_HEIGHT = 15.0


@dataclass(frozen=True, eq=False)
class BaseStation:
    """What a base station knows: where it is, and what it observed.

    Parameters
    ----------
    pos_e : ndarray, shape (3,)
        Antenna, exact [m].
    observations : GnssObservations
    """

    pos_e: FloatArray
    observations: GnssObservations


@dataclass(frozen=True, eq=False)
class _Standstill:
    """The motion of something that does not move."""

    pos_e: FloatArray


@dataclass(frozen=True, eq=False)
class _Monument:
    """Stands where `observe_open_sky` expects a trajectory."""

    pos_e: FloatArray

    def kinematics(
        self, time: ArrayLike, lever_b: ArrayLike = (0.0, 0.0, 0.0), offset: ArrayLike = 0.0
    ) -> _Standstill:
        return _Standstill(np.tile(self.pos_e, (np.size(time), 1)))


def base_position(origin_deg: tuple[float, float, float], distance: float) -> FloatArray:
    """Return the ECEF position of a point `distance` [m] north-east of the origin, on a roof."""
    lat, lon, height = np.radians(origin_deg[0]), np.radians(origin_deg[1]), origin_deg[2]
    aside = C_en_at(lat, lon)[:, :2] @ np.full(2, distance / np.sqrt(2.0))
    return lla_to_ecef(lat, lon, height + _HEIGHT) + aside


def simulate_base(
    pos_e: ArrayLike,
    ephemerides: Ephemerides,
    time: FloatArray,
    rng: np.random.Generator,
    *,
    noise: bool = True,
    atmosphere: bool = True,
    clock: ReceiverClock | None = None,
) -> BaseStation:
    """Return GPS L1 C/A observations of a static receiver under the open sky.

    Parameters
    ----------
    pos_e : array_like, shape (3,)
        Antenna [m].
    ephemerides : Ephemerides
        Those of the rover.
    time : ndarray, shape (n,)
        Epochs by the station's clock, as GPS time [s].
    rng : numpy.random.Generator
        For clock, noise and ambiguities; not the rover's.
    noise, atmosphere : bool
        As in `datasets.simulation.signals.observe`.
    clock : ReceiverClock, optional
        Default: drawn, up to ±0.1 ms off.
    """
    pos_e = np.asarray(pos_e, dtype=float)
    if clock is None:
        clock = ReceiverClock.draw(time[0], float(time[-1] - time[0]), rng, noise)
    observations = observe_open_sky(
        _Monument(pos_e), ephemerides, clock, time, rng, noise=noise, atmosphere=atmosphere
    )
    return BaseStation(pos_e, observations)
