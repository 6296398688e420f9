"""`certnav report`: result directories made elsewhere, merged into one page of comparison."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "merge result directories into one page"
DESCRIPTION = "Merge result directories made elsewhere into one page of comparison."
EXAMPLE = "certnav report results/monday results/tuesday"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav report`` to its parser."""
    parser.add_argument(
        "directory", type=Path, nargs="+", help="result directories, or folders that hold some"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("results/report"), metavar="DIR",
        help="where the page goes [results/report]",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(arguments: argparse.Namespace) -> None:
    """Merge result directories into one page."""
    from ..compare.directories import merge
    from ..compare.report import check_replaceable, write_page
    from .compare import say

    out: Path = arguments.out.resolve()
    check_replaceable(out)
    comparison = merge(arguments.directory)
    write_page(comparison, out)
    say(comparison, out, arguments.json)
