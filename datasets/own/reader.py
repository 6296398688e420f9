"""Own recordings by declaration: from ``sequence.toml`` and the files it names to a `Sequence`.

Nothing is assumed that is not declared, and what is declared is tested: specific force against
gravity, the yaw gyro against the course, velocities against differenced positions.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ..fix_faults import screened
from ..observations import GnssFixes, GnssObservations
from ..physics import check_gravity, check_gyro, course_of
from ..sequence import Calibration, Sequence
from ..series import ImuData, Odometer, Reference
from ..text.columns import Column
from ..text.imu import rates_from_increments
from ..text.tables import sampling_note
from ..time_scales import TimeScale
from .declaration import (
    ACCEL_UNITS,
    GNSS_FORMATS,
    GYRO_UNITS,
    LEVER_LINE,
    NAME,
    SPEED_UNITS,
    Declaration,
    Section,
    imu_axes,
    imu_spec,
    lever,
    mounting,
    read_declaration,
)
from .pvt_columns import read_pvt, read_timed
from .reference import read_reference

if TYPE_CHECKING:
    from ..rtklib import GivenFiles

#: A delay of time stamps that is not known to this is not to be estimated, but found [s].
_LARGEST_DELAY = 1.0
#: How well a mounting is known that was judged by eye, 1σ [deg]: 5° out of square is seen.
_BY_EYE = 5.0
#: And the point of the wheels, measured with a tape, or not at all [m]: a rear axle is within 4 m
#: (2σ) of any IMU in a car.
_TAPE, _ANYWHERE = 0.1, 2.0


def is_declared(folder: Path) -> bool:
    """Return whether the folder holds ``sequence.toml``."""
    return (folder / NAME).is_file()


def read_declared(path: str | Path) -> Sequence:
    """Return a recording as its declaration says.

    Parameters
    ----------
    path : path
        The declaration, or the folder of ``sequence.toml``.

    Raises
    ------
    ConfigError
        What is needed and not declared, with the line to add, or not a known key or value.
    DataError
        Unreadable files, or declared facts that physics contradicts.
    """
    return sequence_of(read_declaration(path))


def sequence_of(declared: Declaration) -> Sequence:
    """Return the recording of a declaration, wherever its keys are from."""
    _one_kind_of_time(declared)
    antenna = declared.required("antenna", f"[antenna] and {LEVER_LINE}  # IMU to antenna")
    lever_b = lever(antenna, "lever_frd_m", f"{LEVER_LINE}  # IMU to antenna, forward right down")
    C_bv = mounting(declared)
    spec = imu_spec(declared)
    imu, imu_notes = read_imu(declared)
    observations, given, rinex_notes = read_rinex(declared)
    navigation = () if given is None else given.navigation
    logs = () if given is None else given.notes
    fixes, fix_notes = read_fixes(declared)
    if observations is None and fixes is None:
        raise ConfigError(
            f"{declared.file}: no GNSS is declared — add [gnss] (positions in a file) or [rinex] "
            "(observations and navigation)"
        )
    vehicle = declared.sections["vehicle"]
    measured = vehicle.has("wheels_frd_m")
    wheels = lever(vehicle, "wheels_frd_m", "") if measured else np.zeros(3)
    calibration = Calibration(
        imu=spec,
        lever_antenna_b=lever_b,
        lever_antenna_source=antenna.text("source", "", default=f"declared in {NAME}"),
        lever_antenna_sigma=float(antenna.numbers("lever_sigma_m", (1,), "", np.zeros(1))[0]),
        delay_sigma=_delay_sigma(declared),
        C_bv=C_bv,
        lever_vehicle_b=wheels,
        mounting_source=f"declared in {NAME}",
        mounting_sigma=np.radians(vehicle.sigma("mounting_sigma_deg", _BY_EYE)),
        lever_vehicle_sigma=vehicle.sigma("wheels_sigma_m", _TAPE if measured else _ANYWHERE),
    )
    reference, reference_notes = read_reference(declared, lever_b, wheels)
    time, course = _course(fixes, reference, observations, navigation)
    physics_notes = _verify_imu(declared, imu, C_bv, time, course)
    odometer, odometer_notes = _odometer(declared)
    relative = declared.time_scale(declared.sections["imu"]).is_relative
    return Sequence(
        name=declared.name,
        imu=imu,
        calibration=calibration,
        observations=observations,
        navigation=navigation,
        fixes=fixes,
        odometer=odometer,
        reference=reference,
        time_scale="relative" if relative else "gps",
        rover_file=None if given is None else given.observations,
        logs=logs,
        notes=(
            *imu_notes,
            *physics_notes,
            f"IMU noise: {spec.name}, {spec.source}",
            f"lever arm IMU→antenna {lever_b} m (forward, right, down), as declared",
            *logs,
            *rinex_notes,
            *fix_notes,
            *odometer_notes,
            *reference_notes,
        ),
    )


def _one_kind_of_time(declared: Declaration) -> None:
    """Refuse files with dates beside files without."""
    kinds = {}
    for name in ("imu", "gnss", "odometer", "reference"):
        section = declared.section(name)
        if section is None or section.values.get("format") == "kf-gins":
            continue
        by_itself = section.values.get("format", "csv") != "csv"  # formats that hold dates
        kinds[name] = not by_itself and declared.time_scale(section).is_relative
    if declared.section("rinex"):
        kinds["rinex"] = False
    if len(set(kinds.values())) > 1:
        bare = ", ".join(f"[{name}]" for name, relative in kinds.items() if relative)
        dated = ", ".join(f"[{name}]" for name, relative in kinds.items() if not relative)
        raise ConfigError(
            f"{declared.file}: time of {bare} is relative, that of {dated} has a date: they "
            'cannot be put on one axis — if you know when the clock started: time_scale = "gps", '
            "time_offset_s = that GPS time"
        )


def read_imu(declared: Declaration) -> tuple[ImuData, list[str]]:
    """Return the declared IMU in body axes, and notes."""
    section = declared.required("imu", '[imu] and file = "imu.csv"')
    gyro_unit = section.choice("gyro_unit", GYRO_UNITS, 'gyro_unit = "deg/s"')
    accel_unit = section.choice("accel_unit", ACCEL_UNITS, 'accel_unit = "m/s2"')
    C_bs = imu_axes(section)
    numbers = {
        "gyro": section.columns("gyro", (3,), 'gyro = ["gx", "gy", "gz"]'),
        "accel": section.columns("accel", (3,), 'accel = ["ax", "ay", "az"]'),
    }
    kind = section.choice("samples", ("mean", "instant"), 'samples = "mean"', default="mean")
    columns, time, stamps = read_timed(section, declared.time_scale(section), numbers)
    if time.size < 2:
        raise DataError(f"expected at least 2 rows, found {time.size}", file=columns.table.file)
    notes = [sampling_note(time, f"IMU {columns.table.file.name}"), *stamps]
    parts = []
    for key, (factor, increments) in (
        ("gyro", GYRO_UNITS[gyro_unit]),
        ("accel", ACCEL_UNITS[accel_unit]),
    ):
        value = columns.numbers[key] * factor
        if increments:
            value = rates_from_increments(time, value)
        elif kind == "instant":
            value = np.vstack([value[:1], 0.5 * (value[1:] + value[:-1])])
        parts.append(value @ C_bs.T)
    notes.append(
        f"IMU as declared: {gyro_unit}, {accel_unit}, axes {section.values['axes']}; "
        + (
            "instantaneous samples averaged with the one before"
            if kind == "instant"
            else "each row the mean (or the increment) over the interval that ends at its stamp"
        )
    )
    return ImuData(time, *parts), notes


def read_rinex(
    declared: Declaration,
) -> tuple[GnssObservations | None, GivenFiles | None, list[str]]:
    """Return the declared observations, the files they are in, and what was repaired in these."""
    section = declared.section("rinex")
    if section is None:
        return None, None, []
    from ..rtklib import given_files, read_observations
    from ..text.rinex_repair import readable_rinex

    home = section.file.parent
    name = section.text("observations", 'observations = "rover.obs"')
    files = section.values.get("navigation", [])
    files = [files] if isinstance(files, str) else files
    if not isinstance(files, list) or not all(isinstance(f, str) and "\0" not in f for f in files):
        raise section.refuse("navigation", "names of files with broadcast ephemerides")
    given = given_files(home / name, [home / f for f in files])
    if not given.navigation:
        raise section.missing('navigation = ["brdc.nav"]', "broadcast ephemerides")
    observations = read_observations(
        given.observations,
        given.navigation,
        systems=section.text("systems", "", default="GREJC"),
        signals=section.choice("signals", ("first", "all"), "", default="first"),
    )
    plain = (given.observations, *given.navigation)
    return observations, given, [note for f in plain for note in readable_rinex(f).notes]


def read_fixes(declared: Declaration) -> tuple[GnssFixes | None, list[str]]:
    """Return the declared positions, implausible ones marked, and notes; None without any."""
    section = declared.section("gnss")
    if section is None:
        return None, []
    kind = section.choice("format", GNSS_FORMATS, 'format = "csv"', default="csv")
    if kind == "csv":
        fixes, notes = _fixes_of_columns(section, declared.time_scale(section))
    else:
        fixes, notes = _fixes_of_format(declared, section, kind)
    if len(fixes) < 2:
        raise DataError(f"expected at least 2 positions, found {len(fixes)}", file=section.path())
    fixes = screened(fixes)
    if fixes.usable.sum() < 2:
        reasons = ", ".join(sorted({str(reason) for reason in fixes.rejected if reason}))
        raise DataError(
            f"expected at least 2 positions, found {int(fixes.usable.sum())} among {len(fixes)} "
            f"rows ({reasons})",
            file=section.path(),
            remedy="log while the receiver has a fix, or declare what the columns mean",
        )
    return fixes, [sampling_note(fixes.time, f"GNSS {section.values['file']}"), *notes]


def _fixes_of_columns(section: Section, scale: TimeScale) -> tuple[GnssFixes, list[str]]:
    extra: dict[str, tuple[Column, ...]] = {}
    text: dict[str, tuple[Column, ...]] = {}
    if section.has("satellites"):
        extra["satellites"] = section.columns("satellites", (1,), "")
    if section.has("quality"):
        text["quality"] = section.columns("quality", (1,), "")
    pvt = read_pvt(section, scale, deviations=True, extra=extra, text=text)
    n = pvt.time.size
    satellites = pvt.columns.numbers.get("satellites", np.full((n, 1), -1.0))[:, 0]
    fixes = GnssFixes(
        time=pvt.time,
        pos_e=pvt.pos_e,
        pos_cov_e=pvt.pos_cov_e,
        vel_e=pvt.vel_e,
        vel_cov_e=pvt.vel_cov_e,
        satellites=np.where(np.isfinite(satellites), satellites, -1).astype(int),
        quality=np.array(pvt.columns.text.get("quality", ["declared"] * n)),
    )
    without = n - int(fixes.has_velocity.sum())
    notes = list(pvt.notes)
    if section.has("velocity") and without:
        notes.append(f"{without} of {n} GNSS rows have no velocity")
    return fixes, notes


def _delay_sigma(declared: Declaration) -> float:
    """Return 1σ of GNSS's time stamps against the IMU's [s]."""
    total = 0.0
    for name in ("imu", "gnss"):
        section = declared.sections.get(name)
        if section is not None and section.has("time_offset_sigma_s"):
            sigma = float(section.numbers("time_offset_sigma_s", (1,), "")[0])
            if not 0.0 <= sigma <= _LARGEST_DELAY:
                raise section.refuse("time_offset_sigma_s", f"0 … {_LARGEST_DELAY:g} s, 1σ")
            total = float(np.hypot(total, sigma))
    return total


def _fixes_of_format(
    declared: Declaration, section: Section, kind: str
) -> tuple[GnssFixes, list[str]]:
    """Return the fixes of a format that says itself what its columns are."""
    path = section.path()
    offset = float(section.numbers("time_offset_s", (1,), "", np.zeros(1))[0])
    notes: tuple[str, ...] = ()
    if kind == "rtklib":
        from ..formats.rtklib_pos import read_pos

        fixes = read_pos(path)
    elif kind == "great-pvt":
        from ..great.pvt import read_flt

        fixes, notes = read_flt(path, week=declared.week(section))
    elif kind == "kf-gins":
        from ..formats.kfgins import read_gnss

        fixes = read_gnss(path, week=declared.week(section))
    else:
        sigma = {
            of: section.numbers(key, (1, 3), "") if section.has(key) else None
            for of, key in (
                ("position_sigma", "position_sigma_m"),
                ("velocity_sigma", "velocity_sigma_mps"),
            )
        }
        if kind == "ubx":
            from ..formats.ubx import read_ubx

            fixes, notes = read_ubx(path, **sigma)
        else:
            from ..formats.nmea import read_nmea

            geoid = (
                float(section.numbers("geoid_m", (1,), "")[0]) if section.has("geoid_m") else None
            )
            fixes, notes = read_nmea(path, **sigma, geoid=geoid)
    if offset:
        fixes = dataclasses.replace(fixes, time=fixes.time + offset)
    return fixes, list(notes)


def _odometer(declared: Declaration) -> tuple[Odometer | None, list[str]]:
    section = declared.section("odometer")
    if section is None:
        return None, []
    speed_unit = section.choice("speed_unit", SPEED_UNITS, 'speed_unit = "m/s"')
    numbers = {"speed": section.columns("speed", (1,), 'speed = "speed"')}
    factor = 0.0
    if section.has("yaw_rate"):
        numbers["yaw_rate"] = section.columns("yaw_rate", (1,), "")
        unit = section.choice("yaw_rate_unit", ("rad/s", "deg/s"), 'yaw_rate_unit = "rad/s"')
        axis = section.choice(
            "yaw_rate_axis", ("down", "up"), 'yaw_rate_axis = "up"', "up: left turns positive"
        )
        factor = GYRO_UNITS[unit][0] * (1.0 if axis == "down" else -1.0)
    columns, time, notes = read_timed(section, declared.time_scale(section), numbers)
    odometer = Odometer(
        time=time,
        speed=columns.numbers["speed"][:, 0] * SPEED_UNITS[speed_unit],
        yaw_rate=columns.numbers["yaw_rate"][:, 0] * factor if factor else None,
    )
    return odometer, notes


def _course(
    fixes: GnssFixes | None,
    reference: Reference | None,
    observations: GnssObservations | None,
    navigation: tuple[Path, ...],
) -> tuple[FloatArray, FloatArray]:
    """Return time and course of the best source there is: velocities before differences."""
    fixes = None if fixes is None else fixes.take(fixes.usable)
    for record in (fixes, reference):
        if record is not None and np.isfinite(record.vel_e).any():
            return record.time, course_of(record.pos_e, record.vel_e)
    if fixes is None:
        if observations is None:
            return np.empty(0), np.empty(0)
        from ..rtklib import single_point

        fixes = single_point(observations, navigation, elevation_mask=np.radians(10.0)).fixes
    if len(fixes) < 3:
        return np.empty(0), np.empty(0)
    stride = max(1, round(1.0 / float(np.median(np.diff(fixes.time)))))
    time, pos_e = fixes.time[::stride], fixes.pos_e[::stride]
    step = np.diff(time)
    # positions a second apart, good to metres: only fast driving gives a course
    vel_e = np.diff(pos_e, axis=0) / step[:, None]
    return time[:-1] + 0.5 * step, course_of(pos_e[1:], vel_e, min_speed=5.0)


def _verify_imu(
    declared: Declaration, imu: ImuData, C_bv: FloatArray, time: FloatArray, course: FloatArray
) -> list[str]:
    """Test the declared units and axes in the vehicle's axes, and return the evidence."""
    section = declared.sections["imu"]
    file, axes = section.path(), section.values["axes"]
    force = f"{section.values['accel_unit']}, {axes}"
    rates = f"{section.values['gyro_unit']}, {axes}"
    notes = [check_gravity(imu.accel_b @ C_bv, file=file, declared=force)]
    turned = ImuData(imu.time, imu.gyro_b @ C_bv, imu.accel_b @ C_bv)
    if time.size < 3 or time[-1] < imu.time[0] or time[0] > imu.time[-1]:
        return notes  # no overlap: `Sequence` says so
    return [*notes, check_gyro(turned, time, course, file=file, declared=rates)]
