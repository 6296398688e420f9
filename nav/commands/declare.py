"""`certnav declare`: the draft of a declaration for files of your own."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "draft sequence.toml for your own files"
DESCRIPTION = (
    "Look at the columns of your files and draft the declaration they need; what "
    'only you can know is left as "?" with a comment.'
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav declare`` to its parser."""
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="write it there, not to the screen"
    )


def run(arguments: argparse.Namespace) -> None:
    """Draft a declaration for the user's own files."""
    from ...datasets.own.declare import draft_declaration
    from ...datasets.placing import write_file
    from ...filters.errors import DataError

    draft = draft_declaration(arguments.files)
    if arguments.out is None:
        print(draft)
        return
    if arguments.out.exists():
        raise DataError("exists already", file=arguments.out, remedy="name another file")
    write_file(arguments.out, draft.encode())
    blanks = draft.count('= "?"')
    print(f"{arguments.out}: {blanks} blanks left for you, then")
    print(f"  certnav check {arguments.out.parent}")
