"""Mathematics of lenses in float64 on the host: transfer functions of pupils, point spreads and kernels of lenses."""
