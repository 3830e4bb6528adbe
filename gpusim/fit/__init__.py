"""Cameras from their own raw files."""
