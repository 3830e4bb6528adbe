"""Readers of scenes and cameras; writers of pictures and raw data."""
