"""Spells of weak GNSS: when they are, what they leave, and how far a solution drifts in them."""
