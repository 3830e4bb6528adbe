"""CUDA devices run the text of local.cl; the CPU has no local memory."""

NATIVE = True  # see gpusim.backends.native
