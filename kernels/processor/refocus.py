"""Views of a light field, displaced by their places in the pupil and averaged: a picture focused elsewhere.

Ports: views (views, planes, rows, cols) float32, places (views, 2) float32 [radius of the pupil], weights
(views,) float32, slopes (slopes,) float32 [pixel per radius] -> (slopes, moments planes, rows, cols) float32 in
the views' unit: the planes of the mean, then the planes of the variance, in its square.

A thing whose displacement in each view is its slope times the view's place (y, x) is in focus in

    out(p) = sum_v weight_v view_v(p + slope place_v) / sum_v weight_v.

Weights make the aperture: a disc of weights gives the picture of a lens with that aperture. The second
moment, if it is wanted, is the variance of view_v(p + slope place_v) over the views, with the same
weights: least if all views show the same. Views are interpolated by the cubic of Keys with a =
-1/2, 4 x 4 taps, and continue with their edge values. A wave of w rad per pixel keeps, in the mean
over fractions of a pixel, all but about w^4 / 82 of its amplitude along each axis: 0.5 % is lost at eight
pixels per period, 6 % at four. Linear interpolation would lose w^2 / 12, 5 % and 19 %.
"""

from math import prod

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.kernels.stage import Array, Case, exact_case, is_opencl_cpu, stage

LINES = 8  # rows of the result that a CPU's work-item does
GPU_LINES = 4


