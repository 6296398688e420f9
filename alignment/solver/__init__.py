"""The certified minimum over SO(3) in microseconds, and how far from it the data let one go."""
