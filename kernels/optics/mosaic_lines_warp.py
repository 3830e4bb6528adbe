"""CUDA devices run the text of mosaic_lines.cl, as they do that of the transforms (common/fft_warp.py)."""

NATIVE = True  # see gpusim.backends.native
