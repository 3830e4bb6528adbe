"""Bursts and brackets of a shaken camera: displacements, merged samples, ghosts, larger pictures.

The scene is a sum of Gaussian spots on a grey wall, whose light on a square pixel is known in closed form (error
functions) at any displacement. Frames are drawn from it by NumPy.
"""

import dataclasses
import functools

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.special import erf

import gpusim as gs
from gpusim.backends import open_device
from gpusim.captures import regression
from gpusim.captures.merge import merge_bracket, merge_burst
from gpusim.captures.regression import Views
from gpusim.cli.captures import parse_capture
from gpusim.cli.main import main
from gpusim.domain.errors import Conflict, OutOfRange
from gpusim.kernels.common.cases import MOSAICS
from gpusim.kernels.processor.best import best

ROWS, COLS, COUNT = 128, 160, 8
WHITE, READ, GAIN, BLACK = 250.0, 2.0, 4.0, 64  # [e-], [e-], [DN/e-], [DN]
SHARES = np.array([0.6, 1.0, 0.7])  # of white in red, green and blue
SHIFTS = np.random.default_rng(4).uniform(-5, 5, (COUNT, 2))
SHIFTS[0] = 0
EDGE = 10  # [pixel] left out: some frames do not see it


@functools.cache
def spots():
    """Places [pixel], widths [pixel], heights and colours of the spots: many small ones of similar colours."""
    random = np.random.default_rng(1)
    count = 1500
    places = random.uniform(-12, [[ROWS + 12, COLS + 12]] * count)
    widths, heights = np.exp(random.uniform(-1.2, 1.2, count)), random.uniform(-0.4, 0.5, count)
    return places, widths, heights, random.uniform(0.6, 1, (count, 3))


def light(shift=(0.0, 0.0), per_pixel=1.0):
    """The scene from a camera moved by `shift` [pixel], white 1, (rows, cols, 3); pixels are 1 wide at any sampling."""

    def means(size, middles, width, moved):
        at = (np.arange(round(size * per_pixel)) + 0.5) / per_pixel - 0.5 + moved
        edges = [erf((at[:, None] + d - middles) / (width * 2**0.5)) for d in (-0.5, 0.5)]
        return (edges[1] - edges[0]) * width * (np.pi / 2) ** 0.5

    places, widths, heights, colours = spots()
    down = means(ROWS, places[:, 0], widths, shift[0])
    across = means(COLS, places[:, 1], widths, shift[1])
    planes = [(down * heights * colour) @ across.T for colour in colours.T]
    return np.maximum(0.35 + np.stack(planes, axis=-1), 0.02)


def mosaic(picture, cfa):
    rows, cols = picture.shape[:2]
    channel = cfa[np.arange(rows)[:, None] % len(cfa), np.arange(cols) % len(cfa[0])]
    return np.take_along_axis(picture * SHARES, channel[..., None], 2)[..., 0]


def digitise(electrons, seed):
    random = np.random.default_rng(seed)
    numbers = BLACK + GAIN * (random.poisson(electrons) + random.normal(0, READ, electrons.shape))
    return np.rint(np.clip(numbers, 0, 65535)).astype(np.uint16)


def table(times=(1.0,) * COUNT, full=65535.0):
    times, ones = np.array(times), np.ones(len(times))
    noise = (READ**2 + 1 / (12 * GAIN**2)) / times**2
    return np.array([BLACK * ones, 1 / (GAIN * times), 1 / times, noise, full * ones])


@functools.cache
def views(name="Bayer", kind="shaken"):
    """Eight frames of a mosaic as `Views`. kind: "shaken", or "moving" with a disc that moves."""
    pictures = [light(shift) for shift in SHIFTS]
    if kind == "moving":
        y, x = np.mgrid[:ROWS, :COLS]
        for k, (picture, shift) in enumerate(zip(pictures, SHIFTS, strict=True)):
            disc = (y + shift[0] - 64) ** 2 + (x + shift[1] - 35 - 12 * k) ** 2 < 13**2
            picture[disc] = 0.9
    raw = [digitise(WHITE * mosaic(one, MOSAICS[name]), k) for k, one in enumerate(pictures)]
    return Views(open_device("opencl:0"), np.array(raw)[None], 0, MOSAICS[name], table())


