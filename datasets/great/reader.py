"""GREAT sequences (Wuhan University): GREAT-Dataset and the sample data of GREAT-MSF.

The files hold: IMU rates in right-forward-up axes, gyro in deg/s, accelerometer in m/s², stamped
with GPS seconds of week and no week; the rover's RINEX; a reference from Inertial Explorer. What
they do not hold is where the antenna is: two public sources contradict each other by 0.24 m, so
a lever arm has to be named. Facts: GREAT-WHU/GREAT-Dataset (Readme, figures parameter1/2),
GREAT-WHU/GREAT-MSF (manual 1.1, configuration files of the samples).

A file ``great.toml`` in the folder may declare what the options declare; the options win.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray, matrix_from_rpy
from ...filters.sensors import imu_preset as _spec
from .. import gpstime
from ..formats.inertial_explorer import ReferenceTable, read_reference_table
from ..observations import GnssObservations
from ..physics import (
    check_gravity,
    check_gyro,
    course_of,
    decide_gyro_unit,
    gyro_unit_ratio,
    vertical_rate,
)
from ..sequence import Calibration
from ..sequence import Sequence as Drive
from ..series import ImuData, Reference
from ..text.imu import ImuTable, convert, read_imu_table
from .catalogue import named_in
from .files import (
    SIDECAR,
    GreatFiles,
    base_stations,
    choose_observations,
    find_files,
    first_observation,
    is_simulated,
)
from .files import is_great as is_great
from .installation import Declared, antenna_lever, read_declared, reference_lever
from .options import GreatOptions, paths

#: GNSS epochs so long before and after the IMU stay [s]: what is interpolated needs them.
_MARGIN = 2.0
#: What a simulated sequence says of itself.
SIMULATED = "simulated drive in the layout of GREAT: none of its figures is of the GREAT dataset"


def read_great(path: str | Path, options: GreatOptions | None = None) -> Drive:
    """Return one GREAT sequence.

    Parameters
    ----------
    path : path
        Folder of the sequence, in either layout.
    options : GreatOptions, optional
        `datasets.loading.load` takes its fields as keywords.

    Raises
    ------
    DataError
        A missing or unreadable file, or data that contradict each other or physics.
    ConfigError
        Something that has to be declared and is not, or not a known value.
    """
    folder, options = Path(path), options or GreatOptions()
    imu = options.imu
    declared = read_declared(folder, options)
    files = _files(folder, options, declared)
    table = read_imu_table(files.imu)
    trajectory = read_reference_table(files.reference) if files.reference else None
    found_week = _week(declared.week, table, trajectory, files)
    start, end = gpstime.from_week_sow(found_week, table.sow[[0, -1]])
    observations_file = choose_observations(files.observations, start, end)

    from ..rtklib import read_observations

    observations = read_observations(
        observations_file, files.navigation, systems=options.systems, signals=options.signals
    )
    observations, beyond = _within(observations, start, end)
    data, physics_notes = _imu(
        table, found_week, declared, trajectory, observations, files.navigation
    )
    lever_b, lever_source = antenna_lever(declared, imu, found_week)
    notes = [
        f"GREAT: {files.imu.name}, {observations_file.name}, GPS week {found_week}",
        *table.notes,
        *beyond,
        *physics_notes,
        "IMU rows are rates, read as means over the interval that ends at their stamp; axes "
        "right-forward-up turned to forward-right-down",
        f"lever arm IMU→antenna {lever_b.round(3)} m (forward, right, down): {lever_source}",
        "mounting of the IMU in the vehicle: "
        + ("not documented, taken as aligned" if declared.lever_vehicle is None else "declared"),
    ]
    base_station, base_note = _base_station(paths(options.base), files.base, start, end)
    if base_note:
        notes.append(base_note)
    simulated = is_simulated(observations_file)
    if simulated:
        declared = dataclasses.replace(declared, reference_source="simulation truth")
    reference = None
    if trajectory is not None:
        reference, more = _reference(declared, imu, found_week, trajectory, lever_b)
        notes += [*trajectory.notes, *more]
    else:
        notes.append("no reference found")
    name = folder.resolve().name
    if simulated:
        notes.insert(1, SIMULATED)
        if named_in(name) is not None:  # nothing shall pass for a figure of that sequence
            name += "-simulated"
    return Drive(
        name=name,
        imu=data,
        calibration=_calibration(declared, lever_b, lever_source),
        observations=observations,
        navigation=files.navigation,
        reference=reference,
        notes=tuple(notes),
        rover_file=observations_file,
        base=base_station,
    )


def _within(
    observations: GnssObservations, start: float, end: float
) -> tuple[GnssObservations, list[str]]:
    """Return the observations of the IMU's time, and what is said of the others.

    A receiver's file may be of a whole day, and of several sequences. One that has nothing of the
    IMU's time is left as it is: checks say why.
    """
    inside = (observations.time >= start - _MARGIN) & (observations.time <= end + _MARGIN)
    outside = np.unique(observations.time[~inside]).size
    if not outside or not inside.any():
        return observations, []
    return observations.take(inside), [f"{outside} GNSS epochs before or after the IMU left out"]


def _calibration(declared: Declared, lever_b: FloatArray, lever_source: str) -> Calibration:
    """Return the calibration; vehicle constraints need mounting and wheels, both declared."""
    spec, rpy, wheels = (
        _spec(declared.imu_preset),
        declared.mounting_rpy_deg,
        declared.lever_vehicle,
    )
    sigma = declared.lever_antenna_sigma_m
    if rpy is None or wheels is None:
        return Calibration(spec, lever_b, lever_source, sigma)
    return Calibration(
        spec,
        lever_b,
        lever_source,
        sigma,
        C_bv=matrix_from_rpy(np.radians(rpy)).T,
        lever_vehicle_b=wheels,
        mounting_source=f"declared in {SIDECAR}",
        mounting_sigma=float(np.radians(declared.mounting_sigma_deg)),
        lever_vehicle_sigma=declared.lever_vehicle_sigma_m,
    )


def _files(folder: Path, options: GreatOptions, declared: Declared) -> GreatFiles:
    """Return the files to read: those named in the call, else those found in the folder."""
    if not folder.is_dir():
        raise DataError("no such folder", file=folder, remedy="check the path")
    named = {"imu": options.imu_file, "reference": options.reference_file}
    found = find_files(
        folder,
        imu=options.imu,
        reference_point=declared.reference_point,
        named={key: Path(value) for key, value in named.items() if value is not None},
    )
    files = dataclasses.replace(
        found,
        observations=found.observations if options.rinex is None else (Path(options.rinex),),
        navigation=paths(options.navigation) or found.navigation,
    )
    for what, option in (("observations", "rinex"), ("navigation", "navigation")):
        if not getattr(files, what):
            raise DataError(
                f"no RINEX {what} found here or in a GNSS_RAW_DATA folder beside it",
                file=folder,
                remedy=f"name the files with {option}=…",
            )
    return files


def _base_station(
    named: tuple[Path, ...], found: tuple[Path, ...], start: float, end: float
) -> tuple[tuple[Path, ...], str]:
    """Return the files of the base station and a note; none where there are several stations."""
    chosen = named
    if not chosen:
        stations = base_stations(found, start, end)
        if len(stations) > 1:
            names = ", ".join(stations)
            return (), f"several base stations ({names}): for RTK, name the files with base=…"
        chosen = next(iter(stations.values()), ())
    names = ", ".join(file.name for file in chosen)
    return chosen, f"base station {names}: used with gnss.position = 'rtk'" if chosen else ""


def _week(
    declared: int | None, table: ImuTable, trajectory: ReferenceTable | None, files: GreatFiles
) -> int:
    """Return the GPS week of the first IMU row, on which all sources have to agree."""
    sources: list[tuple[int, str]] = []
    if declared is not None:
        sources.append((int(declared), "declared"))
    if trajectory is not None:
        where = f"{files.reference}:{trajectory.week_line}"
        sources.append((trajectory.week, where))
    if len(files.observations) == 1:
        rinex = files.observations[0]
        # A recording that begins before midnight on Saturday belongs to the week before.
        first = first_observation(rinex)
        sow = first - gpstime.SECONDS_PER_WEEK * np.floor(first / gpstime.SECONDS_PER_WEEK)
        later = sow > table.sow[0] + gpstime.SECONDS_PER_WEEK / 2
        sources.append((int(first // gpstime.SECONDS_PER_WEEK) + int(later), str(rinex)))
    if not sources:
        raise ConfigError("GPS week unknown: no reference, several RINEX files; declare week=…")
    week, where = sources[0]
    for other, origin in sources[1:]:
        if other != week:
            raise DataError(
                f"GPS week {week} ({where}) and {other} ({origin}) contradict each other",
                file=table.file,
                remedy="the IMU file holds no week: correct the declared one, or the wrong file",
            )
    return week


def _imu(
    table: ImuTable,
    week: int,
    declared: Declared,
    trajectory: ReferenceTable | None,
    observations: GnssObservations,
    navigation: Sequence[Path],
) -> tuple[ImuData, list[str]]:
    """Convert the IMU after telling, or verifying, the gyro's unit against the course."""
    if trajectory is not None:
        time, course = trajectory.time, course_of(trajectory.pos_e, trajectory.vel_e)
    else:
        time, course = _single_point_course(observations, navigation)
    notes = []
    unit = declared.gyro_unit
    if unit == "auto":
        raw = convert(table, week=week, gyro_unit="rad/s", accel_unit="m/s2", axes="RFU")
        ratio = gyro_unit_ratio(raw.time, vertical_rate(raw), time, course)
        unit, evidence = decide_gyro_unit(ratio, file=table.file)
        notes.append(evidence)
    data = convert(table, week=week, gyro_unit=unit, accel_unit="m/s2", axes="RFU")
    notes.append(check_gravity(data.accel_b, file=table.file, declared="m/s², RFU"))
    if declared.gyro_unit != "auto":
        notes.append(check_gyro(data, time, course, file=table.file, declared=f"{unit}, RFU"))
    return data, notes


