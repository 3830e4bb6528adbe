"""Public data bases of cameras and lenses that a user has installed, read in place."""
