"""Blur: its form, whether it is left out or follows the distance of objects, and doubts about its prediction."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from math import ceil

import numpy as np
import scipy
from scipy.fft import dctn, idctn, irfft2, rfft2

from gpusim.domain.account import SAFETY, UNKNOWN, Bound, total
from gpusim.domain.errors import OutOfRange
from gpusim.domain.interpolation import node_weights
from gpusim.domain.pupil import LONGEST_WAVEFRONT, Pupil
from gpusim.domain.spectrum import values_of
from gpusim.optics.depth import TOLERANCE, DepthPlan, plan_depth, power_and_contrast
from gpusim.optics.edges import span_of
from gpusim.optics.field import image_error, natural_difference
from gpusim.optics.fusion import SAMPLED_PERIOD
from gpusim.optics.geometry import DistortionGrid, places_of, view_nodes
from gpusim.optics.kernel_space import KernelSpace
from gpusim.optics.lenses import open_lens
from gpusim.optics.occlusion import SHARP, Bending, Displaced, find_occlusion, hidden_light
from gpusim.planner.knobs.border import Surroundings
from gpusim.planner.knobs.highlights import Picture
from gpusim.planner.probes import SIDE, Probes
from gpusim.planner.question import DECLARED, Notes, Question, displacement_suffix

SMALL = 400  # samples along a frame below which a field varies within a kernel: predicted over true was .1 to 1.7
DOUBT = f"the blur varies over a frame of less than {SMALL} samples; a larger frame can be judged"
# beyond it predicted over true was .4 to .7 in sigmas: the windows see little of so wide a blur
WIDEST_Q = 24.0
BETWEEN_DOUBT = (
    "pixels end between the scene's samples, and light between blurred samples is interpolated"
)
WIDE_DOUBT = f"wavelength x f-number is more than {WIDEST_Q:g} samples: too wide a blur for windows of {SAMPLED_PERIOD}"
ENDINGS = {
    "optics.mosaic": ", folded into the mosaic",
    "optics.blur": "",
    "optics.tiles": ", by tiles",
}
LEAST = 0.5  # of the tolerance: changes by the sum over the pupil that are not computed
MOST_LEAST = 1e-2  # and of the light
DIFFRACTED = (
    1.0  # share of what the sum over the pupil changes: rays take part of a wave out of focus
)
NEGLIGIBLE = 0.1  # of the tolerance: what diffraction in focus makes of products is not computed
WINDOW = 256  # [sample] a side of the part of a picture in which that is predicted
FIELDS = ("light", "alpha", "radius")
WHOLE = 2**17  # samples of a picture of which a part is not looked at apart
COARSE = 8  # [sample] between places that find a part of a picture
PLACES = (0.0, 0.0), (0.6, 0.8), (0.6, -0.8), (-0.6, 0.8), (-0.6, -0.8)  # of the field
RINGS = 8  # of diffraction: beyond is about 2 % of the light
NEAR_FRAME = 4  # [sample] beyond a blur's reach
LEFT = 0.15  # of it, after it was computed
QUANTILES = 16  # of a scene's circles of confusion
BETWEEN_MEASURED = "depth, point spreads between the distances that were measured"
HIDDEN = "depth, in layers (hidden parts are continued)"
MIXED = "depth, samples that may show one surface or two"
NEAR = 4.0  # [sample] over which noise is taken from the light
OTHERS = "depth, if "  # begins the names of errors of alternatives


def form_of(question: Question, around: Surroundings, depth: DepthPlan | None) -> tuple[str, bool]:
    """Return the stage that blurs, and whether it gives the mosaic at once.

    around: surroundings that take part. Layers by depth are composited channel by channel.
    """
    lens, sensor = question.lens, question.sensor
    folded = (
        around.folds
        and question.ratio == 1
        and not sensor.is_monochrome
        and not sensor.stacked
        and lens.is_uniform
        and depth is None
    )
    if around.tiling is not None:
        return "optics.tiles", folded
    return "optics.mosaic" if folded else "optics.blur", folded


def describe(question: Question, form: str, words: str, has_depth: bool, notes: Notes):
    """Note the blur's stages. words: the planes."""
    over = "each scene sample"
    if question.ratio == 1:
        over = f"the pixel{displacement_suffix(question.moved)}"
    stage, pupil = question.lens.describe(has_depth)
    notes.models[stage] = f"{pupil}, integrated over {over}"
    notes.models[form] = words + ENDINGS[form]