def merged(frames, **options):
    """The picture of frames, white 1, (rows, cols, 3)."""
    planes, fitted = frames.merge(frames.align(), WHITE * SHARES, None, **options)
    assert fitted == "raw samples"
    return np.moveaxis(planes, 0, -1) / (WHITE * SHARES)


def psnr(picture, truth, edge=EDGE):
    return -10 * np.log10(np.mean((picture - truth)[edge:-edge, edge:-edge] ** 2))


def developed(raw):
    """A frame demosaicked by `best`, white 1."""
    planes = best(
        raw,
        phase="RGGB",
        black_level=float(BLACK),
        scale=1 / (GAIN * WHITE),
        noise=(GAIN, float(np.hypot(GAIN * READ, 12**-0.5))),
        balance=(1 / SHARES[0], 1 / SHARES[2]),
        device="opencl:0",
    )
    return np.moveaxis(np.asarray(planes), 0, -1) / SHARES


def moved(picture, shift, per_pixel=1.0):
    """A picture drawn at other places, by cubic splines."""
    rows, cols = (round(n * per_pixel) for n in picture.shape[:2])
    y, x = (np.mgrid[:rows, :cols] + 0.5) / per_pixel - 0.5
    places = [y - shift[0], x - shift[1]]
    return np.stack(
        [map_coordinates(plane, places, order=3) for plane in np.moveaxis(picture, -1, 0)], -1
    )


def test_displacements_are_found_to_hundredths_of_a_pixel():
    """The content allows a deviation of .008 pixel at 250 e- (Cramer and Rao, from the closed form's slopes).

    Tents blur the slopes to a half or less, and take a turn and a zoom for possible: some
    three times that. The search's paraboloids are 0.1 off where sharp edges fall between samples.
    """
    truth = light()
    slopes = np.gradient(truth, axis=0)
    variance = (truth * SHARES * WHITE + READ**2) / (SHARES * WHITE) ** 2
    # the pixels of a Bayer mosaic, of both frames
    least = (2 / (slopes**2 / variance @ [0.25, 0.5, 0.25]).sum()) ** 0.5
    frames = views()
    error = (frames.align() * 2 + SHIFTS[:, None, None])[1:]
    rough = (frames.search() * 2 + SHIFTS[:, None, None])[1:]
    deviation = np.sqrt((error**2).mean())
    assert deviation < 3 * least
    assert np.abs(error).max() < 0.06
    assert np.sqrt((rough**2).mean()) > 3 * deviation


@pytest.mark.slow
def test_a_turned_camera_is_followed():
    """A roll of 1 degree about the upper left corner: tiles differ by 2 pixels, and the movement is one."""
    frames, turn = views(), np.deg2rad(1.0)
    y, x = np.mgrid[:ROWS, :COLS].astype(float)
    fine = np.moveaxis(light(per_pixel=4.0), -1, 0)
    places = [y * np.cos(turn) + x * np.sin(turn), x * np.cos(turn) - y * np.sin(turn)]
    at = [(place + 0.5) * 4 - 0.5 for place in places]
    seen = [map_coordinates(plane, at, order=3, mode="nearest") for plane in fine]
    other = digitise(WHITE * mosaic(np.stack(seen, -1), MOSAICS["Bayer"]), 99)
    raw = np.array([frames.layers[0, 0], other])
    pair = Views(frames.device, raw[None], 0, MOSAICS["Bayer"], table((1.0, 1.0)))
    found = pair.align()[1] * 2
    v, u = np.meshgrid(*((np.arange(n) + 0.5) * 32 - 0.5 for n in found.shape[:2]), indexing="ij")
    # the frame shows at q what the scene has at R q: what the reference has at p is at R^-1 p
    down = v * np.cos(turn) - u * np.sin(turn) - v
    right = u * np.cos(turn) + v * np.sin(turn) - u
    assert np.ptp(down) > 2 and np.ptp(right) > 1.5
    # as above, and six numbers in place of two: the corners err by three times as much
    assert np.abs(found - np.stack([down, right], axis=-1)).max() < 0.1


