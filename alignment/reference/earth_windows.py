"""Simulated windows with the Doppler itself, so that rows can be made at any position.

Thirty satellites in six planes, a car with a turn at 12 m/s, light time and the turning Earth
included: what a receiver counts (`velocity.range_rate.predicted_range_rate`), with noise and a
clock that walks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ...filters.earth import (
    EARTH_RATE,
    GM,
    OMEGA_IE_SKEW,
    C_en_at,
    C_en_of,
    ecef_to_lla,
    lla_to_ecef,
)
from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray
from ...velocity.range_rate import predicted_range_rate
from ..anywhere.signals import Signals
from ..local_velocity import LocalTrack
from .simulation import INCLINATION, ORBIT_RADIUS

_PLANES, _PER_PLANE = 6, 5
#: Steps of the track a second.
_FINE = 20
MOTIONS = ("turn", "circle", "line")


@dataclass(frozen=True, eq=False)
class EarthWindow:
    """Doppler and local track with the truth behind them.

    Attributes
    ----------
    signals : Signals
    track : LocalTrack
        As a perfect odometer with perfect gyros has it.
    C_ew : ndarray, shape (3, 3)
        The rotation to be found.
    pos_e : ndarray, shape (3,)
        Antenna at the beginning [m].
    clock_walk : float
        [m/s/√s].
    """

    signals: Signals
    track: LocalTrack
    C_ew: FloatArray
    pos_e: FloatArray
    clock_walk: float

    def __repr__(self) -> str:
        return f"<EarthWindow: {self.signals!r}>"


def earth_window(
    rng: np.random.Generator,
    satellites: int,
    seconds: float,
    *,
    motion: str = "turn",
    interval: float = 1.0,
    speed: float = 12.0,
    sigma: float = 0.05,
    clock_walk: float = 0.1,
    mask_deg: float = 10.0,
    noise: bool = True,
) -> EarthWindow:
    """Return one window.

    Parameters
    ----------
    rng : numpy.random.Generator
    satellites : int
        Drawn from those above the mask.
    seconds : float
        Length of the window; a Doppler epoch every `interval` [s].
    motion : {'turn', 'circle', 'line'}
        Brake, turn by 90° and accelerate; once round; straight ahead with a brake.
    speed : float
        [m/s].
    sigma, clock_walk : float
        Of the range rates [m/s] and of the clock's drift [m/s/√s].
    mask_deg : float
        Elevation mask.
    noise : bool
        False: Doppler without noise and a clock that does not walk; σ is stated all the same.
    """
    if motion not in MOTIONS:
        raise ConfigError.unknown_key(motion, MOTIONS, "motion")
    fine = np.linspace(0.0, seconds, round(seconds * _FINE) + 1)
    step = round(interval * _FINE)
    time = fine[::step]
    pos_e, C_en, sat_pos, sat_vel = _sky(rng, satellites, time, np.radians(mask_deg))
    vel_e = _velocity_n(rng, motion, fine, speed) @ C_en.T
    C_ew = Rotation.random(rng=rng).as_matrix()
    track = LocalTrack(fine, np.broadcast_to(np.eye(3), (fine.size, 3, 3)), vel_e @ C_ew, "truth")
    antenna_e = pos_e + track.moved_at(time) @ C_ew.T
    walk = clock_walk * np.sqrt(interval) * rng.normal(size=time.size - 1)
    drift = 190.3 + np.append(0.0, np.cumsum(walk)) * noise
    count = time.size * satellites
    white = sigma * rng.normal(size=count) * noise

    def each(values: FloatArray) -> FloatArray:
        return np.repeat(values, satellites, axis=0)

    sat_pos, sat_vel = sat_pos.reshape(-1, 3), sat_vel.reshape(-1, 3)
    rate = predicted_range_rate(
        each(antenna_e), each(vel_e[::step]), each(drift), sat_pos, sat_vel, np.zeros(count)
    )
    signals = Signals(
        each(time), rate + white, np.full(count, sigma), sat_pos, sat_vel, np.zeros(count)
    )
    return EarthWindow(signals, track, C_ew, pos_e, clock_walk)


def displaced(rng: np.random.Generator, pos_e: FloatArray, distance: float) -> FloatArray:
    """Return a place of the same height so far away over ground, in any direction [m]."""
    C_en, azimuth = C_en_of(pos_e), rng.uniform(0.0, 2.0 * np.pi)
    towards = C_en[:, 0] * np.cos(azimuth) + C_en[:, 1] * np.sin(azimuth)
    axis = np.cross(pos_e, towards)
    turn = axis / np.linalg.norm(axis) * distance / np.linalg.norm(pos_e)
    there = Rotation.from_rotvec(turn).apply(pos_e)
    latitude, longitude, _ = ecef_to_lla(there)
    height = ecef_to_lla(pos_e)[2]
    return np.asarray(lla_to_ecef(latitude, longitude, height))


def _sky(
    rng: np.random.Generator, satellites: int, time: FloatArray, mask: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Draw place and constellation until enough satellites are up; states (epochs, sats, 3)."""
    while True:
        latitude, longitude = np.radians(rng.uniform(-60.0, 60.0)), rng.uniform(0.0, 2.0 * np.pi)
        pos_e = np.asarray(lla_to_ecef(latitude, longitude, rng.uniform(0.0, 500.0)))
        C_en = C_en_at(latitude, longitude)
        sat_pos, sat_vel = _walker(rng, time)
        delta = sat_pos[0] - pos_e
        sine = -(delta @ C_en[:, 2]) / np.linalg.norm(delta, axis=1)
        visible = np.flatnonzero(sine >= np.sin(mask))
        if visible.size >= satellites:
            chosen = rng.choice(visible, satellites, replace=False)
            return pos_e, C_en, sat_pos[:, chosen], sat_vel[:, chosen]


