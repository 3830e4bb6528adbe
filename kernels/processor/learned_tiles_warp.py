"""CUDA devices run the text of learned_tiles.cl: Warp has local memory in tiles alone."""

NATIVE = True  # see gpusim.backends.native
