"""The same drives, the same spells of weak GNSS, every method."""
