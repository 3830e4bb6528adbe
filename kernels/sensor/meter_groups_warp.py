"""CUDA devices run the text of meter_groups.cl: Warp has local memory in tiles alone."""

NATIVE = True  # see gpusim.backends.native
