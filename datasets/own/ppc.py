"""Precise Positioning Challenge 2024 (taroz/PPC-Dataset): what its README says, as a declaration.

A run's folder holds ``rover.obs`` (Septentrio mosaic-X5, 5 Hz), ``base.obs`` (1 Hz), ``base.nav``,
``imu.csv`` (ADIS16505-2, 100 Hz: seconds of week, week, acceleration [m/s²], rates [deg/s]; x
forward, y right, z down) and ``reference.csv`` (geodetic and ECEF position, roll, pitch, heading,
velocity east, north, up). Lever arms are the README's, by city; RTK of the rover agrees with the
reference without one, so that this is the antenna's.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np

from ...filters.earth import lla_to_ecef
from ...filters.errors import DataError
from ..sequence import Sequence
from ..text.columns import open_text
from .declaration import Declaration, Section
from .reader import sequence_of

_FILES = ("rover.obs", "base.obs", "base.nav", "imu.csv")
_IMU = (
    "gpstow", "gpsweek", "accx", "accy", "accz", "angratex", "angratey", "angratez",
)  # fmt: skip
_REFERENCE = (
    "gpstow", "gpsweek", "latitude", "longitude", "ellipsoidheight", "ecefx", "ecefy", "ecefz",
    "roll", "pitch", "heading", "eastvelocity", "northvelocity", "upvelocity",
)  # fmt: skip
#: By city: the base's phase centre, latitude, longitude [deg] and height [m], and the antenna seen
#: from the IMU, forward, right, down [m].
CITIES = {
    "tokyo": ((35.66633426, 139.79220181, 59.82), (0.31, 0.0, -0.55)),
    "nagoya": ((35.13470947, 136.97757427, 104.718), (0.593, -0.670, -1.216)),
}
#: A run is within this of its base [m]; the cities are 260 km apart.
_NEAR = 50e3


def is_ppc(folder: Path) -> bool:
    """Return whether a folder holds rover, base, navigation and IMU under the challenge's names."""
    return all((folder / name).is_file() for name in _FILES)


def read_ppc(path: str | Path, *, axes: str = "FRD", systems: str = "GREJC") -> Sequence:
    """Return a run.

    Parameters
    ----------
    path : path
        Its folder.
    axes : str
        Directions of the IMU's x, y, z; default: those of the README.
    systems : str
        Constellation letters, as in `datasets.rtklib.read_observations`.

    Raises
    ------
    DataError
        Missing files, other columns, no city known there, or data that contradict physics.
    """
    folder = Path(path)
    _columns(folder / "imu.csv", _IMU)
    tables: dict[str, dict[str, Any]] = {
        "time": {"scale": "gps-week-sow"},
        "imu": {
            "file": "imu.csv", "time": [2, 1], "accel": [3, 4, 5], "accel_unit": "m/s2",
            "gyro": [6, 7, 8], "gyro_unit": "deg/s", "axes": axes,
        },
        # The family's preset: ADIS16505-2 is no noisier than ADIS16470.
        "imu.noise": {"preset": "adis16470"},
        "vehicle": {"mounting_rpy_deg": [0.0, 0.0, 0.0]},
        "rinex": {"observations": "rover.obs", "navigation": ["base.nav"], "systems": systems},
    }  # fmt: skip
    if (folder / "reference.csv").is_file():
        _columns(folder / "reference.csv", _REFERENCE)
        tables["reference"] = {
            "file": "reference.csv", "time": [2, 1], "position": [6, 7, 8],
            "position_frame": "ecef", "velocity": [12, 13, 14], "velocity_frame": "enu",
            "velocity_unit": "m/s", "attitude": [9, 10, 11], "attitude_unit": "deg",
            "attitude_convention": "frd-ned", "attitude_of": "vehicle", "point": "antenna",
            "source": "the challenge's ground truth",
        }  # fmt: skip
    city, lever = _city(folder)
    tables["antenna"] = {"lever_frd_m": list(lever), "source": f"README of the set, {city}"}
    here = folder / "README of PPC-Dataset"
    sections = {name: Section(here, name, values) for name, values in tables.items()}
    name = "-".join(folder.resolve().parts[-2:])
    sequence = sequence_of(Declaration(here, name, sections))
    return dataclasses.replace(sequence, base=(folder / "base.obs",))


def _columns(file: Path, expected: tuple[str, ...]) -> None:
    """Refuse a table whose header names other columns, units aside."""
    names = open_text(file).names or ()
    found = tuple(re.sub(r"\(.*?\)|[^a-z]", "", name.lower()) for name in names)
    if found[: len(expected)] != expected:
        raise DataError(
            f"expected the columns {', '.join(expected)}, found {', '.join(names) or 'no header'}",
            file=file,
            line=1,
            remedy="own layouts go by a declaration: certnav declare FILE…",
        )


def _city(folder: Path) -> tuple[str, tuple[float, float, float]]:
    """Return the city by where the base is, and its lever arm."""
    from ..rtklib.base import base_position  # RTKLIB is slow to import

    found = base_position(folder / "base.obs", None)
    for city, ((lat, lon, height), lever) in CITIES.items():
        place = lla_to_ecef(np.radians(lat), np.radians(lon), height)
        if found is not None and np.linalg.norm(found[0] - place) < _NEAR:
            return city, lever
    raise DataError(
        f"the base is near none of {', '.join(CITIES)}: where the antenna is, is not known",
        file=folder / "base.obs",
        remedy="declare the drive: certnav declare imu.csv rover.obs base.nav",
    )
