"""Positions relative to a base station, put in the place of single-point ones."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path

import numpy as np

from ...datasets.observations import GnssObservations
from ...datasets.sequence import Sequence
from ...filters.errors import DataError
from ..config import GnssConfig
from .events import GnssEvent, inflated

#: Median distance to the single-point positions beyond which the base cannot be where it is
#: said to be [m].
_IMPLAUSIBLE = 30.0


def with_relative_positions(
    events: list[GnssEvent], screened: GnssObservations, sequence: Sequence, config: GnssConfig
) -> tuple[list[GnssEvent], str]:
    """Return the events with relative positions where there are some, and what to say of them.

    Only what single-point positioning has accepted takes part (`screened`): RTKLIB's relative
    positioning does not test its code residuals, and a reflected signal would pass. An epoch
    without a relative position keeps its single-point one.

    Raises
    ------
    DataError
        No usable base file, no relative position at all, or positions that contradict the
        single-point ones throughout.
    """
    from ...datasets.rtklib import relative_positions

    assert sequence.rover_file is not None
    found = relative_positions(
        sequence.rover_file,
        base_files(config, sequence),
        sequence.navigation,
        base_pos_e=config.base_position_e_m or None,
        elevation_mask=np.radians(max(config.elevation_mask_deg, 0.0)),
        screened=screened,
    )
    fixes = found.fixes
    order = [k for k, event in enumerate(events) if not event.reason]
    time = np.array([events[k].time for k in order])
    out, apart = list(events), []
    quality: Counter[str] = Counter()
    for j, at in enumerate(fixes.time):
        near = int(np.argmin(np.abs(time - at))) if time.size else -1
        if near < 0 or abs(time[near] - at) > 0.01:
            continue  # screening left no single-point position there
        event = events[order[near]]
        cov = inflated(
            fixes.pos_cov_e[j], config.position_sigma_scale, config.position_sigma_floor_m
        )
        resolved = str(fixes.quality[j]) == "fixed"
        out[order[near]] = dataclasses.replace(
            event, value_e=fixes.pos_e[j], cov_e=cov, lasting_e=None, resolved=resolved, ranges=None
        )
        apart.append(float(np.linalg.norm(fixes.pos_e[j] - event.value_e)))
        quality[str(fixes.quality[j])] += 1
    if order and not apart:
        why = Counter(reason for _, reason in found.failed).most_common(1)
        raise DataError(
            f"no relative position at any of {len(order)} epochs"
            + (f", mostly: {why[0][0]}" if why else ""),
            file=base_files(config, sequence)[0],
            remedy=f"is the base's position right ({found.base_source}), and the base near?",
        )
    if apart and np.median(apart) > _IMPLAUSIBLE:
        raise DataError(
            f"relative positions are {np.median(apart):.0f} m (median) from the single-point ones: "
            f"base position wrong ({found.base_source})",
            file=base_files(config, sequence)[0],
            remedy="declare gnss.base_position_e_m",
        )
    quality["single"] = len(order) - len(apart)
    said = ", ".join(f"{count} {name}" for name, count in quality.items() if count)
    where = np.array2string(found.base_pos_e, precision=3, separator=", ")
    return out, f"RTK: {said or 'no positions'}; base at {where} m ({found.base_source})"


def base_files(config: GnssConfig, sequence: Sequence) -> tuple[Path, ...]:
    """Return the base station's files: those configured, else those of the recording."""
    if not config.base:
        return sequence.base
    given = Path(config.base)
    if not given.is_dir():
        return (given,)
    from ...datasets.great.files import is_rinex_name, rinex_kind

    files = sorted(f for f in given.iterdir() if f.is_file() and is_rinex_name(f.name))
    files = [f for f in files if rinex_kind(f) == "O"]
    if not files:
        raise DataError("no RINEX observations in this folder", file=given, remedy="check --base")
    return tuple(files)
