"""Cameras and scenes that several tests begin with."""

from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs

PHONE = gs.open_camera("phone")
FIRST = ("figure8", "machine-vision", "mono", "phone")  # for quick tests of every built-in camera
LIBRARY = [
    pytest.param(name, marks=() if name in FIRST else pytest.mark.slow)
    for name in gs.camera_names()
]


def camera_with(base=PHONE, **parts):
    """A camera whose parts have other settings, `noise` that of its sensor."""
    for part, settings in parts.items():
        if part == "noise":
            base = replace(
                base, sensor=replace(base.sensor, noise=replace(base.sensor.noise, **settings))
            )
        else:
            base = replace(base, **{part: replace(getattr(base, part), **settings)})
    return base


def cubes(count, size):
    """Dead leaves in all bands, each a tenth of the first brighter than the one before; size: columns and rows."""
    picture = gs.chart("deadleaves", size=size)
    bands = picture.content.bands_at(slice(None)).astype(np.float32)
    return [
        replace(
            picture,
            content=gs.Cube(picture.wavelengths, bands * np.float32(1 + 0.1 * k)),
            name=f"leaves {k}",
        )
        for k in range(count)
    ]


def again(scene, name):
    """Another scene of the same light: a copy of its content with the same arrays."""
    return replace(scene, name=name, content=replace(scene.content))
