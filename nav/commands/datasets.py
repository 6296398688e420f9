"""`certnav datasets`: what is known of the GREAT sequences, and their archives arranged."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "list the GREAT sequences, or arrange downloaded archives"
DESCRIPTION = (
    "Without arguments: what is known of the GREAT sequences, and where they are. "
    "import: put downloaded archives into the layout `certnav run` reads."
)
EXAMPLE = "certnav datasets import campus-01.zip --to great"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav datasets`` to its parser."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    arrange = actions.add_parser("import", help="arrange downloaded archives")
    arrange.add_argument("archives", type=Path, nargs="+", metavar="ZIP", help="or folders of them")
    arrange.add_argument("--to", type=Path, required=True, metavar="DIR")


def run(arguments: argparse.Namespace) -> None:
    """Print what is known of the GREAT sequences, or arrange archives and say what is missing."""
    from ...datasets.great.catalogue import catalogue_text
    from ...datasets.great.importing import import_archives

    if arguments.action == "import":
        print(import_archives(arguments.archives, arguments.to).text())
    else:
        print(catalogue_text())
