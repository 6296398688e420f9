"""A seeded car in a seeded city under a seeded sky, with the truth known exactly."""
