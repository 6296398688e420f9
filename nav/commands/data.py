"""`certnav declare` and `certnav datasets`: getting data into shape."""

from __future__ import annotations

import argparse

from ...datasets.great.catalogue import catalogue_text
from ...datasets.great.importing import import_archives
from ...datasets.own.declare import draft_declaration
from ...filters.errors import DataError


def declare(arguments: argparse.Namespace) -> None:
    """Draft a declaration for the user's own files."""
    draft = draft_declaration(arguments.files)
    if arguments.out is None:
        print(draft)
        return
    if arguments.out.exists():
        raise DataError("exists already", file=arguments.out, remedy="name another file")
    arguments.out.write_text(draft, encoding="utf-8")
    blanks = draft.count('= "?"')
    print(f"{arguments.out}: {blanks} blanks left for you, then")
    print(f"  certnav check {arguments.out.parent}")


def catalogue(arguments: argparse.Namespace) -> None:
    """Print what is known of the GREAT sequences."""
    print(catalogue_text())


def arrange(arguments: argparse.Namespace) -> None:
    """Arrange downloaded archives and say what is missing."""
    print(import_archives(arguments.archives, arguments.to).text())
