"""Scenes from files, pictures and raw data into files."""
