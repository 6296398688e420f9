"""What GNSS offers the filter: screened observations turned into positions and velocities.

Everything offered is an event in time order; one that cannot be used carries its reason, so
that the update log tells of it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from datasets.sequence import GnssFixes, GnssObservations, Sequence
from filters.earth import SPEED_OF_LIGHT
from filters.errors import ConfigError
from filters.rotation import FloatArray
from nav.config import GnssConfig
from nav.solution import Epochs


@dataclass(frozen=True, eq=False)
class GnssEvent:
    """One antenna position or velocity, or the reason why there is none.

    Parameters
    ----------
    time : float
        GPS time it belongs to [s].
    kind : {'position', 'velocity'}
    value_e : ndarray, shape (3,)
        ECEF [m] or [m/s]; NaN when there is none.
    cov_e : ndarray, shape (3, 3)
        Covariance as the filter is to use it [m²] or [m²/s²].
    satellites : tuple of str
        Satellites behind it, where known.
    reason : str
        Why it cannot be used; '' when it can.
    """

    time: float
    kind: str
    value_e: FloatArray
    cov_e: FloatArray
    satellites: tuple[str, ...] = ()
    reason: str = ""


@dataclass(frozen=True, eq=False)
class GnssTimeline:
    """All events in time order, the epochs they came from, and the screened observations."""

    events: tuple[GnssEvent, ...]
    epochs: Epochs
    observations: GnssObservations | None
    notes: tuple[str, ...] = ()


_NOTHING = np.full(3, np.nan), np.full((3, 3), np.nan)


def gnss_timeline(sequence: Sequence, config: GnssConfig) -> GnssTimeline:
    """Return everything GNSS has to offer in `sequence` under `config`.

    Raises
    ------
    ConfigError
        If a source is asked for that the sequence does not have.
    """
    position, velocity = sources(sequence, config)
    observations, notes = sequence.observations, [f"positions: {position}; velocities: {velocity}"]
    events: list[GnssEvent] = []
    approximate = sequence.fixes
    if observations is not None:
        observations = _weak_marked(observations, config)
    if position == "spp":
        assert observations is not None
        spp_events, approximate = _single_point_events(observations, sequence, config)
        events += spp_events
    elif position == "carried":
        assert sequence.fixes is not None
        events += _carried(sequence.fixes, "position", config)
    if observations is not None and approximate is not None and len(approximate):
        observations = _masked(observations, approximate, config)
    epochs = _epochs(observations, sequence.fixes)
    if velocity == "doppler":
        assert observations is not None
        if approximate is None or not len(approximate):
            raise ConfigError(
                "gnss.velocity: Doppler needs an approximate position, and there is none — "
                "add navigation files for single-point positions"
            )
        doppler_events, observations = _doppler_events(observations, approximate, config)
        events += doppler_events
    elif velocity == "carried":
        assert sequence.fixes is not None
        events += _carried(sequence.fixes, "velocity", config)
    events.sort(key=lambda event: (event.time, event.kind))
    return GnssTimeline(tuple(events), epochs, observations, tuple(notes))


def sources(sequence: Sequence, config: GnssConfig) -> tuple[str, str]:
    """Return where positions and velocities come from: 'spp', 'doppler', 'carried' or 'none'."""
    obs, fixes = sequence.observations, sequence.fixes
    can_spp = obs is not None and bool(sequence.navigation)
    can_doppler = obs is not None and bool(np.isfinite(obs.range_rate).any())
    carries_velocity = fixes is not None and bool(fixes.has_velocity.any())
    position, velocity = config.position, config.velocity
    if position == "auto":
        position = "carried" if fixes is not None else "spp" if can_spp else "none"
    if velocity == "auto":
        velocity = "doppler" if can_doppler else "carried" if carries_velocity else "none"
    missing = {
        "spp": (not can_spp, "pseudoranges with navigation files"),
        "doppler": (not can_doppler, "Doppler observations"),
    }
    if position == "carried" and fixes is None:
        raise ConfigError(f"gnss.position: 'carried', but {sequence.name} carries no positions")
    if velocity == "carried" and not carries_velocity:
        raise ConfigError(f"gnss.velocity: 'carried', but {sequence.name} carries no velocities")
    for key, value in (("position", position), ("velocity", velocity)):
        absent, what = missing.get(value, (False, ""))
        if absent:
            raise ConfigError(f"gnss.{key}: '{value}' needs {what}, and {sequence.name} has none")
    return position, velocity


def _sigma(cov_e: FloatArray, scale: float, floor: float) -> FloatArray:
    """Return the covariance scaled, with `floor` added in variance on every axis."""
    return cov_e * scale**2 + np.eye(3) * floor**2


def _carried(fixes: GnssFixes, kind: str, config: GnssConfig) -> list[GnssEvent]:
    """Return the positions or velocities a set carries as events."""
    if kind == "position":
        value, cov = fixes.pos_e, fixes.pos_cov_e
        scale, floor = config.position_sigma_scale, config.position_sigma_floor_m
        present = np.ones(len(fixes), dtype=bool)
    else:
        value, cov = fixes.vel_e, fixes.vel_cov_e
        scale, floor = config.velocity_sigma_scale, config.velocity_sigma_floor_mps
        present = fixes.has_velocity
    return [
        GnssEvent(float(t), kind, v, _sigma(c, scale, floor))
        if ok
        else GnssEvent(float(t), kind, *_NOTHING, reason=f"no {kind} in the data")
        for t, v, c, ok in zip(fixes.time, value, cov, present, strict=True)
    ]


def _single_point_events(
    observations: GnssObservations, sequence: Sequence, config: GnssConfig
) -> tuple[list[GnssEvent], GnssFixes]:
    """Return RTKLIB single-point positions as events, and as approximate positions."""
    from datasets.rtklib import single_point

    spp = single_point(
        observations,
        sequence.navigation,
        elevation_mask=np.radians(config.elevation_mask_deg),
        ionosphere=config.ionosphere,
        troposphere=config.troposphere,
        raim=config.raim,
        code_sigma=config.code_sigma_m,
    )
    names = {
        t: tuple(observations.sat[rows][observations.usable[rows]])
        for t, rows in observations.epochs()
    }
    events = [
        GnssEvent(
            float(t - clock / SPEED_OF_LIGHT),
            "position",
            pos_e,
            _sigma(cov, config.position_sigma_scale, config.position_sigma_floor_m),
            tuple(map(str, names[float(t)])),
        )
        for t, clock, pos_e, cov in zip(
            spp.fixes.time, spp.clock, spp.fixes.pos_e, spp.fixes.pos_cov_e, strict=True
        )
    ]
    events += [
        GnssEvent(t, "position", *_NOTHING, reason=f"no fix: {why}") for t, why in spp.failed
    ]
    return events, spp.fixes


def _category(message: str) -> str:
    """Return RTKLIB's message without its numbers, so that like reasons count together."""
    return re.sub(r"\s*\b\w+=\S+", "", message).strip()