@stage
def refocus(
    device: Device,
    views: Array,
    places: Array,
    weights: Array,
    slopes: Array,
    *,
    has_variance: bool = False,
) -> Array:
    """Return the pictures of views refocused at slopes, and the variance over the views.

    Args:
        views: Pictures in any linear unit, shape (views, planes, rows, cols).
        places: Places (y, x) of the views in the pupil [radius], along the rows and columns of the
            picture, shape (views, 2).
        weights: Weight of each view, not all 0, shape (views,). Views of weight 0 are not read.
        slopes: Displacements of things in focus [pixel per radius], shape (slopes,).
        has_variance: Whether the variance over the views is wanted too.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Shape (slopes, planes, rows, cols), float32: the mean. With the variance (slopes, 2 planes,
        rows, cols): after the planes of the mean come the variance's.

    Raises:
        BadData: Shapes do not fit.

    Source:
        Ng et al. 2005, "Light field photography with a hand-held plenoptic camera", section 4;
        Vaish et al. 2006, "Reconstructing occluded surfaces using synthetic apertures", for the
        variance; Keys 1981, "Cubic convolution interpolation for digital image processing".
    """
    check_inputs(views, places, weights, slopes)
    count, planes, rows, cols = map(int, views.shape)
    pictures = int(slopes.shape[0])
    moments = 2 if has_variance else 1
    out = device.empty((pictures, moments * planes, rows, cols))
    arrays = [device.array(one) for one in (views, places, weights, slopes)]
    is_cpu = is_opencl_cpu(device)
    lines = LINES if is_cpu else GPU_LINES if device.kind == "opencl" else 1
    device.launch(
        "processor.refocus",
        "refocus",
        (pictures * planes, -(-rows // lines), 1 if is_cpu else cols),
        *(*arrays, out),
        *(pictures, moments, count, planes, rows, cols),
        defines={
            "CPU": int(is_cpu),
            "WIDTH": 8 if is_cpu else 1,
            "LINES": lines,
            "MOMENTS": moments,
        },
        group=(1, 1, 1) if is_cpu else None,
    )
    return out


def check_inputs(views, places, weights, slopes):
    """Raise BadData as `refocus` does."""
    shape = tuple(views.shape)
    if len(shape) != 4 or 0 in shape:
        raise BadData(f"views: shape {shape}, wanted (views, planes, rows, cols)")
    if tuple(places.shape) != (shape[0], 2) or tuple(weights.shape) != shape[:1]:
        raise BadData(
            f"places {tuple(places.shape)} and weights {tuple(weights.shape)}, wanted ({shape[0]}, 2) and "
            f"({shape[0]},) for {shape[0]} views"
        )
    if len(slopes.shape) != 1 or not slopes.shape[0]:
        raise BadData(f"slopes: shape {tuple(slopes.shape)}, wanted (slopes,)")


def cases():
    """Yield cases: whole and broken displacements, beyond the edges, one pixel, weights of 0, odd sizes."""
    random = np.random.default_rng(41)
    why = (
        "in 2^-24: a view is a sum of 4 x 4 taps whose absolute weights add up to 1.27 along an axis, 2 x 9 roundings "
        "times 1.6; its place errs by 2 roundings of 12 pixels along two axes, and a picture between -1 and 1 changes "
        "by up to 2 x 1.6 a pixel: 154; the sum over n views has n / 2 + 2 roundings in the mean: 200 + n / 2 < 2e-5"
    )
    for count, planes, rows, cols, slopes in (
        (9, 3, 33, 45, (0.0, 1.7)),
        (4, 1, 8, 16, (-3.0, 2.0, 11.5)),
        (25, 2, 17, 23, (0.4,)),
        (2, 1, 1, 1, (1.0,)),
        (5, 1, 3, 70, (-0.5,)),
    ):
        places = random.uniform(-1, 1, (count, 2))
        places[0] = 0
        weights = random.uniform(0.1, 1, count)
        weights[-1] = 0
        inputs = {
            "views": random.uniform(-1, 1, (count, planes, rows, cols)).astype(np.float32),
            "places": places.astype(np.float32),
            "weights": weights.astype(np.float32),
            "slopes": np.array(slopes, np.float32),
        }
        name = f"{count} views {rows}x{cols}, {planes} planes, {len(slopes)} slopes"
        yield Case(name, inputs, 2e-5, why)
        spread = "; the variance: a difference of up to 2.6 errs by twice that, and its square by 5.2 times"
        wide = inputs | {"has_variance": True}
        yield Case(f"{name}, variance", wide, 2e-4, why + spread)
    whole = np.array([[-1, 0], [0, 1], [2, -1]], np.float32)
    yield exact_case(
        "whole displacements",
        "sums of whole numbers below 2^24 and their half",
        views=random.integers(0, 4096, (3, 2, 9, 19)).astype(np.float32),
        places=whole,
        weights=np.array([1, 2, 1], np.float32),
        slopes=np.array([0, 1, 3, -2], np.float32),
    )
    flat = np.full((4, 1, 9, 9), 1000.0, np.float32)
    yield Case(
        "light of one brightness",
        {
            "views": flat * (1 + np.arange(4, dtype=np.float32)[:, None, None, None] * 2.0**-10),
            "places": random.uniform(-1, 1, (4, 2)).astype(np.float32),
            "weights": np.ones(4, np.float32),
            "slopes": np.array([0.3], np.float32),
            "has_variance": True,
        },
        3e-3,
        "a difference to one view errs by 16 roundings of 1.6 x 1000, 1.5e-3, and the variance of 1.2 by 2 sqrt(1.2) "
        "of it: 2.8e-3 of itself; squares of 1000 would err by 0.06 a rounding",
        "local",
        0.1,
    )


def bench(rows, cols):
    """Return inputs: 3 x 3 views of three planes, one slope, a whole aperture."""
    random = np.random.default_rng(41)
    places = np.stack(np.meshgrid([-2 / 3, 0, 2 / 3], [-2 / 3, 0, 2 / 3], indexing="ij"), -1)
    return {
        "views": random.random((9, 3, rows, cols), np.float32),
        "places": places.reshape(9, 2).astype(np.float32),
        "weights": np.ones(9, np.float32),
        "slopes": np.array([3.3], np.float32),
    }


def operations(views, places, weights, slopes, has_variance=False):
    """Return multiplications and additions: 4 x 4 taps and the sum over views of every pixel."""
    return (2 * 16 + 2 + 4 * has_variance) * prod(views.shape) * len(slopes)
