"""Simulated drives as folders in the layout of the GREAT dataset.

``IMU/MEMS_imu_data.txt`` and ``IMU/Tactical_imu_data.txt`` (sow, deg/s, m/s², right-forward-up),
``Groundtruth/groundtruth.txt`` (Inertial Explorer, ECEF and geodetic, no Easting),
``GNSS/Rover/*.O`` (RINEX 3.02), ``GNSS/Base/*.o`` where a base station is simulated,
``GNSS/Product/*.rnx`` (RINEX 3.04 navigation), and ``great.toml``, which declares what the files
themselves do not: week, units, lever arm. The reference is of the MEMS IMU's centre; its attitude
is the vehicle's, as the tactical IMU is aligned with the vehicle.

Digits: times lie on a grid of 10 µs, so five decimals are exact; 1e-10 deg/s and 1e-10 m/s² are
far below any noise, also summed over an hour. RINEX gives 1 mm and 1 mHz (0.2 mm/s); the
reference 0.1 mm, 0.01 mm/s and 1e-7 deg.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...filters.earth import ecef_to_lla
from ...filters.errors import DataError
from ...filters.rotation import FloatArray, matrix_from_rpy, rpy_from_matrix
from .. import gpstime
from ..observations import GnssObservations
from ..placing import written_whole
from ..series import ImuData, Reference
from ..simulation.constellation import write_navigation
from ..simulation.simulator import LEVER_ANTENNA, Simulation, SimulationConfig, simulate
from .files import SIDECAR, SIMULATOR
from .installation import WEEK_2020

_MARK = "simulated by certnav"
_NAMES = (
    "Week GPSTime X-ECEF Y-ECEF Z-ECEF Latitude Longitude H-Ell VX-ECEF VY-ECEF VZ-ECEF "
    "Cx11 Cx22 Cx33 Vel-Cx11 Vel-Cx22 Vel-Cx33 Heading Pitch Roll AmbStatus PDOP Q NS"
)
_UNITS = (
    "(weeks) (sec) (m) (m) (m) (+/-D M S) (+/-D M S) (m) (m/s) (m/s) (m/s) (m^2) (m^2) (m^2) "
    "(m^2/s^2) (m^2/s^2) (m^2/s^2) (deg) (deg) (deg) () (dop) () ()"
)


def simulate_folder(
    config: SimulationConfig,
    out: str | Path,
    *,
    overwrite: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> Path:
    """Simulate a drive and write it as a folder in the layout of the GREAT dataset.

    Parameters
    ----------
    config : SimulationConfig
    out : path
        The folder to make.
    overwrite : bool
        Whether an earlier simulation at `out` may be replaced. Anything else never is.
    progress : callable, optional
        Told the fraction done and what happens next.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    DataError
        If `out` exists and may not be replaced.

    The folder appears complete or not at all, and so does its successor (`datasets.placing`).
    """
    out = Path(out)
    _refuse_existing(out, overwrite)
    say = progress or (lambda fraction, what: None)
    say(0.0, "simulating the drive")
    simulation = simulate(config)
    say(0.4, "writing the folder")
    with written_whole(out) as draft:
        write_great(simulation, draft)
    return out


def _refuse_existing(out: Path, overwrite: bool) -> None:
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not overwrite:
        raise DataError("exists already", file=out, remedy="choose another folder or overwrite")
    sidecar = out / SIDECAR
    if not sidecar.is_file() or _MARK not in sidecar.read_text(encoding="utf-8"):
        raise DataError(
            "not a folder the simulator wrote; it is not replaced",
            file=out,
            remedy="choose another folder",
        )


def write_great(simulation: Simulation, folder: Path) -> None:
    """Write a simulation into a folder that is empty, or not there yet."""
    config = simulation.config
    start, end = config.start_time, config.start_time + config.duration
    date = config.start
    day = date.timetuple().tm_yday
    for part in ("IMU", "Groundtruth", "GNSS/Rover", "GNSS/Product"):
        (folder / part).mkdir(parents=True)
    write_imu(folder / "IMU" / "MEMS_imu_data.txt", simulation.imu)
    write_imu(folder / "IMU" / "Tactical_imu_data.txt", simulation.tactical_imu())
    write_reference(
        folder / "Groundtruth" / "groundtruth.txt",
        simulation.reference,
        simulation.trajectory.C_bv,
    )
    rover = folder / "GNSS" / "Rover" / f"SEPT{day:03d}0.{date.year % 100:02d}O"
    write_observations(rover, simulation.observations, 1.0 / config.gnss_rate)
    if simulation.base is not None:
        (folder / "GNSS/Base").mkdir()
        write_observations(
            folder / "GNSS" / "Base" / f"BASE{day:03d}0.{date.year % 100:02d}o",
            simulation.base.observations,
            1.0 / config.gnss_rate,
            marker="BASE",
            position_e=simulation.base.pos_e,
        )
    product = f"BRDC00SIM_R_{date.year}{day:03d}0000_01D_GN.rnx"
    write_navigation(folder / "GNSS" / "Product" / product, simulation.ephemerides, start, end)
    (folder / SIDECAR).write_text(_sidecar(simulation), encoding="utf-8")


def write_imu(path: Path, imu: ImuData) -> None:
    """Write inertial data: sow, gyro [deg/s], accelerometer [m/s²], axes right-forward-up."""
    _, sow = gpstime.to_week_sow(imu.time)
    gyro, accel = _right_forward_up(np.degrees(imu.gyro_b)), _right_forward_up(imu.accel_b)
    np.savetxt(
        path,
        np.column_stack([sow, gyro, accel]),
        fmt=["%.5f", *6 * ["%.10f"]],
        header="Time gx gy gz ax ay az",
        comments="",
    )


def _right_forward_up(vector_b: FloatArray) -> FloatArray:
    return vector_b[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])


def write_reference(path: Path, reference: Reference, C_bv: FloatArray) -> None:
    """Write the IMU's motion with the vehicle's attitude, as Inertial Explorer exports it."""
    week, sow = gpstime.to_week_sow(reference.time)
    lla = ecef_to_lla(reference.pos_e)
    rpy = np.degrees(rpy_from_matrix(matrix_from_rpy(reference.rpy) @ C_bv))
    lines = [_NAMES, _UNITS]
    for k in range(len(reference)):
        numbers = " ".join(f"{v:.4f}" for v in reference.pos_e[k])
        angles = f"{_dms(lla[k, 0])} {_dms(lla[k, 1])} {lla[k, 2]:.4f}"
        velocity = " ".join(f"{v:.5f}" for v in reference.vel_e[k])
        # Exact truth: covariances far below the digits; heading is printed in 0…360.
        attitude = f"{rpy[k, 2] % 360.0:.7f} {rpy[k, 1]:.7f} {rpy[k, 0]:.7f}"
        lines.append(
            f"{week[k]} {sow[k]:.3f} {numbers} {angles} {velocity} "
            f"1e-06 1e-06 1e-06 1e-08 1e-08 1e-08 {attitude} Fixed 1.0 1 12"
        )
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _dms(angle: float) -> str:
    """Return degrees, minutes and seconds (to 0.1 mm) as three tokens; the sign at the degrees."""
    ticks = round(abs(np.degrees(angle)) * 3600e6)
    degree, rest = divmod(ticks, 3600 * 10**6)
    minute, micro = divmod(rest, 60 * 10**6)
    return f"{'-' if angle < 0 else ''}{degree} {minute} {micro / 1e6:.6f}"


def write_observations(
    path: Path,
    observations: GnssObservations,
    interval: float,
    *,
    marker: str = "SEPT",
    position_e: FloatArray | None = None,
) -> None:
    """Write RINEX 3.02 observations: GPS C1C L1C D1C S1C, one line per satellite and epoch.

    Epochs without a satellite are left out, as receivers do. A position is given for base
    stations only: the 2020 GREAT files have none of the rover.
    """

    if not len(observations):
        raise DataError("no satellite was visible at any time: nothing to write")

    def label(content: str, name: str) -> str:
        return f"{content:<60}{name:<20}"

    first, last = (_epoch(t) for t in (observations.time[0], observations.time[-1]))
    lines = [
        label(f"{'3.02':>9}{'':11}{'OBSERVATION DATA':<20}{'G':<20}", "RINEX VERSION / TYPE"),
        label(SIMULATOR, "PGM / RUN BY / DATE"),
        label(marker, "MARKER NAME"),
        label("", "OBSERVER / AGENCY"),
        label(f"{'0':<20}{'SIMULATED':<20}{'':<20}", "REC # / TYPE / VERS"),
        label(f"{'0':<20}{'SIMULATED':<20}", "ANT # / TYPE"),
        *(
            [label("".join(f"{x:14.4f}" for x in position_e), "APPROX POSITION XYZ")]
            if position_e is not None
            else []
        ),
        label(f"{0.0:14.4f}{0.0:14.4f}{0.0:14.4f}", "ANTENNA: DELTA H/E/N"),
        label("G    4 C1C L1C D1C S1C", "SYS / # / OBS TYPES"),
        label(f"{interval:10.3f}", "INTERVAL"),
        label(f"{first[0]}{'':5}GPS", "TIME OF FIRST OBS"),
        label(f"{last[0]}{'':5}GPS", "TIME OF LAST OBS"),
        label("", "END OF HEADER"),
    ]
    doppler = -observations.range_rate / observations.wavelength
    for time, rows in observations.epochs():
        lines.append(f"> {_epoch(time)[1]}  0{rows.stop - rows.start:3d}")
        for k in range(rows.start, rows.stop):
            cycle = f"{observations.carrier[k]:14.3f}{observations.loss_of_lock[k] or ' '} "
            lines.append(
                f"{observations.sat[k]}{observations.pseudorange[k]:14.3f}  {cycle}"
                f"{doppler[k]:14.3f}  {observations.cn0[k]:14.3f}"
            )
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _epoch(time: float) -> tuple[str, str]:
    """Return a GPS time as RINEX prints it in a header and in an epoch line."""
    tick = round(time * 1e5)  # 10 µs, the grid of the simulator's times
    t = gpstime.to_calendar(tick // 100000)
    second = t.second + (tick % 100000) / 1e5
    head = f"{t.year:6d}{t.month:6d}{t.day:6d}{t.hour:6d}{t.minute:6d}{second:13.7f}"
    return head, f"{t:%Y %m %d %H %M}{second:11.7f}"


def _sidecar(simulation: Simulation) -> str:
    """Return what the files do not say, in the form `datasets.great.reader` reads."""
    config = simulation.config
    week, _ = gpstime.to_week_sow(config.start_time)
    aligned = not any(config.mounting_rpy_deg)
    lines = [
        f"# {_MARK}: seed {config.seed}, {config.density}, {config.duration:g} s",
        f"week = {int(week)}",
        'gyro_unit = "deg/s"',
        'reference_point = "mems"',
        'reference_source = "simulation truth"',
        f'reference_body = "{"imu" if aligned else "tactical"}"',
    ]
    # What is the reader's default or preset is left to it: it then holds for both IMUs.
    if config.lever_antenna_b == LEVER_ANTENNA and week == WEEK_2020:
        lines.append('lever = "figure"')
    else:
        lever = ", ".join(repr(float(v)) for v in config.lever_antenna_b)
        lines.append(f"lever_antenna_frd_m = [{lever}]")
    calibration = simulation.calibration
    rpy = np.degrees(rpy_from_matrix(calibration.C_bv.T))
    for key, vector in (
        ("mounting_rpy_deg", rpy),
        ("lever_vehicle_frd_m", calibration.lever_vehicle_b),
    ):
        lines.append(f"{key} = [{', '.join(f'{v:.9f}' for v in vector)}]")
    if config.imu != "adis16470":
        lines.append(f'imu_preset = "{config.imu}"')
    return "\n".join(lines) + "\n"
