"""The CSV tables of a result directory, written fast and read back.

Units are in the column names: deg, m, mps (m/s), degph (deg/h), mg (10⁻³·9.80665 m/s²). Times are
GPS seconds since 1980-01-06. Missing numbers are ``nan``.

The tables keep standard deviations, not correlations: a solution that is read back has diagonal
covariances (attitude: diagonal in roll, pitch, heading).
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from ...datasets.gpstime import to_week_sow
from ...filters.earth import C_en_at
from ...filters.errors import DataError
from ...filters.rotation import FloatArray, matrix_from_rpy
from ...filters.sensors import STANDARD_GRAVITY
from ..evaluation.accuracy import (
    Evaluation,
    attitude_vector_from_rpy,
    rpy_covariance,
    standard_deviation,
)
from ..signals import Signals
from ..solution import Epochs, Separation, Trajectory, Update
from .formats import geodetic_and_ned, write_rows

_DEGPH = np.pi / 180.0 / 3600.0
_MG = 1e-3 * STANDARD_GRAVITY
#: Rows of a table that are read at a time.
_ROWS_AT_ONCE = 1 << 16


def _axes(pattern: str, axes: str, number: str) -> list[tuple[str, str]]:
    return [(pattern.format(axis), number) for axis in axes.split()]


_RPY = "roll pitch heading"

#: Columns of solution.csv and how their numbers are written. Heading is in [0, 360). Standard
#: deviations (1σ) of position and velocity are along north, east, down; those of roll, pitch and
#: heading follow from the NED attitude error covariance to first order. Protection levels are at
#: the risk that summary.json states; nan without them.
SOLUTION_COLUMNS = [
    ("time_gps_s", "%.6f"), ("week", "%d"), ("sow_s", "%.6f"),
    ("lat_deg", "%.10f"), ("lon_deg", "%.10f"), ("height_m", "%.4f"),
    *_axes("pos_e_{}_m", "x y z", "%.4f"),
    *_axes("vel_{}_mps", "n e d", "%.5f"),
    *_axes("{}_deg", _RPY, "%.6f"),
    *_axes("std_pos_{}_m", "n e d", "%.5g"),
    *_axes("std_vel_{}_mps", "n e d", "%.5g"),
    *_axes("std_{}_deg", _RPY, "%.5g"),
    *_axes("gyro_bias_{}_degph", "x y z", "%.4f"),
    *_axes("accel_bias_{}_mg", "x y z", "%.5f"),
    *_axes("std_gyro_bias_{}_degph", "x y z", "%.5g"),
    *_axes("std_accel_bias_{}_mg", "x y z", "%.5g"),
    *_axes("protection_{}_m", "horizontal vertical", "%.5g"),
]  # fmt: skip

#: Columns of reference_errors.csv: the reference point, solution − reference, 3σ of the filter.
ERROR_COLUMNS = [
    ("time_gps_s", "%.6f"),
    ("ref_lat_deg", "%.10f"), ("ref_lon_deg", "%.10f"), ("ref_height_m", "%.4f"),
    *_axes("error_pos_{}_m", "n e d", "%.5f"),
    *_axes("error_vel_{}_mps", "n e d", "%.6f"),
    *_axes("error_{}_deg", _RPY, "%.6f"),
    *_axes("error_{}_after_misalignment_deg", _RPY, "%.6f"),
    *_axes("sigma3_pos_{}_m", "n e d", "%.5g"),
    *_axes("sigma3_vel_{}_mps", "n e d", "%.5g"),
    *_axes("sigma3_{}_deg", _RPY, "%.5g"),
    ("nees_position", "%.5g"),
]  # fmt: skip


def _header(columns: list[tuple[str, str]]) -> tuple[str, str]:
    """Return the line of names and the template of a row."""
    names, numbers = zip(*columns, strict=True)
    return ",".join(names) + "\n", ",".join(numbers)


def _write_table(path: Path, columns: list[tuple[str, str]], table: FloatArray) -> None:
    write_rows(path, *_header(columns), [table], lambda part: part)


def _read_table(path: Path, names: list[str]) -> FloatArray:
    import pandas as pd  # slow to import

    parts = [np.empty((0, len(names)))]
    try:
        # In pieces: of a day pandas would hold three times as much as is kept.
        with pd.read_csv(path, engine="c", chunksize=_ROWS_AT_ONCE) as pieces:
            for frame in pieces:
                missing = [name for name in names if name not in frame.columns]
                if missing:
                    raise DataError(f"expected column '{missing[0]}', not found", file=path)
                parts.append(frame[names].to_numpy(dtype=float))
        return np.concatenate(parts)
    except FileNotFoundError as error:
        raise DataError("missing from the result directory", file=path) from error
    except (OSError, ValueError) as error:
        raise DataError(f"not a table certnav wrote: {error}".splitlines()[0], file=path) from error


def write_solution(path: Path, trajectory: Trajectory) -> None:
    """Write solution.csv."""
    write_rows(path, *_header(SOLUTION_COLUMNS), trajectory.parts(), _solution_table)


def _solution_table(trajectory: Trajectory) -> FloatArray:
    lla_deg, vel_n, rpy_deg = geodetic_and_ned(trajectory)
    cov_rpy = rpy_covariance(trajectory.cov_att_n, np.deg2rad(rpy_deg))
    return np.column_stack([
        trajectory.time, *to_week_sow(trajectory.time), lla_deg, trajectory.pos_e, vel_n, rpy_deg,
        standard_deviation(trajectory.cov_pos_n), standard_deviation(trajectory.cov_vel_n),
        np.rad2deg(standard_deviation(cov_rpy)),
        trajectory.gyro_bias / _DEGPH, trajectory.accel_bias / _MG,
        trajectory.std_gyro_bias / _DEGPH, trajectory.std_accel_bias / _MG,
        trajectory.protection,
    ])  # fmt: skip


def read_solution(path: Path) -> Trajectory:
    """Read solution.csv; covariances come back diagonal (see the module)."""
    table = _read_table(path, [name for name, _ in SOLUTION_COLUMNS])
    time, _, _, lat_deg, lon_deg, _ = table[:, :6].T
    pos_e, vel_n, rpy_deg, std_pos, std_vel, std_rpy_deg, *biases = (
        table[:, k : k + 3] for k in range(6, table.shape[1] - 2, 3)
    )
    gyro_degph, accel_mg, std_gyro_degph, std_accel_mg = biases
    C_en = C_en_at(np.deg2rad(lat_deg), np.deg2rad(lon_deg))
    rpy = np.deg2rad(rpy_deg)
    to_vector = attitude_vector_from_rpy(rpy)
    return Trajectory(
        time=time,
        pos_e=pos_e,
        vel_e=(C_en @ vel_n[:, :, None])[:, :, 0],
        C_eb=C_en @ matrix_from_rpy(rpy),
        gyro_bias=gyro_degph * _DEGPH,
        accel_bias=accel_mg * _MG,
        cov_pos_n=_diagonal(std_pos),
        cov_vel_n=_diagonal(std_vel),
        cov_att_n=to_vector @ _diagonal(np.deg2rad(std_rpy_deg)) @ np.swapaxes(to_vector, 1, 2),
        std_gyro_bias=std_gyro_degph * _DEGPH,
        std_accel_bias=std_accel_mg * _MG,
        protection=table[:, -2:],
    )


def _diagonal(std: FloatArray) -> FloatArray:
    cov: FloatArray = np.square(std)[:, :, None] * np.eye(3)
    return cov


def write_updates(path: Path, updates: Iterable[Update]) -> None:
    """Write updates.csv."""
    updates = list(updates)
    width = max([3, *(len(u.whitened) for u in updates)])
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        names = [f"w{k}" for k in range(1, width + 1)]
        writer.writerow(
            ["time_gps_s", "kind", "satellites", *names, "nis", "dof", "accepted", "reason"]
        )
        for u in updates:
            w = [f"{value:.5f}" for value in u.whitened] + ["nan"] * (width - len(u.whitened))
            writer.writerow([
                f"{u.time:.6f}", u.kind, " ".join(u.satellites), *w, f"{u.nis:.6g}",
                len(u.whitened), int(u.accepted), u.reason,
            ])  # fmt: skip


def read_updates(path: Path) -> tuple[Update, ...]:
    """Read updates.csv."""
    updates = []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = csv.DictReader(file)
            for row in rows:
                dof = int(row["dof"])
                updates.append(
                    Update(
                        time=float(row["time_gps_s"]),
                        kind=row["kind"],
                        satellites=tuple(row["satellites"].split()),
                        whitened=tuple(float(row[f"w{k}"]) for k in range(1, dof + 1)),
                        nis=float(row["nis"]),
                        accepted=row["accepted"] == "1",
                        reason=row["reason"],
                    )
                )
    except FileNotFoundError as error:
        raise DataError("missing from the result directory", file=path) from error
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise DataError("not a line certnav wrote", file=path, line=rows.line_num) from error
    return tuple(updates)


#: Columns of separation.csv: see `nav.solution.Separation`.
SEPARATION_COLUMNS = [
    ("time_gps_s", "%.6f"),
    *_axes("forward_{}_m", "n e d", "%.5g"), *_axes("backward_{}_m", "n e d", "%.5g"),
    ("chi2", "%.5g"),
]  # fmt: skip


def write_separation(path: Path, separation: Separation) -> None:
    """Write separation.csv."""
    s = separation
    table = np.column_stack([s.time, s.forward_n, s.backward_n, s.chi2])
    _write_table(path, SEPARATION_COLUMNS, table)


def read_separation(path: Path) -> Separation | None:
    """Read separation.csv; there is none where nothing was smoothed."""
    if not path.exists():
        return None
    table = _read_table(path, [name for name, _ in SEPARATION_COLUMNS])
    return Separation(table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7])


def write_epochs(path: Path, epochs: Epochs) -> None:
    """Write epochs.csv."""
    columns = [("time_gps_s", "%.6f"), ("tracked", "%d"), ("usable", "%d")]
    _write_table(path, columns, np.column_stack([epochs.time, epochs.tracked, epochs.usable]))


def read_epochs(path: Path) -> Epochs:
    """Read epochs.csv."""
    table = _read_table(path, ["time_gps_s", "tracked", "usable"])
    return Epochs(table[:, 0], table[:, 1].astype(int), table[:, 2].astype(int))


def write_attempts(path: Path, attempts: Iterable[tuple[float, str]]) -> None:
    """Write alignment.csv: when alignment in motion was tried, and what was missing."""
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["time_gps_s", "message"])
        rows.writerows((f"{time:.3f}", message) for time, message in attempts)


def read_attempts(path: Path) -> tuple[tuple[float, str], ...]:
    """Read alignment.csv; there is none where nothing was tried."""
    if not path.exists():
        return ()
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = csv.DictReader(file)
            return tuple((float(row["time_gps_s"]), row["message"]) for row in rows)
    except (KeyError, ValueError, TypeError) as error:
        raise DataError("not a line certnav wrote", file=path, line=rows.line_num) from error


def write_errors(path: Path, evaluation: Evaluation) -> None:
    """Write reference_errors.csv."""
    table = np.column_stack([
        evaluation.time, np.rad2deg(evaluation.ref_lla[:, :2]), evaluation.ref_lla[:, 2],
        evaluation.error_pos_n, evaluation.error_vel_n,
        np.rad2deg(evaluation.error_rpy), np.rad2deg(evaluation.error_rpy_aligned),
        3.0 * evaluation.sigma_pos_n, 3.0 * evaluation.sigma_vel_n,
        3.0 * np.rad2deg(evaluation.sigma_rpy), evaluation.nees_position,
    ])  # fmt: skip
    _write_table(path, ERROR_COLUMNS, table)


def read_errors(path: Path) -> dict[str, FloatArray]:
    """Read reference_errors.csv as the arrays of an `Evaluation`, by field name."""
    table = _read_table(path, [name for name, _ in ERROR_COLUMNS])
    blocks = [table[:, k : k + 3] for k in range(4, 25, 3)]
    return {
        "time": table[:, 0],
        "ref_lla": np.column_stack([np.deg2rad(table[:, 1:3]), table[:, 3]]),
        "error_pos_n": blocks[0],
        "error_vel_n": blocks[1],
        "error_rpy": np.deg2rad(blocks[2]),
        "error_rpy_aligned": np.deg2rad(blocks[3]),
        "sigma_pos_n": blocks[4] / 3.0,
        "sigma_vel_n": blocks[5] / 3.0,
        "sigma_rpy": np.deg2rad(blocks[6]) / 3.0,
        "nees_position": table[:, 25],
    }


#: Columns of signals.csv, and how their numbers are written.
_SIGNAL_COLUMNS = (
    "time_gps_s", "sat", "signal", "cn0_dbhz", "elevation_deg", "azimuth_deg",
    "range_rate_residual_mps", "reason",
)  # fmt: skip


def write_signals(path: Path, signals: Signals) -> None:
    """Write signals.csv: what became of every satellite signal."""
    elevation, azimuth = np.rad2deg(signals.elevation), np.rad2deg(signals.azimuth)
    columns = (signals.time, signals.sat, signals.signal, signals.cn0, elevation, azimuth,
               signals.residual, signals.reason)  # fmt: skip
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(_SIGNAL_COLUMNS)
        for t, sat, signal, cn0, el, az, residual, reason in zip(
            *(column.tolist() for column in columns), strict=True
        ):
            rows.writerow([f"{t:.3f}", sat, signal, f"{cn0:.1f}", f"{el:.2f}", f"{az:.2f}",
                           f"{residual:.4f}", reason])  # fmt: skip


def read_signals(path: Path) -> Signals | None:
    """Read signals.csv; there is none where there were no observations."""
    import pandas as pd  # slow to import

    if not path.exists():
        return None
    try:
        frame = pd.read_csv(path, engine="c", keep_default_na=False, na_values=["nan"],
                            dtype={"sat": str, "signal": str, "reason": str})  # fmt: skip
        t, sat, signal, cn0, elevation, azimuth, residual, reason = (
            frame[name].to_numpy() for name in _SIGNAL_COLUMNS
        )
        return Signals(
            t.astype(float), sat.astype(str), signal.astype(str), cn0.astype(float),
            np.deg2rad(elevation.astype(float)), np.deg2rad(azimuth.astype(float)),
            residual.astype(float), reason.astype(str),
        )  # fmt: skip
    except (KeyError, ValueError, OSError) as error:
        raise DataError(f"not a table certnav wrote: {error}".splitlines()[0], file=path) from error
