"""CUDA devices run the text of network_half.cl: Warp has no name for matrix units of single warps."""

NATIVE = True  # see gpusim.backends.native
