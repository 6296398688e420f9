"""Is a recording what it is declared to be, and can it be navigated?

    report = check("my-drive")
    report.navigable, report.text()

    recording    check: load, test part by part, page
    findings     Finding and Report
    page         the same as a page, with the motion as it was recorded
    gnss         observations against each other, positions against velocities
    inertial     the IMU by itself: gravity, frozen and clipped values, noise, sampling
    motion       motion as the IMU and as GNSS sees it
    timing       the IMU's clock against that motion
    axes         axes, signs and units against it
    orientation  how the IMU's axes are turned in the vehicle, coarsely, whatever is declared
    mounting     yaw and pitch of the IMU in the vehicle, measured
    declarations what was measured other than declared, as lines to paste
    lag          the time between two motions, whatever their axes
    reference    the reference against everything else

The names below are imported when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .findings import Finding, Report
    from .recording import check, check_sequence

__all__ = [
    "Finding",
    "Report",
    "check",
    "check_sequence",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "findings": ("Finding", "Report"),
        "recording": ("check", "check_sequence"),
    },
)
