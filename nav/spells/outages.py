"""Spells of weak GNSS: when they are, and which satellites they leave, from one short text.

::

    SPEC   = SPELLS [":" KEEP] ["@" SHIFTS]
    SPELLS = DURATION "/" PERIOD     DURATION s at the end of every PERIOD s
           | FROM "-" TO             once, seconds from the beginning of the data; TO may be "end"
    KEEP   = N | N "-" M             N satellites, or a number drawn for each spell; default 0
             ["high" | "low"]        the highest or the lowest ones; default: drawn at random
           | "canyon" [DEGREES]      what a street leaves whose houses rise so high at right
                                     angles to the drive; default 60
    SHIFTS = S {"," S}               moves periodic spells by S s; several: one variant each

``60/180`` is the usual test of 60 s in every 180 s without any GNSS; ``60/180:2-3@0,60,120`` leaves
two or three satellites and covers the whole drive in three variants; ``10-end:2`` leaves two from
second 10 on; ``none`` takes nothing away.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray

_NUMBER = r"\d+(?:\.\d+)?"
_SPEC = re.compile(
    rf"(?:(?P<duration>{_NUMBER})/(?P<period>{_NUMBER})|(?P<start>{_NUMBER})-(?P<end>{_NUMBER}|end))"
    rf"(?::(?:(?P<least>\d+)(?:-(?P<most>\d+))?(?P<order>high|low)?"
    rf"|(?P<canyon>canyon(?P<mask>{_NUMBER})?)))?"
    rf"(?:@(?P<shifts>{_NUMBER}(?:,{_NUMBER})*))?"
)
#: The SPEC of no spells at all.
NONE = "none"
_EXAMPLES = "for example 60/180, 60/180:2@0,60,120, 60/180:2-3high, 60/180:canyon50 or 10-end:3"


class Spell(NamedTuple):
    """One stretch of weak GNSS: its beginning (inclusive) and end (exclusive), GPS time [s]."""

    start: float
    end: float


@dataclass(frozen=True)
class Outages:
    """When satellites are taken away, and which are left.

    Parameters
    ----------
    text : str
        As it was written.
    duration, period : float
        Of periodic spells [s]; NaN for a single one.
    start, end : float
        Of a single spell, from the beginning of the data [s]; NaN for periodic ones.
    least, most : int
        Satellites left; equal unless the number is drawn for each spell.
    order : {'random', 'high', 'low', 'canyon'}
        Which ones.
    mask_deg : float
        Of 'canyon': elevation of the houses at right angles to the drive.
    shifts : tuple of float
        One variant each [s].
    """

    text: str
    duration: float = float("nan")
    period: float = float("nan")
    start: float = float("nan")
    end: float = float("nan")
    least: int = 0
    most: int = 0
    order: str = "random"
    mask_deg: float = 60.0
    shifts: tuple[float, ...] = (0.0,)

    @property
    def is_random(self) -> bool:
        """Whether a seed makes a difference."""
        return self.least != self.most or (self.order == "random" and self.most > 0)

    @property
    def keeps_some(self) -> bool:
        """Whether any satellite may be left."""
        return self.order == "canyon" or self.most > 0

    def spells(self, first: float, last: float, earliest: float, shift: float = 0.0) -> list[Spell]:
        """Return the spells of one recording, in order.

        Parameters
        ----------
        first, last : float
            Of the data [s].
        earliest : float
            Periodic spells that would begin before it are left out; alignment must be complete.
        shift : float
            Of periodic spells [s].

        Raises
        ------
        ConfigError
            If no spell fits, or the single one begins before `earliest`.
        """
        if self.text == NONE:
            return []
        if np.isfinite(self.start):
            begin, stop = first + self.start, min(first + self.end, last)
            if begin < earliest:
                raise ConfigError(
                    f"--outages {self.text}: begins at second {self.start:g}, but the solution "
                    f"begins at second {earliest - first:.1f}: begin later"
                )
            out = [Spell(begin, stop)] if begin < stop else []
        else:
            count = int(np.ceil((last - first) / self.period)) + 1
            ends = first + shift % self.period + self.period * np.arange(count + 1)
            out = [
                Spell(float(end - self.duration), float(end))
                for end in ends
                if end - self.duration >= earliest and end <= last
            ]
        if not out:
            raise ConfigError(
                f"--outages {self.text}: no spell fits between second {earliest - first:.1f}, when "
                f"the filter has settled, and the end at second {last - first:.1f}"
            )
        return out


def parse_outages(text: str) -> Outages:
    """Return the outages of a SPEC (see the module).

    Raises
    ------
    ConfigError
        If it is none.
    """
    if text.strip() == NONE:
        return Outages(NONE)
    match = _SPEC.fullmatch(text.strip().replace(" ", ""))
    if match is None:
        raise ConfigError(f"--outages {text}: not understood; {_EXAMPLES}")
    part = match.groupdict()
    values: dict[str, float] = {}
    if part["duration"] is not None:
        values = {"duration": float(part["duration"]), "period": float(part["period"])}
        if not 0.0 < values["duration"] < values["period"]:
            raise ConfigError(
                f"--outages {text}: expected 0 < DURATION < PERIOD, found "
                f"{values['duration']:g}/{values['period']:g}"
            )
    else:
        end = float("inf") if part["end"] == "end" else float(part["end"])
        values = {"start": float(part["start"]), "end": end}
        if not values["start"] < end:
            raise ConfigError(f"--outages {text}: expected FROM before TO; {_EXAMPLES}")
        if part["shifts"]:
            raise ConfigError(f"--outages {text}: only periodic spells can be shifted (@)")
    least = int(part["least"] or 0)
    most = int(part["most"]) if part["most"] else least
    if most < least:
        raise ConfigError(f"--outages {text}: expected N-M with N ≤ M, found {least}-{most}")
    mask = float(part["mask"]) if part["mask"] else 60.0
    if not 0.0 < mask < 90.0:
        raise ConfigError(f"--outages {text}: expected a canyon of 0…90°, found {mask:g}°")
    order = "canyon" if part["canyon"] is not None else part["order"] or "random"
    shifts = tuple(float(s) for s in part["shifts"].split(",")) if part["shifts"] else (0.0,)
    return Outages(
        text, least=least, most=most, order=order, mask_deg=mask, shifts=shifts, **values
    )


def in_spells(time: FloatArray, spells: Iterable[Spell]) -> NDArray[np.bool_]:
    """Return True where `time` is in a spell, its end excluded, shape (n,)."""
    inside = np.zeros(np.shape(time), dtype=bool)
    for start, end in spells:
        inside |= (time >= start) & (time < end)
    return inside
