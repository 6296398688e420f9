"""What is proved of a rotation, and of the choice of rows.

    certificate       what multipliers prove of a rotation, in floating point
    exact, proof      the same in rational numbers, and checked without the solver
    proof_file        written to a file, and read from one that may have been written to do harm
    evidence          the rows behind a proof, and the cost that follows from them
    consensus_proof   that no other rotation has as many rows on its side
    stabbing          its innermost question, compiled

All of it is about matrices and rows as they are, none of it about the signals they came from.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .certificate import Certificate, certify
    from .consensus_proof import ConsensusProof, prove_consensus
    from .evidence import Evidence
    from .exact import evidence_of, exact_proof
    from .proof import Checked, Proof, check
    from .proof_file import read, write

__all__ = [
    "Certificate",
    "Checked",
    "ConsensusProof",
    "Evidence",
    "Proof",
    "certify",
    "check",
    "evidence_of",
    "exact_proof",
    "prove_consensus",
    "read",
    "write",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "certificate": ("Certificate", "certify"),
        "consensus_proof": ("ConsensusProof", "prove_consensus"),
        "evidence": ("Evidence",),
        "exact": ("evidence_of", "exact_proof"),
        "proof": ("Checked", "Proof", "check"),
        "proof_file": ("read", "write"),
    },
)
