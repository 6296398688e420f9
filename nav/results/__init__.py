"""The result directory of a run: written in one move, read back whole.

    write_result(out, solution, evaluation, sequence, to_toml(config), formats=("pos",))
    read_result(out).evaluation.metrics["horizontal_rms_m"]

    directory    what is in it; write_result, read_result
    tables       its CSV tables, written and read
    text         numbers as text, compiled
    summary      summary.json
    formats      solutions for other programs: RTKLIB .pos, KML, TUM, KF-GINS .nav

The names below are imported when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .directory import Result, is_result, read_result, write_result
    from .formats import FORMATS, write_formats

__all__ = [
    "FORMATS",
    "Result",
    "is_result",
    "read_result",
    "write_formats",
    "write_result",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "directory": ("Result", "is_result", "read_result", "write_result"),
        "formats": ("FORMATS", "write_formats"),
    },
)
