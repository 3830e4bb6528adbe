"""The best demosaicking: its symmetries, what it reproduces exactly, and its quality sharp, blurred and in the dark."""

from itertools import product

import numpy as np
import pytest
from devices import ALL_KINDS, DEVICES
from test_demosaic import cpsnr, mosaic, noise, photographs

from gpusim.backends import open_device
from gpusim.backends.opencl import OpenCLDevice
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.kernels.processor.adaptive import adaptive
from gpusim.kernels.processor.bayer import RED
from gpusim.kernels.processor.best import best
from gpusim.kernels.processor.bilinear import bilinear
from gpusim.kernels.processor.learned import learned

pytestmark = pytest.mark.filterwarnings(
    "ignore:.*scipy.ndimage.filters:DeprecationWarning"
)  # colour-demosaicing's
TWELVE_BITS = {"black_level": 0.0, "scale": 1 / 4096}
OPTIONS = [
    {},
    {"domain": "linear"},
    {"noise": (2.0, 5.0)},
    {"domain": "linear", "noise": (2.0, 5.0), "blur": 0.5},
]
NAMES = ["root", "linear", "root, noise", "linear, noise, blur"]
ENCODED = {
    "phase": "RGGB",
    "black_level": 0.0,
    "scale": 1 / 255,
    "domain": "linear",
}  # an 8-bit photograph


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("options", OPTIONS, ids=NAMES)
def test_a_mirrored_mosaic_is_the_mirrored_picture_of_best(options, device):
    """No direction and no phase is preferred: the four phases and the transpose are mirror images of each other.

    Bit for bit on devices, whose sums do not know left from right; NumPy's do, by rounding.
    """
    raw = noise(62, 74)
    straight = best(raw, phase="RGGB", **TWELVE_BITS, **options, device=device)
    tolerance = 1e-12 if device == "numpy" else 0
    for turned, phase, back in (
        (raw[:, ::-1], "GRBG", np.s_[:, :, ::-1]),
        (raw[::-1], "GBRG", np.s_[:, ::-1]),
        (raw[::-1, ::-1], "BGGR", np.s_[:, ::-1, ::-1]),
    ):
        picture = best(
            np.ascontiguousarray(turned), phase=phase, **TWELVE_BITS, **options, device=device
        )
        np.testing.assert_allclose(picture[back], straight, rtol=0, atol=tolerance)
    transposed = best(
        np.ascontiguousarray(raw.T), phase="RGGB", **TWELVE_BITS, **options, device=device
    )
    np.testing.assert_allclose(transposed.transpose(0, 2, 1), straight, rtol=0, atol=tolerance)


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("options", OPTIONS, ids=NAMES)
def test_border_is_the_mirrored_mosaic(options, device):
    """A frame demosaicked alone is the inside of its mirrored surroundings, whatever its size."""
    for rows, cols in ((2, 2), (2, 5), (3, 4), (17, 20), (33, 38)):
        raw = noise(rows, cols)
        alone = best(raw, phase="GRBG", **TWELVE_BITS, **options, device=device)
        wide = best(
            np.pad(raw, 20, mode="reflect"), phase="GRBG", **TWELVE_BITS, **options, device=device
        )
        np.testing.assert_allclose(
            alone, wide[:, 20:-20, 20:-20], rtol=0, atol=1e-12 if device == "numpy" else 0
        )


@pytest.mark.parametrize("device", ALL_KINDS)
def test_red_and_blue_are_treated_alike(device):
    raw = noise(20, 21)
    np.testing.assert_array_equal(
        best(raw, phase="RGGB", **TWELVE_BITS, device=device)[::-1],
        best(raw, phase="BGGR", **TWELVE_BITS, device=device),
    )


@pytest.mark.parametrize("device", ALL_KINDS)
def test_brightness_does_not_matter(device):
    """Four times the exposure gives the same picture bit for bit: all thresholds are fractions of the full scale."""
    raw = noise(20, 21)
    for four_times, once in (({}, {}), ({"noise": (8.0, 20.0)}, {"noise": (2.0, 5.0)})):
        np.testing.assert_array_equal(
            best(
                4 * raw, phase="GRBG", black_level=0.0, scale=1 / 16384, **four_times, device=device
            ),
            best(raw, phase="GRBG", black_level=0.0, scale=1 / 4096, **once, device=device),
        )


