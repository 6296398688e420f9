"""Doppler before any position is assumed, and what a position makes of it.

Around an assumed antenna position a row z (`velocity.range_rate.DopplerRows`) is, to a few 1e-6,

    z = e·v^s + …,    e = (r^s − p)/ρ,    v^s of the satellite relative to the turning Earth,

since Earth rotation moves satellite and antenna alike and nothing along the line between them.
Its derivatives are those of e:

    J = ∂e/∂p = −(I − eeᵀ)/ρ,    g = ∂z/∂p = J v^s,
    h = ∂g/∂p = −(I − eeᵀ)(e·v^s)/ρ² + (egᵀ + geᵀ)/ρ,

and, of a time t of the satellites' states, ∂z/∂t = e·a^s + |(I − eeᵀ)v^s|²/ρ.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...datasets.observations import GnssObservations
from ...filters.earth import GM, OMEGA_IE_SKEW
from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ...velocity.linearised import rows_at
from ...velocity.range_rate import DopplerNoise, line_of_sight


@dataclass(frozen=True, eq=False)
class Signals:
    """Range rates with the satellites' states, k of them in ascending time.

    Parameters
    ----------
    time : array_like, shape (k,)
        GPS time of reception [s].
    range_rate : array_like, shape (k,)
        −λD [m/s].
    sigma : array_like, shape (k,)
        1σ of it [m/s].
    sat_pos_e, sat_vel_e : array_like, shape (k, 3)
        ECEF at transmission [m], [m/s].
    sat_clock_drift : array_like, shape (k,)
        c·δṫ^s [m/s].
    """

    time: FloatArray
    range_rate: FloatArray
    sigma: FloatArray
    sat_pos_e: FloatArray
    sat_vel_e: FloatArray
    sat_clock_drift: FloatArray

    def __post_init__(self) -> None:
        k = np.size(self.time)
        for field in fields(self):
            value = np.asarray(getattr(self, field.name), dtype=float)
            shape = (k, 3) if field.name in ("sat_pos_e", "sat_vel_e") else (k,)
            if value.shape != shape:
                raise DataError(
                    f"signals.{field.name}: expected shape {shape}, found {value.shape}"
                )
            bad = np.argwhere(~np.isfinite(value))
            if bad.size:
                raise DataError(f"signals.{field.name}: not finite at index {int(bad[0, 0])}")
            object.__setattr__(self, field.name, value)
        for name, wrong, expected in (
            ("time", np.diff(self.time, prepend=-np.inf) < 0.0, "ascending times"),
            ("sigma", self.sigma <= 0.0, "a positive 1σ"),
            ("sat_pos_e", np.linalg.norm(self.sat_pos_e, axis=1) < 1e7, "an orbit"),
        ):
            if wrong.any():
                k = int(np.argmax(wrong))
                raise DataError(f"signals.{name}: expected {expected}, found another at index {k}")

    def __len__(self) -> int:
        return self.time.size

    def __repr__(self) -> str:
        epochs = np.unique(self.time).size
        return f"<Signals, {len(self)} at {epochs} epochs>"

    @classmethod
    def of(
        cls,
        observations: GnssObservations,
        noise: DopplerNoise | None = None,
        time: ArrayLike | None = None,
    ) -> Signals:
        """Return the usable Doppler of observations.

        Parameters
        ----------
        observations : GnssObservations
            With satellite states.
        noise : DopplerNoise, optional
        time : array_like, shape (n,), optional
            GPS time of each row where the receiver's clock is known to be off [s].
        """
        row = np.flatnonzero(observations.has_range_rate)
        when = observations.time if time is None else np.asarray(time, dtype=float)
        return cls(
            when[row], observations.range_rate[row],
            (noise or DopplerNoise()).sigma(observations.cn0[row]) * observations.noise_factor[row],
            observations.sat_pos_e[row],
            observations.sat_vel_e[row], observations.sat_clock_drift[row],
        )  # fmt: skip

    def take(self, rows: slice | np.ndarray) -> Signals:
        """Return the given signals (a slice, a mask or indices)."""
        return Signals(*(getattr(self, field.name)[rows] for field in fields(self)))

    def wider(self, factor: float) -> Signals:
        """Return the signals with every σ so many times as large."""
        return self if factor == 1.0 else replace(self, sigma=factor * self.sigma)

    def later(self, seconds: float) -> Signals:
        """Return the signals with satellites' states of another time, by a circular force only.

        The Earth's mass alone: a second is right to 1e-8, ten minutes to 0.03 m/s.
        """
        if seconds == 0.0:
            return self
        pos, vel = self.sat_pos_e, self.sat_vel_e
        steps = max(int(np.ceil(abs(seconds) / 30.0)), 1)
        h = seconds / steps
        for _ in range(steps):
            k1v, k1a = vel, acceleration(pos, vel)
            k2v = vel + 0.5 * h * k1a
            k2a = acceleration(pos + 0.5 * h * k1v, k2v)
            k3v = vel + 0.5 * h * k2a
            k3a = acceleration(pos + 0.5 * h * k2v, k3v)
            k4v = vel + h * k3a
            k4a = acceleration(pos + h * k3v, k4v)
            pos = pos + h / 6.0 * (k1v + 2.0 * k2v + 2.0 * k3v + k4v)
            vel = vel + h / 6.0 * (k1a + 2.0 * k2a + 2.0 * k3a + k4a)
        return replace(self, sat_pos_e=pos, sat_vel_e=vel)

    def at(self, pos_e: ArrayLike) -> Sight:
        """Return rows and derivatives at assumed antenna positions, shape (3,) or (k, 3) [m]."""
        pos_e = np.broadcast_to(np.asarray(pos_e, dtype=float), (len(self), 3))
        sight = line_of_sight(pos_e, self.sat_pos_e, self.sat_vel_e)
        e_e, z = rows_at(sight, pos_e, self.range_rate, self.sat_clock_drift)
        e, distance = sight.e_e, sight.range[:, None]
        moved = sight.sat_vel_i - sight.sat_pos_e @ OMEGA_IE_SKEW.T
        along = np.sum(e * moved, axis=1)[:, None]
        across = moved - along * e
        later = np.sum(e * acceleration(sight.sat_pos_e, moved), axis=1)
        later += np.sum(across * across, axis=1) / sight.range
        return Sight(e, e_e, z, -across / distance, moved, sight.range, later)


class Sight(NamedTuple):
    """Rows at assumed positions, with derivatives.

    Attributes
    ----------
    e : ndarray, shape (k, 3)
        Unit vectors.
    e_e, z : ndarray, shape (k, 3) and (k,)
        As those of `DopplerRows`.
    by_pos : ndarray, shape (k, 3)
        g, ∂z/∂p [1/s].
    sat_vel : ndarray, shape (k, 3)
        v^s relative to the turning Earth, in axes of reception [m/s].
    distance : ndarray, shape (k,)
        ρ [m].
    by_time : ndarray, shape (k,)
        ∂z/∂t of the satellites' states [m/s²].
    """

    e: FloatArray
    e_e: FloatArray
    z: FloatArray
    by_pos: FloatArray
    sat_vel: FloatArray
    distance: FloatArray
    by_time: FloatArray

    def across(self, vector: FloatArray) -> FloatArray:
        """Return Jᵀ vector = −(I − eeᵀ) vector/ρ, shape (k, 3)."""
        along = np.sum(self.e * vector, axis=1)[:, None]
        return (along * self.e - vector) / self.distance[:, None]

    def curvature(self) -> FloatArray:
        """Return h = ∂²z/∂p², shape (k, 3, 3)."""
        along = np.sum(self.e * self.sat_vel, axis=1)[:, None, None]
        outer = self.e[:, :, None] * self.e[:, None, :]
        mixed = self.e[:, :, None] * self.by_pos[:, None, :]
        distance = self.distance[:, None, None]
        return (mixed + np.swapaxes(mixed, 1, 2)) / distance - along / distance**2 * (
            np.eye(3) - outer
        )


def acceleration(pos_e: FloatArray, vel_e: FloatArray) -> FloatArray:
    """Return the acceleration of a satellite in turning axes, the Earth a point [m/s²]."""
    distance = np.linalg.norm(pos_e, axis=1, keepdims=True)
    turning = (2.0 * vel_e + pos_e @ OMEGA_IE_SKEW.T) @ OMEGA_IE_SKEW.T
    return -GM * pos_e / distance**3 - turning
