"""`certnav verify`: check alignment proofs in exact arithmetic, without the solver."""

from __future__ import annotations

import argparse

from ...alignment.proofs.proof import check, read


def verify(arguments: argparse.Namespace) -> int:
    """Check every proof of a file; status 1 if one of them does not hold."""
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
