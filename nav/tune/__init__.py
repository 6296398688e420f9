"""Settings from data: which ones a run should have, and the paper's thresholds for pairs.

    found = tune_settings(["drive-1", "drive-2"])
    write_settings(found, "results/tuning")

    settings         tune_settings: candidates judged by the filter, the default among them
    candidates       what is tried
    trials           one candidate on one recording
    choice           which is better, by how much, how sure that is
    settings_report  thresholds.toml, tuning.json and the page
    tuning           tune: thresholds for the velocity of pairs, as the paper has them
    score            their error and retention over the grid, the choice, its cross-validation
    report           their thresholds.toml, tuning.json and page
    panels           the plots of both pages

The names below are imported when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .report import write_tuning
    from .score import Fold, Score
    from .settings import Settings, tune_settings
    from .settings_report import write_settings
    from .tuning import Tuning, tune

__all__ = [
    "Fold",
    "Score",
    "Settings",
    "Tuning",
    "tune",
    "tune_settings",
    "write_settings",
    "write_tuning",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "report": ("write_tuning",),
        "score": ("Fold", "Score"),
        "settings": ("Settings", "tune_settings"),
        "settings_report": ("write_settings",),
        "tuning": ("Tuning", "tune"),
    },
)
