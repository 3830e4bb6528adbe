"""Data sets for machine learning: noisy frames of photographs with the light that they are of; `gpusim pairs`."""
