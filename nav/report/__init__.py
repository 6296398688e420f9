"""Pages for people, built from result directories alone."""
