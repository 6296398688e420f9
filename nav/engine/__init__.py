"""From GNSS to the filter: events, the start, the loop, and what it thinks of measurements."""
