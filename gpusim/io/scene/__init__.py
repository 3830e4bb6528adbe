"""Readers and writers of scenes."""