def left_out(question: Question, picture: Picture, probes: Probes, notes: Notes) -> Question:
    """Return the question without the blur if the error is small enough; else the same.

    The blur is kept whatever its error if its form, or exactness for every spectrum, is prescribed;
    if it follows distance or field, which one window does not show; if point lights are added to
    it; if it displaces the pixels by parts of samples; or if scenes of its kind were found to need
    it.
    """
    assert question.tolerance is not None
    if (
        question.least
        or question.period
        or question.reach
        or question.guaranteed
        or question.facts.depth is not None
        or not question.lens.is_uniform
        or picture.highlights is not None
        or (question.more and question.ratio == 1)
    ):
        return question
    bound = probes.without_blur
    if SAFETY * bound.ratio(question.tolerance) <= 1:
        bound = total([bound, probes.even_error(picture.from_afar(question, SIDE / 2))])
    if SAFETY * bound.ratio(question.tolerance) > 1:
        return question
    notes.leave_out("blur", bound, "blur left out")
    return question.without_blur()


def doubt_of(question: Question) -> str:
    """Return why predicted errors are not certain (the lens varies within its kernels, a very wide blur), or ""."""
    if not question.is_blurred:
        return ""
    ratio = question.ratio
    if ratio != 1:  # of a pixel's aperture, among the cells of the samples
        width = np.array(question.aperture)
        side = np.array([[-0.5], [0.5]])
        edges = ratio * (0.5 + np.array(question.sensor.displacement) + side * width)
        if not ratio.is_integer() or (np.abs(edges - np.rint(edges)) > 1e-6).any():
            return BETWEEN_DOUBT
    if not question.lens.is_uniform and min(question.size) < SMALL:
        return DOUBT
    return WIDE_DOUBT if question.q.max() > WIDEST_Q else ""


def by_depth(
    question: Question,
    probes: Callable[[], Probes],
    place: Callable[[], DistortionGrid | None],
    notes: Notes,
) -> DepthPlan | None:
    """Return the plan of a blur that follows distance; None if it is the same at all distances.

    `notes` then gives the reason and the error. probes: gives the scene's. place: gives the lens's
    distortion. Raises BadData, OutOfRange.
    """
    optics, facts, scene = question.optics, question.facts, question.scene
    if facts.depth is None:
        return None
    if question.lens.fixed_distance or question.lens.distance_model:
        place()  # its notes come first
    if why := question.lens.fixed_distance:
        notes.leave_out(
            f"depth: {why}, so the blur is the same at all distances",
            _without_depth(question),
            "depth left out",
        )
        return None
    if model := question.lens.distance_model:
        notes.leave_out(
            f"measurements at each distance: {model}", UNKNOWN, "distance of measured spreads"
        )
    light = facts.brightness(question.light)
    made = plan_depth(
        optics,
        question.pitch,
        facts.depth,
        light,
        question.limit,
        scene=scene,
        curvature=_curvature(question),
        is_placed=question.distortion is not None or not scene.view.is_plain,
        widest=8 * LONGEST_WAVEFRONT * float(np.min(question.q)),
        known=question.lens.distances,
    )
    if question.lens.distances is not None:
        made.predicted[BETWEEN_MEASURED] = _between_distances(question, made, light)
    for distance in made.distances[[0, -1]] if question.lens.is_adjustable else ():
        try:
            optics.waves(scene.wavelengths[:1], distance=distance)
        except OutOfRange as error:
            raise OutOfRange(
                "depth",
                f"{distance:.4g} m with the focus at {optics.object_distance:.4g} m",
                f"nearer to the focus, or a smaller aperture: {error}",
            ) from None
    return made if made.layers < 2 else _with_occlusion(question, made, probes, place(), notes)


