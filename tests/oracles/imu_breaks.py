"""Faults of the IMU: rows of its file — sow, gx, gy, gz, ax, ay, az — or what has been read."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from certnav.datasets.sequence import Sequence

from .damage import imu_rows, sidecar

FileFault = Callable[[Path, float], None]
DataFault = Callable[[Sequence, float], Sequence]


def changed_rows(change: Callable[[np.ndarray, int], np.ndarray]) -> FileFault:
    """Return a fault of the rows, which is told the first row it is to touch."""

    def breaks(folder: Path, sow: float) -> None:
        imu_rows(folder, lambda rows: change(rows, int(np.searchsorted(rows[:, 0], sow))))

    return breaks


def gap(seconds: float) -> FileFault:
    return changed_rows(lambda rows, k: np.delete(rows, slice(k, k + round(100 * seconds)), axis=0))


def repeated(rows: np.ndarray, k: int) -> np.ndarray:
    return np.insert(rows, k, rows[k : k + 10], axis=0)


def swapped(rows: np.ndarray, k: int) -> np.ndarray:
    rows[[k, k + 1]] = rows[[k + 1, k]]
    return rows


def swapped_values(rows: np.ndarray, k: int) -> np.ndarray:
    """Swap neighbouring samples for a second, their stamps staying in order."""
    block = rows[k : k + 100, 1:].reshape(50, 2, 6)
    rows[k : k + 100, 1:] = block[:, ::-1].reshape(100, 6)
    return rows


def frozen(columns: slice, seconds: float) -> FileFault:
    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[k : k + round(100 * seconds), columns] = rows[k, columns]
        return rows

    return changed_rows(change)


def stamps(seconds: float) -> FileFault:
    """Return a jump of the stamps from the fault's time to the end."""

    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[k:, 0] += seconds
        return rows

    return changed_rows(change)


def all_stamps(seconds: float) -> FileFault:
    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[:, 0] += seconds
        return rows

    return changed_rows(change)


def clipped(columns: slice, limit: float) -> FileFault:
    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[:, columns] = np.clip(rows[:, columns], -limit, limit)
        return rows

    return changed_rows(change)


def declared_week(change: int) -> FileFault:
    other = sidecar(
        r"(?m)^(imu_week|week)( *= *)(\d+)", lambda m: f"{m[1]}{m[2]}{int(m[3]) + change}"
    )
    return lambda folder, sow: other(folder)


def zeroed(columns: slice, seconds: float) -> FileFault:
    """Return axes that read nothing for a while."""

    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[k : k + round(100 * seconds), columns] = 0.0
        return rows

    return changed_rows(change)


def held(columns: slice, samples: int) -> FileFault:
    """Return axes that report only every so many samples, from the fault's time to the end."""

    def change(rows: np.ndarray, k: int) -> np.ndarray:
        at = k + samples * (np.arange(len(rows) - k) // samples)
        rows[k:, columns] = rows[at, columns]
        return rows

    return changed_rows(change)


def looped(columns: slice, seconds: float) -> FileFault:
    """Return axes that repeat their last second for a while."""

    def change(rows: np.ndarray, k: int) -> np.ndarray:
        for n in range(round(seconds)):
            rows[k + 100 * n : k + 100 * (n + 1), columns] = rows[k - 100 : k, columns]
        return rows

    return changed_rows(change)


def scaled(columns: slice, factor: float) -> FileFault:
    """Return axes of another scale or sign from the fault's time to the end."""

    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[k:, columns] *= factor
        return rows

    return changed_rows(change)


def offset(columns: slice, by: float) -> FileFault:
    """Return axes whose bias jumps at the fault's time."""

    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[k:, columns] += by
        return rows

    return changed_rows(change)


def spike(columns: slice, value: float) -> FileFault:
    """Return one sample that is absurd."""

    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[k, columns] = value
        return rows

    return changed_rows(change)


def gap_in_memory(seconds: float) -> DataFault:
    def change(sequence: Sequence, begin: float) -> Sequence:
        imu = sequence.inertial
        keep = (imu.time < begin) | (imu.time >= begin + seconds)
        less = dataclasses.replace(
            imu, time=imu.time[keep], gyro_b=imu.gyro_b[keep], accel_b=imu.accel_b[keep]
        )
        return dataclasses.replace(sequence, imu=less)

    return change


def stamps_in_memory(seconds: float) -> DataFault:
    def change(sequence: Sequence, begin: float) -> Sequence:
        imu = sequence.inertial
        time = imu.time + np.where(imu.time >= begin, seconds, 0.0)
        return dataclasses.replace(sequence, imu=dataclasses.replace(imu, time=time))

    return change


def turned(sequence: Sequence, begin: float) -> Sequence:
    """Return the drive with the IMU built in the other way round and declared as before.

    The course points over the boot: the vehicle reverses.
    """
    half = np.diag([-1.0, -1.0, 1.0])
    imu = sequence.inertial
    imu = dataclasses.replace(imu, gyro_b=imu.gyro_b @ half, accel_b=imu.accel_b @ half)
    lever = half @ sequence.calibration.lever_antenna_b
    calibration = dataclasses.replace(sequence.calibration, lever_antenna_b=lever)
    reference = sequence.reference
    assert reference is not None
    rpy = reference.rpy * [-1.0, -1.0, 1.0] + [0.0, 0.0, np.pi]
    reference = dataclasses.replace(reference, rpy=rpy, lever_b=half @ reference.lever_b)
    return dataclasses.replace(sequence, imu=imu, calibration=calibration, reference=reference)


def begun_late(sequence: Sequence, begin: float) -> Sequence:
    """Return what is recorded from the fault's time on: it starts in motion."""
    return sequence.between(begin, sequence.span[1])


def begun_late_turned(sequence: Sequence, begin: float) -> Sequence:
    """Return a drive that starts reversing, in motion."""
    return begun_late(turned(sequence, begin), begin)
