"""CUDA devices run the text of tiles_groups.cl."""

NATIVE = True  # see gpusim.backends.native
