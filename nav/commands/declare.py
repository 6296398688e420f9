"""`certnav declare`: the draft of a declaration for files of your own."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ...datasets.own.draft import Draft

HELP = "draft sequence.toml for your own files"
DESCRIPTION = (
    "Look at the columns of your files, measure clocks, units, axes and mounting from the motion "
    "in them, and draft the declaration they need, every value with its evidence; what neither "
    'names nor motion tell is left as "?" with a comment.'
)
EXAMPLE = "certnav declare drive/imu.csv drive/gnss.csv --out drive/sequence.toml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav declare`` to its parser."""
    parser.add_argument(
        "files", type=Path, nargs="+", metavar="FILE",
        help="of IMU, GNSS (positions, RINEX or a receiver's log), odometer, reference; any order",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="write it there, not to the screen"
    )


def run(arguments: argparse.Namespace) -> None:
    """Draft a declaration for the user's own files."""
    from ...datasets.placing import write_file
    from ...filters.errors import DataError
    from ..drafting import measured_draft

    out = arguments.out
    if out is not None and out.is_dir():
        out = out / "sequence.toml"
    if out is not None and out.exists():  # before anything is measured
        raise DataError("exists already", file=out, remedy="name another file, or remove it")
    if out is not None and not out.parent.is_dir():
        raise DataError("no such folder", file=out.parent, remedy="make it, or name another")
    draft = measured_draft(arguments.files)
    if out is None:
        print(draft.text())
        return
    write_file(out, draft.text().encode())
    for line in summary(draft, out):
        print(line)


def summary(draft: Draft, out: Path) -> list[str]:
    """Return what was drafted, in lines: what was measured, what is asked, what to type next."""
    lines = []
    for name, content in draft.sections.items():
        for line in content:
            if line.key and "measured:" in line.comment and not line.blank:
                lines.append(f"  [{name}] {str(line).split('  #')[0].strip()}")
    lines = [f"{out}: {len(lines)} values measured", *lines]
    if draft.blanks:
        lines.append(f"{len(draft.blanks)} blanks left for you, each with what is known beside it:")
        for name, key in draft.blanks:
            value = draft.get(name, key)  # a list is blank in part
            known = f" = {json.dumps(value)}" if isinstance(value, list) else ""
            lines.append(f"  [{name}] {key}{known}")
    whole = out.name == "sequence.toml"
    where = out.parent if whole and str(out.parent) != "." else out
    return [*lines, f"{'then' if draft.blanks else 'next'}:  certnav check {where}"]
