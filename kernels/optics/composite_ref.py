"""out = sum_k B_k prod_{j < k} (1 - A_j), the last B_k over its A_k; float64."""

import numpy as np


def composite(lights, alphas, layers):
    """Return the stage's result, see `composite.py`."""
    lights = np.asarray(lights, np.float64)
    alphas = np.asarray(alphas, np.float64)
    layers = np.asarray(layers)
    out, through = 0.0, 1.0
    for k in np.unique(layers):
        light, coverage = lights[layers == k].sum(axis=0), alphas[layers == k].sum(axis=0)
        if k == layers[-1]:
            some = coverage > 0
            return out + through * np.where(some, light / np.where(some, coverage, 1), 0)
        out = out + through * light
        through = through * (1 - np.clip(coverage, 0, 1))