def _between_distances(question, depth, light):
    """Return the relative RMS error by interpolation of point spreads between the distances that were measured.

    Cubics may err by as much as they differ from lines. Counted on the axis, at some of the scene's distances.
    """
    lens, nodes = question.lens, depth.kernels
    at = np.quantile(depth.confusion, (np.arange(QUANTILES) + 0.5) / QUANTILES)
    high = np.clip(np.searchsorted(nodes, at), 1, len(nodes) - 1)
    share = (at - nodes[high - 1]) / (nodes[high] - nodes[high - 1])
    wrong, row = node_weights(nodes, at), np.arange(QUANTILES)
    wrong[row, high - 1] -= 1 - share
    wrong[row, high] -= share
    middle, size = [float(np.median(question.content.wavelengths))], lens.least_size | 1
    kernels = np.stack([lens.kernels(middle, (0.0, 0.0), size, one) for one in depth.distances])
    errors = np.tensordot(wrong, kernels, 1)
    _, contrast = power_and_contrast(light)
    return image_error(errors, np.zeros_like(errors))[0] * contrast / natural_difference()


def _curvature(question):
    """Range of circles of confusion by which the field is out of focus along any axis, with 0 (low, high) [sample].

    A wavefront of W waves at the rim is a circle of 8 q W.
    """
    optics = question.optics
    if question.lens.is_uniform or not question.lens.is_adjustable:
        return 0.0, 0.0
    own = [optics.wavefront.polynomial(height) for height in np.linspace(0, 1, 5)]
    waves = [table[at] - own[0][at] for table in own for at in ((2, 0), (0, 2))]
    circle = 8 * optics.wavefront.reference * 1e-9 * optics.working_f_number / question.pitch
    return circle * min(waves), circle * max(waves)


def _with_occlusion(question, depth, probes, placed, notes):
    """Return the plan with the places at which layers are summed over the pupil, and with the errors that are left."""
    picture = question.facts.brightness(question.light)
    square = float(np.mean(np.square(picture, dtype=np.float64)))
    if not square > 0:
        return depth

    def brightness(content):
        return picture if content is None else content.on_host().brightness(question.light)

    least = LEAST * min(question.limit or TOLERANCE, MOST_LEAST) * square**0.5
    scene = question.scene
    border = "edge" if scene.border == "scene" else scene.border
    nodes = None
    if placed is not None or not scene.view.is_plain:
        nodes = view_nodes(scene.view, placed, question.size, scene.content.shape, question.ratio)
    bending = _bending_of(question)
    bent = bending.reach if bending else 0.0
    box, sources, places = _around_edges(depth, nodes, question.size, bent)
    sheets = depth.in_brightness(brightness, sources)
    begin = np.array([one.start for one in box], np.int32)
    settings, displaced = (question.optics.pupil, border, least), None
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # NumPy and SciPy let other threads run
        if nodes is not None:
            at = tuple(one.start for one in sources)
            is_cubic = placed is None or placed.method == "cubic"
            displaced = Displaced(sheets, at, *places) if is_cubic else None
            sheets = list(pool.map(lambda sheet: sheet.at(*places, border), sheets))
        finding = pool.submit(
            find_occlusion, sheets, *settings, bending=bending, begin=begin, displaced=displaced
        )
        if not depth.sheets:
            hiding = pool.submit(hidden_light, sheets)
        known = probes() if question.tolerance is not None else None
        window, tolerance = _densest(sheets), question.tolerance
        fields = [{key: getattr(one, key)[window] for key in FIELDS} for one in sheets]
        parts = [replace(one, **its) for one, its in zip(sheets, fields, strict=True)]
        wrong = _behind_edges(question, parts)
        light = picture[box].astype(np.float64)
        locate = _Locating(question, light, known, square, picture.size)
        found = finding.result()
    found = replace(found, places=found.places + begin)
    product = _locate(question, wrong, light[window], known)
    if tolerance is None or product.ratio(tolerance) > NEGLIGIBLE:
        sharp = [k for k, one in enumerate(sheets) if np.abs(one.radius).max() + bent <= SHARP]
        found = replace(found, is_diffracted=bool(wrong.any()), sharp=tuple(sharp))
        product = product.times(_left_of(question, sheets, begin))
    # rays know no lateral colour, and nothing of a measured lens
    is_exact = question.lens.is_adjustable and not np.any(values_of(question.optics.lateral_color))
    left = found.error if is_exact else found.error + found.seen
    bounds = {"depth, light behind the edges of layers": total([product, locate(left)])}
    if len(found.places):
        notes.leave_out(
            "diffraction at the edges of objects out of focus: rays are cut there",
            locate(found.seen * DIFFRACTED),
            "depth, diffraction at edges",
            of_scene=True,
        )
    if not depth.sheets:
        rms = depth.predicted.pop(HIDDEN)
        bounds[HIDDEN] = replace(locate(hiding.result()), rms=rms)
    if depth.mixed is not None and len(depth.mixed.at):
        seen = locate
        if sources != box:
            light = picture[sources].astype(np.float64)
            seen = _Locating(question, light, known, square, picture.size)
        bounds[MIXED] = seen(_doubt_of(depth, picture, sources))
    return replace(depth, occlusion=found, bounds=bounds)


