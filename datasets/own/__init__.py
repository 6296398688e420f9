"""A user's own files by declaration: ``sequence.toml``, its draft, its reader, its reference."""