@pytest.mark.parametrize("device", ALL_KINDS)
def test_flat_field_stays_flat_at_any_size(device):
    for shape in ((1, 1), (1, 6), (7, 1), (2, 2), (2, 5), (3, 5), (33, 38)):
        for phase in RED:
            out = best(
                np.full(shape, 700, np.uint16),
                phase=phase,
                black_level=64.0,
                scale=1 / 959,
                device=device,
            )
            # Root, quotients, blends, square: below 16 roundings of 2^-24.
            np.testing.assert_allclose(out, 636 / 959, rtol=1e-6)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_measured_samples_are_kept(device):
    for phase, options in product(RED, ({}, {"domain": "linear"}, {"blur": 1.0})):
        raw = noise(33, 35)
        out = best(raw, phase=phase, **TWELVE_BITS, **options, device=device)
        np.testing.assert_array_equal(
            4096 * mosaic(np.moveaxis(out, 0, 2), phase), raw
        )  # a power of two: exact


@pytest.mark.parametrize("device", ALL_KINDS)
def test_colored_planes_are_exact(device):
    """Three unrelated linear ramps: no bends, so the gains are 1, the differences linear and their means exact."""
    y, x = np.mgrid[:60, :64]
    image = np.stack([300 + 7 * x + 3 * y, 900 - 5 * x + 2 * y, 400 + 4 * x + 9 * y], 2).astype(
        np.uint16
    )
    for phase in RED:
        out = best(mosaic(image, phase), phase=phase, **TWELVE_BITS, domain="linear", device=device)
        # Away from the mirrored border, whose bend reaches 14 pixels in. 48 roundings of codes below 1.
        np.testing.assert_allclose(
            out[:, 14:-14, 14:-14],
            np.moveaxis(image / 4096, 2, 0)[:, 14:-14, 14:-14],
            atol=48 * 2.0**-24,
        )


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("device", ALL_KINDS)
def test_gray_edge_has_no_zipper(axis, device):
    """Along a gray step all differences vanish; across it the four sides' weights are below theirs.

    Step 1/4 of the full scale. A side across the step has differences of at least h = 3/8 of the step at a pixel next
    to it (a gain of 1 overshoots by 1/8, of 0 by 1/2; between them the other pixel's does), and so a weight below
    (EDGE / (EDGE + 3 h))^2 = (.0196 / .30)^2 = .0043 of the sides along it; its estimate is off by less than half a
    step. So green errs by less than .0043 steps, and red and blue, which take green's error over at most three times
    (own, two neighbours'), by less than .013.
    """
    step = np.where(np.arange(40) < 19, 1000, 2024).astype(np.uint16)
    image = np.broadcast_to(step if axis else step[:, None], (40, 40)).copy()
    sharp = 4096 * best(image, phase="RGGB", **TWELVE_BITS, domain="linear", device=device)
    assert np.abs(sharp - image).max() < 0.013 * 1024
    plain = 4096 * bilinear(image, phase="RGGB", **TWELVE_BITS, device=device)
    assert np.abs(plain - image).max() > 0.249 * 1024


