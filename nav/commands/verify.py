"""`certnav verify`: check alignment proofs in exact arithmetic, without the solver."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "check the proofs of certnav align --proof in exact arithmetic"
DESCRIPTION = (
    "Check alignment proofs in integers and fractions, without the solver: for "
    "the cost matrix in the file, no rotation costs less than the bound."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav verify`` to its parser."""
    parser.add_argument("path", type=Path, metavar="FILE")


def run(arguments: argparse.Namespace) -> int:
    """Check every proof of a file; status 1 if one of them does not hold."""
    from ...alignment.proofs.proof import check, read

    refused = 0
    proofs = read(arguments.path)
    for proof in proofs:
        checked = check(proof)
        refused += not checked.proved
        print(f"{proof.label}: {'proved' if checked.proved else 'REFUSED'}: {checked.reason}")
    print(
        f"{len(proofs) - refused} of {len(proofs)} proofs hold, in exact arithmetic; they are "
        "about the matrices in the file, not about the signals these were made from"
    )
    return 1 if refused else 0