def _bending_of(question):
    """Return the displacements of rays by the lens's aberrations; None: it has none, or they are not known."""
    own, lens = question.optics.wavefront, question.lens
    if not (lens.is_adjustable and (any(own.seidel) or np.any(own.zernike))):
        return None
    middle = (np.array(question.size) - 1) / 2 + lens.axis
    box = (-1, -1), tuple(question.size)
    settings = question.optics, question.pitch, tuple(middle), question.corner, box
    return question.cache("bending", _make_bending, *settings)


def _make_bending(*settings):
    """Return a `Bending`, which finds its terms once."""
    return Bending(*settings)


def _around_edges(depth, nodes, size, bent=0.0):
    """Return a box of samples with all light that comes from near the edges of layers.

    nodes: of the places from which the samples' light comes, as of a DistortionGrid; None: from their own. size: rows
    and columns of the samples. bent: most displacement of rays by aberrations [sample].

    Returns:
        The box, a box of its sources, and row, column, both from that on, and flux factor of the source of each sample
        of the box.
    """
    shape = depth.confusion.shape
    box = sources = tuple(slice(0, n) for n in size)
    # filters of this reach see others of this reach
    reach = 2 * int(np.ceil(depth.reach + bent + 1)) + NEAR_FRAME
    is_part = max(shape[0] * shape[1], size[0] * size[1]) > WHOLE
    if nodes is None:
        if is_part:
            box = sources = _wider(depth.edge_box(), reach, size, WINDOW)
        return box, sources, None
    if is_part:
        every = tuple(np.append(np.arange(0, n - 1, COARSE), n - 1) for n in size)
        there = np.ones([len(one) for one in every], bool)
        for place, its in zip(places_of(nodes, size, every)[:2], depth.edge_box(), strict=True):
            # what lies between these samples
            between = max(np.abs(np.diff(place, axis=axis)).max(initial=0) for axis in (0, 1))
            there &= (place > its.start - between - 1) & (place < its.stop + between)
        spans = span_of(there.any(axis=1)), span_of(there.any(axis=0))
        found = [
            slice(one[its.start], one[its.stop - 1]) if its.stop else its
            for one, its in zip(every, spans, strict=True)
        ]
        box = _wider(found, reach + COARSE, size, WINDOW)
    rows, cols, flux = places_of(nodes, size, box)
    sources = tuple(slice(0, n) for n in shape)
    if is_part:
        ends = [(int(np.floor(one.min())), int(np.ceil(one.max())) + 1) for one in (rows, cols)]
        sources = _wider([slice(*one) for one in ends], 1, shape)
    return box, sources, (rows - sources[0].start, cols - sources[1].start, flux)


