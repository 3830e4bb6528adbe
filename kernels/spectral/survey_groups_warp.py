"""CUDA devices run the text of survey_groups.cl: Warp has local memory in tiles alone."""

NATIVE = True  # see gpusim.backends.native
