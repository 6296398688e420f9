"""Draft a declaration and measure what files show of each other: `certnav declare`.

    draft = measured_draft(["imu.csv", "gnss.csv"])
    draft.text(), draft.blanks

    measured     the entrance: files, what is measured of them in which order, what follows
    trial        a draft read with trial answers in place of its blanks
    clocks       time scales and offsets, from motion
    velocities   columns, frame and unit of velocities, from positions
    columns      columns that no name tells, from the same
    turned       the gyro's unit and columns, axes and mounting, from gravity and motion
    truth        the reference: which file it is, its clock, angles and point
    installed    mounting and lever arm, by a navigation that estimates them

Nothing is guessed. What too little motion leaves open stays blank, with the reason.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .measured import measured_draft

__all__ = ["measured_draft"]

__getattr__, __dir__ = names(__name__, {"measured": ("measured_draft",)})
