"""Attitude from IMU and Doppler alone, while moving: no odometer, no standstill.

    track      integrals of the IMU over a window, and their response to sensor errors
    rows       Doppler rows tied to these
    unknowns   biases, scale factors, gyro noise and clock: what is known of them
    window     one window, solved until it settles
    align      one window: attitude, velocity, biases, verdicts
    doubts     what speaks against it: rows, rivals, single satellites
    waiting    a window that grows and slides until its verdicts pass

What track_kernels and window_kernels do for `track` and `window` is compiled.

`wait_for_alignment` is the whole of it for a recording, `MotionAligner` for live data.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .align import InertialAlignment, align_inertial
    from .rows import DopplerEpoch
    from .unknowns import InertialOptions
    from .waiting import Attempt, MotionAligner, MotionOptions, attempts, wait_for_alignment

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

__getattr__, __dir__ = names(
    __name__,
    {
        "align": ("InertialAlignment", "align_inertial"),
        "rows": ("DopplerEpoch",),
        "unknowns": ("InertialOptions",),
        "waiting": ("Attempt", "MotionAligner", "MotionOptions", "attempts", "wait_for_alignment"),
    },
)
