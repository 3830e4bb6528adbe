"""Cameras from their own raw files. `gpusim.fit` is the function of `gpusim.fit.fitting`."""
