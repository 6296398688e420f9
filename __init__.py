"""Loosely coupled GNSS/INS navigation of road vehicles, started in motion with a certificate."""