def _walker(rng: np.random.Generator, time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities in ECEF, shape (epochs, 30, 3)."""
    node = np.repeat(2.0 * np.pi * np.arange(_PLANES) / _PLANES, _PER_PLANE)
    node = node + rng.uniform(0.0, 2.0 * np.pi) - EARTH_RATE * time[:, None]
    rate = np.sqrt(GM / ORBIT_RADIUS**3)
    phase = rng.uniform(0.0, 2.0 * np.pi, _PLANES * _PER_PLANE) + rate * time[:, None]
    zero, tilt = np.zeros_like(node), INCLINATION
    ascending = np.stack([np.cos(node), np.sin(node), zero], axis=-1)
    ahead = np.stack(
        [-np.sin(node) * np.cos(tilt), np.cos(node) * np.cos(tilt), zero + np.sin(tilt)], axis=-1
    )
    c, s = np.cos(phase)[..., None], np.sin(phase)[..., None]
    pos = ORBIT_RADIUS * (c * ascending + s * ahead)
    vel = ORBIT_RADIUS * rate * (c * ahead - s * ascending)
    return pos, vel - pos @ OMEGA_IE_SKEW.T


def _velocity_n(
    rng: np.random.Generator, motion: str, time: FloatArray, speed: float
) -> FloatArray:
    """Return velocities north, east, down [m/s]."""
    span, course = time[-1], rng.uniform(0.0, 2.0 * np.pi) + 0.0 * time
    middle, side = rng.uniform(0.35, 0.65) * span, float(rng.choice([-1.0, 1.0]))
    slope = 0.02 * np.sin(2.6 * np.pi * time / span + rng.uniform(0.0, 2.0 * np.pi))
    slower = np.exp(-(((time - middle) / 5.0) ** 2))
    pace = speed * (1.0 - 0.6 * slower)
    if motion == "circle":
        course, pace = course + 2.0 * np.pi * time / span, np.full_like(time, speed)
    elif motion == "turn":
        course = course + side * 0.5 * np.pi / (1.0 + np.exp(-(time - middle) / 1.2))
    level = np.cos(slope)
    return pace[:, None] * np.stack(
        [level * np.cos(course), level * np.sin(course), -np.sin(slope)], -1
    )
