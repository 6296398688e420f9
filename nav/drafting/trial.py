"""A draft read with trial answers: units and axes that measuring does not depend on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...datasets.observations import GnssFixes, GnssObservations
from ...datasets.own.blanks import is_blank
from ...datasets.own.declaration import NAME, Declaration, Section
from ...datasets.own.draft import Draft
from ...datasets.own.pvt_columns import Timed, read_timed
from ...datasets.own.reader import read_fixes, read_imu, read_rinex, sequence_of
from ...datasets.own.reference import read_reference
from ...datasets.physics import collected_refusals
from ...datasets.sequence import Sequence
from ...datasets.series import ImuData, Reference
from ...filters.errors import NavError

#: Answers in place of blanks. Axes as they are in the file; a lever that says nothing.
_ANSWERS: dict[str, dict[str, Any]] = {
    "imu": {"axes": "FRD", "gyro_unit": "rad/s", "accel_unit": "m/s2"},
    "gnss": {
        "height": "ellipsoid", "height_unit": "m", "angle_unit": "deg",
        "velocity_frame": "ned", "velocity_unit": "m/s", "geoid_m": 0.0,
        "position_sigma_m": 3.0, "velocity_sigma_mps": 0.3, "week": 0,
    },
    "imu.noise": {"preset": "consumer"},
    "antenna": {"lever_frd_m": [0.0, 0.0, 0.0], "lever_sigma_m": 1.0},
    "vehicle": {"mounting_rpy_deg": [0.0, 0.0, 0.0]},
}  # fmt: skip
_ANSWERS["reference"] = {
    **_ANSWERS["gnss"], "attitude_unit": "deg", "attitude_convention": "frd-ned",
    "attitude_of": "imu", "point": "imu", "source": "trial",
}  # fmt: skip
_ANSWERS["odometer"] = {"speed_unit": "m/s"}
#: Without these a section cannot be read at all; without those it is read without them.
_NEEDED = ("file", "topic", "time", "time_unit", "gyro", "accel", "position", "position_frame",
           "observations", "navigation", "speed")  # fmt: skip
_OPTIONAL = ("velocity",)
_OF_VELOCITY = ("velocity", "velocity_frame", "velocity_unit", "velocity_sigma",
                "velocity_sigma_mps", "velocity_sigma_unit", "velocity_variance")  # fmt: skip
_DATED = ("utc", "gps-calendar")


def readable(draft: Draft, section: str) -> bool:
    """Return whether a section is there with all that its columns need."""
    return section in draft.sections and not any(draft.asks(section, key) for key in _NEEDED)


def has_dates(draft: Draft, section: str) -> bool:
    """Return whether the time of a section is text."""
    if draft.get(section, "time_scale") in _DATED:
        return True
    return draft.asks(section, "time_scale") and "dates" in draft.comment(section, "time_scale")


def declaration(draft: Draft, answers: Mapping[tuple[str, str], Any] | None = None) -> Declaration:
    """Return the draft as a declaration without blanks.

    Parameters
    ----------
    draft : Draft
    answers : mapping of (section, key), optional
        Before those of all trials.
    """
    tables = draft.tables(answers or {})
    for name, table in tables.items():
        trial = _ANSWERS.get(name, {})
        for key in [k for k, value in table.items() if is_blank(value)]:
            if key == "time_scale":
                table[key] = "gps-calendar" if has_dates(draft, name) else "relative"
            elif key in _OPTIONAL:
                del table[key]
            elif key in trial:
                table[key] = trial[key]
        if "velocity" not in table:
            for key in _OF_VELOCITY:
                table.pop(key, None)
        if name == "imu" and draft.asks("imu", "gyro_unit") and table.get("accel_unit") == "m/s":
            table["gyro_unit"] = "rad"  # increments both
    file = draft.home / NAME
    return Declaration(file, "draft", {k: Section(file, k, v) for k, v in tables.items()})


def imu_of(draft: Draft) -> ImuData | None:
    """Return the IMU in the file's axes; None where columns are missing."""
    if not readable(draft, "imu"):
        return None
    return read_imu(declaration(draft, {("imu", "axes"): "FRD"}))[0]


def fixes_of(draft: Draft) -> GnssFixes | None:
    """Return the positions; None where there are none, or columns are missing."""
    if not readable(draft, "gnss"):
        return None
    with collected_refusals():
        return read_fixes(declaration(draft))[0]


def observations_of(draft: Draft) -> GnssObservations | None:
    """Return the raw observations; None where there are none, or no ephemerides."""
    return read_rinex(declaration(draft))[0] if readable(draft, "rinex") else None


def reference_of(draft: Draft, answers: Mapping[str, Any] | None = None) -> Reference | None:
    """Return the reference with its point at the IMU; None where columns are missing."""
    if not readable(draft, "reference"):
        return None
    given = {("reference", key): value for key, value in (answers or {}).items()}
    given[("reference", "point")] = "imu"
    with collected_refusals():
        zero = np.zeros(3)
        return read_reference(declaration(draft, given), zero, zero)[0]


def columns_of(draft: Draft, section: str, keys: Mapping[str, int]) -> Timed:
    """Return columns of a section as numbers, so many of each key, and their time."""
    declared = declaration(draft)
    table = declared.sections[section]
    wanted = {key: table.columns(key, (count,), "") for key, count in keys.items()}
    return read_timed(table, declared.time_scale(table), wanted, may_miss=tuple(keys))


def sequence_if_read(draft: Draft, answers: Mapping[tuple[str, str], Any]) -> Sequence | None:
    """Return the whole recording with trial answers; None where its reader refuses it."""
    try:
        with collected_refusals() as refused:
            sequence = sequence_of(declaration(draft, answers))
    except NavError:
        return None
    return None if refused else sequence


@contextmanager
def unmeasured(draft: Draft, what: str) -> Iterator[None]:
    """Say in the draft's head what kept something from being measured, instead of raising."""
    try:
        yield
    except NavError as error:
        draft.head.append(f"{what} not measured: {error}")