def _weak_marked(observations: GnssObservations, config: GnssConfig) -> GnssObservations:
    """Return the observations with signals below the C/N0 limit marked."""
    return observations.mark(observations.cn0 < config.min_cn0_dbhz, "weak signal")


def approximate_positions(fixes: GnssFixes, time: FloatArray) -> FloatArray:
    """Return positions interpolated to `time` and held beyond the ends, shape (n, 3)."""
    return np.column_stack([np.interp(time, fixes.time, fixes.pos_e[:, k]) for k in range(3)])


def _masked(
    observations: GnssObservations, fixes: GnssFixes, config: GnssConfig
) -> GnssObservations:
    """Return the observations with elevations filled in and low satellites marked."""
    from velocity.range_rate import with_elevation

    observations = with_elevation(observations, approximate_positions(fixes, observations.time))
    low = observations.elevation < np.radians(config.elevation_mask_deg)
    return observations.mark(low, "below elevation mask")


def _doppler_events(
    observations: GnssObservations, fixes: GnssFixes, config: GnssConfig
) -> tuple[list[GnssEvent], GnssObservations]:
    """Return a least-squares velocity, or the reason for none, for every epoch.

    Rows that its residual test excludes come back marked.
    """
    from velocity.least_squares import REJECTED, doppler_velocities

    events: list[GnssEvent] = []
    faulty = np.zeros(len(observations), dtype=bool)
    positions = approximate_positions(fixes, observations.time)
    for found in doppler_velocities(observations, positions):
        faulty[list(found.rejected)] = True
        satellites = tuple(map(str, found.satellites))
        if found.ok:
            cov = _sigma(found.cov_e, config.velocity_sigma_scale, config.velocity_sigma_floor_mps)
            events.append(GnssEvent(found.time, "velocity", found.vel_e, cov, satellites))
        else:
            events.append(
                GnssEvent(found.time, "velocity", *_NOTHING, satellites, reason=found.status)
            )
    return events, observations.mark(faulty, REJECTED)


def _epochs(observations: GnssObservations | None, fixes: GnssFixes | None) -> Epochs:
    """Count satellites per epoch: tracked, and usable with Doppler after screening."""
    if observations is None:
        assert fixes is not None
        return Epochs(fixes.time, fixes.satellites, fixes.satellites)
    doppler = observations.has_range_rate
    times, tracked, usable = [], [], []
    for time, rows in observations.epochs():
        times.append(time)
        tracked.append(np.unique(observations.sat[rows]).size)
        usable.append(np.unique(observations.sat[rows][doppler[rows]]).size)
    return Epochs(np.array(times), np.array(tracked, dtype=int), np.array(usable, dtype=int))
