"""Text as instruments and archives write it: numbers, tables, columns, IMU rows, RINEX, TOML."""
