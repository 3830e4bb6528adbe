"""CUDA devices run the text of far_groups.cl."""

NATIVE = True  # see gpusim.backends.native
