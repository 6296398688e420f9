"""The page of a run, made from its result directory alone.

    write_report(Path("results/suburb"))       # or write_result(…, draw=write_report)
    write_figures(read_result("results/suburb"), Path("figures"), "pdf")

    run        the page from top to bottom
    verdict    the run in plain sentences
    map        the track, coloured by what the reader chooses
    timeline   everything over time
    bounds     protection levels; how far earlier and later data part
    sky        satellites: where, how strong, used or why not, residuals, geometry
    span       figures of the span that the reader selects
    calibration  how IMU and antenna sit in the vehicle
    coverage   what GNSS could do along the run
    paper      the figures for papers:
    track      the track
    figures    everything over time
    panels     what figures over time have in common

The names below are imported when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .paper import write_figures
    from .run import build_report, write_report

__all__ = [
    "build_report",
    "write_figures",
    "write_report",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "paper": ("write_figures",),
        "run": ("build_report", "write_report"),
    },
)
