"""Alignment of the local (IMU, odometer) frame with the Earth."""