@pytest.mark.parametrize("domain", ["root", "linear"])
@pytest.mark.parametrize("electrons", [5, 20, 200])
def test_noise_of_a_flat_field_falls_and_its_mean_stays(electrons, domain):
    """Known noise is averaged; roots and shrinkage must not darken the picture.

    128 x 128 pixels of Poisson light and 2 e- read noise. Drawing leaves less than half of the variance (bilinear's
    mean of 4 would leave a quarter, of kept samples a part stays). The mean may be off by a tenth of one electron (the
    root's correction is of second order, and clipping at 0 DN is avoided by the black level of 50) and by four standard
    errors of the mean of the samples, which averaging with unequal weights may double.
    """
    random = np.random.default_rng(6)
    field = random.poisson(electrons, (128, 128)) + random.normal(0, 2, (128, 128))
    raw = np.round(50 + 4 * field).clip(0).astype(np.uint16)
    white = 10000  # electrons
    result = white * best(
        raw,
        phase="RGGB",
        black_level=50.0,
        scale=0.25 / white,
        noise=(4.0, 8.0),
        domain=domain,
        device="opencl",
    )
    variance = electrons + 4
    assert abs(result.mean() - field.mean()) < 0.1 + 8 * np.sqrt(variance / field.size)
    assert result.var() < variance / 2


