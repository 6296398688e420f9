"""What constellations are worth beside each other, for everything that takes range rates."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...datasets.observations import GnssObservations
from ...velocity.constellations import compare_constellations
from ...velocity.range_rate import DopplerNoise, doppler_rows
from ..notes import Note

NAMES = {"G": "GPS", "R": "GLONASS", "E": "Galileo", "J": "QZSS", "C": "BeiDou"}
#: Noise that is not more than this times another's is the same [ratio].
_SAME = 1.2


def weighed_constellations(
    observations: GnssObservations, pos_e: ArrayLike, noise: DopplerNoise
) -> tuple[GnssObservations, tuple[Note, ...]]:
    """Return observations with each constellation's noise, those that disagree marked, and notes.

    Parameters
    ----------
    observations : GnssObservations
    pos_e : array_like, shape (n, 3)
        Antenna at each row, within about 100 m [m].
    noise : DopplerNoise
        As configured, by C/N0.
    """
    rows = doppler_rows(observations, pos_e, noise)
    if len(rows) == 0:
        return observations, ()
    epoch = np.cumsum(np.diff(observations.time[rows.row], prepend=-np.inf) > 0) - 1
    letters = observations.sat.astype("U1")
    factor = observations.noise_factor.copy()
    notes = []
    for found in compare_constellations(rows, epoch):
        name, mine = NAMES.get(found.letter, found.letter), letters == found.letter
        if found.disagrees:
            observations = observations.mark(
                mine & observations.has_range_rate, "constellation's Doppler disagrees"
            )
            text = (
                f"{name}: its Doppler has another clock drift than that of the others, by "
                f"{found.offset:+.2f} ± {found.offset_sigma:.2f} m/s, and is left out: wrong "
                "ephemerides, or a wrong carrier frequency (GLONASS channels)?"
            )
            notes.append(Note("doubtful", text))
        elif found.noise > _SAME:
            factor[mine] *= found.noise
            text = f"{name}: its Doppler is {found.noise:.1f} times as noisy as that of the others"
            notes.append(Note("note", f"{text}, and is weighed so"))
    return observations.with_columns(noise_factor=factor), tuple(notes)
