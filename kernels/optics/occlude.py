"""Light between layers out of focus, which the product of blurred layers misses: summed over the pupil.

`optics.composite` multiplies means over the pupil. But a pixel sees both a layer and the gaps next to it through the
same points of the pupil, so the mean of the product counts. With u a point of the pupil of radius 1, w its share of
the light, and layer k seen at y_k = x + r_k u + d(x, u), of coverage a_k and light b_k = coverage times light,

    out(x) = base(x) + sum over k of  < b_k V_k > - < b_k > product over nearer j of (1 - < a_j >),
    V_k(u) = product over nearer j of (1 - a_j(y_j)),    < f > = sum over u of w f(y(u)).

d is the displacement of rays by aberrations, a sum of terms: d(x, u) = sum over t of weights_t(x) bends_t(u).

Distortion and view displace the layers: the light at y_k comes from the place S(y_k) of the layer, and is J(y_k) times
as bright. Both are linear around x, `maps`: S(x) - x, (dS_y/dy, dS_y/dx, dS_x/dy, dS_x/dx), J(x), (dJ/dy, dJ/dx).

Displacements are of the place that is seen. If radii and weights change from place to place, with their derivatives,
`slopes`, along rows and columns, it is to first order

    y_k - x = (1 - d/dx (r_k u + d))^-1 (r_k u + d),    b_k thinned to b_k / det(1 - d/dx d),

and so are the means of a_j in the product, where rays crowd.

Each sample is even over its cell. The sum is over the layers that take part at a place, and at the places that are
given: elsewhere the two are equal.

Ports: base (channels, rows, cols) float32, lights (layers, channels, R, S) float32 in the base's unit, alphas (layers,
R, S) float32 [1], places (E, 2) int32, members (n, E) int32, radii (n, E) float32 [sample], points (M, 3) float32,
weights (T, E) float32 [1], bends (T, M, 2) float32 [sample], maps (9, E) float32 [sample, sample, 1 ...],
slopes (T + n, 2, E) float32 [1 / sample] -> (channels, rows, cols) float32, out or its change from the base.
R = rows + 2 margin, S = cols + 2 margin.
"""

import functools

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.common.border import BORDERS
from gpusim.kernels.stage import Array, Case, stage

MOST_AT_ONCE = 4
TOGETHER = 64  # points with a sum of their own


