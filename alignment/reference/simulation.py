"""Simulated alignment windows in the manner of Song et al., Table I.

A vehicle at 3 m/s for ten epochs of one second, either in a level circle (2D) or over hills (3D),
seen by satellites of a Walker constellation of 24 (six planes, 55°, circular, random phases, mask
10°). The local frame is turned at random against ECEF. Earth rotation and light time are left
out: they belong to `velocity.range_rate`, which removes them from real rows.

The paper gives no place; here the receiver is anywhere between 60° south and north, so that a
rate over runs is one over geometries.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ...filters.earth import GM, C_en_at, lla_to_ecef
from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray
from ..rows import AlignmentRows

#: Radius of the orbits [m] and inclination [rad].
ORBIT_RADIUS = 2.656e7
INCLINATION = np.radians(55.0)
_PLANES, _PER_PLANE = 6, 4
MOTIONS = ("2d", "3d", "line")


@dataclass(frozen=True, eq=False)
class SimulatedWindow:
    """Rows with the truth behind them.

    Attributes
    ----------
    rows : AlignmentRows
    C_ew : ndarray, shape (3, 3)
        The rotation to be found.
    up_e : ndarray, shape (3,)
        Vertical.
    clock_drift : ndarray, shape (epochs,)
        cδṫ [m/s].
    """

    rows: AlignmentRows
    C_ew: FloatArray
    up_e: FloatArray
    clock_drift: FloatArray

    def __repr__(self) -> str:
        return f"<SimulatedWindow: {self.rows!r}>"


def simulate_window(
    rng: np.random.Generator,
    satellites: int,
    motion: str = "3d",
    *,
    epochs: int = 10,
    interval: float = 1.0,
    speed: float = 3.0,
    sigma: float = 0.0,
    assumed_sigma: float = 0.05,
    clock_drift: float = 190.3,
    clock_rate: float = 0.0,
    clock_walk: float = 0.0,
    mask_deg: float = 10.0,
) -> SimulatedWindow:
    """Return one window.

    Parameters
    ----------
    rng : numpy.random.Generator
    satellites : int
        Drawn from those above the mask.
    motion : {'2d', '3d', 'line'}
        A level circle, a circle over hills, straight ahead.
    epochs : int
    interval : float
        [s].
    speed : float
        Uniform [m/s].
    sigma : float
        Noise of the range rates [m/s].
    assumed_sigma : float
        What the rows state where `sigma` is zero [m/s].
    clock_drift, clock_rate, clock_walk : float
        cδṫ at the start [m/s], its rate [m/s²] and random walk [m/s/√s]; the default drift is
        the paper's 1000 Hz on L1.
    mask_deg : float
        Elevation mask.
    """
    if motion not in MOTIONS:
        raise ConfigError.unknown_key(motion, MOTIONS, "motion")
    time: FloatArray = interval * np.arange(epochs, dtype=float)
    pos_e, C_en, sat_pos, sat_vel = _geometry(rng, satellites, time, np.radians(mask_deg))
    vel_e = _velocity_n(rng, motion, epochs, speed) @ C_en.T
    travelled = pos_e + np.cumsum(vel_e, axis=0) * interval
    delta = sat_pos - travelled[:, None]
    e_e = delta / np.linalg.norm(delta, axis=-1, keepdims=True)
    walk = np.append(0.0, np.cumsum(rng.normal(size=epochs - 1))) * clock_walk * np.sqrt(interval)
    drift = clock_drift + clock_rate * time + walk
    range_rate = np.sum(e_e * (sat_vel - vel_e[:, None]), axis=-1) + drift[:, None]
    range_rate += sigma * rng.normal(size=range_rate.shape)
    z = np.sum(e_e * sat_vel, axis=-1) - range_rate
    C_ew = Rotation.random(rng=rng).as_matrix()
    rows = AlignmentRows(
        e_e.reshape(-1, 3),
        np.repeat(vel_e @ C_ew, satellites, axis=0),
        z.ravel(),
        np.full(z.size, sigma if sigma > 0.0 else assumed_sigma),
        np.repeat(np.arange(epochs), satellites),
        np.repeat(time, satellites),
    )
    return SimulatedWindow(rows, C_ew, -C_en[:, 2], drift)


def _geometry(
    rng: np.random.Generator, satellites: int, time: FloatArray, mask: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Draw place and constellation until enough satellites are up; states (epochs, sats, 3)."""
    while True:
        latitude, longitude = np.radians(rng.uniform(-60.0, 60.0)), rng.uniform(0.0, 2.0 * np.pi)
        pos_e = lla_to_ecef(latitude, longitude, 0.0)
        C_en = C_en_at(latitude, longitude)
        sat_pos, sat_vel = _walker(rng, time)
        delta = sat_pos[0] - pos_e
        sine = -(delta @ C_en[:, 2]) / np.linalg.norm(delta, axis=1)
        visible = np.flatnonzero(sine >= np.sin(mask))
        if visible.size >= satellites:
            chosen = rng.choice(visible, satellites, replace=False)
            return pos_e, C_en, sat_pos[:, chosen], sat_vel[:, chosen]


def _walker(rng: np.random.Generator, time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities of the constellation, shape (epochs, 24, 3)."""
    node = np.repeat(2.0 * np.pi * np.arange(_PLANES) / _PLANES, _PER_PLANE)
    rate = np.sqrt(GM / ORBIT_RADIUS**3)
    phase = rng.uniform(0.0, 2.0 * np.pi, node.size) + rate * time[:, None]
    ascending = np.stack([np.cos(node), np.sin(node), np.zeros_like(node)], axis=-1)
    ahead = np.stack(
        [
            -np.sin(node) * np.cos(INCLINATION),
            np.cos(node) * np.cos(INCLINATION),
            np.full_like(node, np.sin(INCLINATION)),
        ],
        axis=-1,
    )
    c, s = np.cos(phase)[..., None], np.sin(phase)[..., None]
    return ORBIT_RADIUS * (c * ascending + s * ahead), ORBIT_RADIUS * rate * (
        c * ahead - s * ascending
    )


def _velocity_n(rng: np.random.Generator, motion: str, epochs: int, speed: float) -> FloatArray:
    """Return velocities north, east, down [m/s]; one turn in the window, from a random course."""
    start = rng.uniform(0.0, 2.0 * np.pi)
    if motion == "line":
        course = np.full(epochs, start)
    else:
        course = start + 2.0 * np.pi * np.arange(epochs) / epochs
    slope = np.zeros(epochs)
    if motion == "3d":
        for harmonic in (1, 2, 3):
            steepness, phase = rng.uniform(0.1, 0.4), rng.uniform(0.0, 2.0 * np.pi)
            slope += steepness * np.sin(harmonic * (course - start) + phase)
    level = np.cos(slope)
    return speed * np.stack([level * np.cos(course), level * np.sin(course), -np.sin(slope)], -1)
