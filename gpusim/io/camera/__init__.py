"""Readers of cameras: camera files, calibrations, profiles, point spreads."""