@pytest.mark.slow
def test_merged_samples_are_ahead_of_developed_frames():
    """Eight frames of 250 e-, against frames developed by `best` and averaged by their true shifts."""
    truth, frames = light(), views()
    peers = np.mean(
        [moved(developed(raw), s) for raw, s in zip(frames.layers[0], SHIFTS, strict=True)], axis=0
    )
    # every 20000 values have a standard error of 1 / sqrt(2 20000) = .5 % of the error, .04 dB each
    assert psnr(merged(frames), truth) > psnr(peers, truth) + 0.5
    assert psnr(peers, truth) > psnr(developed(frames.layers[0, 0]), truth) + 5


@pytest.mark.slow
@pytest.mark.parametrize("name", ["X-Trans", "quad-Bayer", "GBRG", "grey"])
def test_every_mosaic_is_merged(name):
    """The level is the scene's, and noise falls by more than eight frames' average of one frame's samples."""
    truth, frames = light(), views(name)
    if name == "grey":
        truth = truth[..., :1]
        planes, _ = frames.merge(frames.align(), WHITE * SHARES[:1], None)
        found = np.moveaxis(planes, 0, -1) / (WHITE * SHARES[:1])
    else:
        found = merged(frames)
    inner = np.s_[EDGE:-EDGE, EDGE:-EDGE]
    # 8 x 15000 samples of 10 % noise: .03 %; the fit is not linear, kernels follow the noise: 1 %
    assert found[inner].mean(axis=(0, 1)) == pytest.approx(truth[inner].mean(axis=(0, 1)), rel=0.01)
    noise = np.sqrt((truth.mean() * WHITE * 0.77 + READ**2) / (WHITE * 0.77) ** 2)
    # a third of the samples has each colour, an eighth of that noise variance is left by eight frames
    assert psnr(found, truth) > -20 * np.log10(noise * np.sqrt(3 / 8))


def test_what_moves_leaves_no_ghost_in_a_shaken_burst(monkeypatch):
    """A disc of .9 crosses the picture. Without the mask its ghosts, an eighth of their contrast each, are seen."""
    frames = views(kind="moving")
    truth = light()
    y, x = np.mgrid[:ROWS, :COLS]
    truth[(y - 64) ** 2 + (x - 35) ** 2 < 13**2] = 0.9
    path = np.s_[52:76, 52:132]  # where the disc is in the others, not in the reference

    def ghost():
        """The largest mean error of blocks of 8 x 8 pixels of the path."""
        error = (merged(frames) - truth)[path].reshape(3, 8, 10, 8, 3).mean(axis=(1, 3))
        return np.abs(error).max()

    # seven frames are left: noise of a block of 64 pixels, a third of one colour, 5 deviations
    noise = np.sqrt(1 / (WHITE * 0.5) / (7 * 64 / 3))
    assert ghost() < 5 * noise + 0.02  # and what the mask lets pass, see `processor.trust`
    monkeypatch.setattr(
        regression, "trust", lambda raw, *_, **options: np.ones((COUNT, 64, 80), np.float32)
    )
    assert ghost() > 0.06


def test_a_larger_picture_is_better_than_one_frame_enlarged():
    """Twice the rows and columns: eight frames have 9 dB less noise than the one that cubic splines enlarge."""
    frames, truth = views(), light(per_pixel=2.0)
    found = merged(frames, enlarge=2.0)
    assert found.shape == truth.shape
    single = moved(developed(frames.layers[0, 0]), (0, 0), 2.0)
    # 3 dB less for details that `best` removes with the noise
    assert psnr(found, truth, 2 * EDGE) > psnr(single, truth, 2 * EDGE) + 6


# --- through a camera -------------------------------------------------------------------------------------------------

PHONE = gs.open_camera("phone")


@functools.cache
def simulator(**sensor):
    noise = dataclasses.replace(PHONE.sensor.noise, prnu=0.0, dsnu=0.0)
    processor = dataclasses.replace(PHONE.processor, demosaic="best")
    made = dataclasses.replace(PHONE.sensor, noise=noise, **sensor)
    return gs.Simulator(
        dataclasses.replace(PHONE, sensor=made, processor=processor), device="opencl:0"
    )


@functools.cache
def leaves():
    return gs.chart("deadleaves", size=(2 * (COLS + 32), 2 * (ROWS + 32)))


