"""CUDA devices run the text of multiscale_groups.cl: Warp has local memory only in tiles."""

NATIVE = True  # see gpusim.backends.native
