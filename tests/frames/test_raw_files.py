"""Raw files of simulated frames: their levels, their noise, and the colours that raw converters make of them."""

from dataclasses import replace

import numpy as np
import pytest
import rawpy
from cameras import camera_with
from exif import exiftool

import gpusim as gs
from gpusim.data.charts import colorchecker_patches
from gpusim.domain.errors import OutOfRange
from gpusim.domain.mosaics import MOSAICS

SIZE = (192, 128)
CLEAN = gs.Noise(photon="none")
D65 = np.array([0.3127 / 0.3290, 1, (1 - 0.3127 - 0.3290) / 0.3290])
D50 = np.array([0.9642, 1, 0.8249])
BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
SRGB = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)  # IEC 61966-2-1
CURVES = {
    "R": (0.02, 0.03, 0.1, 0.6, 0.05),
    "G": (0.03, 0.1, 0.6, 0.1, 0.02),
    "B": (0.1, 0.6, 0.1, 0.02, 0.01),
    "W": (0.3, 0.8, 0.85, 0.7, 0.1),
    "C": (0.3, 0.55, 0.5, 0.05, 0.01),
    "M": (0.2, 0.5, 0.08, 0.5, 0.1),
    "Y": (0.02, 0.08, 0.6, 0.5, 0.05),
}  # electrons per photon at 360, 450, 550, 640 and 830 nm


def tags_of(path):
    """Numbers of a DNG's tags, of which exiftool approves."""
    return {name: np.ravel(value) for name, value in exiftool(path).items()}


def camera_of(name, **parts):
    """Without noise, with 16 bits, so that colours are all there is to see."""
    base = gs.open_camera(name)
    sensor = {"bits": 16, "black_level": 1000, "noise": CLEAN, "gain": None} | parts
    return camera_with(base, processor={"demosaic": "bilinear"}, sensor=sensor)


def patches(picture):
    """Means of the 24 patches inside, (24, 3), of a picture (rows, cols, 3)."""
    inner = slice(5, -5)
    return np.array(
        [picture[patch][inner, inner].mean(axis=(0, 1)) for patch in colorchecker_patches(SIZE)]
    )


def own(frame):
    """Linear sRGB as simulated, 1 where the strongest channel of white would saturate: LibRaw's scale."""
    return patches(frame.linear.astype(float)) * frame.rendering.white / frame.rendering.saturation


def by_libraw(path):
    with rawpy.imread(str(path)) as file:
        shown = file.postprocess(
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
            use_camera_wb=True,
            gamma=(1, 1),
            output_color=rawpy.ColorSpace.sRGB,
            output_bps=16,
            no_auto_bright=True,
            user_flip=0,
            adjust_maximum_thr=0.0,
        )  # else the largest value that is there would be white
    return patches(shown / 65535)


