"""Faults in the middle of a drive: of its files, or of what has been read.

What is said of each, and how far the solution goes off, is the table of ``scripts/faults.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certnav.datasets.sequence import Sequence

from . import gnss_breaks as gnss
from . import imu_breaks as imu
from .imu_breaks import DataFault, FileFault


@dataclass(frozen=True)
class Fault:
    """One fault.

    Parameters
    ----------
    name : str
        What was done.
    base : {'raw', 'fixes', 'fast', 'real'}
        Simulated drive with raw GNSS in files; the same with positions and velocities of a
        receiver, at 1 Hz and at 5 Hz; a real drive with those.
    files : callable, optional
        Does it to the files of a folder, given the time it begins [s of week].
    data : callable, optional
        Does it to what has been read, given the time it begins [GPS s].
    undetectable : str
        Why it cannot be seen in some of the drives.
    """

    name: str
    base: str
    files: FileFault | None = None
    data: DataFault | None = None
    undetectable: str = ""


_GYRO, _ACCEL, _ALL = slice(1, 4), slice(4, 7), slice(1, 7)

_ROOM = (
    "the other satellites leave room for it: residuals over minutes are within what orbits and "
    "ionosphere leave, and nothing but the ranges knows where the drive is"
)
_NOTHING = "nothing is wrong any more: the second half alone, whose errors are other ones"

FAULTS = (
    Fault("IMU: 0.1 s missing", "raw", imu.gap(0.1)),
    Fault("IMU: 1 s missing", "raw", imu.gap(1.0)),
    Fault("IMU: 5 s missing", "raw", imu.gap(5.0)),
    Fault("IMU: ten rows repeated with their stamps", "raw", imu.changed_rows(imu.repeated)),
    Fault("IMU: two rows in the wrong order", "raw", imu.changed_rows(imu.swapped)),
    Fault("IMU: samples swapped in pairs for 1 s, stamps in order", "raw",
          imu.changed_rows(imu.swapped_values)),
    Fault("IMU: all axes frozen for 0.3 s", "raw", imu.frozen(_ALL, 0.3)),
    Fault("IMU: all axes frozen for 2 s", "raw", imu.frozen(_ALL, 2.0)),
    Fault("IMU: gyro frozen for 10 s", "raw", imu.frozen(_GYRO, 10.0)),
    Fault("IMU: accelerometer frozen for 10 s", "raw", imu.frozen(_ACCEL, 10.0)),
    Fault("IMU: gyro clipped at 12 deg/s", "raw", imu.clipped(_GYRO, 12.0)),
    Fault("IMU: horizontal accelerometers clipped at 1.2 m/s²", "raw",
          imu.clipped(slice(4, 6), 1.2)),
    Fault("IMU: right accelerometer clipped at 1.2 m/s²", "raw", imu.clipped(slice(4, 5), 1.2)),
    Fault("IMU: forward accelerometer clipped at 1.2 m/s²", "raw", imu.clipped(slice(5, 6), 1.2)),
    Fault("IMU: forward accelerometer frozen for 10 s", "raw", imu.frozen(slice(5, 6), 10.0)),
    Fault("IMU: yaw gyro frozen for 10 s", "raw", imu.frozen(slice(3, 4), 10.0)),
    Fault("IMU: yaw gyro clipped at 25 deg/s", "raw", imu.clipped(slice(3, 4), 25.0)),
    Fault("IMU: stamps jump 0.1 s ahead", "raw", imu.stamps(0.1)),
    Fault("IMU: stamps jump 1 s ahead", "raw", imu.stamps(1.0)),
    Fault("IMU: stamps jump 0.1 s back", "raw", imu.stamps(-0.1)),
    Fault("IMU: all stamps 0.1 s late", "raw", imu.all_stamps(0.1)),
    Fault("IMU: all stamps 1 s late (leap second)", "raw", imu.all_stamps(1.0)),
    Fault("IMU: all stamps 18 s early (UTC)", "raw", imu.all_stamps(-18.0)),
    Fault("GPS week of the IMU 1024 too small", "raw", imu.declared_week(-1024)),
    Fault("calendar of the receiver 1024 weeks back", "raw", gnss.rinex_weeks(-1024)),
    Fault("IMU: right accelerometer frozen for 10 s", "raw", imu.frozen(slice(4, 5), 10.0)),
    Fault("IMU: up accelerometer frozen for 10 s", "raw", imu.frozen(slice(6, 7), 10.0)),
    Fault("IMU: pitch gyro frozen for 10 s", "raw", imu.frozen(slice(1, 2), 10.0)),
    Fault("IMU: roll gyro frozen for 10 s", "raw", imu.frozen(slice(2, 3), 10.0)),
    Fault("IMU: up accelerometer clipped at 9.9 m/s²", "raw", imu.clipped(slice(6, 7), 9.9)),
    Fault("IMU: yaw gyro reads 0 for 10 s", "raw", imu.zeroed(slice(3, 4), 10.0)),
    Fault("IMU: forward accelerometer reads 0 for 10 s", "raw", imu.zeroed(slice(5, 6), 10.0)),
    Fault("IMU: yaw gyro repeats its last second for 10 s", "raw",
          imu.looped(slice(3, 4), 10.0)),
    Fault("IMU: yaw gyro reports at 10 Hz, held between", "raw", imu.held(slice(3, 4), 10)),
    Fault("IMU: yaw gyro changes its sign", "raw", imu.scaled(slice(3, 4), -1.0)),
    Fault("IMU: forward accelerometer changes its sign", "raw", imu.scaled(slice(5, 6), -1.0)),
    Fault("IMU: bias of the yaw gyro jumps by 1 deg/s", "raw", imu.offset(slice(3, 4), 1.0)),
    Fault("IMU: bias of the forward accelerometer jumps by 0.5 m/s²", "raw",
          imu.offset(slice(5, 6), 0.5)),
    Fault("IMU: one sample of the forward accelerometer at 1000 m/s²", "raw",
          imu.spike(slice(5, 6), 1000.0)),
    Fault("IMU: all stamps 0.3 s early", "raw", imu.all_stamps(-0.3)),
    Fault("one satellite 26 m along its orbit", "raw", gnss.ephemeris(1e-6), undetectable=_ROOM),
    Fault("one satellite 106 m along its orbit", "raw", gnss.ephemeris(4e-6), undetectable=_ROOM),
    Fault("one satellite 265 m along its orbit", "raw", gnss.ephemeris(1e-5), undetectable=_ROOM),
    Fault("another satellite 265 m along its orbit", "raw", gnss.ephemeris(1e-5, 3),
          undetectable=_ROOM),
    Fault("one satellite 2.6 km along its orbit", "raw", gnss.ephemeris(1e-4)),
    Fault("one satellite 26 km along its orbit", "raw", gnss.ephemeris(1e-3)),
    Fault("another satellite 26 km along its orbit", "raw", gnss.ephemeris(1e-3, 3)),
    Fault("one satellite 106 km along its orbit", "raw", gnss.ephemeris(4e-3)),
    Fault("one satellite's pseudorange 100 m too long", "raw",
          data=gnss.wrong_satellite(100.0, 0.0)),
    Fault("one satellite's Doppler 1 m/s off", "raw", data=gnss.wrong_satellite(0.0, 1.0)),
    Fault("no satellites for 20 s", "raw", data=gnss.satellites(0, 20.0)),
    Fault("three satellites for 30 s", "raw", data=gnss.satellites(3, 30.0)),
    Fault("receiver clock jumps 1 ms, pseudorange and stamp", "raw",
          data=gnss.receiver_clock(1e-3, True)),
    Fault("receiver clock jumps 1 ms, pseudorange alone", "raw",
          data=gnss.receiver_clock(1e-3, False),
          undetectable="the clock is unknown in every epoch, and may jump"),
    Fault("receiver clock jumps 0.1 s, pseudorange and stamp", "raw",
          data=gnss.receiver_clock(0.1, True)),
    Fault("GNSS 0.1 s late", "fixes", data=gnss.late(0.1)),
    Fault("GNSS 0.3 s late", "fixes", data=gnss.late(0.3)),
    Fault("GNSS 1 s late (leap second)", "fixes", data=gnss.late(1.0)),
    Fault("GNSS 18 s early (UTC)", "fixes", data=gnss.late(-18.0)),
    Fault("GNSS 0.5 s late for 20 s", "fixes", data=gnss.late(0.5, 20.0)),
    Fault("GNSS stamps jump 0.1 s ahead", "fixes", data=gnss.late_from(0.1),
          undetectable="0.1 s is a metre or two along the road, what a single fix is off by, and "
          "half of it on the average of the drive; a drive that hardly brakes or turns after the "
          "jump does not show it"),
    Fault("GNSS stamps jump 1 s ahead", "fixes", data=gnss.late_from(1.0)),
    Fault("15 m jump of the fix, 1 epoch", "fixes", data=gnss.jump(15.0, 1)),
    Fault("15 m jump of the fix, 10 epochs", "fixes", data=gnss.jump(15.0, 10)),
    Fault("15 m jump of the fix, 40 epochs", "fixes", data=gnss.jump(15.0, 40)),
    Fault("receiver frozen for 10 s, fresh stamps", "fixes", data=gnss.fixes_frozen(10.0)),
    Fault("receiver frozen for 3 s, fresh stamps", "fixes", data=gnss.fixes_frozen(3.0)),
    Fault("receiver frozen for 40 s, fresh stamps", "fixes", data=gnss.fixes_frozen(40.0)),
    Fault("receiver at 5 Hz frozen for 3 s, fresh stamps", "fast", data=gnss.fixes_frozen(3.0)),
    Fault("receiver at 5 Hz frozen for 20 s, fresh stamps", "fast", data=gnss.fixes_frozen(20.0)),
    Fault("every fix printed five times, fresh stamps", "fixes", data=gnss.printed(5)),
    Fault("position held for 10 s, velocity live", "fixes",
          data=gnss.rows_of(gnss.repeats("pos_e"), 10.0)),
    Fault("velocity held for 10 s, position live", "fixes",
          data=gnss.rows_of(gnss.repeats("vel_e"), 10.0)),
    Fault("no fixes for 20 s", "fixes", data=gnss.no_fixes(20.0)),
    Fault("latitude and longitude 0 for 10 s", "fixes", data=gnss.rows_of(gnss.at_null(), 10.0)),
    Fault("stated accuracy 0 for 10 s, position 50 m off", "fixes",
          data=gnss.rows_of(gnss.displaced(50.0, pos_cov_e=0.0), 10.0)),
    Fault("fix type none for 10 s, position 50 m off", "fixes",
          data=gnss.rows_of(gnss.displaced(50.0, quality="none"), 10.0)),
    Fault("zero satellites for 10 s, position 50 m off", "fixes",
          data=gnss.rows_of(gnss.displaced(50.0, satellites=0), 10.0)),
    Fault("stated accuracy ten times too good", "fixes",
          data=gnss.rows_of(gnss.stated(0.1), np.inf)),
    Fault("first fix at latitude and longitude 0", "fixes",
          data=gnss.rows_of(gnss.at_null(), 0.5, np.nan)),
    Fault("first fix 500 m off", "fixes", data=gnss.rows_of(gnss.displaced(500.0), 0.5, np.nan)),
    Fault("first three fixes 500 m off", "fixes",
          data=gnss.rows_of(gnss.displaced(500.0), 2.5, np.nan)),
    Fault("start in motion, first fix 500 m off", "fixes",
          data=gnss.then(imu.begun_late, gnss.rows_of(gnss.displaced(500.0), 0.5, np.nan)),
          undetectable=_NOTHING),
    Fault("start in motion", "fixes", data=imu.begun_late, undetectable=_NOTHING),
    Fault("start in motion, reversing all the way", "fixes", data=imu.begun_late_turned,
          undetectable=_NOTHING),
    Fault("reversing all the way", "fixes", data=imu.turned),
    Fault("position creeps east at 0.5 m/s for 40 s", "fixes",
          data=gnss.rows_of(gnss.creeping(0.5), 40.0)),
    Fault("east and west exchanged in the positions", "fixes",
          data=gnss.rows_of(gnss.position_turned((1.0, -1.0, 1.0)), np.inf, np.nan)),
    Fault("east and west exchanged in the velocities", "fixes",
          data=gnss.rows_of(gnss.velocity_turned(np.diag([1.0, -1.0, 1.0])), np.inf, np.nan)),
    Fault("vertical velocity up instead of down", "fixes",
          data=gnss.rows_of(gnss.velocity_turned(np.diag([1.0, 1.0, -1.0])), np.inf, np.nan)),
    Fault("velocities in km/h", "fixes",
          data=gnss.rows_of(gnss.velocity_turned(3.6 * np.eye(3)), np.inf, np.nan)),
    Fault("GNSS 0.3 s early", "fixes", data=gnss.late(-0.3)),
    Fault("GNSS stamps jump 1 s back (leap second)", "fixes", data=gnss.late_from(-1.0)),
    Fault("IMU: 1 s missing", "real", data=imu.gap_in_memory(1.0)),
    Fault("IMU: 5 s missing", "real", data=imu.gap_in_memory(5.0)),
    Fault("IMU: stamps jump 0.1 s ahead", "real", data=imu.stamps_in_memory(0.1)),
    Fault("IMU: stamps jump 1 s ahead", "real", data=imu.stamps_in_memory(1.0)),
    Fault("GNSS 0.3 s late", "real", data=gnss.late(0.3)),
    Fault("15 m jump of the fix, 1 epoch", "real", data=gnss.jump(15.0, 1)),
    Fault("15 m jump of the fix, 10 epochs", "real", data=gnss.jump(15.0, 10)),
)  # fmt: skip


def faults_begin(sequence: Sequence) -> float:
    """Return a whole second in the second half of the drive after which it moves and turns."""
    reference, imu = sequence.reference, sequence.inertial
    assert reference is not None
    first, last = sequence.span
    rate = np.cumsum(np.abs(imu.gyro_b[:, 2])) * imu.interval
    way = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(reference.pos_e, axis=0), axis=1))]
    )
    best, most = first, -1.0
    for begin in np.arange(np.ceil(first + 0.5 * (last - first)), last - 60.0):
        ends = [begin, begin + 10.0]
        turned = float(np.diff(np.interp(ends, imu.time, rate))[0])
        moved = float(np.diff(np.interp(ends, reference.time, way))[0])
        if moved > 50.0 and turned > most:
            best, most = float(begin), turned
    return best
