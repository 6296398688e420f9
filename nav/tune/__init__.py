"""Screening thresholds for Doppler from data, cross-validated.

    tuning = tune(["drive-1", "drive-2"], snr=range(30, 51), k=[0.05, 0.1, 0.2, 0.4])
    write_tuning(tuning, "results/tuning")

    tuning      tune: which pair of thresholds to take, and what is behind it
    score       error and retention over the grid, the choice, its cross-validation
    position    drift of the filter over spells of weak GNSS as the error
    report      thresholds.toml, tuning.json and the page

The names below are imported when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .position import drift_scores
    from .report import write_tuning
    from .score import Fold, Score
    from .tuning import Tuning, tune

__all__ = [
    "Fold",
    "Score",
    "Tuning",
    "drift_scores",
    "tune",
    "write_tuning",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "position": ("drift_scores",),
        "report": ("write_tuning",),
        "score": ("Fold", "Score"),
        "tuning": ("Tuning", "tune"),
    },
)
