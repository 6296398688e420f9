"""What alignment is compared with.

    certifiable        the semidefinite relaxation as published (Song et al.)
    sdp, sdp_cvxpy     its dual through clarabel, and written down a second time for cvxpy
    baselines          VOBA and Gauss–Newton
    simulation         windows with known truth, as Song et al. have them
    earth_windows      the same with the Doppler itself, for alignment without a position

Nothing that navigates uses any of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .baselines import BaselineRotation, gauss_newton, voba
    from .certifiable import CertifiedMinimum, align_sdp, certified_minimum
    from .sdp import DualSolution, solve_dual
    from .simulation import SimulatedWindow, simulate_window

__all__ = [
    "BaselineRotation",
    "CertifiedMinimum",
    "DualSolution",
    "SimulatedWindow",
    "align_sdp",
    "certified_minimum",
    "gauss_newton",
    "simulate_window",
    "solve_dual",
    "voba",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "certifiable": ("CertifiedMinimum", "align_sdp", "certified_minimum"),
        "sdp": ("DualSolution", "solve_dual"),
        "baselines": ("BaselineRotation", "gauss_newton", "voba"),
        "simulation": ("SimulatedWindow", "simulate_window"),
    },
)
