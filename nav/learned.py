"""What a run has learned of its installation, as TOML for the next run on the same vehicle.

The keys are those of `sequence.toml`, so that own data may have them pasted; `certnav run
--calibration FILE` takes the file for recordings of any format.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from ..datasets.own.declaration import Section, lever
from ..datasets.sequence import Calibration, Sequence
from ..datasets.text.toml_files import read_toml
from ..filters.errors import ConfigError, DataError
from ..filters.rotation import matrix_from_rpy
from .solution import Solution

#: What the file may hold.
_KEYS = {
    "antenna": ("lever_frd_m", "lever_sigma_m"),
    "vehicle": ("mounting_rpy_deg", "mounting_sigma_deg", "wheels_frd_m", "wheels_sigma_m"),
    "imu": ("time_offset_s", "time_offset_sigma_s"),
}


def learned(solution: Solution) -> str:
    """Return what was estimated and what the motion has shown, as TOML.

    Raises
    ------
    DataError
        If nothing was: a lost solution, or everything declared as exact.
    """
    found = solution.installation
    sections: dict[str, list[str]] = {}
    if found is not None and solution.status != "lost":
        antenna = found.antenna
        if antenna.prior_sigma.any():
            sections["antenna"] = [
                f"lever_frd_m = {_list(antenna.lever_b, 3)}",
                f"lever_sigma_m = {antenna.sigma.max():.3f}  # of the axis that is known worst",
            ]
        if found.estimated and not found.off:
            figures = found.figures()
            mounting = float(np.degrees(np.sqrt(np.diag(found.mounting_cov).max())))
            sections["vehicle"] = [
                f"mounting_rpy_deg = {_list(figures['mounting_rpy_deg'], 2)}",
                f"mounting_sigma_deg = {mounting:.3f}",
                f"wheels_frd_m = {_list(figures['wheels_frd_m'], 2)}",
                f"wheels_sigma_m = {found.wheel_sigma.max():.3f}",
            ]
        if antenna.delay_prior_sigma:
            sections["imu"] = [
                f"time_offset_s = {-antenna.delay:.4f}  # GNSS is as much later than stamped",
                f"time_offset_sigma_s = {antenna.delay_sigma:.4f}",
            ]
    if not sections:
        raise DataError(
            f"{solution.name}: nothing was learned of the installation",
            remedy="declare lever_sigma_m, mounting_sigma_deg or gnss.delay_sigma_s above 0",
        )
    lines = [f"# Learned by certnav run on {solution.name}; sigmas are 1σ."]
    for name, content in sections.items():
        lines += ["", f"[{name}]", *content]
    return "\n".join(lines) + "\n"


def with_calibration(sequence: Sequence, file: Path) -> Sequence:
    """Return the recording with what a file says of the installation in place of its own.

    Raises
    ------
    ConfigError
        For an unknown key, or a value that cannot be.
    """
    tables, _ = read_toml(file)
    for name, table in tables.items():
        if name not in _KEYS or not isinstance(table, dict):
            raise ConfigError.unknown_key(name, tuple(_KEYS), where=str(file))
        for key in table:
            if key not in _KEYS[name]:
                raise ConfigError.unknown_key(key, _KEYS[name], where=f"{file}: [{name}]")
    sections = {name: Section(file, name, tables.get(name, {})) for name in _KEYS}
    calibration = _installed(sequence.calibration, sections, f"declared in {file.name}")
    imu = sequence.imu
    if imu is not None and sections["imu"].has("time_offset_s"):
        offset = float(sections["imu"].numbers("time_offset_s", (1,), "")[0])
        imu = dataclasses.replace(imu, time=imu.time + offset)
    return dataclasses.replace(sequence, calibration=calibration, imu=imu)


def _installed(old: Calibration, sections: dict[str, Section], source: str) -> Calibration:
    new, antenna, vehicle = old, sections["antenna"], sections["vehicle"]
    if antenna.has("lever_frd_m"):
        new = dataclasses.replace(
            new,
            lever_antenna_b=lever(antenna, "lever_frd_m", ""),
            lever_antenna_source=source,
            lever_antenna_sigma=antenna.sigma("lever_sigma_m"),
        )
    if vehicle.has("mounting_rpy_deg"):
        rpy = np.radians(vehicle.numbers("mounting_rpy_deg", (3,), ""))
        new = dataclasses.replace(
            new,
            C_bv=matrix_from_rpy(rpy).T,
            mounting_source=source,
            mounting_sigma=float(np.radians(vehicle.sigma("mounting_sigma_deg"))),
        )
    if vehicle.has("wheels_frd_m"):
        new = dataclasses.replace(
            new,
            lever_vehicle_b=lever(vehicle, "wheels_frd_m", ""),
            lever_vehicle_sigma=vehicle.sigma("wheels_sigma_m"),
        )
    if sections["imu"].has("time_offset_sigma_s"):
        new = dataclasses.replace(new, delay_sigma=sections["imu"].sigma("time_offset_sigma_s"))
    return new


def _list(values: np.ndarray, digits: int) -> str:
    return "[" + ", ".join(f"{float(v):.{digits}f}" for v in values) + "]"
