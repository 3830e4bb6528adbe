"""Built-in scenes: test charts with known reflectance in a chosen light."""

import inspect
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gpusim.data.lights import light_of, white_radiance
from gpusim.data.reflectances import reflectances
from gpusim.domain.content import Materials
from gpusim.domain.errors import OutOfRange, UnknownName, is_known
from gpusim.domain.memory import require_memory
from gpusim.domain.scene import Scene
from gpusim.domain.spectrum import Spectrum

WAVELENGTHS = np.arange(400.0, 701.0, 10.0)
FINEST = 1e6  # largest number of samples along a pixel
BYTES_PER_PIXEL = 48  # ids, shading and the float64 intermediates of the costliest chart


def chart(
    name: str,
    *,
    size: tuple[int, int] = (768, 512),
    light: str | Spectrum = "D65",
    luminance: float = 100.0,
    wavelengths: ArrayLike | None = None,
    samples_per_pixel: float = 1.0,
    **options: Any,
) -> Scene:
    """Return a built-in scene.

    Args:
        name: Name of the chart, one of CHARTS.
        size: Columns and rows of the frame [pixel].
        light: A name for `illuminant`, or its relative power in energy units.
        luminance: Luminance of a perfect white diffuser in this light [cd m-2].
        wavelengths: Wavelengths of the reflectances [nm]; None: 400, 410 .. 700. Beyond its own
            table a reflectance keeps its end value.
        samples_per_pixel: Scene samples along a pixel, see `Scene`.
        options: Options of the chart, see its function.

    Returns:
        The scene.

    Raises:
        DoesNotFit: The chart needs more memory than there is; raised before any allocation.
        OutOfRange: A number is outside its range.
        UnknownName: Chart, light or option is not known.
    """
    if not is_known(name, CHARTS):
        raise UnknownName("chart", name, CHARTS)
    draw = CHARTS[name]
    parameters = inspect.signature(draw).parameters
    known = [option for option in parameters if option not in ("cols", "rows", "fine")]
    for option in options:
        if option not in known:
            raise UnknownName(f"option of chart {name!r}", option, known)
    checked_size(size)
    _require(
        "samples_per_pixel", samples_per_pixel, 1 <= samples_per_pixel <= FINEST, f"1 .. {FINEST:g}"
    )
    cols, rows = checked_size([math.ceil(n * samples_per_pixel) for n in size])
    fine = {"fine": samples_per_pixel} if "fine" in parameters else {}
    ids, shading, materials, border = draw(cols, rows, **fine, **options)
    wavelengths = WAVELENGTHS if wavelengths is None else np.asarray(wavelengths, np.float64)
    content = Materials(wavelengths, ids, shading, materials.at(wavelengths, outside=None))
    white = white_radiance(light_of(light), luminance)
    return Scene(content, white, border, name=name, samples_per_pixel=samples_per_pixel)


def colorchecker_patches(size) -> list[tuple[slice, slice]]:
    """Return rows and columns of the 24 patches of "colorchecker", from dark skin to black.

    Args:
        size: Columns and rows of the chart [pixel].

    Returns:
        Slices of rows and columns of each patch, row by row.

    Raises:
        OutOfRange: The chart is smaller than 24 x 16 pixels.
    """
    cols, rows = checked_size(size)
    if cols < 24 or rows < 16:
        raise OutOfRange(
            "size of chart 'colorchecker'", f"{cols} x {rows}", "at least 24 x 16 pixels"
        )
    patch, gap, _ = _colorchecker_measures(cols, rows)
    left = (cols - 6 * patch - 5 * gap) // 2
    top = (rows - 4 * patch - 3 * gap) // 2
    starts = [
        (top + row * (patch + gap), left + col * (patch + gap))
        for row in range(4)
        for col in range(6)
    ]
    return [(slice(y, y + patch), slice(x, x + patch)) for y, x in starts]


def _colorchecker(cols, rows):
    """Draw the 24 patches of ISO 17321-1 in a black frame on middle grey.

    The frame has half the reflectance of the black patch, which keeps the two distinct. The
    surroundings are the patch neutral 5. Patch edges lie on pixel edges.
    """
    patches = colorchecker_patches((cols, rows))
    _, _, frame = _colorchecker_measures(cols, rows)
    ids = np.full((rows, cols), 21, np.uint8)
    shading = np.ones((rows, cols), np.float32)
    first, last = patches[0], patches[-1]
    inside = (
        slice(first[0].start - frame, last[0].stop + frame),
        slice(first[1].start - frame, last[1].stop + frame),
    )
    ids[inside], shading[inside] = 23, 0.5
    for number, patch in enumerate(patches):
        ids[patch], shading[patch] = number, 1
    return ids, shading, reflectances("colorchecker"), "edge"


