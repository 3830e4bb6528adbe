"""CUDA devices run the text of network_tiles.cl: Warp has local memory only in tiles."""

NATIVE = True  # see gpusim.backends.native
