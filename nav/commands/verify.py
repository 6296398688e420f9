"""`certnav verify`: check alignment proofs in exact arithmetic, without the solver."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ...alignment.proofs.proof import Proof

HELP = "check the proofs of certnav align --proof in exact arithmetic"
DESCRIPTION = (
    "Check alignment proofs in integers and fractions, without the solver: for "
    "the rows in the file, no rotation costs less than the bound."
)
EXAMPLE = "certnav align drive --proof proofs.json && certnav verify proofs.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav verify`` to its parser."""
    parser.add_argument("path", type=Path, metavar="FILE")
    parser.add_argument(
        "--rows", type=Path, metavar="PATH",
        help="take the rows from the recording of that folder, not from the file",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Check every proof of a file; status 1 if one of them does not hold."""
    from ...alignment.proofs.proof import check
    from ...alignment.proofs.proof_file import read_with_options

    proofs, options = read_with_options(arguments.path)
    if arguments.rows is not None:
        proofs = _with_rows_of(arguments.rows, proofs, options)
    refused = 0
    for proof in proofs:
        checked = check(proof)
        refused += not checked.proved
        print(f"{proof.label}: {'proved' if checked.proved else 'REFUSED'}: {checked.reason}")
    rows = "in the file" if arguments.rows is None else f"of {arguments.rows}"
    print(
        f"{len(proofs) - refused} of {len(proofs)} proofs hold, in exact arithmetic; they are "
        f"about the rows {rows}, not about the signals these were made from"
    )
    return 1 if refused else 0


def _with_rows_of(path: Path, proofs: list[Proof], options: dict[str, Any]) -> list[Proof]:
    """Return the proofs with the rows that the recording has in their windows."""
    from ...datasets.loading import load
    from ...filters.errors import ConfigError, DataError
    from ..windows.options import WindowOptions
    from ..windows.recording import align_recording
    from ..windows.report import evidence

    try:
        # Files that do not speak of the phase are older than the question.
        options = {"phase": "off", **options}
        how = WindowOptions(**{key: _decoded(value) for key, value in options.items()})
        if not (how.step >= 0.1 and how.window <= 3600.0):
            raise ValueError(f"{how.window:g} s every {how.step:g} s")
    except (TypeError, ValueError, OverflowError, ConfigError) as error:
        raise DataError(f"--rows: the file's options cut no windows: {error}") from error
    results, _ = align_recording(load(path), how)
    bound = []
    for proof in proofs:
        rows = evidence(results[proof.window]) if 0 <= proof.window < len(results) else None
        if rows is None:
            raise DataError(f"--rows: the recording has no rows for {proof.label}", file=path)
        bound.append(replace(proof, evidence=rows))
    return bound


def _decoded(value: Any) -> Any:
    """Return a float that was written as text, anything else as it is."""
    hexadecimal = isinstance(value, str) and value.lstrip("-").startswith("0x")
    return float.fromhex(value) if hexadecimal else value