def _colorchecker_measures(cols, rows):
    """Return side of a patch, gap and frame width [pixel] as on the printed chart."""
    unit = min(cols / 8.15, rows / 5.85)
    return int(unit), max(1, round(0.15 * unit)), max(1, round(0.3 * unit))


def _slanted_edge(cols, rows, angle_deg=5.0, contrast=4.0, bright=0.8):
    """Draw an edge through the centre at `angle_deg` from the vertical, dark left, bright right.

    bright: reflectance of the bright side. The dark side has bright / contrast (ISO 12233 demands
    4:1). A pixel on the edge has the exact average over its area.
    """
    _require("slanted-edge: angle_deg", angle_deg, -90 <= angle_deg <= 90, "-90 .. 90")
    _require("slanted-edge: contrast", contrast, 1 <= contrast <= 1e9, "1 .. 1e9")
    _require("slanted-edge: bright", bright, 0 < bright <= 1, "0 < bright <= 1")
    angle = np.deg2rad(angle_deg)
    across, along = np.cos(angle), np.sin(angle)
    x = np.arange(cols) - (cols - 1) / 2
    y = np.arange(rows) - (rows - 1) / 2
    coverage = half_plane_coverage(x[None, :] * across + y[:, None] * along, across, along)
    dark = bright / contrast
    return _gray(cols, rows, dark + (bright - dark) * coverage)


def half_plane_coverage(distance, across, along):
    """Return the fraction of a unit pixel on the positive side of a line.

    The distance over a pixel is the sum of two uniform variables of widths |across| and |along|.
    Its distribution function is the second integral of the four corners' ramps.

    Args:
        distance: Signed distance of the pixel's centre from the line [pixel], any shape.
        across: First component of the line's unit normal.
        along: Second component.

    Returns:
        Fraction [1], shape of `distance`.
    """
    wide, narrow = sorted((abs(across) / 2, abs(along) / 2), reverse=True)
    distance = np.clip(distance, -(wide + narrow), wide + narrow)
    if narrow < 1e-9:  # the limit: one uniform variable
        return np.clip(0.5 + distance / (2 * wide), 0, 1)
    corners = [(1, wide + narrow), (-1, wide - narrow), (-1, narrow - wide), (1, -wide - narrow)]
    area = sum(sign * np.maximum(distance + corner, 0) ** 2 for sign, corner in corners) / (
        8 * wide * narrow
    )
    return np.clip(area, 0, 1)


def _ramp(cols, rows, low=0.0, high=1.0, decades=0.0):
    """Draw a linear ramp from `low` at the left to `high` at the right, in units of white.

    high > 1 is a light source. decades: if positive, the ramp is logarithmic and ends that many
    decades below `high`.
    """
    _require("ramp: low", low, 0 <= low < np.inf, "0 <= low")
    _require("ramp: high", high, 0 < high < np.inf, "0 < high")
    _require("ramp: decades", decades, 0 <= decades <= 12, "0 .. 12")
    position = (np.arange(cols) + 0.5) / cols
    levels = high * 10 ** (decades * (position - 1)) if decades else low + (high - low) * position
    return _gray(cols, rows, levels)


def _flat(cols, rows, reflectance=0.18):
    """Draw one uniform grey; the default is the photographer's grey card."""
    _require("flat: reflectance", reflectance, 0 <= reflectance < np.inf, "0 <= reflectance")
    return _gray(cols, rows, reflectance)


def _points(cols, rows, fine, count=24, background=1e-3, lowest=1e2, highest=1e6, seed=0):
    """Draw point lights of one sample on a dim grey background, with darkness around the frame.

    background: in units of white. The points have `lowest` to `highest` times the light of a
    background pixel, evenly spaced in the logarithm, in white and six colours in turn, at the
    centres of pixels that `seed` selects.
    """
    width, height = int(cols / fine), int(rows / fine)
    most = min(width * height, 100_000)
    _require(
        "points: count",
        count,
        isinstance(count, int | np.integer) and 1 <= count <= most,
        f"1 .. {most} (and at most the pixels)",
    )
    _require("points: background", background, 0 < background < np.inf, "0 < background")
    _require("points: lowest", lowest, 0 < lowest < np.inf, "0 < lowest")
    _require("points: highest", highest, lowest <= highest < np.inf, "lowest <= highest")
    colours = reflectances("colorchecker")
    chosen = colours.values[12:18]  # blue, green, red, yellow, magenta, cyan
    spectra = np.vstack([np.ones(chosen.shape[1]), chosen / chosen.max(1, keepdims=True)])
    pixels = np.divmod(
        np.random.default_rng(seed).choice(width * height, count, replace=False), width
    )
    where = tuple(((place + 0.5) * fine).astype(int) for place in pixels)
    ids = np.zeros((rows, cols), np.uint8)
    shading = np.full((rows, cols), background, np.float32)
    ids[where] = np.arange(count) % len(spectra)
    shading[where] = background * np.geomspace(lowest, highest, count) * fine**2
    return ids, shading, Spectrum(colours.wavelengths, spectra), "zero"


