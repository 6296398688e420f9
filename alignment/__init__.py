"""Alignment of the local (IMU, odometer) frame with the Earth: an attitude, and what proves it.

    result = align(AlignmentRows.paired(doppler, time, vel_w), ClockModel("random-walk", 0.1))
    result.passed, result.C_ew, result.bound, result.message

    rows             Doppler measurements paired with local velocities
    problem          the quadratic cost they make, without clock and other unknowns
    clock_walk       rows under a clock that walks, made independent in one pass
    local_velocity   the vehicle's own velocity, from odometer and gyros
    priors           a known vertical or heading, as rows of the same problem
    observability    which windows determine a rotation at all
    entrance         align: arrays in, one result out
    verdict, result  the verdicts on a solution, and the result that carries them
    row_selection,   the same where part of the rows is wrong
    robust
    direction        nose or tail first: which of two headings fits the accelerations
    velocity_matching  how far any heading is off, from how the velocity changes
    status           what is proved of a rotation, in one word

    solver/          the certified minimum in microseconds, and the bound around it
    proofs/          certificates, exact proofs, proofs about the choice of rows
    anywhere/        attitude and position, from Doppler alone
    levelling/       the conventional start: levelling and course
    in_motion/       attitude from IMU and Doppler alone, while moving
    reference/       what it is compared with

The names below are imported when they are first asked for: importing the package costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..lazy import names

if TYPE_CHECKING:
    from .anywhere.align import AnywhereAlignment, align_anywhere
    from .entrance import align
    from .levelling.attitude import InitialAttitude, VelocityTrack, given_attitude
    from .levelling.course import level_and_course
    from .local_velocity import LocalTrack, inertial_track, planar_track
    from .observability import Geometry
    from .priors import Prior, heading_prior, up_prior, with_priors
    from .problem import AlignmentProblem, ClockModel, build_problem
    from .result import AlignmentResult, Ask, Verdict
    from .robust import RobustAlignment, RobustOptions, align_robust
    from .rows import AlignmentRows
    from .status import AlignmentStatus
    from .verdict import VerdictLimits, judge

__all__ = [
    "AlignmentProblem",
    "AlignmentResult",
    "AlignmentRows",
    "AlignmentStatus",
    "AnywhereAlignment",
    "Ask",
    "ClockModel",
    "Geometry",
    "InitialAttitude",
    "LocalTrack",
    "Prior",
    "RobustAlignment",
    "RobustOptions",
    "VelocityTrack",
    "Verdict",
    "VerdictLimits",
    "align",
    "align_anywhere",
    "align_robust",
    "build_problem",
    "given_attitude",
    "heading_prior",
    "inertial_track",
    "judge",
    "level_and_course",
    "planar_track",
    "up_prior",
    "with_priors",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "anywhere.align": ("AnywhereAlignment", "align_anywhere"),
        "entrance": ("align",),
        "verdict": ("VerdictLimits", "judge"),
        "result": ("AlignmentResult", "Ask", "Verdict"),
        "status": ("AlignmentStatus",),
        "problem": ("AlignmentProblem", "ClockModel", "build_problem"),
        "rows": ("AlignmentRows",),
        "priors": ("Prior", "heading_prior", "up_prior", "with_priors"),
        "robust": ("RobustAlignment", "RobustOptions", "align_robust"),
        "local_velocity": ("LocalTrack", "inertial_track", "planar_track"),
        "levelling.attitude": ("InitialAttitude", "VelocityTrack", "given_attitude"),
        "levelling.course": ("level_and_course",),
        "observability": ("Geometry",),
    },
)
