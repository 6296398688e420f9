"""Methods side by side: the same drives, the same spells of weak GNSS.

    found = compare([load(path)], parse_methods("lc4,lc+rows"), parse_outages("60/180:2"), Config())
    write_page(found, Path("results/comparison"))

    methods        what is compared: GNSS alone, four satellites and more, DDIA-VE, rows …
    comparison     compare: every method over every variant of every drive
    runs           one run reduced to its figures, and all of them together
    intervals      how far these would differ with other spells
    others         results of other programs, judged likewise
    directories    result directories made elsewhere, merged into a comparison
    report         the page: its verdict, and what each step bought
    sections       its tables
    panels         its plots
    figures        the same for a paper
    exports        the same figures as CSV and LaTeX

The names below are imported when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .comparison import compare
    from .directories import merge
    from .methods import METHODS, Method, parse_methods
    from .report import write_page
    from .runs import Comparison, Run

__all__ = [
    "METHODS",
    "Comparison",
    "Method",
    "Run",
    "compare",
    "merge",
    "parse_methods",
    "write_page",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "comparison": ("compare",),
        "directories": ("merge",),
        "methods": ("METHODS", "Method", "parse_methods"),
        "report": ("write_page",),
        "runs": ("Comparison", "Run"),
    },
)
