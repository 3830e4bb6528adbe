"""Readers of cameras: camera files, calibrations, noise profiles, point spread functions."""
