"""The spells of a drive that can be judged: satellites can be left, and a reference has been."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...datasets.sequence import Sequence
from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from .drift import judgeable
from .outages import NONE, Outages, Spell

#: After alignment, before the first periodic spell [s]: a filter needs to settle.
SETTLE = 10.0


@dataclass(frozen=True, eq=False)
class Seen:
    """What of a drive decides which spells count.

    Attributes
    ----------
    name : str
    span : tuple of float
        Of the data [s].
    observed_until : float
        Last satellite observation [s]; infinite where there are none.
    reference_time : ndarray, shape (n,)
        Epochs of the reference [s].
    """

    name: str
    span: tuple[float, float]
    observed_until: float
    reference_time: FloatArray

    @classmethod
    def of(cls, sequence: Sequence) -> Seen:
        """Return it of a recording with a reference."""
        assert sequence.reference is not None
        o = sequence.observations
        until = float("inf") if o is None else float(o.time[-1])
        return cls(sequence.name, sequence.span, until, sequence.reference.time)


def judged_spells(
    outages: Outages, seen: Seen, aligned: float, shift: float
) -> tuple[list[Spell], list[str]]:
    """Return the spells of a drive that count, and what is said of the others.

    Spells that leave satellites are where there are observations. Periodic ones that the reference
    has not seen begin and end are none: GNSS stays.

    Parameters
    ----------
    outages : Outages
    seen : Seen
    aligned : float
        When the run without spells has begun [s].
    shift : float
        Of periodic spells [s].

    Raises
    ------
    ConfigError
        If no spell fits.
    DataError
        If the reference has seen none.
    """
    said = []
    first, last = seen.span
    if outages.keeps_some and last - seen.observed_until > SETTLE:
        last = seen.observed_until
        said.append(f"spells up to second {last - first:.0f}: later there are no observations")
    periodic = not np.isfinite(outages.start)
    spells = outages.spells(first, last, aligned + SETTLE * periodic, shift)
    if not periodic or outages.text == NONE:
        return spells, said
    judged = judgeable(spells, seen.reference_time)
    if not judged:
        raise DataError(
            f"{seen.name}: the reference has seen none of {len(spells)} spells begin and end",
            remedy="move them, as in 60/180@30, or make them shorter",
        )
    if len(judged) < len(spells):
        said.append(
            f"{len(spells) - len(judged)} of {len(spells)} spells that the reference has not seen "
            "begin or end are left out"
        )
    return judged, said
