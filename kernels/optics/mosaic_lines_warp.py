"""CUDA devices run the text of mosaic_lines.cl, see common/fft_warp.py."""

NATIVE = True  # see gpusim.backends.native
