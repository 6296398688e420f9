"""Faults in the middle of a drive: of its files, or of what has been read.

What is said of each, and how far the solution goes off, is the table of ``scripts/faults.py``.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from certnav.datasets.loading import load
from certnav.datasets.observations import GnssFixes
from certnav.datasets.sequence import Sequence
from certnav.filters.earth import SPEED_OF_LIGHT, C_en_of

from .damage import imu_rows, sidecar

FileFault = Callable[[Path, float], None]
DataFault = Callable[[Sequence, float], Sequence]


@dataclass(frozen=True)
class Fault:
    """One fault.

    Parameters
    ----------
    name : str
        What was done.
    base : {'raw', 'fixes', 'real'}
        Simulated drive with raw GNSS in files; the same with positions and velocities of a
        receiver; a real drive with those.
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


# --- faults of the IMU's file: rows sow, gx, gy, gz, ax, ay, az -----------------------------


def _imu(change: Callable[[np.ndarray, int], np.ndarray]) -> FileFault:
    """Return a fault of the rows, which is told the first row it is to touch."""

    def breaks(folder: Path, sow: float) -> None:
        imu_rows(folder, lambda rows: change(rows, int(np.searchsorted(rows[:, 0], sow))))

    return breaks


def _gap(seconds: float) -> FileFault:
    return _imu(lambda rows, k: np.delete(rows, slice(k, k + round(100 * seconds)), axis=0))


def _repeated(rows: np.ndarray, k: int) -> np.ndarray:
    return np.insert(rows, k, rows[k : k + 10], axis=0)


def _swapped(rows: np.ndarray, k: int) -> np.ndarray:
    rows[[k, k + 1]] = rows[[k + 1, k]]
    return rows


def _swapped_values(rows: np.ndarray, k: int) -> np.ndarray:
    """Swap neighbouring samples for a second, their stamps staying in order."""
    block = rows[k : k + 100, 1:].reshape(50, 2, 6)
    rows[k : k + 100, 1:] = block[:, ::-1].reshape(100, 6)
    return rows


def _frozen(columns: slice, seconds: float) -> FileFault:
    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[k : k + round(100 * seconds), columns] = rows[k, columns]
        return rows

    return _imu(change)


def _stamps(seconds: float) -> FileFault:
    """Return a jump of the stamps from the fault's time to the end."""

    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[k:, 0] += seconds
        return rows

    return _imu(change)


def _all_stamps(seconds: float) -> FileFault:
    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[:, 0] += seconds
        return rows

    return _imu(change)


def _clipped(columns: slice, limit: float) -> FileFault:
    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[:, columns] = np.clip(rows[:, columns], -limit, limit)
        return rows

    return _imu(change)


def _declared_week(change: int) -> FileFault:
    other = sidecar(
        r"(?m)^(imu_week|week)( *= *)(\d+)", lambda m: f"{m[1]}{m[2]}{int(m[3]) + change}"
    )
    return lambda folder, sow: other(folder)


# --- faults of the GNSS --------------------------------------------------------------------


def _rinex_weeks(weeks: int) -> FileFault:
    """Return a receiver whose calendar is off by so many weeks; time of week is right."""

    def breaks(folder: Path, sow: float) -> None:
        file = next((folder / "GNSS" / "Rover").iterdir())
        shift = np.timedelta64(7 * weeks, "D")

        def moved(match: re.Match[str]) -> str:
            y, m, d = (int(v) for v in match[2].split())
            date = (np.datetime64(f"{y:04d}-{m:02d}-{d:02d}") + shift).astype(datetime)
            return f"{match[1]}{date.year:4d} {date.month:02d} {date.day:02d}"

        text = re.sub(r"(?m)^(> )(\d{4} [ \d]\d [ \d]\d)", moved, file.read_text())
        file.write_text(text)

    return breaks


def _ephemeris(anomaly: float) -> FileFault:
    """Return a GPS satellite shifted along its orbit: mean anomaly [rad]."""

    def breaks(folder: Path, sow: float) -> None:
        used = load(folder).observations
        assert used is not None
        seen, count = (
            np.unique(used.sat[used.elevation > 0.6], return_counts=True)
            if (np.isfinite(used.elevation).any())
            else np.unique(used.sat, return_counts=True)
        )
        name = str(seen[np.argmax(count)])
        (file,) = (folder / "GNSS" / "Product").iterdir()
        lines = file.read_text().splitlines()
        for number, line in enumerate(lines):
            if line.startswith(name):
                orbit = lines[number + 1]
                value = float(orbit[61:80].replace("D", "E")) + anomaly
                lines[number + 1] = f"{orbit[:61]}{value:19.12E}{orbit[80:]}"
        file.write_text("\n".join(lines) + "\n")

    return breaks


