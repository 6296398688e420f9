"""Alignment over sliding windows of a recording, with the noise that it shows."""
