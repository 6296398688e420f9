"""The certified minimum over SO(3) in microseconds, and how far from it the data let one go.

    constraints      the rotation group as quadratic equations
    quartic          the cost as a quartic of the quaternion: Gram matrices
    fast_solver      the solver; fast_compiled, with kernels, margin_kernels, or fast_numpy works
    exact_cost       the same questions in integers, where rounding hides the answer
    elimination      unknowns that nobody asked for, taken out of rows
    refinement       Newton's method on SO(3)
    attitude_bound   the angle that no rotation which the data allow exceeds

It knows a cost matrix and nothing of what it was made from.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .attitude_bound import region_threshold
    from .fast_solver import FastMinimum, LocalMinima, fast_minimum, local_minima
    from .refinement import Minimum, newton, rotation_angle

__all__ = [
    "FastMinimum",
    "LocalMinima",
    "Minimum",
    "fast_minimum",
    "local_minima",
    "newton",
    "region_threshold",
    "rotation_angle",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "fast_solver": ("FastMinimum", "LocalMinima", "fast_minimum", "local_minima"),
        "refinement": ("Minimum", "newton", "rotation_angle"),
        "attitude_bound": ("region_threshold",),
    },
)
