"""CUDA devices run the text of fft.cl: transforms of Warp's tiles refuse lengths like 1200."""

NATIVE = True  # see gpusim.backends.native
