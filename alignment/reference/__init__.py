"""What alignment is compared with.

    certifiable        the semidefinite relaxation as published (Song et al.)
    sdp, sdp_cvxpy     its dual through clarabel, and written down a second time for cvxpy
    baselines          VOBA and Gauss–Newton
    simulation         windows with known truth

Nothing that navigates uses any of it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .baselines import BaselineRotation, gauss_newton, voba
    from .certifiable import CertifiedMinimum, align_sdp, certified_minimum
    from .sdp import DualSolution, solve_dual
    from .simulation import SimulatedWindow, simulate_window

#: Public names by the module that each is imported from when it is first asked for.
_PUBLIC = {
    "certifiable": ("CertifiedMinimum", "align_sdp", "certified_minimum"),
    "sdp": ("DualSolution", "solve_dual"),
    "baselines": ("BaselineRotation", "gauss_newton", "voba"),
    "simulation": ("SimulatedWindow", "simulate_window"),
}
_HOME = {name: module for module, names in _PUBLIC.items() for name in names}

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


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