@pytest.mark.parametrize("read", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("electrons", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("balance", [(1.0, 1.0), (0.5, 2.0)], ids=["as it comes", "balanced"])
def test_dark_greys_have_no_cast(electrons, read, balance):
    """Means of the three planes over 256 x 256 pixels of dark grey are those of the light within 4 standard errors.

    Of each channel's samples, a quarter of the pixels for red and blue, half for green. balance: red twice as strong,
    blue half as strong as green, so that white is grey again.
    """
    random = np.random.default_rng(8)
    size, gain, black, white = 256, 8.0, 500.0, 6000.0
    means = electrons / np.array([balance[0], 1.0, balance[1]])
    light = np.tile([[means[0], means[1]], [means[1], means[2]]], (size // 2, size // 2))
    raw = black + gain * (random.poisson(light) + read * random.standard_normal(light.shape))
    planes = white * best(
        np.round(raw).astype(np.uint16),
        phase="RGGB",
        black_level=black,
        scale=1 / (gain * white),
        noise=(gain, gain * read),
        balance=balance,
        device="opencl",
    ).astype(float)
    for plane, mean, share in zip(planes, means, (4, 2, 4), strict=True):
        assert abs(plane.mean() - mean) < 4 * np.sqrt((mean + read**2) * share) / size


@pytest.mark.parametrize(("mean", "read"), [(1, 2), (4, 5), (40, 1)])
def test_drawing_keeps_the_mean_of_measured_samples(mean, read):
    """What is drawn takes as much as it gives: at each kind of site the mean stays that of its samples.

    Drawing moves a value by half of the noise or less (one mean of four has 1.1 times it); of 512 x 512 such moves the
    mean scatters by 1/512 of that, taken four times. Drawn roots would lose a twentieth of an electron here and more.
    """
    random = np.random.default_rng(9)
    field = random.poisson(mean, (1024, 1024)) + read * random.standard_normal((1024, 1024))
    raw = np.round(200 + 4 * field).astype(np.uint16)
    out = 4000 * best(
        raw,
        phase="RGGB",
        black_level=200.0,
        scale=1 / 16000,
        noise=(4.0, 4.0 * read),
        device="opencl",
    ).astype(float)
    exact = (raw - 200.0) / 4
    for plane, site in (
        (0, np.s_[::2, ::2]),
        (1, np.s_[::2, 1::2]),
        (1, np.s_[1::2, ::2]),
        (2, np.s_[1::2, 1::2]),
    ):
        assert (
            abs(out[plane][site].mean() - exact[site].mean())
            < 4 * 0.55 * np.sqrt(mean + read**2) / 512
        )


@pytest.mark.parametrize("options", OPTIONS, ids=NAMES)
def test_gpu_form_is_the_cpu_form(options):
    """OpenCL's two forms, one pass over strips and kernels over tiles, agree bit for bit on a CPU.

    GPUs may divide otherwise (native_divide): there the stage's cases compare them with the reference.
    """
    device = next(
        device
        for device in map(open_device, DEVICES)
        if device.kind == "opencl" and not device.is_gpu
    )
    gpu = OpenCLDevice(device.cl_device, "opencl, GPU form")
    gpu.is_gpu = True
    cpu = OpenCLDevice(device.cl_device, "opencl, CPU form")
    cpu.is_gpu = False
    raw = noise(300, 131)  # several strips
    for phase in ("RGGB", "GBRG"):
        np.testing.assert_array_equal(
            best(raw, phase=phase, **TWELVE_BITS, **options, device=gpu),
            best(raw, phase=phase, **TWELVE_BITS, **options, device=cpu),
        )


def test_wrong_input_is_refused():
    options = {"phase": "RGGB", **TWELVE_BITS, "device": "opencl"}
    for name, value in (("phase", "RGBG"), ("domain", "log")):
        with pytest.raises(UnknownName):
            best(noise(4, 4), **{**options, name: value})
    for bad in (
        np.ones((4, 4), np.float32),
        np.ones((3, 4, 4), np.uint16),
        np.ones((0, 4), np.uint16),
    ):
        with pytest.raises(BadData):
            best(bad, **options)
    for name, value in (
        ("scale", 0.0),
        ("blur", -0.1),
        ("blur", np.nan),
        ("blur", np.inf),
        ("noise", (-1.0, 0.0)),
        ("noise", (1.0, np.nan)),
        ("noise", (np.inf, 1.0)),
    ):
        with pytest.raises(OutOfRange):
            best(noise(4, 4), **{**options, name: value})


# Quality -------------------------------------------------------------------------------------------------------------


def light(code):
    """Linear light 0..1 of sRGB codes 0..255 (IEC 61966-2-1)."""
    code = np.asarray(code, np.float64) / 255
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def codes(linear):
    linear = np.clip(linear, 0, 1)
    return 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def captured(image, *, electrons=None, blur=0.0, seed=0, methods=(bilinear, best)):
    """CPSNR [dB] of methods after sRGB encoding; the mosaic is seen in linear light, blurred, as digital numbers.

    electrons: mean over the mosaic; Poisson noise and 2 e- of read noise, a gain that puts white at 40000 DN.
        None: no noise.
    """
    from scipy.ndimage import gaussian_filter

    linear = light(image)
    if blur:
        linear = gaussian_filter(linear, (blur, blur, 0), mode="mirror")
    samples = mosaic(linear)
    white, black, known = 40000.0, 2000.0, {"blur": blur}
    if electrons is None:
        numbers = black + white * samples
    else:
        random = np.random.default_rng(seed)
        scale = electrons / samples.mean()  # electrons at white
        seen = random.poisson(samples * scale) + random.normal(0, 2, samples.shape)
        numbers = black + white / scale * seen
        known["noise"] = (white / scale, 2 * white / scale)
    raw = np.clip(np.round(numbers), 0, 65535).astype(np.uint16)
    quality = []
    for method in methods:
        options = (
            known
            if method is best
            else {key: known[key] for key in ("noise",) if key in known and method is learned}
        )
        rgb = method(
            raw, phase="RGGB", black_level=black, scale=1 / white, **options, device="opencl"
        )
        quality.append(cpsnr(codes(np.moveaxis(rgb.astype(np.float64), 0, 2)), codes(linear)))
    return quality


def encoded_quality(image):
    return cpsnr(255 * np.moveaxis(best(mosaic(image), **ENCODED, device="opencl"), 0, 2), image)


@pytest.mark.parametrize("folder", ["kodak", "mcm"])
def test_never_below_bilinear(shared_data, folder):
    """One picture of each set; the whole sweep is marked slow."""
    image = next(photographs(shared_data / folder))[100:356, 100:356]
    for electrons, blur in product((5, 100, None), (0.0, 0.8, 2.0)):
        plain, ours = captured(image, electrons=electrons, blur=blur)
        assert ours > plain, (electrons, blur)


@pytest.mark.parametrize("folder", ["kodak", "mcm"])
def test_quality_on_one_photograph(shared_data, folder):
    """Its first pictures are the hard ones: sharp, the adaptive stage is surpassed by .3 dB, blurred by .5 dB."""
    image = next(photographs(shared_data / folder))
    sharp = cpsnr(
        255 * np.moveaxis(adaptive(mosaic(image), **ENCODED, device="opencl"), 0, 2), image
    )
    assert encoded_quality(image) > sharp + 0.3
    soft, ours = captured(image, blur=0.8, methods=(adaptive, best))
    assert ours > soft + 0.5


def test_read_noise_alone_keeps_the_root():
    """With no or hardly any shot noise the result goes to that without noise, and stays above the adaptive stage's.

    A picture of its own: coloured discs over each other, some dark. Read noise in parts of white.
    """
    random = np.random.default_rng(11)
    y, x = np.mgrid[:160, :160]
    image = np.full((160, 160, 3), 128.0)
    for _ in range(400):
        row, col = random.uniform(0, 160, 2)
        image[np.hypot(y - row, x - col) < random.uniform(3, 15)] = (
            255 * random.uniform(0, 1, 3) ** 2
        )
    linear = light(image)
    for read in (0.0, 1e-10, 1e-6, 1e-3, 1e-2, 0.03):
        samples = mosaic(linear) + read * random.standard_normal((160, 160))
        raw = np.clip(np.rint(4000 + 40000 * samples), 0, 65535).astype(np.uint16)
        options = {"phase": "RGGB", "black_level": 4000.0, "scale": 1 / 40000, "device": "opencl"}
        quality = [
            cpsnr(codes(np.moveaxis(picture.astype(float), 0, 2)), codes(linear))
            for picture in (
                adaptive(raw, **options),
                best(raw, **options),
                *(best(raw, noise=(40000 * gain, 40000 * read), **options) for gain in (0.0, 1e-8)),
            )
        ]
        assert min(quality[2:]) > quality[0], read
        if read < 1e-5:  # its assumed noise, .16 (read / 20)^.5 of a code's scale, is below a 255th
            np.testing.assert_allclose(quality[2:], quality[1], atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["kodak", "mcm"])
def test_never_below_bilinear_at_any_noise_or_blur(shared_data, folder):
    gains = {}
    for electrons, blur in product((5, 20, 100, 1000, None), (0.0, 0.5, 0.8, 1.2, 2.0)):
        results = np.array(
            [
                captured(image[60:444, 60:444], electrons=electrons, blur=blur, seed=number)
                for number, image in enumerate(photographs(shared_data / folder))
            ]
        )
        gains[electrons, blur] = (results[:, 1] - results[:, 0]).min()
        plain, ours = results.mean(0)
        print(
            f"{folder} {electrons} e- blur {blur}: bilinear {plain:.2f}, best {ours:.2f} dB; "
            f"least gain of a picture {gains[electrons, blur]:.2f}"
        )
    assert min(gains.values()) > 0


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["kodak", "mcm"])
def test_blurred_it_surpasses_the_adaptive_stage(shared_data, folder):
    """Gaussian blur of 0.8 pixel on linear light, no noise: 0.5 dB over soft Hamilton-Adams in the same domain."""
    soft, ours = np.mean(
        [
            captured(image, blur=0.8, methods=(adaptive, best))
            for image in photographs(shared_data / folder)
        ],
        axis=0,
    )
    print(f"{folder}, blur 0.8: adaptive {soft:.2f}, best {ours:.2f} dB")
    assert ours > soft + 0.5


@pytest.mark.slow
@pytest.mark.parametrize(("folder", "gain"), [("kodak", 0.7), ("mcm", 1.9)])
def test_quality_against_menon(shared_data, folder, gain):
    """Constants were chosen on the first, third, fifth .. picture of each set: both halves must hold."""
    from colour_demosaicing import demosaicing_CFA_Bayer_Menon2007

    results = np.array(
        [
            [
                encoded_quality(image),
                cpsnr(demosaicing_CFA_Bayer_Menon2007(mosaic(image).astype(float)), image),
            ]
            for image in photographs(shared_data / folder)
        ]
    )
    for name, half in (("chosen on", results[::2]), ("held out", results[1::2])):
        ours, menon = half.mean(0)
        print(f"{folder}, {name} ({len(half)}): best {ours:.2f}, Menon {menon:.2f} dB")
        assert ours > menon + gain
