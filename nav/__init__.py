"""Navigation runs: from files to a solution, its evaluation and its report.

    config, config_files        what a run is asked, and how it is written down
    solution, notes             what it returns, what it tells
    signals                     what became of every satellite signal
    installation                how the IMU sits in the vehicle
    learned                     what a run found of that, for the next one
    pipeline, navigator         a whole recording; a live vehicle
    vehicles, rest              what kinds of vehicles can do; when a log stands
    rejections                  carried fixes that are not used, in words

    sweep/                      much at once: threads, processes, a cluster; drives by their paths
    engine/                     events, the start, the filter loop and its decisions
    evaluation/                 errors against a reference, honesty of the covariance
    spells/                     spells of weak GNSS: when, what is left, the drift in them
    results/                    the result directory
    page/ report/               what all pages share; the page of a run
    check/ drafting/ compare/   recordings against physics; declarations; methods side by side
    study/ tune/                the DDIA-VE paper of any drive; settings from data
    windows/                    alignment windows of a recording
    commands/                   the command line

The names below are imported when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..lazy import names

if TYPE_CHECKING:
    from .config import Config
    from .config_files import load_config
    from .engine.events import GnssEvent
    from .evaluation.accuracy import Evaluation, evaluate
    from .navigator import LiveState, Navigator
    from .notes import Note
    from .pipeline import navigate
    from .results.directory import Result, read_result, write_result
    from .solution import Solution, Trajectory, Update

__all__ = [
    "Config",
    "Evaluation",
    "GnssEvent",
    "LiveState",
    "Navigator",
    "Note",
    "Result",
    "Solution",
    "Trajectory",
    "Update",
    "evaluate",
    "load_config",
    "navigate",
    "read_result",
    "write_result",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "config": ("Config",),
        "config_files": ("load_config",),
        "engine.events": ("GnssEvent",),
        "evaluation.accuracy": ("Evaluation", "evaluate"),
        "navigator": ("LiveState", "Navigator"),
        "notes": ("Note",),
        "pipeline": ("navigate",),
        "results.directory": ("Result", "read_result", "write_result"),
        "solution": ("Solution", "Trajectory", "Update"),
    },
)
