"""Data sets for machine learning: noisy and clean frames of photographs; `gpusim pairs`."""
