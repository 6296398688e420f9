"""Attitude from IMU and Doppler alone, while moving: no odometer, no standstill.

    track      integrals of the IMU over a window, and their response to sensor errors
    rows       Doppler rows tied to these
    unknowns   biases, scale factors, gyro noise and clock; one window, solved until it settles
    align      one window: attitude, velocity, biases, verdicts
    doubts     what speaks against it: rows, rivals, single satellites
    waiting    a window that grows and slides until its verdicts pass

`wait_for_alignment` is the whole of it for a recording, `MotionAligner` for live data.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .align import InertialAlignment, align_inertial
    from .rows import DopplerEpoch
    from .unknowns import InertialOptions
    from .waiting import Attempt, MotionAligner, MotionOptions, attempts, wait_for_alignment

#: Public names by the module that each is imported from when it is first asked for.
_PUBLIC = {
    "align": ("InertialAlignment", "align_inertial"),
    "rows": ("DopplerEpoch",),
    "unknowns": ("InertialOptions",),
    "waiting": ("Attempt", "MotionAligner", "MotionOptions", "attempts", "wait_for_alignment"),
}
_HOME = {name: module for module, names in _PUBLIC.items() for name in names}

__all__ = [
    "Attempt",
    "DopplerEpoch",
    "InertialAlignment",
    "InertialOptions",
    "MotionAligner",
    "MotionOptions",
    "align_inertial",
    "attempts",
    "wait_for_alignment",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
