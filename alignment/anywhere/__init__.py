"""Attitude without knowing where one is: from Doppler alone, hundreds of kilometres away.

    found = align_anywhere(observations, track, near, radius=300e3, height_sigma=300.0)
    found.passed, found.C_ew, found.bound, found.pos_e, found.located.message

    signals   Doppler before any position is assumed, and what a position makes of it
    joint     attitude, position, time and speed scale in one quadratic cost
    ball      what is left out of it, and the ball of positions that contracts
    align     the rounds, the verdicts

`near` may be wrong by as much as `radius`; nothing is claimed beyond it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .align import AnywhereAlignment, align_anywhere
    from .signals import Signals

__all__ = ["AnywhereAlignment", "Signals", "align_anywhere"]

__getattr__, __dir__ = names(
    __name__, {"align": ("AnywhereAlignment", "align_anywhere"), "signals": ("Signals",)}
)
