"""Attitude from IMU and Doppler alone, while moving: rows, unknowns, one window, the wait."""
