"""Cameras by name, composed from the installed data bases: body, lens and colour."""
