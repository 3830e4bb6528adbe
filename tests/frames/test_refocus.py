"""Refocusing: against textures in closed form, the lens's own blur, and the two methods against each other."""

import numpy as np
import pytest
from scipy.fft import next_fast_len
from scipy.special import j1
from textured_views import (
    FOCUS,
    Waves,
    cells,
    lens_camera,
    made_views,
    plane_views,
    thin_lens_slope,
)

import gpusim as gs
from gpusim.captures.refocus import slopes_between
from gpusim.domain.errors import BadData, Conflict, DoesNotFit, GpusimError, OutOfRange
from gpusim.domain.memory import limit_memory
from gpusim.domain.view_images import ViewImages

DEVICES = ["numpy", "opencl", "warp:cpu"]
RIM = 12


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("distance", [0.32, 0.5, 2.0])
def test_a_plane_is_sharp_at_its_distance(device, distance):
    """Waves up to 0.6 rad a pixel lose up to w^4 / 64 = 0.2 % by the cubic, at half a pixel (Keys): each of amplitude
    0.2 sqrt(2 / 20), all 20 in step 0.0026 along each axis."""
    waves = Waves(np.random.default_rng(5), highest=0.6)
    slope = thin_lens_slope(distance)
    views = made_views(plane_views(waves, slope, (3, 4), (48, 56)))
    y, x = np.arange(48) - 23.5, np.arange(56) - 27.5
    sharp = waves(y[:, None], x[None])[..., None]
    found = gs.refocus(views, distance=distance, device=device)
    assert np.abs(found - sharp)[RIM:-RIM, RIM:-RIM].max() < 6e-3
    other = gs.refocus(views, slope=slope + 3, device=device)
    assert np.abs(other - sharp)[RIM:-RIM, RIM:-RIM].max() > 0.1
    assert found.shape == sharp.shape and found.dtype == np.float32


def test_slopes_are_those_of_the_lens():
    views = ViewImages.of(np.ones((3, 3, 4, 4, 1)), lens_camera())
    for distance in (0.2, 0.5, 3.0, np.inf):
        assert views.slope_at(distance) == pytest.approx(thin_lens_slope(distance), abs=1e-9)
    back = views.distance_at(views.slope_at(np.array([0.2, 0.7, 1e3])))
    assert back == pytest.approx([0.2, 0.7, 1e3], rel=1e-6)
    assert views.distance_at(views.slope_at(np.inf) * 1.1) == np.inf
    finer = ViewImages.of(np.ones((3, 3, 4, 4, 1)), lens_camera(), samples_per_pixel=2)
    assert finer.slope_per_diopter == pytest.approx(2 * views.slope_per_diopter)


def test_views_of_a_light_field_refocus():
    """A scene's wall at 1.5 m, as pinholes in the pupil see it, is sharp at 1.5 m. Tolerances: as above."""
    y, x = np.arange(64) - 31.5, np.arange(56) - 27.5
    sharp = Waves(np.random.default_rng(6), highest=0.6)(y[:, None], x[None])
    content = gs.Cube(np.array([550.0]), sharp[None].astype(np.float32))
    light = gs.chart("flat").illuminant
    scene = gs.Scene(content, light, depth=np.full(sharp.shape, 1.5))
    field = gs.light_field(scene, lens_camera(), (4, 3))
    values = np.array(
        [[np.moveaxis(one.content.values, 0, -1) for one in row] for row in field.views]
    )
    views = ViewImages.of(values, lens_camera())
    assert field.places / field.radius == pytest.approx(views.places)
    found = gs.refocus(views, distance=1.5, device="opencl")[..., 0]
    assert np.abs(found - sharp)[RIM:-RIM, RIM:-RIM].max() < 8e-3


def test_cells_that_the_pupil_cuts_are_at_the_middle_of_their_light():
    """Views through the cells of a round pupil, of one brightness, refocused with the share of each as weight.

    The middle of a cell's light is found from 200 x 200 points, in the code from 32 x 32: 2e-3 of a cell.
    """
    shape, slope = (5, 4), 3.0
    points = np.stack(np.meshgrid(cells(5 * 200), cells(4 * 200), indexing="ij"), axis=-1)
    lit = (np.square(points).sum(axis=-1) <= 1).reshape(5, 200, 4, 200)
    points = points.reshape(5, 200, 4, 200, 2)
    count = lit.sum(axis=(1, 3))
    middles = (points * lit[..., None]).sum(axis=(1, 3)) / count[..., None]
    waves = Waves(np.random.default_rng(8), 0.5)
    y, x = np.arange(48) - 23.5, np.arange(56) - 27.5
    values = np.empty((*shape, 48, 56, 1))
    for at in np.ndindex(shape):
        down, right = slope * middles[at]
        values[*at, ..., 0] = waves((y - down)[:, None], (x - right)[None])
    views = made_views(values, light=count / 200**2)
    assert views.places == pytest.approx(middles, abs=2e-3)
    found = gs.refocus(views, slope=slope, device="opencl")[RIM:-RIM, RIM:-RIM, 0]
    sharp = waves(y[:, None], x[None])[RIM:-RIM, RIM:-RIM]
    assert np.abs(found - sharp).max() < 6e-3