def _receiver_clock(seconds: float, stamps: bool) -> DataFault:
    """Return a jump of the receiver's clock: pseudoranges, and the stamps if it does so."""

    def change(sequence: Sequence, begin: float) -> Sequence:
        old = sequence.observations
        assert old is not None
        after = old.time >= begin
        new = old.with_columns(
            time=old.time + np.where(after & stamps, seconds, 0.0),
            pseudorange=old.pseudorange + np.where(after, SPEED_OF_LIGHT * seconds, 0.0),
        )
        return dataclasses.replace(sequence, observations=new)

    return change


def _fixes(change: Callable[[GnssFixes, float], GnssFixes]) -> DataFault:
    def changed(sequence: Sequence, begin: float) -> Sequence:
        assert sequence.fixes is not None
        return dataclasses.replace(sequence, fixes=change(sequence.fixes, begin))

    return changed


def _late(seconds: float, for_s: float = np.inf) -> DataFault:
    """Return fixes stamped late: all of them, or those of a while after the fault's time."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        during = (fixes.time >= begin) & (fixes.time < begin + for_s)
        late = np.ones(len(fixes), bool) if np.isinf(for_s) else during
        return dataclasses.replace(fixes, time=fixes.time + seconds * late)

    return _fixes(change)


def _late_from(seconds: float) -> DataFault:
    """Return a receiver clock that jumps: every stamp after the fault's time is late."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        after = fixes.time >= begin
        return dataclasses.replace(fixes, time=fixes.time + seconds * after)

    return _fixes(change)


def jump(metres: float, epochs: int) -> DataFault:
    """Return positions shifted to the east for so many epochs, velocities as they were."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        k = int(np.searchsorted(fixes.time, begin))
        pos_e = fixes.pos_e.copy()
        pos_e[k : k + epochs] += metres * C_en_of(pos_e[k : k + epochs])[:, :, 1]
        return dataclasses.replace(fixes, pos_e=pos_e)

    return _fixes(change)


def _fixes_frozen(seconds: float) -> DataFault:
    """Return a receiver that repeats its last position and velocity with fresh stamps."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        k, m = np.searchsorted(fixes.time, [begin, begin + seconds])
        pos_e, vel_e = fixes.pos_e.copy(), fixes.vel_e.copy()
        pos_e[k:m], vel_e[k:m] = pos_e[k], vel_e[k]
        return dataclasses.replace(fixes, pos_e=pos_e, vel_e=vel_e)

    return _fixes(change)


def _gap_in_memory(seconds: float) -> DataFault:
    def change(sequence: Sequence, begin: float) -> Sequence:
        imu = sequence.inertial
        keep = (imu.time < begin) | (imu.time >= begin + seconds)
        less = dataclasses.replace(
            imu, time=imu.time[keep], gyro_b=imu.gyro_b[keep], accel_b=imu.accel_b[keep]
        )
        return dataclasses.replace(sequence, imu=less)

    return change


def _stamps_in_memory(seconds: float) -> DataFault:
    def change(sequence: Sequence, begin: float) -> Sequence:
        imu = sequence.inertial
        time = imu.time + np.where(imu.time >= begin, seconds, 0.0)
        return dataclasses.replace(sequence, imu=dataclasses.replace(imu, time=time))

    return change


_GYRO, _ACCEL, _ALL = slice(1, 4), slice(4, 7), slice(1, 7)