def _single_point_course(
    observations: GnssObservations, navigation: Sequence[Path]
) -> tuple[FloatArray, FloatArray]:
    """Return time and course from differenced single-point positions (no reference at hand)."""
    from ..rtklib import single_point

    fixes = single_point(observations, navigation, elevation_mask=np.radians(10.0)).fixes
    if len(fixes) < 3:
        return np.empty(0), np.empty(0)
    step = np.diff(fixes.time)
    vel_e = np.diff(fixes.pos_e, axis=0) / step[:, None]
    middle = 0.5 * (fixes.pos_e[1:] + fixes.pos_e[:-1])
    # metre-level positions a second apart: only fast driving gives a course
    return fixes.time[:-1] + 0.5 * step, course_of(middle, vel_e, min_speed=5.0)


def _reference(
    declared: Declared, imu: str, week: int, table: ReferenceTable, lever_b: FloatArray
) -> tuple[Reference, list[str]]:
    """Put the reference on its declared point and its attitude on its declared body."""
    vector, name = reference_lever(declared, imu, week, lever_b)
    same = declared.reference_body == "imu" or imu == "tactical"
    note = f"reference of the {name}, {vector.round(3)} m from the IMU, as declared; attitude of "
    note += (
        "the IMU navigated with"
        if same
        else "the tactical IMU: a constant misalignment to the MEMS IMU (pitch about −0.65°, "
        "heading up to 1.7° in GREAT-MSF's manual) remains in attitude differences"
    )
    reference = Reference(
        time=table.time,
        pos_e=table.pos_e,
        vel_e=table.vel_e,
        rpy=table.rpy,
        lever_b=vector,
        point=name,
        source=declared.reference_source,
        attitude_frame="b" if same else "v",
    )
    return reference, [note]