def seen(shift, disc=None):
    """Dead leaves from a camera moved by `shift` pixels, to half of one. disc: place of a white disc, if any."""
    content = leaves().content
    top, left = (round((16 + d) * 2) for d in shift)
    cut = np.s_[top : top + 2 * ROWS, left : left + 2 * COLS]
    shading = content.shading[cut].copy()
    if disc is not None:
        y, x = np.mgrid[: 2 * ROWS, : 2 * COLS]
        shading[(y - 2 * disc[0]) ** 2 + (x - 2 * disc[1]) ** 2 < 26**2] *= 2
    content = dataclasses.replace(content, ids=content.ids[cut], shading=shading)
    return dataclasses.replace(leaves(), samples_per_pixel=2, content=content)


def exposures(shifts, stops, discs=None):
    """Frames of `seen` at shifts and stops, and the noise-free picture of the middle one."""
    simulate = simulator()
    time = simulate.expose(seen((0, 0))).exposure_time
    frames = []
    for k, (shift, stop) in enumerate(zip(shifts, stops, strict=True)):
        scene = seen(shift, None if discs is None else discs[k])
        frames.append(simulate.expose(scene, time * 2.0**stop).frame(seed=3, first=k))
    return frames


@pytest.mark.parametrize(
    ("stops", "shifts"),
    [
        ((-4, -2, 0), [(0.5, -1.5), (0, 0), (-4.5, 3)]),
        pytest.param((-4, -2, 0), [(5, 7), (0, 0), (-5, -7)], marks=pytest.mark.slow),
        pytest.param((-4, -2, 0), [(4, 6), (0, 0), (-2, 8)], marks=pytest.mark.slow),
        pytest.param((0, -2, 0), [(0.5, -1.5), (0, 0), (-4.5, 3)], marks=pytest.mark.slow),
        pytest.param((0, -2, 0), [(5, 7), (0, 0), (-5, -7)], marks=pytest.mark.slow),
    ],
)
def test_a_shaken_bracket_is_aligned(stops, shifts):
    """As good as one at rest within 1 dB; without alignment it is at least 8 dB worse. Also long, short, long."""
    frames, still = exposures(shifts, stops), exposures([(0, 0)] * 3, stops)
    simulate = simulator()
    # ordered by what they hold, the middle of the three is the reference
    order = sorted(range(3), key=lambda k: (stops[k], k))
    at = shifts[order[1]]
    truth = gs.Simulator(
        dataclasses.replace(
            simulate.camera,
            sensor=dataclasses.replace(
                simulate.camera.sensor, stacked=True, noise=gs.Noise(photon="none")
            ),
        ),
        device="opencl:0",
    )
    wanted = truth.expose(seen(at), frames[order[1]].exposure_time).frame().linear
    resting = truth.expose(seen((0, 0)), frames[order[1]].exposure_time).frame().linear
    merged = merge_bracket(simulate, frames).linear
    # 15000 pixels of 10 % noise: .1 % in each, 4 of these; a black level in the wrong place would be seen
    inner = np.s_[EDGE:-EDGE, EDGE:-EDGE]
    assert merged[inner].mean() == pytest.approx(frames[order[1]].linear[inner].mean(), rel=0.0055)
    found = psnr(merged, wanted)
    assert found > psnr(merge_bracket(simulate, still).linear, resting) - 1
    assert found > psnr(merge_bracket(simulate, frames, align=False).linear, wanted) + 8


@pytest.mark.slow
def test_what_moves_appears_once_in_a_bracket():
    """A disc at another place in each exposure, camera at rest: its places in the others show the background."""
    discs = [(60, 40), (60, 80), (60, 120)]
    stops = (-2, 0, -1)
    frames = exposures([(0, 0)] * 3, stops, discs)
    simulate = simulator()
    # the middle one in the order of what they hold
    clean = simulate.expose(seen((0, 0), discs[2]), frames[2].exposure_time)
    wanted = np.array(simulate.device.numpy(clean.mean)) / clean.exposure_time
    for options, is_clean in (({}, True), ({"align": False}, False)):
        merged = merge_bracket(simulate, frames, **options)
        error = merged.mean / merged.exposure_time / wanted - 1
        for y, x in discs[:2]:
            # a disc is twice as bright; 256 pixels of 3 % noise leave .2 %, half of the trust's band 2 %
            part = abs(error[y - 8 : y + 8, x - 8 : x + 8].mean())
            assert part < 0.025 if is_clean else part > 0.05