FAULTS = (
    Fault("IMU: 0.1 s missing", "raw", _gap(0.1)),
    Fault("IMU: 1 s missing", "raw", _gap(1.0)),
    Fault("IMU: 5 s missing", "raw", _gap(5.0)),
    Fault("IMU: ten rows repeated with their stamps", "raw", _imu(_repeated)),
    Fault("IMU: two rows in the wrong order", "raw", _imu(_swapped)),
    Fault("IMU: samples swapped in pairs for 1 s, stamps in order", "raw", _imu(_swapped_values)),
    Fault("IMU: all axes frozen for 0.3 s", "raw", _frozen(_ALL, 0.3)),
    Fault("IMU: all axes frozen for 2 s", "raw", _frozen(_ALL, 2.0)),
    Fault("IMU: gyro frozen for 10 s", "raw", _frozen(_GYRO, 10.0)),
    Fault("IMU: accelerometer frozen for 10 s", "raw", _frozen(_ACCEL, 10.0)),
    Fault("IMU: gyro clipped at 12 deg/s", "raw", _clipped(_GYRO, 12.0)),
    Fault("IMU: horizontal accelerometers clipped at 1.2 m/s²", "raw", _clipped(slice(4, 6), 1.2)),
    Fault("IMU: right accelerometer clipped at 1.2 m/s²", "raw", _clipped(slice(4, 5), 1.2)),
    Fault("IMU: forward accelerometer clipped at 1.2 m/s²", "raw", _clipped(slice(5, 6), 1.2)),
    Fault("IMU: forward accelerometer frozen for 10 s", "raw", _frozen(slice(5, 6), 10.0)),
    Fault("IMU: yaw gyro frozen for 10 s", "raw", _frozen(slice(3, 4), 10.0)),
    Fault("IMU: yaw gyro clipped at 25 deg/s", "raw", _clipped(slice(3, 4), 25.0)),
    Fault("IMU: stamps jump 0.1 s ahead", "raw", _stamps(0.1)),
    Fault("IMU: stamps jump 1 s ahead", "raw", _stamps(1.0)),
    Fault("IMU: stamps jump 0.1 s back", "raw", _stamps(-0.1)),
    Fault("IMU: all stamps 0.1 s late", "raw", _all_stamps(0.1)),
    Fault("IMU: all stamps 1 s late (leap second)", "raw", _all_stamps(1.0)),
    Fault("IMU: all stamps 18 s early (UTC)", "raw", _all_stamps(-18.0)),
    Fault("GPS week of the IMU 1024 too small", "raw", _declared_week(-1024)),
    Fault("calendar of the receiver 1024 weeks back", "raw", _rinex_weeks(-1024)),
    Fault("one satellite 26 m along its orbit", "raw", _ephemeris(1e-6)),
    Fault("one satellite 265 m along its orbit", "raw", _ephemeris(1e-5),
          undetectable="with six or seven satellites it leaves residuals below 4 m, which orbits "
          "and atmosphere may leave too; with nine it is named"),
    Fault("one satellite 26 km along its orbit", "raw", _ephemeris(1e-3)),
    Fault("receiver clock jumps 1 ms, pseudorange and stamp", "raw",
          data=_receiver_clock(1e-3, True)),
    Fault("receiver clock jumps 1 ms, pseudorange alone", "raw",
          data=_receiver_clock(1e-3, False)),
    Fault("receiver clock jumps 0.1 s, pseudorange and stamp", "raw",
          data=_receiver_clock(0.1, True)),
    Fault("GNSS 0.1 s late", "fixes", data=_late(0.1)),
    Fault("GNSS 0.3 s late", "fixes", data=_late(0.3)),
    Fault("GNSS 1 s late (leap second)", "fixes", data=_late(1.0)),
    Fault("GNSS 18 s early (UTC)", "fixes", data=_late(-18.0)),
    Fault("GNSS 0.5 s late for 20 s", "fixes", data=_late(0.5, 20.0)),
    Fault("GNSS stamps jump 0.1 s ahead", "fixes", data=_late_from(0.1)),
    Fault("GNSS stamps jump 1 s ahead", "fixes", data=_late_from(1.0)),
    Fault("15 m jump of the fix, 1 epoch", "fixes", data=jump(15.0, 1)),
    Fault("15 m jump of the fix, 10 epochs", "fixes", data=jump(15.0, 10)),
    Fault("15 m jump of the fix, 40 epochs", "fixes", data=jump(15.0, 40)),
    Fault("receiver frozen for 10 s, fresh stamps", "fixes", data=_fixes_frozen(10.0)),
    Fault("IMU: 1 s missing", "real", data=_gap_in_memory(1.0)),
    Fault("IMU: 5 s missing", "real", data=_gap_in_memory(5.0)),
    Fault("IMU: stamps jump 0.1 s ahead", "real", data=_stamps_in_memory(0.1)),
    Fault("IMU: stamps jump 1 s ahead", "real", data=_stamps_in_memory(1.0)),
    Fault("GNSS 0.3 s late", "real", data=_late(0.3)),
    Fault("15 m jump of the fix, 1 epoch", "real", data=jump(15.0, 1)),
    Fault("15 m jump of the fix, 10 epochs", "real", data=jump(15.0, 10)),
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
