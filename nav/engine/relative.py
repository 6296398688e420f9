"""Positions relative to a base station, put in the place of single-point ones.

Ambiguities resolved to the wrong integers give a position that claims a centimetre and is
decimetres to tens of metres off. The pseudoranges behind the single-point position of the same
epoch have passed their own test, and their covariance is honest: where both contradict each other
beyond it, the single-point position stays. What is wrong by less the filter's gate has to refuse.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...datasets.observations import GnssObservations
from ...datasets.sequence import Sequence
from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ..config import GnssConfig
from ..notes import Note
from ..solution import Resolution
from .events import GnssEvent, inflated

if TYPE_CHECKING:
    from ...datasets.rtklib import RelativePositions

#: Median distance to the single-point positions beyond which the base cannot be where it is
#: said to be [m].
_IMPLAUSIBLE = 30.0
#: chi² of three numbers that is exceeded once in 10 000.
_UNLIKELY = 21.1


def with_relative_positions(
    events: list[GnssEvent], screened: GnssObservations, sequence: Sequence, config: GnssConfig
) -> tuple[list[GnssEvent], Resolution, tuple[Note, ...]]:
    """Return the events with relative positions where there are some, figures and notes on them.

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
    bases = base_files(config, sequence)
    found = relative_positions(
        sequence.rover_file,
        bases,
        sequence.navigation,
        base_pos_e=config.base_position_e_m or None,
        elevation_mask=np.radians(max(config.elevation_mask_deg, 0.0)),
        systems=config.systems,
        frequencies=config.frequencies,
        direction=config.rtk_direction,
        screened=screened,
    )
    fixes = found.fixes
    order = [k for k, event in enumerate(events) if not event.reason]
    time = np.array([events[k].time for k in order])
    out, apart = list(events), []
    quality: Counter[str] = Counter()
    ratios: list[float] = []
    for j, at in enumerate(fixes.time):
        near = int(np.argmin(np.abs(time - at))) if time.size else -1
        if near < 0 or abs(time[near] - at) > 0.01:
            continue  # screening left no single-point position there
        event = events[order[near]]
        apart.append(fixes.pos_e[j] - event.value_e)
        cov = inflated(
            fixes.pos_cov_e[j], config.position_sigma_scale, config.position_sigma_floor_m
        )
        if _contradicts(apart[-1], event, cov):
            quality["contradicted"] += 1
            continue
        name = str(fixes.quality[j])
        out[order[near]] = dataclasses.replace(
            event,
            value_e=fixes.pos_e[j],
            cov_e=cov,
            lasting_e=None,
            resolved=name == "fixed",
            ranges=None,
        )
        quality[name] += 1
        if name == "fixed":
            ratios.append(float(found.ratio[j]))
    _refuse_nowhere(found, bases[0], len(order), np.array(apart).reshape(-1, 3))
    single = len(order) - quality["fixed"] - quality["float"] - quality["dgps"]
    resolution = Resolution(
        fixed=quality["fixed"], floating=quality["float"], dgps=quality["dgps"], single=single,
        contradicted=quality["contradicted"],
        ratio_median=float(np.median(ratios)) if ratios else float("nan"),
        ratio_p5=float(np.percentile(ratios, 5)) if ratios else float("nan"),
        systems=found.systems, frequencies=found.frequencies, direction=config.rtk_direction,
        base_apart_m=_base_apart(found),
    )  # fmt: skip
    return out, resolution, _notes(found, resolution)


def _contradicts(apart_e: FloatArray, single: GnssEvent, cov_e: FloatArray) -> bool:
    """Return whether a relative position is not the single-point one, beyond what both claim."""
    whole = single.cov_e + cov_e
    if single.lasting_e is not None:
        whole = whole + single.lasting_e
    return float(apart_e @ np.linalg.solve(whole, apart_e)) > _UNLIKELY


def _refuse_nowhere(found: RelativePositions, base: Path, offered: int, apart: FloatArray) -> None:
    """Refuse a base without any relative position, or with wrong ones throughout."""
    if offered and not len(apart):
        why = Counter(reason for _, reason in found.failed).most_common(1)
        raise DataError(
            f"no relative position at any of {offered} epochs"
            + (f", mostly: {why[0][0]}" if why else ""),
            file=base,
            remedy=f"is the base's position right ({found.base_source}), and the base near?",
        )
    if len(apart) and (median := float(np.median(np.linalg.norm(apart, axis=1)))) > _IMPLAUSIBLE:
        raise DataError(
            f"relative positions are {median:.0f} m (median) from the single-point ones: "
            f"base position wrong ({found.base_source})",
            file=base,
            remedy="declare gnss.base_position_e_m",
        )


def _base_apart(found: RelativePositions) -> float:
    if found.base_own is None:
        return float("nan")
    return float(np.linalg.norm(found.base_own.pos_e - found.base_pos_e))


def _notes(found: RelativePositions, resolution: Resolution) -> tuple[Note, ...]:
    """Return what there is to say: shares, ratio, the base, and what is doubtful of them."""
    r = resolution
    said = r.shares + (f" (median), {r.ratio_p5:.1f} (5 %)" if r.fixed else "")
    where = np.array2string(found.base_pos_e, precision=3, separator=", ")
    text = (
        f"RTK: {said}; {r.direction}, {r.frequencies} frequencies of "
        f"{r.systems}; base at {where} m ({found.base_source})"
    )
    own = found.base_own
    if own is not None:
        text += (
            f", its own single-point mean is {r.base_apart_m:.1f} m from there (1σ "
            f"{own.sigma:.1f} m per axis)"
        )
    notes = [Note("note", text)]
    if own is not None and r.base_apart_m**2 > _UNLIKELY * own.sigma**2:
        text = (
            f"base position ({found.base_source}): its own pseudoranges have it "
            f"{r.base_apart_m:.0f} m away; what it is off, every position is off"
        )
        notes.append(Note("doubtful", text))
    if r.contradicted:
        text = (
            f"RTK: {r.contradicted} relative positions contradict their pseudoranges: the "
            "single-point ones stay"
        )
        # A reflection contradicts some; what contradicts most is a base that stands elsewhere.
        most = r.contradicted > r.fixed + r.floating + r.dgps
        if most:
            text += f". Is the base's position right ({found.base_source})?"
        notes.append(Note("doubtful" if most else "note", text))
    without = Counter(reason for _, reason in found.failed)
    if without:
        lacking = ", ".join(f"{n} {reason}" for reason, n in without.most_common())
        notes.append(Note("note", f"RTK: epochs without a relative position: {lacking}"))
    return tuple(notes)


def base_files(config: GnssConfig, sequence: Sequence) -> tuple[Path, ...]:
    """Return the base station's files as plain RINEX: those configured, or the recording's."""
    from ...datasets.rtklib import given_files

    near = 0.5 * sum(sequence.span)
    files = _configured(config.base) if config.base else sequence.base
    return tuple(given_files(file, near=near).observations for file in files)


def _configured(base: str) -> tuple[Path, ...]:
    given = Path(base)
    if not given.is_dir():
        return (given,)
    from ...datasets.great.files import is_rinex_name, rinex_kind
    from ...datasets.rtklib import is_raw_log

    inside = sorted(f for f in given.iterdir() if f.is_file())
    files = [f for f in inside if is_rinex_name(f.name) and rinex_kind(f) == "O"]
    files = files or [f for f in inside if is_raw_log(f)]
    if not files:
        raise DataError("no RINEX observations in this folder", file=given, remedy="check --base")
    return tuple(files)
