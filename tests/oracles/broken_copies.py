"""Ways to break a recording that ``certnav check`` has to name, and what it said of a copy.

The table of all of them is made by ``scripts/broken_copies.py``.
"""

from __future__ import annotations

import dataclasses
import re
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from certnav.datasets.great.writer import write_reference
from certnav.datasets.loading import load
from certnav.filters.earth import C_en_of
from certnav.nav.check.findings import Report
from certnav.nav.check.recording import check

from . import recordings
from .damage import Damage, arrays, both, csv, cut, imu_rows, remove, rinex, sidecar
from .recordings import SIMULATED, base_folder


@dataclass(frozen=True)
class Fault:
    """One way to break a recording.

    Parameters
    ----------
    name : str
        What was done to it.
    base : str
        The recording it is done to.
    breaks : callable
        Does it to a folder.
    expected : str
        Regular expression that a fatal or doubtful finding has to match; '' if none can.
    undetectable : str
        Why not.
    """

    name: str
    base: str
    breaks: Damage
    expected: str
    undetectable: str = ""


# --- the simulated drive -------------------------------------------------------------------


def _imu(change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    return lambda folder: imu_rows(folder, change)


def _scaled(columns: slice, factor: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(rows: np.ndarray) -> np.ndarray:
        rows[:, columns] *= factor
        return rows

    return change


def _later(seconds: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(rows: np.ndarray) -> np.ndarray:
        rows[:, 0] += seconds
        return rows

    return change


def _order(columns: list[int], signs: list[int]) -> Callable[[np.ndarray], np.ndarray]:
    """Return a change of both triads: new x, y, z are the old ones of this order and sign."""
    index = np.array([0, *(1 + c for c in columns), *(4 + c for c in columns)])
    sign = np.array([1, *signs, *signs])
    return lambda rows: rows[:, index] * sign


def _swapped_gyros(rows: np.ndarray) -> np.ndarray:
    rows[:, [1, 2]] = rows[:, [2, 1]]
    return rows


def _nan(rows: np.ndarray) -> np.ndarray:
    rows[12345, 5] = np.nan
    return rows


def _backwards(rows: np.ndarray) -> np.ndarray:
    rows[[8000, 8001], 0] = rows[[8001, 8000], 0]
    return rows


def _duplicated(rows: np.ndarray) -> np.ndarray:
    return np.insert(rows, 5000, rows[5000:5010], axis=0)


def _frozen(rows: np.ndarray) -> np.ndarray:
    rows[15000:15800, 1:4] = rows[15000, 1:4]
    return rows


def _clipped(rows: np.ndarray) -> np.ndarray:
    rows[:, 4:6] = np.clip(rows[:, 4:6], -1.2, 1.2)
    return rows


def _gap(rows: np.ndarray) -> np.ndarray:
    return np.delete(rows, slice(12000, 14000), axis=0)


def _mirrored_doppler(line: str) -> str:
    return f"{line[:35]}{-float(line[35:49]):14.3f}{line[49:]}"


def _no_doppler(line: str) -> str:
    return f"{line[:35]}{'':14}{line[49:]}"


def _strength_steps(line: str) -> str:
    return f"{line[:51]}{min(max(int(float(line[51:65]) // 6), 1), 9):14.3f}{line[65:]}"


def _other_navigation(folder: Path) -> None:
    product = folder / "GNSS" / "Product"
    for file in product.iterdir():
        file.unlink()
    shutil.copyfile(recordings.DATA / "broadcast" / "brdc1190.21n", product / "brdc1190.21n")


def _reference(change: Callable[[object], dict]) -> Damage:
    """Return a fault that rewrites the reference with some of its fields replaced."""

    def breaks(folder: Path) -> None:
        reference = load(folder).reference
        assert reference is not None
        changed = dataclasses.replace(reference, **change(reference))
        write_reference(folder / "Groundtruth" / "groundtruth.txt", changed, np.eye(3))

    return breaks


def _east(reference) -> dict:
    return {"pos_e": reference.pos_e + 3.0 * C_en_of(reference.pos_e)[:, :, 1]}


def _enu_yaw(reference) -> dict:
    rpy = reference.rpy.copy()
    rpy[:, 2] = np.pi / 2 - rpy[:, 2]
    return {"rpy": rpy}


# --- Oakville: CSV with a header -----------------------------------------------------------


def _assign(**columns: Callable[[pd.DataFrame], pd.Series]) -> Callable:
    return lambda table: table.assign(**columns)


def _swap(a: str, b: str) -> Callable[[pd.DataFrame], pd.DataFrame]:
    return lambda table: table.rename(columns={a: b, b: a})


def _positions(change: Callable[[pd.DataFrame], pd.DataFrame]) -> Damage:
    return both(csv("gnss", change), csv("reference_position", change))


def _gyro_degrees(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(**{f"g{k}_radps": np.degrees(table[f"g{k}_radps"]) for k in "xyz"})


def _without_gravity(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(az_mps2=table["az_mps2"] - 9.81)


def _turned_gyro(table: pd.DataFrame) -> pd.DataFrame:
    """Write z, x, y where x, y, z are expected."""
    return table.rename(
        columns={"gx_radps": "gy_radps", "gy_radps": "gz_radps", "gz_radps": "gx_radps"}
    )


def _radians(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(**{k: np.radians(table[k]) for k in ("lat_deg", "lon_deg")})


def _kilometres(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(**{k: 3.6 * table[k] for k in ("vn_mps", "ve_mps", "vd_mps")})


def _half_file(folder: Path) -> None:
    file = folder / "imu.csv.gz"
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])


def _dead_gyro(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(gz_radps=table["gz_radps"].iloc[0])


# --- comma2k19: arrays without extension ---------------------------------------------------


_COMMA_IMU = ("processed_log/IMU/gyro/t", "processed_log/IMU/accelerometer/t")
_COMMA_RAW = "processed_log/GNSS/raw_gnss_ublox/value"


def _column(k: int, function: Callable[[np.ndarray], object]) -> Callable:
    def change(value: np.ndarray) -> np.ndarray:
        value = value.copy()
        value[:, k] = function(value[:, k])
        return value

    return change


# --- rtklibexplorer ------------------------------------------------------------------------


def _pos_utc(folder: Path) -> None:
    """Move the solution 18 s back, as if its GPST column held UTC."""
    file = next(folder.glob("gnss_*.pos"))
    out = []
    for line in file.read_text().splitlines():
        if line[:2] == "20":
            stamp = pd.Timestamp(line[:23].replace("/", "-")) - pd.Timedelta(seconds=18)
            line = f"{stamp:%Y/%m/%d %H:%M:%S}.{stamp.microsecond // 1000:03d}{line[23:]}"
        out.append(line)
    file.write_text("\n".join(out) + "\n")


def _imu_si(folder: Path) -> None:
    file = next(folder.glob("imu_*.csv"))
    table = pd.read_csv(file, header=None)
    table[[0, 1, 2]] *= 9.80665
    table.to_csv(file, header=False, index=False)


FAULTS = (
    Fault("gyro in rad/s, declared deg/s", SIMULATED, _imu(_scaled(slice(1, 4), np.pi / 180)),
          "gyro.*rad/s"),
    Fault("accelerometer in g, declared m/s²", SIMULATED, _imu(_scaled(slice(4, 7), 1 / 9.80665)),
          r"gravity.*in g\b"),
    Fault("x and y swapped in both triads (left-handed axes)", SIMULATED,
          _imu(_order([1, 0, 2], [1, 1, 1])), "left-handed.*swapped"),
    Fault("axes forward-right-down, declared right-forward-up", SIMULATED,
          _imu(_order([1, 0, 2], [1, 1, -1])), "up is"),
    Fault("only the roll and pitch gyros swapped", SIMULATED, _imu(_swapped_gyros), "",
          "not tested: a road turns a car too little about these axes"),
    Fault("IMU in UTC, declared GPS time (18 s)", SIMULATED, _imu(_later(-18.0)),
          "IMU's stamps are 18.0.*UTC"),
    Fault("IMU 0.1 s late", SIMULATED, _imu(_later(0.1)), r"IMU's stamps are 0\.(09|1).*late"),
    Fault("GPS week declared one too small", SIMULATED, sidecar("week = 2129", "week = 2128"),
          "week 2128.*2129"),
    Fault("Doppler mirrored", SIMULATED, rinex(_mirrored_doppler), "Doppler.*sign is reversed"),
    Fault("no Doppler (dropped in conversion)", SIMULATED, rinex(_no_doppler), "no Doppler"),
    Fault("RINEX cut in the middle of a line", SIMULATED, cut(0.6, False),
          "cut short"),
    Fault("RINEX ends at half of the drive", SIMULATED, cut(0.5, True), "GNSS.*ends"),
    Fault("C/N0 as RINEX signal-strength steps 1–9", SIMULATED, rinex(_strength_steps),
          "C/N0.*steps"),
    Fault("navigation file missing", SIMULATED, remove("GNSS/Product/*"), "no RINEX navigation"),
    Fault("navigation file of another week", SIMULATED, _other_navigation, "no ephemeris"),
    Fault("NaN in one IMU value", SIMULATED, _imu(_nan), "finite number.*nan"),
    Fault("two IMU rows in the wrong order", SIMULATED, _imu(_backwards), "increasing time"),
    Fault("ten IMU rows duplicated", SIMULATED, _imu(_duplicated), "increasing time"),
    Fault("20 s of IMU rows missing", SIMULATED, _imu(_gap), r"gaps, the longest 20\.0"),
    Fault("gyro frozen for 8 s", SIMULATED, _imu(_frozen), "gyro.*frozen for 8"),
    Fault("horizontal accelerometers clipped at 1.2 m/s²", SIMULATED, _imu(_clipped),
          "accelerometer.*saturated"),
    Fault("IMU file missing", SIMULATED, remove("IMU/*"), "no IMU text"),
    Fault("lever arm not declared", SIMULATED, sidecar(r"lever = .*", ""), "lever arm.*not given"),
    Fault("lever arm with the opposite sign", SIMULATED,
          sidecar(r"lever = .*", "lever_antenna_frd_m = [0.65, 0.05, 0.15]"),
          "lever arm.*opposite"),
    Fault("reference shifted by 3 m to the east", SIMULATED, _reference(_east),
          r"shifted.*\+[23]\.\d m east"),
    Fault("reference in UTC, declared GPS time (18 s)", SIMULATED,
          _reference(lambda r: {"time": r.time - 18.0}), "reference's stamps are 18.0.*UTC"),
    Fault("reference heading counted from east (ENU yaw)", SIMULATED, _reference(_enu_yaw),
          "heading.*(ENU|course)"),
    Fault("gyro in deg/s, declared rad/s", "Oakville", csv("imu", _gyro_degrees), "gyro.*deg/s"),
    Fault("gravity taken out of the accelerometer", "Oakville", csv("imu", _without_gravity),
          "gravity has been taken out"),
    Fault("gyro columns z, x, y instead of x, y, z", "Oakville", csv("imu", _turned_gyro),
          "yaw rate is on axis x"),
    Fault("right axis reversed (left-handed)", "Oakville",
          csv("imu", _assign(gy_radps=lambda t: -t["gy_radps"], ay_mps2=lambda t: -t["ay_mps2"])),
          "left-handed: the right axis"),
    Fault("yaw gyro stuck at one value", "Oakville", csv("imu", _dead_gyro), "never changes"),
    Fault("IMU 18 s late", "Oakville", csv("imu", _assign(t_s=lambda t: t["t_s"] + 18.0)),
          "IMU's stamps are 18.0"),
    Fault("IMU 0.1 s late", "Oakville long", csv("imu", _assign(t_s=lambda t: t["t_s"] + 0.1)),
          r"IMU's stamps are 0\.(09|1).*late"),
    Fault("latitude and longitude swapped", "Oakville", _positions(_swap("lat_deg", "lon_deg")),
          "latitude and longitude are swapped"),
    Fault("latitude and longitude in radians, declared degrees", "Oakville", _positions(_radians),
          "latitude and longitude are in radians"),
    Fault("height missing (0 everywhere)", "Oakville",
          _positions(_assign(height_m=lambda t: 0.0 * t["height_m"])), "height.*missing"),
    Fault("north and east velocity swapped", "Oakville", csv("gnss", _swap("vn_mps", "ve_mps")),
          "north and east are swapped"),
    Fault("velocity up, declared down", "Oakville",
          csv("gnss", _assign(vd_mps=lambda t: -t["vd_mps"])), "down component"),
    Fault("velocity in km/h, declared m/s", "Oakville", csv("gnss", _kilometres),
          "km/h"),
    Fault("file cut in the middle (gzip)", "Oakville", _half_file, "imu.csv.gz"),
    Fault("column az missing", "Oakville", csv("imu", lambda t: t.drop(columns="az_mps2")),
          "missing columns az"),
    Fault("Doppler in Hz, declared m/s", "comma2k19",
          arrays(_COMMA_RAW, change=_column(6, lambda v: -v / 0.190293673)), "Doppler.*Hz"),
    Fault("C/N0 constant", "comma2k19", arrays(_COMMA_RAW, change=_column(8, lambda v: 45.0)),
          "C/N0.*constant"),
    Fault("IMU 18 s late", "comma2k19", arrays(*_COMMA_IMU, change=lambda t: t + 18.0),
          r"IMU's stamps are (18|17\.9)"),
    Fault("IMU 0.1 s late", "comma2k19", arrays(*_COMMA_IMU, change=lambda t: t + 0.1), "",
          "a minute of even driving: its own uncertainty is larger than the fault"),
    Fault("yaw gyro with the opposite sign", "comma2k19",
          arrays("processed_log/IMU/gyro/value", change=lambda v: v * [1, 1, -1]), "",
          "6° of turning in a minute: the road is straight"),
    Fault("solution in UTC, declared GPS time (18 s)", "rtklibexplorer", _pos_utc,
          "IMU's stamps are 18.0.*UTC"),
    Fault("accelerometer in m/s², declared g", "rtklibexplorer", _imu_si, "multiplied by g"),
    Fault("time tag missing", "rtklibexplorer", remove("*.tag"), "time tag not found"),
)  # fmt: skip


# --- running it ----------------------------------------------------------------------------


def broken(fault: Fault, work: Path) -> Report | None:
    """Return what `check` says to a copy with the fault; None where the base is absent."""
    base = base_folder(fault.base, work)
    if base is None:
        return None
    with tempfile.TemporaryDirectory(dir=work) as place:
        copy = Path(place) / "copy"
        shutil.copytree(base, copy, copy_function=shutil.copyfile)
        for folder in (copy, *(p for p in copy.rglob("*") if p.is_dir())):
            folder.chmod(0o755)  # bases may be read-only
        fault.breaks(copy)
        return check(copy)


def named(fault: Fault, report: Report) -> str:
    """Return the finding that names the fault, without the copy's path; '' if none does."""
    for finding in (*report.of("fatal"), *report.of("doubtful")):
        if fault.expected and re.search(fault.expected, finding.line):
            also = sorted(
                {f.subject for f in report.findings if f.severity != "note" and f is not finding}
            )
            more = f" (also raised: {'; '.join(also)})" if also else ""
            return f"{finding.severity}: {clean(finding.line, report.path)}{more}"
    return ""


def clean(line: str, path: str) -> str:
    """Return a finding's line with the copy's folder taken out."""
    return re.sub(r"\s+", " ", line.replace(f"{path}/", "").replace(path, "folder"))
