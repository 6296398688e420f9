"""Spells of weak GNSS: when they are, what they leave, and how far a solution drifts in them.

    outages = parse_outages("60/180:2")
    spells = outages.spells(first, last, earliest)
    evaluation = evaluate(navigate(degrade(sequence, spells, outages), config), sequence)
    [spell_figures(evaluation, spell).drift for spell in spells]

    outages        Outages, Spell: one short text says when, and which satellites are left
    degradation    degrade: a recording with GNSS taken away within the spells
    judged         which spells of a drive count
    drift          what a spell did to a solution

The names below are imported when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .degradation import degrade
    from .drift import SpellFigures, spell_figures
    from .outages import Outages, Spell, in_spells, parse_outages

__all__ = [
    "Outages",
    "Spell",
    "SpellFigures",
    "degrade",
    "in_spells",
    "parse_outages",
    "spell_figures",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "degradation": ("degrade",),
        "drift": ("SpellFigures", "spell_figures"),
        "outages": ("Outages", "Spell", "in_spells", "parse_outages"),
    },
)
