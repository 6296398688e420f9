"""The result directory of a run, written in one move and read back whole."""
