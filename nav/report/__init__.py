"""The page of a run, made from its result directory alone.

    write_report(Path("results/suburb"))       # or write_result(…, draw=write_report)

    run        the page from top to bottom
    verdict    the run in plain sentences
    track      the map
    figures    everything over time
    panels     what figures over time have in common

The names below are imported when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .run import build_report, write_report

__all__ = [
    "build_report",
    "write_report",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "run": ("build_report", "write_report"),
    },
)
