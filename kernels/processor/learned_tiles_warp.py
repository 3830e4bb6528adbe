"""CUDA devices run the text of learned_tiles.cl: Warp has local memory only in tiles."""

NATIVE = True  # see gpusim.backends.native
