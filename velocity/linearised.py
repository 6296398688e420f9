"""Range rates as linear equations, for any places at once, and compiled for the one of an epoch.

The filter asks for the satellites of one epoch thousands of times a run, and of eight satellites
numpy spends its time on looking at arrays: `at_one_place` is the same arithmetic in one loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..filters.compiled.jit import njit
from ..filters.earth import EARTH_RATE, OMEGA_IE_SKEW, SPEED_OF_LIGHT
from ..filters.rotation import FloatArray

if TYPE_CHECKING:
    from .range_rate import LineOfSight


def rows_at(
    sight: LineOfSight, pos_e: FloatArray, counted: FloatArray, sent: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return e/κ and z of range rates, shape (n, 3) and (n,).

    Parameters
    ----------
    sight : LineOfSight
        From `pos_e`.
    pos_e : ndarray, shape (3,) or (n, 3)
        Antenna [m].
    counted, sent : ndarray, shape (n,)
        Range rates R and the satellites' c·δṫ^s [m/s].
    """
    satellite = np.sum(sight.e_e * sight.sat_vel_i, axis=-1)
    earth = np.sum(sight.e_e * (pos_e @ OMEGA_IE_SKEW.T), axis=-1)
    stretch = (1.0 + satellite / SPEED_OF_LIGHT) / (1.0 + sent / SPEED_OF_LIGHT)
    kappa = stretch * (1.0 - counted / SPEED_OF_LIGHT)
    return sight.e_e / kappa[:, None], (satellite - earth - stretch * (counted + sent)) / kappa


def by_position(sight: LineOfSight, pos_e: FloatArray) -> FloatArray:
    """Return ∂z/∂p of rows, to 1e-4 of it: z = e·(v^s − ω×p) + …, ∂e/∂p = −(I − eeᵀ)/ρ.

    Left out are the derivatives of κ and of the turn during light time, both of order v/c.
    """
    moved = sight.sat_vel_i - pos_e @ OMEGA_IE_SKEW.T
    along = np.sum(sight.e_e * moved, axis=-1)
    across = sight.e_e * along[:, None] - moved
    return np.asarray(across / sight.range[:, None] - sight.e_e @ OMEGA_IE_SKEW)


def at_one_place(
    pos_e: FloatArray,
    sat_pos_e: FloatArray,
    sat_vel_e: FloatArray,
    counted: FloatArray,
    sent: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return e/κ (n, 3), z (n,) and ∂z/∂p (n, 3) of the range rates seen from one place.

    Parameters
    ----------
    pos_e : ndarray, shape (3,)
        Antenna, ECEF at reception [m].
    sat_pos_e, sat_vel_e : ndarray, shape (n, 3)
        Satellites, ECEF at transmission [m], [m/s].
    counted, sent : ndarray, shape (n,)
        As for `rows_at`.
    """
    out = np.empty((7, counted.size))
    places = (pos_e, sat_pos_e, sat_vel_e, counted, sent)
    _fill(*(np.ascontiguousarray(a) for a in places), out)
    return out[:3].T, out[3], out[4:].T


@njit(cache=True)
def _fill(pos, sat_pos, sat_vel, counted, sent, out):
    """Fill a column a satellite: e/κ, z, ∂z/∂p; see `line_of_sight`, `rows_at`, `by_position`."""
    w, c = EARTH_RATE, SPEED_OF_LIGHT
    px, py, pz = pos[0], pos[1], pos[2]
    for k in range(counted.size):
        sx, sy, sz = sat_pos[k, 0], sat_pos[k, 1], sat_pos[k, 2]
        ux, uy, uz = sat_vel[k, 0] - w * sy, sat_vel[k, 1] + w * sx, sat_vel[k, 2]  # inertial
        dx, dy, dz = sx - px, sy - py, sz - pz
        sine, cosine = 0.0, 1.0
        for _ in range(3):  # the Earth turns while light is on its way
            angle = w / c * np.sqrt(dx * dx + dy * dy + dz * dz)
            sine, cosine = np.sin(angle), np.cos(angle)
            dx, dy = cosine * sx + sine * sy - px, cosine * sy - sine * sx - py
        distance = np.sqrt(dx * dx + dy * dy + dz * dz)
        ex, ey, ez = dx / distance, dy / distance, dz / distance
        ux, uy = cosine * ux + sine * uy, cosine * uy - sine * ux
        satellite = ex * ux + ey * uy + ez * uz
        earth = ey * (w * px) - ex * (w * py)
        stretch = (1.0 + satellite / c) / (1.0 + sent[k] / c)
        kappa = stretch * (1.0 - counted[k] / c)
        out[0, k], out[1, k], out[2, k] = ex / kappa, ey / kappa, ez / kappa
        out[3, k] = (satellite - earth - stretch * (counted[k] + sent[k])) / kappa
        mx, my, mz = ux + w * py, uy - w * px, uz  # over the turning Earth
        along = ex * mx + ey * my + ez * mz
        out[4, k] = (ex * along - mx) / distance - w * ey
        out[5, k] = (ey * along - my) / distance + w * ex
        out[6, k] = (ez * along - mz) / distance
