"""What is proved of a rotation: certificates in floating point, proofs in exact numbers."""