def _deadleaves(cols, rows, fine, surfaces="nature", smallest=4.0, seed=0):
    """Draw overlapping discs with radii from the power law r^-3, each of a measured reflectance.

    This law makes a picture that looks the same at every scale, as natural scenes do (Lee, Mumford
    & Huang, "Occlusion models for natural images", IJCV 41, 2001). Radii go from `smallest` [pixel]
    to a third of the picture. surfaces: a set of `reflectances`. A sample belongs to the disc at
    its centre.
    """
    _require("deadleaves: smallest", smallest, 1 <= smallest < np.inf, "at least 1 pixel")
    samples = reflectances(surfaces)
    width, height = cols / fine, rows / fine
    largest = max(2 * smallest, min(width, height) / 3)
    random = np.random.default_rng(seed)
    mean_area = 2 * np.pi * np.log(largest / smallest) / (smallest**-2 - largest**-2)
    # Eight layers on average leave e^-8 of the picture to the bottom leaf. Centres may lie outside.
    layers = 8 * (width + 2 * largest) * (height + 2 * largest) / mean_area
    ids = np.full((rows, cols), random.integers(len(samples.values)), np.uint8)
    for _ in range(int(layers)):
        x, y, quantile = random.random(3)
        x, y = x * (width + 2 * largest) - largest, y * (height + 2 * largest) - largest
        # shift the origin from the centre of pixel 0 to the centre of sample 0
        x, y = (place * fine + (fine - 1) / 2 for place in (x, y))
        radius = fine * (smallest**-2 + quantile * (largest**-2 - smallest**-2)) ** -0.5
        left, right = max(0, int(np.ceil(x - radius))), min(cols, int(x + radius) + 1)
        top, bottom = max(0, int(np.ceil(y - radius))), min(rows, int(y + radius) + 1)
        surface = random.integers(len(samples.values))
        if left < right and top < bottom:
            disc = (np.arange(left, right) - x) ** 2 + ((np.arange(top, bottom) - y) ** 2)[
                :, None
            ] <= radius**2
            ids[top:bottom, left:right][disc] = surface
    return ids, np.ones((rows, cols), np.float32), samples, "edge"


def _sweep(cols, rows, fine, contrast=1.0):
    """Draw a cosine whose frequency grows linearly from 0 at the left to Nyquist (0.5 cycle/pixel).

    Reflectance 0.5 (1 + contrast cos(pi x^2 / (2 cols))), x and cols [pixel], averaged over each
    sample exactly with Fresnel's integral.
    """
    from scipy.special import fresnel

    _require("sweep: contrast", contrast, 0 <= contrast <= 1, "0 .. 1")
    scale = np.sqrt(cols * fine)
    averages = scale * np.diff(fresnel(np.arange(cols + 1) / scale)[1])
    return _gray(cols, rows, 0.5 * (1 + contrast * averages))


def _gray(cols, rows, levels):
    """Return one neutral material; levels: an array that broadcasts to (rows, cols)."""
    shading = np.empty((rows, cols), np.float32)
    shading[:] = levels
    return (
        np.zeros((rows, cols), np.uint8),
        shading,
        Spectrum(WAVELENGTHS[[0, -1]], np.ones((1, 2))),
        "edge",
    )


def _require(key, value, allowed, text):
    if not allowed:
        raise OutOfRange(key, value, text)


def checked_size(size) -> tuple[int, int]:
    """Return columns and rows as whole numbers.

    Raise OutOfRange below 1, and DoesNotFit if the memory is too small.
    """
    cols, rows = size
    if not all(isinstance(n, int | np.integer) and n >= 1 for n in (cols, rows)):
        raise OutOfRange(
            "size", f"{cols} x {rows}", "at least 1 x 1, whole pixels (columns x rows)"
        )
    require_memory(f"an image of {cols} x {rows} pixels", BYTES_PER_PIXEL * int(cols) * int(rows))
    return int(cols), int(rows)


CHARTS: dict[str, Callable] = {
    "colorchecker": _colorchecker,
    "slanted-edge": _slanted_edge,
    "ramp": _ramp,
    "flat": _flat,
    "points": _points,
    "deadleaves": _deadleaves,
    "sweep": _sweep,
}
