"""What GREAT's files do not say: where antenna, IMUs and reference point are, and whose attitude.

The published sources contradict each other (a figure of GREAT-Dataset and the configuration
files of GREAT-MSF differ by 0.24 m in the lever arm of the same IMU on the same day), so nothing
here has a default that could be wrong in silence. It is declared in the call, or in a file
``great.toml`` in the sequence's folder; the call wins.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from ..text.imu import GYRO_UNITS
from ..text.toml_files import read_toml
from .files import SIDECAR
from .options import IMU_PRESETS, GreatOptions

#: Week of 2020-10-27 and 2020-10-29, the only days the drawn lever arms are valid for.
WEEK_2020 = 2129
#: From the IMU to the antenna, forward-right-down [m], and where it comes from.
LEVERS: dict[tuple[str, str], tuple[tuple[float, float, float], str]] = {
    ("figure", "mems"): ((-0.65, -0.05, -0.15), "GREAT-Dataset figure parameter1, 2024-11-19"),
    ("figure", "tactical"): ((-0.33, -0.05, -0.16), "GREAT-Dataset figure parameter1, 2024-11-19"),
    ("msf_xml", "mems"): ((-0.41, -0.05, -0.15), "GREAT-MSF configuration of MSF_20201027"),
}
#: From the MEMS IMU to the tactical IMU by week, forward-right-down [m] (parameter1, parameter2).
MEMS_TO_TACTICAL = {2129: (-0.32, 0.0, 0.01), 2233: (0.35, 0.04, -0.06)}
#: What made the references of the dataset.
REFERENCE_SOURCE = "Inertial Explorer, tightly coupled RTK and tactical IMU, smoothed"
#: Points a reference may be of.
POINTS = ("imu", "antenna", "mems", "tactical")
#: How well the file's own values are known, 1σ, each of use beside its value alone.
_SIGMAS = {
    "lever_antenna_sigma_m": "lever_antenna_frd_m",
    "mounting_sigma_deg": "mounting_rpy_deg",
    "lever_vehicle_sigma_m": "lever_vehicle_frd_m",
}
_OF_MEMS = ("imu_preset", *_SIGMAS, *_SIGMAS.values())
#: Options that the file may hold too.
_CALLED = ("lever", "reference_point", "reference_body", "imu_preset", "week", "gyro_unit")
SIDECAR_KEYS = (
    "lever",
    "lever_antenna_frd_m",
    "reference_point",
    "reference_body",
    "imu_preset",
    "week",
    "gyro_unit",
    "reference_source",
    "mounting_rpy_deg",
    "lever_vehicle_frd_m",
    *_SIGMAS,
)


@dataclass(frozen=True)
class Declared:
    """Everything the files do not say, from the arguments or from ``great.toml``."""

    lever: str | FloatArray
    lever_from: str
    reference_point: str | FloatArray | None
    reference_body: str | None
    imu_preset: str
    week: int | None
    gyro_unit: str
    reference_source: str
    mounting_rpy_deg: FloatArray | None
    lever_vehicle: FloatArray | None
    lever_antenna_sigma_m: float = 0.0
    mounting_sigma_deg: float = 0.0
    lever_vehicle_sigma_m: float = 0.0


def read_declared(folder: Path, options: GreatOptions) -> Declared:
    """Merge options and ``great.toml``, and refuse what is missing or unknown.

    Keys of the file are those of `Declared`, with ``lever`` for a preset and
    ``lever_antenna_frd_m`` for a vector. Its vectors, its noise model and 'imu' as the reference
    point are meant for the MEMS IMU; for the tactical one they have to be given in the call.
    """
    imu = options.imu
    called = {key: value for key in _CALLED if (value := getattr(options, key)) is not None}
    given = {**sidecar(folder, imu), **called}
    lever = given.get("lever", given.get("lever_antenna_frd_m"))
    if lever is None:
        raise ConfigError(
            f"{folder}: lever arm of the {imu} IMU not given: lever='figure' (GREAT-Dataset "
            "drawing), 'msf_xml' (GREAT-MSF configuration) or (forward, right, down) in metres; "
            "no default, because the two sources differ by 0.24 m"
        )
    week, unit = given.get("week"), given.get("gyro_unit", "auto")
    body = given.get("reference_body")
    if body not in (None, "imu", "tactical"):
        raise ConfigError(f"reference_body: expected 'imu' or 'tactical', found {body!r}")
    if unit not in ("auto", *GYRO_UNITS):
        raise ConfigError(f"gyro_unit: expected 'auto', 'deg/s' or 'rad/s', found {unit!r}")
    if week is not None and (isinstance(week, bool) or not isinstance(week, int | np.integer)):
        raise ConfigError(f"week: expected a GPS week number, found {week!r}")
    point = given.get("reference_point")
    if point is not None:
        point = word_or_vector("reference_point", point, POINTS)
    return Declared(
        lever=word_or_vector("lever", lever, ("figure", "msf_xml")),
        lever_from="declared in the call" if "lever" in called else f"declared in {SIDECAR}",
        reference_point=None if point is None else word_or_vector("reference_point", point, POINTS),
        reference_body=body,
        imu_preset=given.get("imu_preset", IMU_PRESETS[imu]),
        week=None if week is None else int(week),
        gyro_unit=unit,
        reference_source=str(given.get("reference_source", REFERENCE_SOURCE)),
        mounting_rpy_deg=_optional_vector("mounting_rpy_deg", given),
        lever_vehicle=_optional_vector("lever_vehicle_frd_m", given),
        # A lever in the call is another one than that of the file.
        lever_antenna_sigma_m=0.0 if "lever" in called else _sigma("lever_antenna_sigma_m", given),
        mounting_sigma_deg=_sigma("mounting_sigma_deg", given),
        lever_vehicle_sigma_m=_sigma("lever_vehicle_sigma_m", given),
    )


def word_or_vector(key: str, value: Any, words: tuple[str, ...]) -> str | FloatArray:
    """Return one of some words, or three numbers; refuse (`ConfigError`) anything else."""
    if not isinstance(value, str) or not words:
        return _vector(key, value)
    if value not in words:
        raise ConfigError.unknown_key(value, words, where=key)
    return value


def _optional_vector(key: str, given: Mapping[str, Any]) -> FloatArray | None:
    return _vector(key, given[key]) if key in given else None


def _sigma(key: str, given: Mapping[str, Any]) -> float:
    """Return a 1σ, 0 where none is given: exactly."""
    value = given.get(key, 0.0)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < np.inf:
        raise ConfigError(f"{key}: expected a number of 0 or more, found {value!r}")
    return float(value)


def sidecar(folder: Path, imu: str) -> Mapping[str, Any]:
    """Return what ``great.toml`` declares for that IMU; nothing where there is none."""
    file = folder / SIDECAR
    if not file.is_file():
        return {}
    try:
        content, _ = read_toml(file)
    except DataError as error:
        raise ConfigError(str(error)) from None
    for key in content:
        if key not in SIDECAR_KEYS:
            raise ConfigError.unknown_key(key, SIDECAR_KEYS, where=str(file))
    if "lever" in content and "lever_antenna_frd_m" in content:
        raise ConfigError(f"{file}: give either lever or lever_antenna_frd_m, not both")
    for key, of in _SIGMAS.items():
        if key in content and of not in content:
            raise ConfigError(f"{file}: {key} without {of}: give both")
    if imu == "mems":
        return {**content, **({"reference_point": "mems"} if _names_imu(content) else {})}
    of_both = {k: v for k, v in content.items() if k not in _OF_MEMS}
    if isinstance(of_both.get("reference_point"), list):
        del of_both["reference_point"]
    elif _names_imu(content):
        of_both["reference_point"] = "mems"
    return of_both


def _names_imu(content: Mapping[str, Any]) -> bool:
    return content.get("reference_point") == "imu"


def _vector(key: str, value: Any) -> FloatArray:
    try:
        vector = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ConfigError(f"{key}: expected three numbers (forward, right, down), found {value!r}")
    return vector


def antenna_lever(declared: Declared, imu: str, week: int) -> tuple[FloatArray, str]:
    if not isinstance(declared.lever, str):
        return declared.lever, declared.lever_from
    known = LEVERS.get((declared.lever, imu))
    if known is None:
        raise ConfigError(f"lever='{declared.lever}' holds no value for the {imu} IMU: give it")
    if week != WEEK_2020:
        raise ConfigError(
            f"lever='{declared.lever}' is drawn for 2020-10-27/29 (GPS week {WEEK_2020}), this "
            f"sequence is of week {week}: give lever=(forward, right, down) in metres"
        )
    value, source = known
    return np.array(value), source


def reference_lever(
    declared: Declared, imu: str, week: int, lever_b: FloatArray
) -> tuple[FloatArray, str]:
    """Return the vector from the IMU to the reference point [m] and the point's name."""
    point = declared.reference_point
    if point is None:
        raise ConfigError(
            "reference_point not given: 'imu', 'antenna', 'mems', 'tactical' or (forward, right, "
            "down) in metres; no default, because GREAT-Dataset does not say which point its "
            "ground truth is of"
        )
    if not isinstance(point, str):
        return point, "declared point"
    if point == "antenna":
        return lever_b, "antenna"
    if point in ("imu", imu):
        return np.zeros(3), "imu"
    if week in MEMS_TO_TACTICAL:
        sign = 1.0 if point == "tactical" else -1.0
        return sign * np.array(MEMS_TO_TACTICAL[week]), f"{point} IMU"
    raise ConfigError(
        f"reference_point='{point}': where it is from the {imu} IMU is not known for week "
        f"{week}; give (forward, right, down) in metres"
    )
