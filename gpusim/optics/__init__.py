"""Mathematics of lenses in float64 on the host: transfer functions of pupils, point spreads and kernels of lenses."""

from gpusim.domain.lazy import load_at_use

# SciPy reads all attributes of NumPy
load_at_use("numpy.f2py")  # a compiler of Fortran, 80 ms
load_at_use("numpy.testing")  # tools of tests, 20 ms
