"""Screening thresholds for Doppler from data, cross-validated."""
