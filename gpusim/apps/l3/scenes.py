"""Training scenes of filters: measured reflectances in shapes of every size, light and shade."""

from dataclasses import replace

import numpy as np

from gpusim.data.charts import WAVELENGTHS, chart, half_plane_coverage
from gpusim.data.reflectances import reflectances
from gpusim.domain.content import Materials
from gpusim.domain.errors import OutOfRange
from gpusim.domain.scene import Scene

SURFACES = ("objects", "nature", "munsell", "skin", "dupont")  # of the scenes in turn
SMALLEST = (1.0, 2.0, 4.0)  # radii of the smallest leaves [pixel]
FINENESS = 2.0  # samples along a pixel: edges lie anywhere in it
SIZE = 96  # [pixel]


def training_scenes(count: int, *, light="D65", seed: int = 0, size: int = SIZE) -> list[Scene]:
    """Return `count` scenes of size x size pixels, white at 100 cd m-2 in `light`.

    They depend only on `seed`. Each has three layers. Leaves: overlapping discs of the measured reflectances
    (dead leaves, the statistics of natural scenes at every scale). Strokes: thin straight lines of
    other surfaces, a third of the scene having dark ones on grey, as print has. Patches: grey and
    coloured ramps, and gratings up to the finest that the pixels resolve. Over all of it lie shade,
    smooth over a factor of 8, and texture at the scale of pixels.
    Raises OutOfRange.
    """
    if count < 1 or size < 32:
        raise OutOfRange("training scenes", f"{count} of {size} pixels", "at least 1 of 32 pixels")
    return [
        _scene(number, light, np.random.default_rng((seed, number)), size)
        for number in range(count)
    ]


def _scene(number, light, random, size):
    surfaces = SURFACES[number % len(SURFACES)]
    base = chart(
        "deadleaves",
        size=(size, size),
        light=light,
        samples_per_pixel=FINENESS,
        surfaces=surfaces,
        smallest=SMALLEST[number % len(SMALLEST)],
        seed=int(random.integers(2**31)),
    )
    white = np.ones((1, len(WAVELENGTHS)))
    spectra = np.vstack([reflectances(surfaces).at(WAVELENGTHS, outside=None), white])
    ids, shading = base.content.ids.astype(np.uint16), base.content.shading.astype(np.float64)
    grey = len(spectra) - 1
    _strokes(ids, shading, random, grey)
    _patches(ids, shading, random, grey)
    shading *= _shade(shading.shape, random)
    content = Materials(WAVELENGTHS, ids, np.minimum(shading, 1).astype(np.float32), spectra)
    return replace(base, content=content, border="reflect", name=f"training scene {number}")


def _strokes(ids, shading, random, grey):
    """Lines of 0.5 to 3 pixels' width anywhere; in one quadrant dark ones on light grey."""
    n = len(ids)
    y, x = np.mgrid[:n, :n]
    page = np.s_[
        (half := n // 2 * random.integers(2)) : half + n // 2,
        (side := n // 2 * random.integers(2)) : side + n // 2,
    ]
    ids[page], shading[page] = grey, random.uniform(0.5, 0.95)
    on_page = np.zeros(ids.shape, bool)
    on_page[page] = True
    for _ in range(n // 3):
        # half of them upright or level, as most strokes of print are
        is_level = random.random() < 0.5
        angle = random.integers(4) * np.pi / 2 if is_level else random.uniform(0, np.pi)
        cy, cx = random.uniform(0, n, 2)
        along = (x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)
        across = (y - cy) * np.cos(angle) - (x - cx) * np.sin(angle)
        line = abs(along) < random.uniform(2, 15) * FINENESS
        line &= abs(across) < random.uniform(0.25, 1.5) * FINENESS
        if on_page[int(cy), int(cx)]:
            line &= on_page
            shading[line] = random.uniform(0.02, 0.15)
        else:
            ids[line], shading[line] = random.integers(grey + 1), random.uniform(0.2, 1)


def _patches(ids, shading, random, grey):
    """Return squares of a sixth of the scene: ramps, flat fields, gratings, edges; half of them grey."""
    n = len(ids)
    side = n // 6
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    for kind in range(6):
        top, left = random.integers(n - side, size=2)
        patch = np.s_[top : top + side, left : left + side]
        angle = random.uniform(0, 2 * np.pi)
        across = x * np.cos(angle) + y * np.sin(angle)
        high, low = random.uniform(0.3, 1), random.uniform(0.01, 0.3)
        if kind < 2:
            part = across / np.ptp(across) + 0.5
        elif kind == 2:
            part = np.ones((side, side))
        elif kind == 3:
            part = half_plane_coverage(across, np.cos(angle), np.sin(angle))
        else:
            part = 0.5 + 0.5 * np.cos(2 * np.pi * random.uniform(0.05, 0.5) / FINENESS * across)
        ids[patch] = grey if kind % 2 else random.integers(grey)
        shading[patch] = low + (high - low) * part


def _shade(shape, random):
    """Return uneven light times a texture; both depend only on the place."""
    from scipy.ndimage import gaussian_filter

    def field(sigma):
        values = gaussian_filter(random.standard_normal(shape), sigma, mode="wrap")
        return values / values.std()

    # in patches, most of it faint: filters treat a feature of all scenes as detail, and would keep
    # such noise
    strength = 0.15 * random.random() ** 3
    fine = field(0.6 * FINENESS) + field(2 * FINENESS)
    texture = strength * fine * (field(shape[0] / 16) > 0.5)
    return np.exp2(np.clip(field(shape[0] / 5) - 0.7, -2, 1)) * np.exp(texture)
