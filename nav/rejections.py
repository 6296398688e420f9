"""Fixes that are not used, in sentences: how many, why, and from when to when."""

from __future__ import annotations

from ..datasets.fix_faults import COPIED, stretches
from ..datasets.observations import GnssFixes
from .notes import clock

#: Stretches that are told one by one.
_TOLD = 5


def rejections(fixes: GnssFixes) -> list[str]:
    """Return a sentence for each stretch of rejected rows; from the sixth on, one for all."""
    found = stretches(fixes)
    out = []
    for reason, rows, first, last in found[:_TOLD]:
        if reason == COPIED:
            out.append(f"{rows} of {len(fixes)} rows: {reason}; the first of each is used")
            continue
        out.append(
            f"{rows} rows from {clock(first)} to {clock(last)} ({last - first:.1f} s): {reason}; "
            "not used"
        )
    if len(found) > _TOLD:
        rest = found[_TOLD:]
        rows = sum(count for _, count, _, _ in rest)
        out.append(f"{rows} more rows in {len(rest)} stretches: no fixes, or repeated; not used")
    return out
