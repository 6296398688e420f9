"""What GNSS offers the filter: screened observations turned into positions and velocities.

Everything offered is an event in time order; one that cannot be used carries its reason, so
that the update log tells of it.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, MutableMapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...alignment.in_motion.rows import DopplerEpoch
from ...datasets.fix_faults import screened
from ...datasets.observations import GnssFixes, GnssObservations
from ...datasets.sequence import Sequence
from ...filters.earth import SPEED_OF_LIGHT
from ...filters.errors import ConfigError
from ...filters.measurements import Biases
from ...velocity.least_squares import REJECTED
from ..config import GnssConfig
from ..notes import Note, plain
from ..rejections import rejections
from ..solution import Epochs, Resolution
from .constellations import weighed_constellations
from .events import GnssEvent, doppler_noise, inflated, missing
from .relative import with_relative_positions
from .whereabouts import Whereabouts, without_fixes

if TYPE_CHECKING:
    from ...datasets.rtklib import SinglePoint
    from ...datasets.rtklib.each_range import EachRange


@dataclass(frozen=True, eq=False)
class GnssTimeline:
    """All events in time order, the epochs they came from, and the screened observations.

    `misfit` is that of the single-point positions, None where positions are others; `resolution`
    is None where none are relative to a base.
    """

    events: tuple[GnssEvent, ...]
    epochs: Epochs
    observations: GnssObservations | None
    notes: tuple[Note, ...] = ()
    misfit: float | None = None
    resolution: Resolution | None = None


#: Reflections with twice this detour arrive too weak to be tracked, 1σ of a pseudorange [m].
_LONGEST_DETOUR = 300.0
#: Fewer rows of a satellite than this say nothing about it.
_MANY = 30
#: Reason given to rows of satellites that are wrong all the time.
_WRONG = "contradicts the other satellites all the time"
#: What single-point positions depend on.
_OF_POSITIONS = (
    "systems", "min_cn0_dbhz", "elevation_mask_deg", "ionosphere", "troposphere", "raim",
    "code_sigma_m", "code_weak_sigma_m", "position_sigma_scale", "position_sigma_floor_m",
)  # fmt: skip
#: Rows of an epoch that tell which of them is wrong: two more than velocity and clock drift.
_TESTED = 6
#: 1σ per axis added to a least-squares velocity that no residual has checked [m/s].
_UNCHECKED = 3.0


def gnss_timeline(
    sequence: Sequence, config: GnssConfig, positions: MutableMapping[tuple, Any] | None = None
) -> GnssTimeline:
    """Return everything GNSS has to offer in `sequence` under `config`.

    Parameters
    ----------
    sequence : Sequence
    config : GnssConfig
    positions : mapping, optional
        Single-point positions of this recording that are known, by what they depend on; new ones
        are added.

    Raises
    ------
    ConfigError
        If a source is asked for that the sequence does not have.
    """
    position, velocity = sources(sequence, config)
    if sequence.fixes is not None:
        sequence = dataclasses.replace(sequence, fixes=screened(sequence.fixes))
    notes = plain([f"positions: {position}; velocities: {velocity}"])
    if sequence.fixes is not None and "carried" in (position, velocity):
        texts = rejections(sequence.fixes)
        notes += tuple(Note("doubtful", f"fixes: {text}") for text in texts)
    if sequence.observations is None:
        assert sequence.fixes is not None
        events = [
            *(_carried(sequence.fixes, "position", config) if position != "none" else ()),
            *(_carried(sequence.fixes, "velocity", config) if velocity != "none" else ()),
        ]
        epochs = Epochs(sequence.fixes.time, sequence.fixes.satellites, sequence.fixes.satellites)
        return GnssTimeline(_in_order(events), epochs, None, notes)

    observations = _of_systems(sequence.observations, config.systems)
    observations = observations.mark(observations.cn0 < config.min_cn0_dbhz, "weak signal")
    events, where, misfit, resolution = [], None, None, None
    faulty, wrong = (np.zeros(len(observations), dtype=bool) for _ in range(2))
    if position in ("spp", "rtk"):
        known = {} if positions is None else positions
        key = tuple(getattr(config, name) for name in _OF_POSITIONS)
        if key not in known:
            known[key] = _single_point(observations, sequence, config)
        made, where, faulty, wrong, doubts, misfit = known[key]
        events = list(made)
        notes += doubts
        if position == "rtk":
            lost = ~np.isin(observations.time, where.time)  # code that no fix vouches for
            kept = observations.mark(faulty | lost, "not in the single-point fix")
            events, resolution, found = with_relative_positions(events, kept, sequence, config)
            notes += found
    elif sequence.fixes is not None:
        fixes = sequence.fixes
        at = fixes.take(fixes.usable)
        where = Whereabouts.of(at)
        if position == "carried":
            events = _carried(fixes, "position", config)
    if velocity == "doppler" and (where is None or not where.time.size):
        where, text = without_fixes(sequence, observations, config)
        notes += (Note("note", text),)
    if where is not None and where.time.size:
        observations = _masked(observations, where, config)
    epochs = _count(observations)
    if velocity == "doppler":
        assert where is not None
        # Whose orbit is wrong all the time has no line of sight and no velocity to speak of.
        observations = observations.mark(wrong, _WRONG)
        observations, said = weighed_constellations(
            observations, where.at(observations.time), doppler_noise(config)
        )
        notes += said
        velocities, observations, tested = _doppler(observations, where, config)
        events += velocities
        notes += tuple(_always_refused(observations, tested))
    elif velocity == "carried":
        assert sequence.fixes is not None
        events += _carried(sequence.fixes, "velocity", config)
    # Marked last: one faulty pseudorange says nothing about the Doppler, which has its own test.
    observations = observations.mark(faulty, "pseudorange residual")
    return GnssTimeline(_in_order(events), epochs, observations, notes, misfit, resolution)


def _of_systems(observations: GnssObservations, systems: str) -> GnssObservations:
    """Return the observations with other constellations than those asked for marked."""
    if not systems:
        return observations
    other = ~np.isin(observations.sat.astype("U1"), list(systems))
    if other.all():
        held = ", ".join(np.unique(observations.sat.astype("U1")))
        raise ConfigError(f"gnss.systems: found {systems!r}, and the recording has {held} only")
    return observations.mark(other, "constellation not asked for")


def _in_order(events: list[GnssEvent]) -> tuple[GnssEvent, ...]:
    return tuple(sorted(events, key=lambda event: (event.time, event.kind)))


def sources(sequence: Sequence, config: GnssConfig) -> tuple[str, str]:
    """Return where positions ('spp', 'rtk') and velocities ('doppler') come from.

    Both may also be 'carried' or 'none'.
    """
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
        "rtk": (
            not can_spp or sequence.rover_file is None or not (config.base or sequence.base),
            "the rover's RINEX, navigation files and a base station's RINEX (--base FILE)",
        ),
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


def _carried(fixes: GnssFixes, kind: str, config: GnssConfig) -> list[GnssEvent]:
    """Return the positions or velocities a set carries as events."""
    if kind == "position":
        value, cov, resolved = fixes.pos_e, fixes.pos_cov_e, fixes.quality == "fixed"
        scale, floor = config.position_sigma_scale, config.position_sigma_floor_m
        present = fixes.usable
    else:
        value, cov, resolved = fixes.vel_e, fixes.vel_cov_e, np.zeros(len(fixes), dtype=bool)
        scale, floor = config.velocity_sigma_scale, config.velocity_sigma_floor_mps
        present = fixes.has_velocity & fixes.usable
    return [
        GnssEvent(float(t), kind, v, inflated(c, scale, floor), resolved=bool(whole))
        if ok
        else missing(float(t), kind, str(why) or f"no {kind} in the data")
        for t, v, c, ok, why, whole in zip(
            fixes.time, value, cov, present, fixes.rejected, resolved, strict=True
        )
    ]


def _single_point(
    observations: GnssObservations, sequence: Sequence, config: GnssConfig
) -> tuple[
    list[GnssEvent], Whereabouts, NDArray[np.bool_], NDArray[np.bool_], tuple[Note, ...], float
]:
    """Return single-point positions as events and as whereabouts, notes, and their misfit.

    Between them rows whose pseudorange took no part, and those of satellites that are wrong all
    the time.
    """
    from ...datasets.rtklib import single_point

    spp = single_point(
        observations,
        sequence.navigation,
        elevation_mask=np.radians(config.elevation_mask_deg),
        ionosphere=config.ionosphere,
        troposphere=config.troposphere,
        raim=config.raim,
        code_sigma=config.code_sigma_m,
        weak_sigma=config.code_weak_sigma_m,
    )
    where = Whereabouts.of(spp.fixes, spp.clock / SPEED_OF_LIGHT)
    scale, floor = config.position_sigma_scale, config.position_sigma_floor_m
    lasting = [None] * len(where.time) if spp.lasting_cov_e is None else spp.lasting_cov_e
    ranges = [None] * len(where.time) if spp.ranges is None else spp.ranges
    events = [
        GnssEvent(
            time, "position", pos_e, inflated(cov, scale, floor), satellites,
            shared=True, lasting_e=stays,
            ranges=_ranges(satellites, each),
        )
        for time, pos_e, cov, satellites, stays, each in zip(
            where.time - where.clock, spp.fixes.pos_e, spp.fixes.pos_cov_e, spp.satellites,
            lasting, ranges, strict=True,
        )
    ]  # fmt: skip
    offered = _satellites(observations, np.isfinite(observations.pseudorange))
    for time, why in spp.failed:
        at = where.true_time(time) if where.time.size else time
        reason = f"no fix: {_category(why)}"
        events.append(missing(at, "position", reason, offered[time]))
    faulty, wrong = (np.zeros(len(observations), dtype=bool) for _ in range(2))
    wrong[list(spp.left_out)] = True
    faulty[[*spp.rejected, *spp.left_out]] = True
    notes = tuple(_persistent(spp, observations, wrong))
    return events, where, faulty, wrong, notes, spp.misfit


def _ranges(satellites: tuple[str, ...], each: EachRange | None) -> Biases | None:
    if each is None:
        return None
    names = tuple(f"pseudorange of {name}" for name in satellites)
    return Biases(names, each.gain, _LONGEST_DETOUR, each.excess, each.noise, each.lasting)


def _persistent(
    spp: SinglePoint, observations: GnssObservations, wrong: NDArray[np.bool_]
) -> Iterator[Note]:
    """Name the satellites whose pseudoranges are wrong all the time, left out or not."""
    gone = set(observations.sat[wrong])
    for fault in spp.persistent:
        who = " or ".join([fault.satellite, *fault.suspects])
        text = (
            f"{who}: its pseudoranges contradict the other satellites by {fault.bias:+.0f} m "
            f"on the average of {fault.fixes} fixes"
        )
        cause = "wrong ephemeris, or reflected all the time?"
        if fault.satellite in gone:
            yield Note("note", f"{text}, and are left out: {cause}")
        else:
            yield Note(
                "doubtful",
                f"{text}, which are off by some of it: {cause} give another navigation file, or "
                "one without it",
            )


def _always_refused(observations: GnssObservations, tested: NDArray[np.bool_]) -> Iterator[Note]:
    """Name the satellites whose Doppler is excluded most of the time where it could be."""
    refused = tested & (observations.rejected == REJECTED)
    for sat in np.unique(observations.sat[refused]):
        rows = (observations.sat == sat) & tested
        share = float(refused[rows].mean()) if rows.sum() >= _MANY else 0.0
        if share > 0.5:
            yield Note(
                "note",
                f"{sat}: {100 * share:.0f} % of its Doppler contradicts the other satellites "
                "and is left out: wrong ephemeris?",
            )


def _category(message: str) -> str:
    """Return a message of RTKLIB without its numbers, so that like reasons count together."""
    return re.sub(r"^\d+ satellites$", "too few satellites", re.sub(r"\s*\b\w+=\S+", "", message))


def _satellites(
    observations: GnssObservations, rows: NDArray[np.bool_]
) -> dict[float, tuple[str, ...]]:
    """Return the satellites of the usable rows in the mask, by epoch."""
    rows = rows & observations.usable
    return {
        time: tuple(map(str, np.unique(observations.sat[epoch][rows[epoch]])))
        for time, epoch in observations.epochs()
    }


def _masked(
    observations: GnssObservations, where: Whereabouts, config: GnssConfig
) -> GnssObservations:
    """Return the observations with elevations filled in and low satellites marked."""
    from ...velocity.range_rate import with_elevation

    observations = with_elevation(observations, where.at(observations.time))
    low = observations.elevation < np.radians(config.elevation_mask_deg)
    return observations.mark(low, "below elevation mask")


def _doppler(
    observations: GnssObservations, where: Whereabouts, config: GnssConfig
) -> tuple[list[GnssEvent], GnssObservations, NDArray[np.bool_]]:
    """Return for every epoch a least-squares velocity, else its rows, else the reason.

    Rows that the residual test of least squares excludes come back marked; last, which rows it
    could have excluded.
    """
    from ...velocity.least_squares import doppler_velocity, mark_rejected
    from ...velocity.range_rate import doppler_rows

    rows = doppler_rows(observations, where.at(observations.time), doppler_noise(config))
    scale, floor = config.velocity_sigma_scale, config.velocity_sigma_floor_mps
    events, velocities = [], []
    tested = np.zeros(len(observations), dtype=bool)
    for time, epoch in observations.epochs():
        here = rows.take(slice(*np.searchsorted(rows.row, [epoch.start, epoch.stop])))
        found = doppler_velocity(here, time)
        velocities.append(found)
        tested[here.row] = len(here) >= _TESTED
        at = where.true_time(time)
        kept = here.take(~np.isin(here.row, found.rejected)) if found.rejected else here
        offer = None
        if len(kept):
            here_e, known = where.at(np.array([time]))[0], where.sigma_at(np.array([time]))
            given = (float(where.time[0]), float(where.sigma[0])) if where.assumed else None
            offer = DopplerEpoch(at, here_e, kept, float(known[0]), given)
        if found.ok:
            # Four satellites fit any velocity; one reflected among them is not rare.
            cov = inflated(found.cov_e, scale, floor if found.dof else np.hypot(floor, _UNCHECKED))
            raw = observations.take(here.row)
            events.append(
                GnssEvent(at, "velocity", found.vel_e, cov, found.satellites, "", raw, offer)
            )
            continue
        names = tuple(map(str, here.sat))
        few = len(here) >= 2 and config.below_four != "off"
        kind, reason = ("doppler", "") if few else ("velocity", found.status)
        offered = observations.take(here.row) if few else None
        events.append(missing(at, kind, reason, names, offered, offer))
    return events, mark_rejected(observations, velocities), tested


def _count(observations: GnssObservations) -> Epochs:
    """Count satellites per epoch: tracked, and usable with Doppler after screening."""
    doppler = observations.has_range_rate
    times, tracked, usable = [], [], []
    for time, rows in observations.epochs():
        times.append(time)
        tracked.append(np.unique(observations.sat[rows]).size)
        usable.append(np.unique(observations.sat[rows][doppler[rows]]).size)
    return Epochs(np.array(times), np.array(tracked, dtype=int), np.array(usable, dtype=int))