@stage
def occlude(
    device: Device,
    base: Array,
    lights: Array,
    alphas: Array,
    places: Array,
    members: Array,
    radii: Array,
    points: Array,
    border: str,
    margin: int = 0,
    change: bool = False,
    weights: Array | None = None,
    bends: Array | None = None,
    maps: Array | None = None,
    slopes: Array | None = None,
) -> Array:
    """Return composed layers with the covariance over the pupil at some places.

    Args:
        base: Layers composed by products, shape (channels, rows, cols).
        lights: Light of each layer times its coverage, without blur, shape (layers, channels, rows
            + 2 margin, cols + 2 margin).
        alphas: Coverage of each layer [1], shape (layers, rows + 2 margin, cols + 2 margin).
        places: Row and column of each place in `base`, all different, shape (E, 2).
        members: Layers that take part at each place, the nearest first, -1 for none, shape (n, E).
        radii: Radius of their blur, signed, positive beyond the focus [sample], shape (n, E).
        points: y, x and share of the light of points of the pupil [1], shape (M, 3).
        border: "zero", "edge" or "reflect"; coverage goes on at the edge of a dark world.
        margin: Samples on each side of the layers that are not in the result.
        change: Whether to return the change from the base.
        weights: Weight of each term of the rays' displacements at each place [1], shape (T, E); None: there are none.
        bends: Displacement (rows, cols) of each term at each point [sample], shape (T, M, 2).
        maps: Place and flux of the light that arrives at each place, and their derivatives, see above, shape (9, E);
            None: the layers are not displaced.
        slopes: Derivatives of the weights, and of the radii, along rows and columns, shape (T + n, 2, E); None: they
            are the same all around.
        device: A `Device`, or its name for `open_device`.

    Returns:
        The light, shape (channels, rows, cols), float32, not below 0 at the places; or its change.

    Source:
        Potmesil and Chakravarty, Computer Graphics 15 (1981), for the rays; the sum is their mean.
    """
    channels, rows, cols = base.shape
    sheets, count = members.shape
    base, lights, alphas = device.array(base), device.array(lights), device.array(alphas)
    terms = 0 if weights is None else weights.shape[0]
    if not terms:
        weights, bends = np.zeros((1, 1), np.float32), np.zeros((1, 1, 2), np.float32)
    # channels at once share their rays' places; a GPU needs all work-items
    each = channels if channels <= MOST_AT_ONCE and not device.is_gpu else 1
    defines = {
        "BORDER": BORDERS[border],
        "SHEETS": max(sheets, 1),
        "BENDS": terms,
        "MAPS": int(maps is not None),
        "SLOPES": int(slopes is not None),
        "EACH": each,
        "TOGETHER": TOGETHER,
    }
    maps = np.zeros((9, 1), np.float32) if maps is None else maps
    slopes = np.zeros((1, 2, 1), np.float32) if slopes is None else slopes
    launch = functools.partial(device.launch, "optics.occlude", defines=defines)
    out = device.empty((channels, rows, cols))
    launch("begin", out.shape, base, out, int(change), *out.shape)
    if count:
        chosen = [device.array(places, np.int32), device.array(members, np.int32)]
        of_rays = [device.array(one) for one in (radii, points, weights, bends, maps, slopes)]
        arrays = [base, lights, alphas, *chosen, *of_rays, out]
        sizes = [margin, int(change), points.shape[0], count, rows, cols, *lights.shape[1:]]
        launch("occlude", (channels // each, count), *arrays, *sizes)
    return out


def operations(
    base,
    lights,
    alphas,
    places,
    members,
    radii,
    points,
    border,
    margin=0,
    change=False,
    weights=None,
    bends=None,
    maps=None,
    slopes=None,
) -> float:
    """Return the multiplications and additions.

    For each point at each place in each channel: 12 for each layer, 12 more if it is displaced, 4 for each term of
    displacements; with slopes 20 more for each layer, and 8 for each term.
    """
    terms = 0 if weights is None else weights.shape[0]
    more = slopes is not None
    each = (12.0 + 12 * (maps is not None) + 20 * more) * members.shape[0] + (4 + 8 * more) * terms
    return each * base.shape[0] * members.shape[1] * points.shape[0]


def cases():
    """Yield cases: one place, several layers, gaps among members, every border, aberrations, distortion, slopes."""
    random = np.random.default_rng(35)
    why = (
        "the places of the samples are rounded alike; shares, products and sums of positive terms round by half an "
        "ulp, of 64 points and then of such sums, and the two sums are below the brightest light of the layers, or "
        "3 times that with fluxes"
    )
    for layers, channels, rows, cols, places, points, border, margin, terms, more in (
        (2, 1, 1, 1, 1, 1, "edge", 0, 0, ""),
        (2, 3, 33, 41, 60, 40, "edge", 0, 0, ""),
        (3, 4, 20, 65, 130, 64, "zero", 0, 0, ""),
        (5, 2, 12, 9, 40, 33, "reflect", 3, 0, ""),
        (2, 3, 8, 8, 0, 5, "edge", 0, 0, ""),
        (2, 3, 33, 41, 60, 2048, "edge", 0, 0, ""),
        (2, 3, 33, 41, 60, 40, "edge", 0, 1, ""),
        (3, 2, 20, 65, 130, 64, "zero", 2, 7, ""),
        (2, 3, 33, 41, 60, 40, "edge", 0, 0, "displaced"),
        (3, 2, 20, 65, 130, 64, "zero", 2, 3, "displaced"),
        (2, 3, 33, 41, 60, 40, "edge", 0, 0, "sloped"),
        (3, 2, 20, 65, 130, 64, "reflect", 2, 3, "displaced, sloped"),
    ):
        shape = rows + 2 * margin, cols + 2 * margin
        alphas = np.rint(1.5 * random.random((layers, *shape))).clip(0, 1)
        alphas[0] *= random.random(shape)
        alphas[-1] = 1
        lights = alphas[:, None] * 10.0 ** random.uniform(-2, 3, (layers, channels, *shape))
        at = random.permutation(rows * cols)[:places]
        members = np.sort(random.random((layers, places)), axis=0).argsort(axis=0)
        members[1:-1][random.random((layers - 2, places)) < 0.3] = -1
        radius = random.uniform(0, 1, points) ** 0.5
        angle = 2 * np.pi * random.random(points)
        shares = random.uniform(0.5, 1, points)
        disc = [radius * np.sin(angle), radius * np.cos(angle), shares / shares.sum()]
        aberrations = {}
        if terms:
            aberrations = {
                "weights": random.standard_normal((terms, places)).astype(np.float32),
                "bends": random.standard_normal((terms, points, 2)).astype(np.float32),
            }
        if "displaced" in more:
            # turned and magnified by up to 20 %, so that fluxes stay below 3 within 20 samples
            own = [random.uniform(-3, 3, (2, places)), random.uniform(-0.2, 0.2, (4, places))]
            own[1][[0, 3]] += 1
            own += [random.uniform(0.5, 1.5, (1, places)), random.uniform(-0.03, 0.03, (2, places))]
            aberrations["maps"] = np.concatenate(own).astype(np.float32)
        if "sloped" in more:
            # determinants are 0.5 to 1.6 with up to 3 terms of up to 4
            own = random.uniform(-0.01, 0.01, (terms, 2, places))
            own = np.concatenate([own, random.uniform(-0.05, 0.05, (layers, 2, places))])
            aberrations["slopes"] = own.astype(np.float32)
        longest = min(points, TOGETHER) + -(-points // TOGETHER)
        yield Case(
            f"{rows}x{cols}, {layers} layers, {places} places, {points} points, {border}, margin {margin}, "
            f"{terms} aberrations{', ' * bool(more)}{more}",
            {
                **aberrations,
                "base": random.random((channels, rows, cols), np.float32),
                "lights": lights.astype(np.float32),
                "alphas": alphas.astype(np.float32),
                "places": np.stack(np.unravel_index(at, (rows, cols)), axis=1).astype(np.int32),
                "members": members.astype(np.int32),
                "radii": random.uniform(-9, 9, (layers, places)).astype(np.float32),
                "points": np.stack(disc, axis=1).astype(np.float32),
                "border": border,
                "margin": margin,
                "change": border == "reflect",
            },
            (12 if more else 4) * layers * (longest + layers) * 2.0**-24 * lights.max(),
            why,
            metric="exact",
        )


def bench(rows, cols):
    """Return inputs: two layers, three channels, a twentieth of the pixels, 200 points."""
    random = np.random.default_rng(35)
    count = rows * cols // 20
    at = np.arange(count) * 20
    angle = 2.4 * np.arange(200)
    radius = np.sqrt((np.arange(200) + 0.5) / 200)
    alphas = np.ones((2, rows, cols), np.float32)
    alphas[0, :, : cols // 2] = 0
    return {
        "base": random.random((3, rows, cols), np.float32),
        "lights": alphas[:, None] * random.random((2, 3, rows, cols), np.float32),
        "alphas": alphas,
        "places": np.stack(np.unravel_index(at, (rows, cols)), axis=1).astype(np.int32),
        "members": np.repeat(np.arange(2, dtype=np.int32)[:, None], count, 1),
        "radii": np.repeat(np.array([[-4.0], [4.0]], np.float32), count, 1),
        "points": np.stack(
            [radius * np.sin(angle), radius * np.cos(angle), np.full(200, 1 / 200)], axis=1
        ).astype(np.float32),
        "border": "edge",
    }
