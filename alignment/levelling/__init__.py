"""Initial attitude by levelling and GNSS course.

The conventional start of a loosely coupled filter: roll and pitch from the specific force, at
rest if the data begin with a standstill and against the GNSS acceleration otherwise; heading
from the course once the vehicle moves, on the assumption that it goes where it points.

    attitude   an attitude to start with, velocities to find one from, one that is given
    level      roll and pitch from specific force
    rest       standstills
    course     heading from the course: levelling and course as a whole
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .attitude import LARGEST_SIGMA_HEADING, InitialAttitude, VelocityTrack, given_attitude
    from .course import level_and_course
    from .level import LEVEL_WINDOW

__all__ = [
    "LARGEST_SIGMA_HEADING",
    "LEVEL_WINDOW",
    "InitialAttitude",
    "VelocityTrack",
    "given_attitude",
    "level_and_course",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "attitude": (
            "LARGEST_SIGMA_HEADING", "InitialAttitude", "VelocityTrack", "given_attitude",
        ),
        "course": ("level_and_course",),
        "level": ("LEVEL_WINDOW",),
    },
)  # fmt: skip
