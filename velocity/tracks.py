"""Velocities of one recording from every source it has, ready to be compared with each other.

A check must take well below a second, so raw observations are thinned to some hundred epochs, and
their positions are coarse: pseudoranges of one constellation, no atmosphere (20–60 m), all epochs
solved at once. That is enough for Doppler velocities, and to tell a position from a wrong one.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ..datasets.observations import GnssFixes, GnssObservations
from ..datasets.sequence import Sequence
from ..datasets.series import Reference
from ..filters.earth import C_en_of
from ..filters.rotation import FloatArray
from .least_squares import doppler_velocities
from .range_rate import line_of_sight

#: A Doppler velocity counts if this many rows more than needed have checked it …
_MIN_REDUNDANCY = 2
#: … and its residuals do not exceed their σ by more than this (in variance).
_MAX_VARIANCE_FACTOR = 4.0
_MAX_DOP = 10.0
_MIN_PSEUDORANGES = 5
#: Iterations from the Earth's centre, and then the residuals that halve a row's weight [m]: from
#: what an orbit 100 km off leaves, by halves down to reflections.
_FROM_CENTRE = 7
_SCALES = (*(30.0 * 2.0**k for k in range(9, 0, -1)), *[30.0] * 5)
#: Epochs of raw observations that are solved; more only make it slower.
_MAX_EPOCHS = 600


@dataclass(frozen=True, eq=False)
class Track:
    """Positions and velocities of one source.

    Attributes
    ----------
    name : str
        'Doppler velocity', 'reference' …
    time : ndarray, shape (n,)
        GPS time [s].
    pos_e : ndarray, shape (n, 3)
        ECEF [m].
    vel_n : ndarray, shape (n, 3)
        North, east, down [m/s]; NaN where there is none.
    precise : bool
        Whether the velocities are good to decimetres per second: axes can be judged by them.
    """

    name: str
    time: FloatArray
    pos_e: FloatArray
    vel_n: FloatArray
    precise: bool = True

    def __len__(self) -> int:
        return self.time.size

    @property
    def speed(self) -> FloatArray:
        """Horizontal speed [m/s], shape (n,)."""
        return np.hypot(self.vel_n[:, 0], self.vel_n[:, 1])

    def course(self, min_speed: float) -> FloatArray:
        """Return the course clockwise from north [rad]; NaN below `min_speed` [m/s]."""
        slow = ~(self.speed >= min_speed)
        return np.where(slow, np.nan, np.arctan2(self.vel_n[:, 1], self.vel_n[:, 0]))


@dataclass(frozen=True, eq=False)
class Tracks:
    """What the checks compare.

    Attributes
    ----------
    gnss : Track or None
        The best GNSS velocities there are: Doppler, else carried, else differenced positions.
    doppler : Track or None
        Velocities from Doppler, where consistent.
    coarse : Track or None
        Positions from pseudoranges (10 m), velocities NaN.
    reference : Track or None
    """

    gnss: Track | None
    doppler: Track | None
    coarse: Track | None
    reference: Track | None


def tracks(sequence: Sequence) -> Tracks:
    """Return the velocities of every source of `sequence`."""
    reference = sequence.reference
    gnss, doppler, coarse = gnss_tracks(sequence.fixes, sequence.observations)
    return Tracks(gnss, doppler, coarse, None if reference is None else reference_track(reference))


def reference_track(reference: Reference) -> Track:
    """Return the velocities of a reference, of its positions where it has none."""
    ref = _track("reference", reference.time, reference.pos_e, reference.vel_e)
    if not np.isfinite(ref.vel_n).all(1).any():
        ref = differenced("reference", reference.time, reference.pos_e)
    return ref


def gnss_tracks(
    fixes: GnssFixes | None, observations: GnssObservations | None
) -> tuple[Track | None, Track | None, Track | None]:
    """Return the best velocities of GNSS, those of Doppler, and coarse positions; see `Tracks`."""
    fixes = None if fixes is None else fixes.take(fixes.usable)
    observations = thinned(observations, _MAX_EPOCHS)
    coarse = None if observations is None else _coarse_positions(observations)
    doppler = None
    if observations is not None:
        near = coarse
        if fixes is not None and len(fixes):
            near = _track("fixes", fixes.time, fixes.pos_e, fixes.vel_e)
        if near is not None:
            doppler = _doppler(observations, near)
    gnss = doppler
    if gnss is None and fixes is not None and fixes.has_velocity.sum() >= 3:
        gnss = _track("GNSS velocity", fixes.time, fixes.pos_e, fixes.vel_e)
    if gnss is None and fixes is not None and len(fixes) >= 3:
        gnss = differenced("differenced GNSS positions", fixes.time, fixes.pos_e)
    if gnss is None and coarse is not None and len(coarse) >= 3:
        moved = differenced("differenced pseudorange positions", coarse.time, coarse.pos_e)
        gnss = dataclasses.replace(moved, precise=False)
    return gnss, doppler, coarse


def differenced(name: str, time: FloatArray, pos_e: FloatArray) -> Track:
    """Return the track whose velocities are differences of positions, at the times between."""
    step = np.diff(time)
    vel_e = np.diff(pos_e, axis=0) / step[:, None]
    vel_e[step > 3.0 * np.median(step)] = np.nan
    return _track(name, time[:-1] + 0.5 * step, 0.5 * (pos_e[1:] + pos_e[:-1]), vel_e)


def _track(name: str, time: FloatArray, pos_e: FloatArray, vel_e: FloatArray) -> Track:
    return Track(name, time, pos_e, np.einsum("nji,nj->ni", C_en_of(pos_e), vel_e))


def thinned(observations: GnssObservations | None, epochs: int) -> GnssObservations | None:
    """Return every k-th epoch, so that at most about `epochs` are left."""
    if observations is None or not len(observations):
        return None
    epoch = np.cumsum(np.diff(observations.time, prepend=-np.inf) > 0)
    stride = int(np.ceil(epoch[-1] / epochs))
    return observations if stride == 1 else observations.take(epoch % stride == 0)


def _coarse_positions(observations: GnssObservations) -> Track | None:
    """Return positions from the pseudoranges of the constellation with most rows."""
    known = (
        observations.usable
        & np.isfinite(observations.pseudorange)
        & np.isfinite(observations.sat_pos_e).all(1)
        & np.isfinite(observations.sat_clock)
    )
    if not known.any():
        return None
    letter = observations.sat.astype("U1")
    letters, count = np.unique(letter[known], return_counts=True)
    rows = observations.take(known & (letter == letters[np.argmax(count)]))
    start = np.flatnonzero(np.diff(rows.time, prepend=-np.inf) > 0)
    epoch = np.repeat(np.arange(start.size), np.diff(start, append=len(rows)))
    measured = rows.pseudorange + rows.sat_clock
    state = np.zeros((start.size, 4))
    good = np.diff(start, append=len(rows)) >= _MIN_PSEUDORANGES
    for scale in [np.inf] * _FROM_CENTRE + [*_SCALES]:
        sight = line_of_sight(state[epoch, :3], rows.sat_pos_e, rows.sat_vel_e)
        residual = measured - sight.range - state[epoch, 3]
        weight = 1.0 / (1.0 + (residual / scale) ** 2)
        H = np.column_stack([-sight.e_e, np.ones(len(rows))])
        normal = np.add.reduceat(weight[:, None, None] * H[:, :, None] * H[:, None, :], start)
        right = np.add.reduceat((weight * residual)[:, None] * H, start)
        good &= np.linalg.eigvalsh(normal)[:, 0] > 1e-3
        if not good.any():
            return None
        state[good] += np.linalg.solve(normal[good], right[good, :, None])[..., 0]
    # Within 60 km of the Earth's radius a solution has not run away.
    good &= np.abs(np.linalg.norm(state[:, :3], axis=1) - 6.37e6) < 6e4
    if good.sum() < 2:
        return None
    nothing = np.full((int(good.sum()), 3), np.nan)
    return Track("pseudorange positions", rows.time[start][good], state[good, :3], nothing)


def _doppler(observations: GnssObservations, near: Track) -> Track | None:
    """Return the velocities of epochs whose Doppler is redundant and agrees with itself."""
    where = np.column_stack([np.interp(observations.time, near.time, p) for p in near.pos_e.T])
    found = [
        v
        for v in doppler_velocities(observations, where, max_dop=_MAX_DOP)
        if v.ok and v.dof >= _MIN_REDUNDANCY and v.variance_factor < _MAX_VARIANCE_FACTOR
    ]
    if len(found) < 3:
        return None
    time = np.array([v.time for v in found])
    pos_e = np.column_stack([np.interp(time, near.time, p) for p in near.pos_e.T])
    return _track("Doppler velocity", time, pos_e, np.array([v.vel_e for v in found]))
