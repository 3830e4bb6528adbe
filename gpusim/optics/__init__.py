"""Mathematics of lenses in float64 on the host: transfer functions of pupils, point spreads and kernels of lenses."""

from gpusim.domain.lazy import load_at_use

load_at_use("numpy.f2py")  # SciPy reads all attributes of NumPy: 80 ms for a compiler of Fortran
