"""What is proved of a rotation, and of the choice of rows.

    certificate       what multipliers prove of a rotation, in floating point
    exact, proof      the same in rational numbers, written to a file and checked without the solver
    consensus_proof   that no other rotation has as many rows on its side

All of it is about matrices and rows as they are, none of it about the signals they came from.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .certificate import Certificate, certify
    from .consensus_proof import ConsensusProof, prove_consensus
    from .exact import exact_proof
    from .proof import Checked, Proof, check, read, write

#: Public names by the module that each is imported from when it is first asked for.
_PUBLIC = {
    "certificate": ("Certificate", "certify"),
    "consensus_proof": ("ConsensusProof", "prove_consensus"),
    "exact": ("exact_proof",),
    "proof": ("Checked", "Proof", "check", "read", "write"),
}
_HOME = {name: module for module, names in _PUBLIC.items() for name in names}

__all__ = [
    "Certificate",
    "Checked",
    "ConsensusProof",
    "Proof",
    "certify",
    "check",
    "exact_proof",
    "prove_consensus",
    "read",
    "write",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
