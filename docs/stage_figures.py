"""Draws a figure for each stage: input and output of its float64 reference for a small picture.

Inputs come from the stage's `bench`; a photograph replaces random numbers if a port is a picture.
"""

import importlib
from pathlib import Path

import numpy as np
from skimage import data
from skimage.transform import resize

from gpusim.kernels.stage import stage_module

ROWS, COLS = 64, 96
WELL = 4e3  # [e-] of the brightest pixel
RAW = ("raw",)
ELECTRONS = ("mean", "expected", "rates", "mosaic", "pixels")
LIGHT = ("planes", "content", "camera", "rgb", "ambient", "flash", "lights", "onto")
SMOOTH = {  # smooth ports: transfer functions, fall-off, a disc in front, patches
    "tables": lambda value: np.broadcast_to(_centred(value, 3.0, corner=True), value.shape).astype(
        value.dtype
    ),
    "gains": lambda value: np.broadcast_to(_centred(value, 0.7), value.shape).astype(value.dtype),
    "alphas": lambda value: np.broadcast_to(_centred(value, 9.0) > 0.6, value.shape).astype(
        value.dtype
    ),
    "maps": lambda value: np.stack([_centred(value, 3.0), 1 - _centred(value, 3.0)]).astype(
        value.dtype
    ),
    "shading": lambda value: _centred(value, 1.5).astype(value.dtype),
    "ids": lambda value: (
        (np.indices(value.shape) // 16 * [[[6]], [[1]]]).sum(0).astype(value.dtype)
    ),
}
TABLES = ("airy", "near", "pupil")
MIXED = (
    "blur",
    "integrate",
)  # stages with random mixes of planes in `bench`: no colours


def draw(name, folder):
    """Draw a stage's figure into a folder unless it is up to date. Returns its path, or None."""
    module, leaf = stage_module(name), name.rpartition(".")[2]
    reference = importlib.import_module(f"{module.__name__}_ref")
    path = folder / f"{name.replace('.', '-')}.png"
    newest = max(
        Path(file).stat().st_mtime for file in (module.__file__, reference.__file__, __file__)
    )
    if path.is_file() and path.stat().st_mtime > newest:
        return path
    inputs = module.bench(ROWS, COLS)
    inputs |= {
        key: picture_for(key, value, inputs) for key, value in inputs.items() if is_picture(value)
    }
    if leaf == "shade":  # gains that correct a fall-off
        inputs["gains"] = 1 / SMOOTH["gains"](inputs["gains"])
    result = getattr(reference, leaf)(**inputs)
    result = result[0] if isinstance(result, tuple) else result
    shown = [(f"in: {key}", value) for key, value in inputs.items() if is_picture(value)][:2]
    shown.append(("out", np.asarray(result)))
    shown = [(text, image(value, leaf)) for text, value in shown if is_picture(value)]
    if not shown or shown[-1][0] != "out":
        return None
    save(path, shown)
    return path


def is_picture(value):
    """Return whether a value is an array that can be shown as a picture."""
    return (isinstance(value, np.ndarray) and value.ndim >= 2 and min(value.shape[-2:]) >= 24) or (
        isinstance(value, np.ndarray)
        and value.ndim == 3
        and value.shape[2] == 3
        and min(value.shape[:2]) >= 24
    )


def _centred(value, fall, corner=False):
    """Return a Gaussian over the last two axes, about the centre or the first corner."""
    y, x = (
        np.arange(n) / n if corner else (np.arange(n) + 0.5) / n - 0.5 for n in value.shape[-2:]
    )
    return np.exp(-fall * (y[:, None] ** 2 + x**2))


def photograph(rows, cols):
    """Return the linear light of a part of NASA's portrait of Eileen Collins, (3, rows, cols), 0 .. 1."""
    part = data.astronaut()[0:320, 40:520] / 255.0
    return np.moveaxis(resize(part, (rows, cols), anti_aliasing=True), -1, 0) ** 2.2


def picture_for(key, value, inputs):
    """Return a photograph with the shape and type of a stage's input; other inputs unchanged."""
    if key in SMOOTH:
        return SMOOTH[key](value)
    if key not in (*RAW, *ELECTRONS, *LIGHT, "codes"):
        return value
    if key == "codes":
        return (255 * np.moveaxis(photograph(*value.shape[:2]), 0, -1) ** (1 / 2.2)).astype(
            value.dtype
        )
    colors = photograph(*value.shape[-2:])
    count = int(np.prod(value.shape[:-2], dtype=int))
    if value.ndim == 2 or key in RAW:
        rows = inputs.get("cfa", ("RG", "GB"))  # letters, or indices of channels
        if isinstance(rows[0], str):
            rows = [["RGB".index(letter) for letter in row] for row in rows]
        period = np.asarray(rows) % 3
        y, x = np.indices(value.shape[-2:])
        one = np.take_along_axis(colors, period[y % len(period), x % len(period[0])][None], 0)[0]
        planes = np.broadcast_to(one, (count, *one.shape))
    else:
        planes = np.stack([colors[min(3 * number // count, 2)] for number in range(count)])
    if key in RAW:
        scale = inputs.get("scale", 1 / 959)
        random = np.random.default_rng(1)  # shot noise
        planes = random.poisson(planes * 300) / 300 / scale + float(
            np.max(inputs.get("black_level", 64))
        )
        return planes.reshape(value.shape).clip(0, 1 / scale + 64).astype(value.dtype)
    return (planes.reshape(value.shape) * (WELL if key in ELECTRONS else 1)).astype(value.dtype)


def image(value, leaf):
    """Return an array as a picture: three planes as colours, else one plane; tables as contrast."""
    value = np.asarray(value, np.float64)
    if value.dtype == np.float64 and value.ndim == 3 and value.shape[-1] == 3:
        return value / max(value.max(), 1e-30)
    while value.ndim > 3:
        value = value[0]
    if value.ndim == 3 and len(value) == 3 and leaf not in TABLES + MIXED:
        value = np.moveaxis(value, 0, -1)
    elif value.ndim == 3:
        value = value[len(value) // 2]
    if leaf in TABLES:
        return value
    low, high = np.nanquantile(value, (0.002, 0.998))
    return ((value - low) / max(high - low, 1e-30)).clip(0, 1) ** (1 / 2.2)


def save(path, shown):
    """Save pictures side by side."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, len(shown), figsize=(3.2 * len(shown), 2.5), squeeze=False)
    for axis, (text, picture) in zip(axes[0], shown, strict=True):
        axis.imshow(picture, cmap="gray", interpolation="nearest")
        axis.set_title(f"{text}, {picture.shape[0]} x {picture.shape[1]}", fontsize=8)
        axis.set_axis_off()
    figure.tight_layout(pad=0.3)
    figure.savefig(path, dpi=90)
    plt.close(figure)
