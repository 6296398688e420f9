"""Readers that turn files into one `Sequence`, the types themselves, and the simulator."""