def _wider(box, more, shape, least=1):
    """Return a box that is wider on each side, and at least so wide, as far as a picture of a shape goes."""
    found = []
    for one, n in zip(box, shape, strict=True):
        more_here = max(more, (least - (one.stop - one.start) + 1) // 2)
        first = max(min(one.start - more_here, n - least), 0)
        found.append(slice(first, min(max(one.stop + more_here, first + least), n)))
    return tuple(found)


def _doubt_of(depth, picture, box):
    """Return the light that samples of a box have of another distance if they show one surface only, (rows, cols)."""
    mixed, error = depth.mixed, np.zeros(picture.shape)
    error.flat[mixed.at] = mixed.doubt(picture)
    error = error[box]
    sides = depth.confusion.ravel()[np.stack([mixed.front, mixed.back])]
    return scipy.ndimage.gaussian_filter(error, float(np.abs(sides).min()) / 4)


def _left_of(question, sheets, begin):
    """Share of the blur of products by diffraction in focus that is left after it was computed.

    All of it if it is not known well: behind aberrations in focus and measured lenses, and at edges so near the frame's
    that light from outside takes part. begin: first row and column of the sheets in the frame.
    """
    if not open_lens(replace(question.optics, pupil=Pupil()), question.pitch).is_airy:
        return 1.0
    for sheet in sheets[:-1]:
        reach = int(np.ceil(np.abs(sheet.radius).max())) + NEAR_FRAME
        y, x = (
            (np.arange(first, first + m) >= reach) & (np.arange(first, first + m) < n - reach)
            for first, m, n in zip(begin, sheet.alpha.shape, question.size, strict=True)
        )
        outside = sheet.alpha[~(y[:, None] & x)]
        if outside.size and np.ptp(outside) > 0:
            return 1.0
    return LEFT


def _densest(sheets):
    """Rows and columns of the window of up to WINDOW samples a side in which most of the layers' edges lie."""
    rows, cols = sheets[0].alpha.shape
    if max(rows, cols) <= WINDOW:
        return np.s_[:, :]
    edges = sum(np.abs(np.diff(one.alpha, axis=1, prepend=one.alpha[:, :1])) for one in sheets)
    edges = edges + sum(np.abs(np.diff(one.alpha, axis=0, prepend=one.alpha[:1])) for one in sheets)
    down, across = (np.arange(0, n, WINDOW) for n in (rows, cols))
    sums = np.add.reduceat(np.add.reduceat(edges, down, axis=0), across, axis=1)
    y, x = np.unravel_index(sums.argmax(), sums.shape)
    return np.s_[down[y] : down[y] + WINDOW, across[x] : across[x] + WINDOW]


def _behind_edges(question, sheets):
    """Error of a product of light and coverage that are blurred together in focus, brightness (rows, cols).

    Exact is the blur of the product of light and transmission. The two differ by the covariance
    within the kernel of the lens in focus, at the mean wavelength in a mirrored world; in a varying
    field by the largest of some places. First each is blurred for its own distance, a disc of
    diameter c by a Gaussian of standard deviation c / 4.
    """
    products, light, is_sharp = [], None, False
    for sheet in reversed(sheets):
        width = float(np.abs(sheet.radius).mean()) / 2
        front, cover = (
            scipy.ndimage.gaussian_filter(sheet.light, width),
            scipy.ndimage.gaussian_filter(sheet.alpha, width),
        )
        is_sharp |= bool(np.abs(sheet.radius).min() <= SHARP)
        if light is not None and np.ptp(cover) > 0:
            products.append((np.stack([cover * light, cover, light]), is_sharp))
        light = front if light is None else front + (1 - cover) * light
    found = np.zeros(sheets[0].alpha.shape)
    if not products:
        return found
    transform, blurs = _blurs_in_focus(question, found.shape)
    spectra = [(transform(fields), is_sharp) for fields, is_sharp in products]
    for blur in blurs:
        square = 0.0
        for one, is_sharp in spectra:
            product, cover, light = blur(one, is_sharp)
            square = square + (product - cover * light) ** 2
        found = np.maximum(found, np.sqrt(square))
    return found


def _blurs_in_focus(question, shape):
    """Return a transform of pictures (n, rows, cols), and functions from it to these pictures blurred in focus.

    There is one function (spectra, whether over cells) for each place of the field. Samples in focus are even over
    their cells; out of focus the sum over the pupil has the cells. An aberrated kernel has them always.
    """
    axes, (rows, cols) = (-2, -1), shape
    if question.lens.is_airy or question.lens.is_pointlike:
        # of the cosines of a mirrored world
        fy, fx = (np.arange(n)[:, None] / (2 * n) for n in shape)
        s = np.minimum(np.hypot(fy, fx.T) * question.mean_q, 1)
        seen = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
        cells = np.sinc(fy * question.cell[0]) * np.sinc(fx.T * question.cell[1])

        def blur_round(spectra, with_cells):
            return idctn(spectra * (seen * cells if with_cells else seen), axes=axes, workers=-1)

        return partial(dctn, axes=axes, workers=-1), [blur_round]
    lens = question.lens
    nm = lens.nanometres(np.array([question.mean_q]))
    radius = ceil(lens.spread(nm) + RINGS * question.mean_q)
    size = max(lens.least_size, 2 * radius + 1)

    def transform(fields):
        return rfft2(np.pad(fields, ((0, 0), (0, rows), (0, cols)), mode="symmetric"), workers=-1)

    def blur(spectra, _, passed):
        return irfft2(spectra * passed, (2 * rows, 2 * cols), workers=-1)[:, :rows, :cols]

    every = question.cache("kernels in focus", _transform_kernels, lens, nm, size, shape)
    return transform, [partial(blur, passed=passed) for passed in every]


def _transform_kernels(lens, wavelengths, size, shape):
    """Return transforms of kernels of size x size samples at places of the field, in a mirrored world."""
    at, found = np.arange(size) - size // 2, []
    y, x = (at % (2 * n) for n in shape)
    for place in ((0.0, 0.0),) if lens.is_uniform else PLACES:
        kernel = np.zeros([2 * n for n in shape])
        np.add.at(kernel, np.ix_(y, x), lens.kernels(wavelengths, place, size)[0])
        found.append(rfft2(kernel / kernel.sum()))
    return found


def _locate(question, error, light, probes):
    """Return the bound of an error of the brightness at each sample, (rows, cols).

    light: brightness without blur.
    """
    return _Locating(question, light, probes, float(np.mean(light**2)), light.size)(error)


class _Locating:
    """Bounds of errors of the brightness at the samples of a part of a picture, 0 elsewhere.

    The channel with the largest part of the light has the largest error in noise sigmas.

    light: brightness without blur, (rows, cols). square, count: mean square of that of the picture, and its samples.
    """

    def __init__(self, question, light, probes, square, count):
        self._square, self._count, self._scale = square, count, None
        if probes is not None:
            part = question.weights.sum(axis=1)
            part = probes.seconds * float(part.max() / part.sum())
            # light may come from anywhere within the blur
            level = np.maximum(scipy.ndimage.gaussian_filter(light, NEAR), 0)
            self._scale = part / np.sqrt(np.maximum(part * level + probes.noise, 1))

    def __call__(self, error) -> Bound:
        """Return the bound of an error, (rows, cols)."""
        part = error.size / self._count
        rms = float(np.sqrt(np.mean(error**2) * part / self._square))
        if self._scale is None:
            return Bound(rms)
        sigma = self._scale * error
        return Bound(rms, float(np.quantile(sigma, max(1 - 0.001 / part, 0))), float(sigma.max()))


def _without_depth(question):
    """Bound of the error of one picture of layers without blur: of samples that they cover in part, it is not known."""
    partial = (np.asarray(layer.alpha) % 1 for layer in question.scene.layers)
    return UNKNOWN if any(map(np.any, partial)) else DECLARED


def bounds_of(depth: DepthPlan | None, probes: Probes | None) -> dict[str, Bound]:
    """Return the named errors of the blur by distance, located at edges."""
    if depth is None:
        return {}
    local = Bound if probes is None else probes.local
    named = {
        name: local(error) for name, error in depth.predicted.items() if not name.startswith(OTHERS)
    }
    return named | depth.bounds


def describe_depth(depth: DepthPlan | None, space: KernelSpace | None, notes: Notes):
    """Note how the blur follows distance. space: its kernels."""
    if depth is None:
        return
    notes.models["optics.composite"] = depth.model
    if space is not None:
        notes.models["optics.field"] = space.report
    notes.beside |= {
        name: error for name, error in depth.predicted.items() if name.startswith(OTHERS)
    }
    if depth.layers > 1 and not depth.sheets:
        notes.leave_out(
            "surfaces hidden by nearer objects: one picture does not show them; the picture next to them is "
            "continued there",
            notes.bounds.get(HIDDEN) or depth.bounds.get(HIDDEN) or Bound(),
            HIDDEN,
        )
