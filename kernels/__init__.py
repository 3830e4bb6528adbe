"""The stages of the simulation, in the order the light goes; each is written three times (see `kernels.stage`)."""

if __name__ != "gpusim.kernels":
    raise ImportError("import this package as gpusim.kernels, not as kernels")