def balanced(frame):
    """The patches' camera values over those of white, (24, C), as they are measured in the raw values."""
    sensor = frame.camera.sensor
    values = (frame.raw - sensor.dark_level) / (sensor.gain_dn_per_electron * sensor.saturation)
    cfa, means = sensor.cfa_indices, []
    for rows, cols in colorchecker_patches(SIZE):
        inside = np.zeros(values.shape, bool)
        inside[rows.start + 5 : rows.stop - 5, cols.start + 5 : cols.stop - 5] = True
        tiled = np.tile(cfa, (values.shape[0] // len(cfa) + 1, values.shape[1] // len(cfa[0]) + 1))
        tiled = tiled[: values.shape[0], : values.shape[1]]
        means.append(
            [values[inside & (tiled == channel)].mean() for channel in range(len(sensor.channels))]
        )
    return np.array(means)


def adapted(white, to):
    return np.linalg.inv(BRADFORD) @ np.diag((BRADFORD @ to) / (BRADFORD @ white)) @ BRADFORD


def difference(linear, truth):
    """CIEDE2000 of the patches in linear sRGB and their XYZ in D65, both as bright on the average as the other."""
    import colour

    shown = np.clip(linear, 0, None) @ np.linalg.inv(SRGB).T
    shown *= truth[:, 1].sum() / shown[:, 1].sum()
    xy = colour.XYZ_to_xy(D65)
    return colour.delta_E(
        colour.XYZ_to_Lab(shown, xy), colour.XYZ_to_Lab(truth, xy), method="CIE 2000"
    )


@pytest.mark.parametrize("name", ["phone", "figure8"])
def test_libraw_makes_our_colours_in_daylight(tmp_path, name):
    """With the file's matrix for D65, which is the one that the frame was rendered by, on all 24 patches.

    LibRaw's XYZ of sRGB's primaries (BT.709's digits) differ from ours by 1e-4 of white, and a camera's matrix,
    inverted, enlarges that up to three times: linear values differ by 3e-4 of the balanced channels' sum, and by two of
    65535 steps. White, of which each row is 1 whatever the matrix, differs by the steps alone. It clips to 0 .. 1:
    so do we.
    """
    frame = gs.Simulator(camera_of(name), device="opencl")(
        gs.chart("colorchecker", size=SIZE, light="D65")
    )
    frame.save(tmp_path / "a.dng")
    found, wanted = by_libraw(tmp_path / "a.dng"), np.clip(own(frame), 0, 1)
    sums = (balanced(frame) / frame.rendering.neutral).sum(axis=1, keepdims=True)
    assert (np.abs(found - wanted) <= 3e-4 * sums + 2 / 65535).all()
    print(f"{name}: at most {np.abs(found - wanted).max():.1e}")
    np.testing.assert_allclose(
        found[18], wanted[18], rtol=1e-4
    )  # white, nearly as neutral as white can be


@pytest.mark.parametrize("light", ["A", "FL11"])
@pytest.mark.parametrize("name", ["phone", "figure8"])
def test_white_balance_in_other_lights(tmp_path, name, light):
    """LibRaw takes the matrix for D65 in any light; white is white by AsShotNeutral: rows of its matrix sum to 1.

    The white patch is not quite a perfect diffuser: its balanced channels v differ a little. LibRaw's matrix differs
    from ours by D, whose rows sum to 0, so what they make of it by no more than half the sum of a row of |D| times the
    range of v. Raw values, a seventh of the range or more, are rounded to 7e-5, shown ones to 1e-4 of white.
    """
    frame = gs.Simulator(camera_of(name), device="opencl")(
        gs.chart("colorchecker", size=SIZE, light=light)
    )
    frame.save(tmp_path / "a.dng")
    found, wanted = by_libraw(tmp_path / "a.dng")[18], own(frame)[18]
    with rawpy.imread(str(tmp_path / "a.dng")) as file:
        theirs = file.color_matrix[:, :3]
    ours = frame.rendering.display_from_camera * frame.rendering.neutral * frame.rendering.white
    np.testing.assert_allclose(ours.sum(axis=1), 1, rtol=1e-6)
    apart = (
        np.abs(theirs - ours).sum(axis=1)
        / 2
        * np.ptp(balanced(frame)[18] / frame.rendering.neutral)
    )
    assert (np.abs(found - wanted) <= apart + 2e-4 * wanted).all()
    assert (apart < 0.01 * wanted).all()


def rendered(tags, values, light):
    """Linear sRGB of camera values by the specification's chapter 6, with the forward matrix of a file's light."""
    place = {"A": 1, "D65": 2}[light]
    forward = tags[f"ForwardMatrix{place}"].reshape(3, -1)
    return values / tags["AsShotNeutral"] @ (SRGB @ adapted(D50, D65) @ forward).T


@pytest.mark.filterwarnings("ignore:Aligning")  # of tables of other steps, as is meant
@pytest.mark.parametrize("light", ["A", "D65"])
@pytest.mark.parametrize("name", ["phone", "figure8"])
def test_matrices_of_both_lights_are_good(tmp_path, name, light):
    """Rendered as the specification says, patches are as near to their colours as by our own rendering of the frame.

    Truth: colour-science's spectra of the chart, of the lights and of the observer, adapted to D65 (Bradford). The
    frame's own matrix is fitted to surfaces as they look in D65, the file's to how they look in the light and are
    adapted: that is the truth here, so nothing but the fit to other surfaces parts the two. White comes out as white.
    """
    import colour

    frame = gs.Simulator(camera_of(name), device="opencl")(
        gs.chart("colorchecker", size=SIZE, light=light)
    )
    frame.save(tmp_path / "a.dng")
    tags = tags_of(tmp_path / "a.dng")
    spectra = colour.SDS_COLOURCHECKERS["ISO 17321-1"].values()
    lamp, observer = (
        colour.SDS_ILLUMINANTS[light],
        colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"],
    )
    white = colour.sd_to_XYZ(lamp, observer, method="Integration")
    truth = (
        np.array([colour.sd_to_XYZ(sd, observer, lamp, method="Integration") for sd in spectra])
        / 100
    )
    truth = truth @ adapted(white / white[1], D65).T
    spec = difference(rendered(tags, balanced(frame), light), truth)
    ours = difference(own(frame), truth)
    print(
        f"{name} in {light}: specification {spec.mean():.2f} (most {spec.max():.2f}), own {ours.mean():.2f} "
        f"({ours.max():.2f})"
    )
    assert spec.mean() <= 1.1 * ours.mean()
    # AsShotNeutral is the color matrix's own white, so that a program that looks for the light finds it
    place = {"A": 1, "D65": 2}[light]
    neutral = tags[f"ColorMatrix{place}"].reshape(-1, 3) @ (white / white[1])
    # by tables of the lights and of the observer that are not ours: to 1e-3
    np.testing.assert_allclose(neutral / neutral.max(), tags["AsShotNeutral"], rtol=1e-3)
    np.testing.assert_allclose(
        tags[f"ForwardMatrix{place}"].reshape(3, -1).sum(axis=1), D50, rtol=1e-6
    )


@pytest.mark.parametrize("name", ["rgbw", "cygm", "x-trans", "rccb", "stacked"])
def test_matrices_of_other_mosaics(tmp_path, name):
    """Their white is that of the frame in D65, their forward matrix leads it to D50; LibRaw reads them."""
    stacked = name == "stacked"
    cfa = MOSAICS["bayer-rggb" if stacked else name]
    letters = "".join(dict.fromkeys("".join(cfa)))
    qe = gs.Spectrum([360, 450, 550, 640, 830], [CURVES[letter] for letter in letters])
    camera = camera_of("phone", qe=qe, channels=letters, cfa=cfa, stacked=stacked)
    frame = gs.Simulator(camera, device="numpy")(gs.chart("colorchecker", size=SIZE, light="D65"))
    frame.save(tmp_path / "a.dng")
    tags = tags_of(tmp_path / "a.dng")
    neutral = tags["ColorMatrix2"].reshape(-1, 3) @ D65
    np.testing.assert_allclose(
        neutral / neutral.max(), tags["AsShotNeutral"], rtol=1e-3
    )  # D65 has four digits
    np.testing.assert_allclose(tags["ForwardMatrix2"].reshape(3, -1).sum(axis=1), D50, rtol=1e-6)
    with rawpy.imread(str(tmp_path / "a.dng")) as file:
        raw = np.moveaxis(file.raw_image_visible, -1, 0)[:3] if stacked else file.raw_image_visible
        np.testing.assert_array_equal(raw, frame.raw)


NOISE = {
    "read": 4.0,
    "adc": 1.5,
    "row": 1.0,
    "reset": 2.0,
    "dark_current": 200.0,
    "dsnu": 3.0,
    "prnu": 0.01,
}


@pytest.mark.parametrize(
    "sensor",
    [
        {"analog_gain": 1.0},
        {"analog_gain": 4.0, "analog_offset": 10.3},
        {"gain": 0.05},
        {"binning": (2, 2), "binning_mode": "digital"},
        {"binning": (2, 2)},
    ],
    ids=["base", "gain", "well", "digital", "charge"],
)
def test_noise_profile_is_the_noise_of_the_frames(tmp_path, sensor):
    """S x + O against the variance of each pixel over 64 frames, from dark to half of white, with the file's levels.

    Of n pixels and 64 frames a mean variance has the relative standard error sqrt(2 / 63 n): n is 4096 or more, 2.8e-3
    (rows share a part, at most a 20th of the variance in the dark, of 64 rows, 2.2e-2 of it: 1.1e-3). Five of them are
    1.5 %. Poisson noise of 12 .. 3000 e- is as kurtotic as normal to 1 / 12 / 2; rounding after row noise is even.
    """
    camera = camera_with(
        gs.open_camera("mono"),
        noise={**{key: 0.0 for key in ("prnu", "dsnu")}, **NOISE},
        sensor={"full_well": 6000.0, "bits": 12, "black_level": 200, "gain": None} | sensor,
    )
    simulate = gs.Simulator(camera, device="opencl")
    scene = gs.chart("flat", size=(128, 128))
    auto = simulate.expose(scene).exposure_time
    tags = None
    for part in (0.01, 0.1, 0.5):
        exposure = simulate.expose(scene, part * auto)
        if tags is None:
            simulate.loop(scene, exposure_time=part * auto).frame().save(tmp_path / "a.dng")
            tags = tags_of(tmp_path / "a.dng")
            (slope, floor), black, white = (
                tags["NoiseProfile"],
                tags["BlackLevel"],
                tags["WhiteLevel"],
            )
            low, high = black[0], white[0]
        raws = np.asarray(simulate.device.numpy(exposure.raw(seed=5, frames=64)), float)
        x = (raws - low) / (high - low)
        assert x.var(axis=0, ddof=1).mean() == pytest.approx(slope * x.mean() + floor, rel=0.015)


def test_levels_are_where_values_end(tmp_path):
    """White: the full well, 3000 e- of .5 DN above 1000 DN and an offset of 10.3 e-, far below the converter's end."""
    camera = camera_of("phone", bits=14, full_well=3000.0, gain=0.5, analog_offset=10.3)
    simulate = gs.Simulator(camera, device="opencl")
    frame = simulate.loop(gs.chart("flat", size=(32, 32)), exposure_time=100.0).frame()
    frame.save(tmp_path / "a.dng")
    tags = tags_of(tmp_path / "a.dng")
    assert tags["BlackLevel"] == pytest.approx([1005.15], rel=1e-7) and tags[
        "WhiteLevel"
    ].tolist() == [2505]
    assert frame.raw.max() == 2505
    assert "NoiseProfile" not in tags  # S = 0 is none


def test_frames_of_several_exposures_tell_no_profile(tmp_path):
    simulate = gs.Simulator(gs.open_camera("phone"), device="opencl")
    frames = gs.bracket(simulate, gs.chart("flat", size=(32, 32)), (-1, 1))
    gs.merge_bracket(simulate, frames).save(tmp_path / "a.dng")
    assert "NoiseProfile" not in tags_of(tmp_path / "a.dng")


def test_filters_that_give_other_planes(tmp_path):
    camera = gs.open_camera("phone")
    frame = gs.Simulator(camera, device="opencl")(gs.chart("flat", size=(32, 32)))

    class Table:
        class layout:
            outputs = ("X", "Y", "Z")

    processor = replace(camera.processor)
    object.__setattr__(processor, "table", Table)
    with pytest.raises(
        OutOfRange, match=r"processor\.table with a \.dng output = filters with the outputs X, Y, Z"
    ):
        replace(frame, camera=replace(camera, processor=processor)).save(tmp_path / "a.dng")


@pytest.mark.parametrize("name", ["quad-bayer", "rccb", "x-trans", "rgbw"])
def test_mosaics_that_raw_converters_misread_are_refused(name, tmp_path):
    """LibRaw's own pattern of the file, where one is written, is the mosaic; a larger period would lose its end."""
    camera = gs.open_camera("phone").with_(cfa=name)
    path = tmp_path / "a.dng"
    frame = gs.Simulator(camera, device="numpy")(gs.chart("colorchecker", size=(36, 24)))
    if name == "quad-bayer":
        with pytest.raises(OutOfRange, match=r"4 x 4: allowed is 2 x 2 pixels, or 6 x 6 .*\.npz"):
            frame.save(path)
        assert not path.exists()
        return
    frame.save(path)
    with rawpy.imread(str(path)) as file:
        assert np.array_equal(file.raw_image_visible, frame.raw)
        rows, cols = len(camera.sensor.cfa), len(camera.sensor.cfa[0])
        assert file.raw_pattern.shape == (rows, cols)
