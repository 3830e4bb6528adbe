"""Cameras by name, composed of what the installed data bases have on body, lens and colour."""
