"""The stages of the simulation, in the order of the light, in three versions: see KERNELS.md."""

if __name__ != "gpusim.kernels":
    raise ImportError("import this package as gpusim.kernels, not as kernels")
