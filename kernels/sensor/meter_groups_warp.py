"""CUDA devices run the text of meter_groups.cl: Warp has local memory only in tiles."""

NATIVE = True  # see gpusim.backends.native