def blurred_wave(k, slope, shape, size):
    """Views of the wave 1 + cos(k . p), each through its whole cell: means over squares of the pupil.

    The mean of exp(i u s) over |s| <= h is sinc(u h / pi).
    """
    y, x = (np.arange(n) - (n - 1) / 2 for n in size)
    half = 1 / np.array(shape)
    kept = np.prod(np.sinc(slope * np.array(k) * half / np.pi))
    found = np.empty((*shape, *size, 1))
    for j, down in enumerate(cells(shape[0])):
        for i, right in enumerate(cells(shape[1])):
            turns = k[0] * (y - slope * down)[:, None] + k[1] * (x - slope * right)[None]
            found[j, i, ..., 0] = 1 + kept * np.cos(turns)
    return found


def amplitude(picture, k):
    """Amplitude of the wave in the middle of a picture, at the centre, where its phase is 0."""
    rows, cols = picture.shape[:2]
    y, x = (np.arange(n) - (n - 1) / 2 for n in (rows, cols))
    wave = np.cos(k[0] * y[:, None] + k[1] * x[None])
    middle = slice(rows // 4, -rows // 4), slice(cols // 4, -cols // 4)
    part, wave = picture[middle][..., 0] - 1, wave[middle]
    return (part * wave).sum() / (wave**2).sum()


@pytest.mark.parametrize("radius", [1.0, 0.8, 0.6])
def test_a_synthetic_aperture_blurs_as_a_smaller_lens(radius):
    """The transfer function of a disc of radius a, 2 J1(u) / u at u = k slope a, begins as 1 - u^2 / 8.

    The loss u^2 / 8 is the blur's squared rms radius times k^2 / 4. At u = 0.35 further terms are u^2 / 24 = 0.5 %
    of it, and both have them to a tenth. The square root of the losses' ratio is the ratio of radii, to 1 %.
    """
    slope, shape = 5.0, (9, 9)
    k = np.array([0.6, 0.8]) * 0.35 / (slope * radius)
    views = made_views(blurred_wave(k, slope, shape, (24, 24)))
    found = amplitude(gs.refocus(views, slope=0.0, aperture=radius, device="opencl"), k)
    u = np.hypot(*k) * slope * radius
    wanted = 2 * j1(u) / u
    # the blur's rms radius, from what is lost
    assert np.sqrt((1 - found) / (1 - wanted)) == pytest.approx(1, abs=0.01)


def test_an_aperture_of_whole_cells_is_a_square_lens():
    """3 x 3 of 9 x 9 cells are a square of a third: sinc along both axes, exactly; float32 sums of values of 2."""
    slope, k = 5.0, np.array([0.3, 0.5])
    views = made_views(blurred_wave(k, slope, (9, 9), (24, 24)))
    mask = np.zeros((9, 9))
    mask[3:6, 3:6] = 1
    found = amplitude(gs.refocus(views, slope=0.0, aperture=mask, device="opencl"), k)
    assert found == pytest.approx(np.prod(np.sinc(slope * k / 3 / np.pi)), abs=1e-5)
    moved = np.roll(
        mask, (1, 2), (0, 1)
    )  # seen from aside, the wave moves by the aperture's middle
    picture = gs.refocus(views, slope=0.0, aperture=moved, device="opencl")
    turn = slope * (k @ np.array([1, 2])) * 2 / 9
    assert amplitude(picture, k) == pytest.approx(found * np.cos(turn), abs=0.02)


def test_the_whole_pupil_is_the_disc():
    """Cells at the edge of a round lens, with their light: a disc of radius 1 is all of it."""
    points = np.stack(np.meshgrid(cells(9 * 200), cells(9 * 200), indexing="ij"))
    light = (np.square(points).sum(axis=0) <= 1).reshape(9, 200, 9, 200).mean(axis=(1, 3))
    views = made_views(np.ones((9, 9, 2, 2, 1)), light=light)
    # a disc's share of a cell is counted by 32 x 32 points: one column of them along its edge
    assert np.abs(views.weigh(1.0) - light).max() < 2 / 32
    assert np.abs(views.weigh() - light).max() == 0
    assert np.abs(views.weigh(3.0) - light).max() < 2 / 32


def test_fourier_slices_make_the_same_pictures():
    """Against shift and add, within the cubic's loss, and against the definition: phases of the views' transforms."""
    size, shape, slopes = (40, 48), (5, 4), (-1.5, 0.7, 2.2)
    views = made_views(plane_views(Waves(np.random.default_rng(2), 0.5), 1.1, shape, size))
    slices = gs.refocus_by_slices(views, slopes)
    stack = gs.focus_stack(views, slopes=slopes, device="opencl")
    assert slices.shape == stack.shape == (3, *size, 1)
    # 0.5^4 / 64 = 0.1 % at most along each axis of 20 waves of 0.063 in step, and ringing of the continued edges
    middle = slice(RIM, -RIM)
    assert np.abs(slices - stack)[:, middle, middle].max() < 4e-3
    # the kernel of 6 nodes at twice the views, to the promised 1e-5. At half a wave per pixel the direction of a
    # displaced wave is ambiguous: the half plane of real transforms decides, as in the code
    rim = int(np.ceil(2.2 * 0.8)) + 1
    rows, cols = (n + 2 * rim for n in size)
    rows, cols = next_fast_len(rows, real=True), next_fast_len(cols, real=True)
    fy, fx = np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols)[None]
    for slope, picture in zip(slopes, slices, strict=True):
        total = np.zeros((rows, cols // 2 + 1), complex)
        for j, down in enumerate(cells(shape[0])):
            for i, right in enumerate(cells(shape[1])):
                view = np.pad(
                    views.values[j, i, ..., 0].astype(float),
                    ((rim, rows - rim - size[0]), (rim, cols - rim - size[1])),
                    "edge",
                )
                phase = np.exp(2j * np.pi * slope * (fy * down + fx * right))
                total += np.fft.rfft2(view) * phase / np.prod(shape)
        exact = np.fft.irfft2(total, (rows, cols))[rim : rim + size[0], rim : rim + size[1]]
        assert np.abs(picture[..., 0] - exact).max() < 1e-5 * exact.max()


def test_stacks_are_pictures_one_by_one():
    random = np.random.default_rng(4)
    views = made_views(random.random((2, 3, 9, 11, 3), np.float32))
    distances = (0.3, 0.5, 1.0)
    stack = gs.focus_stack(views, distances=distances, device="opencl", aperture=np.ones((2, 3)))
    for picture, distance in zip(stack, distances, strict=True):
        assert np.array_equal(picture, gs.refocus(views, distance=distance, device="opencl"))
    assert np.array_equal(
        gs.refocus(views, device="opencl"), gs.refocus(views, distance=FOCUS, device="opencl")
    )


def test_bad_requests_are_one_line():
    views = made_views(np.ones((2, 2, 5, 5, 1)))
    wrong = [
        (lambda: gs.refocus(np.ones((2, 2, 5, 5, 1))), BadData, "wanted ViewImages"),
        (lambda: gs.refocus(views, distance=1.0, slope=1.0), Conflict, "a distance is given too"),
        (lambda: gs.refocus(views, distance=0.0), OutOfRange, "more than 0 m"),
        (lambda: gs.refocus(views, slope=np.nan), OutOfRange, "a finite number"),
        (lambda: gs.refocus(views, aperture=-1.0), OutOfRange, "radius"),
        (lambda: gs.refocus(views, aperture=0.01), OutOfRange, "one cell"),
        (lambda: gs.refocus(views, aperture=np.zeros((2, 2))), BadData, "no light"),
        (lambda: gs.refocus(views, aperture=np.ones(3)), BadData, "one number a view"),
        (lambda: gs.focus_stack(views), Conflict, "distances and slopes"),
        (lambda: gs.focus_stack(views, slopes=[]), BadData, "one or more"),
        (lambda: gs.refocus_by_slices(views, [30.0]), OutOfRange, "below 5 pixels"),
        (lambda: slopes_between(views, (1.0, 0.5)), OutOfRange, "nearest"),
        (lambda: slopes_between(views, (1e-6, 0.5)), OutOfRange, "fewer than"),
        (lambda: made_views(np.ones((2, 2, 5, 5))), BadData, "channels"),
        (lambda: made_views(np.full((2, 2, 5, 5, 1), np.nan)), BadData, "NaN"),
        (lambda: made_views(np.ones((1, 1, 2, 2, 1)), extent=0.0), OutOfRange, "extent"),
        (lambda: made_views(np.ones((1, 1, 2, 2, 1)), light=[[2.0]]), OutOfRange, "shares"),
    ]
    for call, kind, words in wrong:
        with pytest.raises(kind, match=words) as caught:
            call()
        assert "\n" not in str(caught.value)
    with limit_memory(10**3), pytest.raises(DoesNotFit):
        gs.focus_stack(views, slopes=np.arange(20.0), device="opencl")
    assert issubclass(DoesNotFit, GpusimError)
