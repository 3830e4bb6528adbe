"""CUDA devices run the text of fft.cl: Warp has local memory in tiles alone, whose transform refuses 1200, say."""

NATIVE = True  # see gpusim.backends.native
