"""The DDIA-VE paper's tables and figures, of any recordings side by side.

    found = study(["GREAT/Dataset_campus-01", "comma2k19-example1"])
    write_study(found, "results/study")

    paper        what the paper says of its own three sets
    recording    study: every figure of every recording
    tables       Tables 2 to 5, the operating points, and the numbers behind the figures
    figures      Figs. 3 to 8 for a paper
    panels       the same for the page
    report       page, CSV, LaTeX and PDF in one directory

The names below are imported when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .recording import Studied, Study, StudyOptions, study
    from .report import write_study

__all__ = [
    "Studied",
    "Study",
    "StudyOptions",
    "study",
    "write_study",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "recording": ("Studied", "Study", "StudyOptions", "study"),
        "report": ("write_study",),
    },
)