@pytest.mark.slow
def test_a_burst_at_rest_or_in_whole_periods_is_averaged():
    """Its mosaic has an n-th of the variance; a burst at half pixels is fitted."""
    whole = exposures([(0, 0), (2, -4), (-6, 2)], (-3,) * 3)
    half = exposures([(0, 0), (2.5, -4), (-6, 1.5), (1.5, 1), (3, 3.5), (-1, -2.5)], (-3,) * 6)
    stages = [
        {stage.stage for stage in merge_burst(simulator(), frames).report.stages}
        for frames in (whole, half)
    ]
    assert "processor.average" in stages[0] and "processor.regress" not in stages[0]
    assert "processor.regress" in stages[1] and "processor.average" not in stages[1]


@pytest.mark.slow
def test_a_few_frames_are_fitted_after_demosaicking():
    """Three frames have too few samples for the two colours of a Bayer mosaic that are a quarter of it."""
    frames = exposures([(0, 0), (2.5, -4), (-6, 1.5)], (-3,) * 3)
    merged = merge_burst(simulator(), frames)
    models = {stage.stage: stage.model for stage in merged.report.stages}
    assert models["processor.regress"].startswith("demosaicked frames of 3 frames")
    truth = frames[0].mean
    assert merged.mean.mean() / 3 == pytest.approx(truth.mean(), rel=0.01)


@pytest.mark.slow
def test_an_enlarged_burst_is_a_camera_of_finer_pixels():
    frames = exposures([(0, 0), (2.5, -4), (-6, 1.5), (0.5, 0.5)], (-3,) * 4)
    taken = gs.Burst(3, enlarge=2.0, merged=True).take(simulator(), gs.chart("flat", size=(40, 36)))
    assert taken[0].rgb.shape == (72, 80, 3)
    merged = merge_burst(simulator(), frames, enlarge=1.5)
    assert merged.linear.shape == (1.5 * ROWS, 1.5 * COLS, 3)
    assert merged.mean.shape == merged.raw.shape == (1.5 * ROWS, 1.5 * COLS)
    assert merged.camera.sensor.pixel_pitch == pytest.approx(PHONE.sensor.pixel_pitch / 1.5)
    plain = merge_burst(simulator(), frames)
    assert merged.linear.mean() == pytest.approx(plain.linear.mean(), rel=0.01)


def test_options_of_bursts_and_brackets(tmp_path, capsys):
    assert parse_capture("burst=4,merged,enlarge=1.5") == gs.Burst(4, enlarge=1.5, merged=True)
    assert parse_capture("bracket=-2:0,merged,unaligned") == gs.Bracket(
        (-2, 0), align=False, merged=True
    )
    for text in (
        "bracket=-2:0,merged,enlarge=2",
        "burst=2,merged,unaligned",
        "bracket=-2:0,unaligned",
        "burst=2,enlarge=2",
    ):
        with pytest.raises(Exception, match=r"enlarge|unaligned"):
            parse_capture(text)
    with pytest.raises(Conflict, match="enlarge"):
        gs.Burst(4, enlarge=1.5)
    for wrong in (0.5, 4, "x"):
        with pytest.raises(OutOfRange, match="enlarge"):
            gs.Burst(4, enlarge=wrong, merged=True)
    large = gs.Burst(2, enlarge=2.0, merged=True)
    with pytest.raises(Conflict, match="enlarge"):
        large.output(simulator().loop(gs.chart("flat", size=(40, 36))), "codes")
    given = ["--camera", "phone", "--exposure", "5ms", "--capture", "burst=2,merged,enlarge=2"]
    for command in ("video", "pairs"):
        main([command, "colorchecker", *given, "-o", str(tmp_path / "x.npz")])
        assert "enlarge" in capsys.readouterr().err
    frames = exposures([(0, 0), (0, 0)], (-3, -3))
    with pytest.raises(OutOfRange, match="enlarge"):
        merge_burst(simulator(), frames, enlarge=5)
