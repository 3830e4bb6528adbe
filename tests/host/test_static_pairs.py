"""`gpusim fit` of pairs of static scenes, of telegraph noise, temperatures, lossy and shifted values."""

import re
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from raw_cameras import RawCamera, draw_maps, expose
from static_scenes import draw_scene, shoot_pairs

import gpusim as gs
from gpusim.cli.main import main
from gpusim.io.raw.raw_files import read_raw

CAMERA = RawCamera(
    **{"shape": (90, 101), "cfa": ("RG", "GB"), "bits": 12, "black": 128, "gains": {100: 0.4}},
    **{"full_well": 8000, "read": 4.0, "adc": 0.0, "row": 1.0, "column": 1.0},
    **{"dsnu": 2.0, "row_dsnu": 0.0, "column_dsnu": 0.0, "prnu": 0.01},
    **{"row_prnu": 0.0, "column_prnu": 0.0, "dark_current": 20.0, "hot_pixels": 0.0},
    **{"hot_current": 0.0, "dead_pixels": 0.0, "efficiency": {"R": 0.7, "G": 1.0, "B": 0.6}},
    **{"shading": 0.02, "seed": 7},
)


def save_darks(camera, folder, seconds=0.001, count=8, spoil=lambda frame, rng: frame, **more):
    rng, maps = np.random.default_rng(1), draw_maps(camera)
    folder.mkdir(exist_ok=True, parents=True)
    for number in range(count):
        frame = spoil(expose(camera, maps, 100, seconds, 0.0, rng), rng)
        settings = {"cfa": np.array(camera.cfa), "iso": 100.0, "exposure_time_s": seconds}
        np.savez(folder / f"d{seconds}_{number}.npz", dn=frame, **settings, **more)


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    place = tmp_path_factory.mktemp("pairs") / "pairs"
    shoot_pairs(CAMERA, place)
    return place


def test_pairs_give_gain_and_read_noise(pairs, tmp_path, capsys):
    out = tmp_path / "mine.toml"
    assert main(["fit", "--pairs", *map(str, pairs.glob("*")), "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "stated by the files" in printed and "not known: PRNU" in printed
    assert "not known: DSNU, fixed rows and columns" in printed
    assert ", 6 frames" in out.read_text()
    camera = gs.open_camera(out)
    # three pairs of 9,000 pixels: standard errors of 1.5 % and 3 %
    assert camera.sensor.gain == pytest.approx(0.4, rel=0.08)
    assert camera.sensor.noise.read == pytest.approx(4, rel=0.15)
    assert camera.sensor.black_level == 128


def test_bits_that_nothing_states_are_usual_ones(tmp_path):
    shoot_pairs(CAMERA, tmp_path, levels=(0.15, 0.45))
    for path in tmp_path.glob("*"):
        with np.load(path) as stored:
            kept = {name: stored[name] for name in stored if name != "white_level"}
        assert 1023 < kept["dn"].max() < 2048 or "0.15" in path.name
        np.savez(path, **kept)
    found = gs.fit(pairs=sorted(tmp_path.glob("*")))
    sensor = found.camera.sensor
    assert sensor.bits == 12 and any(line.startswith("bits: ") for line in found.unknown)
    assert sensor.full_well == pytest.approx((4095 - 128) / sensor.gain, rel=0.01)


def test_content_tells_pairs_and_darks_make_them_whole(pairs, tmp_path):
    for path in pairs.glob("*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    save_darks(CAMERA, tmp_path / "darks")
    found = gs.fit(tmp_path)
    assert found.lines == ("frames: 8 of dark, 6 of pairs",)
    one = found.estimates["sensor.gain_dn_per_e"]
    assert one.value == pytest.approx(0.4, rel=0.08)
    assert found.estimates["noise.dsnu_e"].value == pytest.approx(2, rel=0.3)


def test_an_unknown_black_level_has_bounds(tmp_path):
    shoot_pairs(CAMERA, tmp_path / "pairs", states_black=False)
    found = gs.fit(tmp_path)
    for key, value in (("sensor.black_level_dn", 128), ("noise.read_e", 4)):
        one = found.estimates[key]
        assert one.low <= value <= one.high and "bounds" in one.note
    assert any(line.startswith("black level and read noise") for line in found.unknown)


FINE = draw_scene(7, (360, 404))


def seen(shift):
    """The light of a fine scene that moved by quarters of a pixel."""
    picture = np.roll(FINE, shift, axis=1).reshape(90, 4, 101, 4).mean((1, 3))
    return draw_maps(CAMERA)["light"] * picture


def shadow(light):
    light = light.copy()
    light[30:45, 30:60] *= 0.95
    light[45:60, 30:60] *= 1.06
    return light


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda light: seen(2), "displaced by"),
        (lambda light: light * 1.03, "light changed by +"),
        (shadow, "differ by more than noise"),
    ],
)
def test_a_changed_scene_is_refused_in_one_line(tmp_path, change, words, capsys):
    shoot_pairs(
        CAMERA,
        tmp_path / "pairs",
        seen(0) / draw_maps(CAMERA)["light"],
        change=lambda maps, rng: maps | {"light": change(maps["light"])},
    )
    assert main(["fit", str(tmp_path), "-o", str(tmp_path / "a.toml")]) == 2
    line = capsys.readouterr().err
    assert words in line and "shoot" in line and line.count("\n") == 1


def test_pixels_with_telegraph_noise_are_found(pairs, tmp_path):
    jumping = np.random.default_rng(2).random(CAMERA.shape) < 0.004

    def jump(frame, rng):
        return frame + (jumping & (rng.random(frame.shape) < 0.5)) * np.uint16(60)

    save_darks(CAMERA, tmp_path / "darks", count=12, spoil=jump)
    found = gs.fit(tmp_path, pairs=pairs)
    one = found.estimates["noise.telegraph_pixels"]
    # a pixel that always or never jumps in 12 frames is missed: 2 of 4,096
    assert one.value == pytest.approx(jumping.mean(), rel=0.1)
    assert found.settings["noise"]["telegraph_e"] == pytest.approx(60 / 0.4, rel=0.15)


def test_temperatures_give_the_doubling(pairs, tmp_path):
    for degrees, rate in ((20.0, 20.0), (28.0, 40.0), (36.0, 80.0)):
        warm = replace(CAMERA, dark_current=rate)
        for seconds in (0.001, 2.0):
            folder = tmp_path / f"{degrees:g}" / "darks"
            save_darks(warm, folder, seconds, 3, temperature_deg_c=degrees)
    one = gs.fit(tmp_path, pairs=pairs).estimates["noise.doubling_k"]
    # the rate has errors of about 1 %: 0.1 K
    assert one.low < 8 < one.high and one.value == pytest.approx(8, abs=0.5)


def raw_dng(path, reduction=None, compression=1):
    """A DNG by tifffile; a compression that is no raw's is written as a number only."""
    extra = [(50706, "B", 4, (1, 4, 0, 0), True), (33421, "H", 2, (2, 2), True)]
    extra += [(33422, "B", 4, (0, 1, 1, 2), True)]
    if reduction:
        extra += [(50935, "2I", 1, reduction, True)]
    tifffile.imwrite(path, np.ones((32, 32), np.uint16), photometric="cfa", extratags=extra)
    if compression != 1:
        with tifffile.TiffFile(path, mode="r+b") as tiff:
            tiff.pages[0].tags["Compression"].overwrite(compression)


def test_lossy_and_denoised_dngs_are_refused(tmp_path, capsys):
    for name, more, words in (
        ("lossy", {"compression": 34892}, "compressed with loss"),
        ("denoised", {"reduction": (1, 2)}, "NoiseReductionApplied 0.5"),
    ):
        raw_dng(tmp_path / f"{name}.dng", **more)
        with pytest.raises(gs.GpusimError, match=words):
            read_raw(tmp_path / f"{name}.dng")
        assert main(["fit", str(tmp_path / f"{name}.dng"), "-o", str(tmp_path / "a.toml")]) == 2
        line = capsys.readouterr().err
        assert re.search(words, line) and line.count("\n") == 1


def test_values_behind_a_lossy_curve_are_noticed(pairs, tmp_path):
    for path in pairs.glob("*"):
        with np.load(path) as stored:
            fields = dict(stored)
        signal = np.maximum(fields["dn"].astype(float) - 300, 0)
        code = np.rint(
            20 * (np.sqrt(signal + 100) - 10)
        )  # 1 DN apart at 300 DN, 3 at 1100 and 5 at 2800
        bright = np.rint(300 + (code / 20 + 10) ** 2 - 100)
        fields["dn"] = np.where(signal > 0, bright, fields["dn"]).astype(np.uint16)
        np.savez(tmp_path / path.name, **fields)
    lines = gs.fit([], pairs=tmp_path).unexplained
    assert sum("compressed with loss by a curve" in line for line in lines) == 1


def test_shifted_bits_are_taken_out(pairs, tmp_path):
    for path in pairs.glob("*"):
        with np.load(path) as stored:
            fields = dict(stored)
        more = {key: fields[key] * 16 for key in ("dn", "black_level", "white_level")}
        np.savez(tmp_path / path.name, **(fields | more))
    found = gs.fit([], pairs=tmp_path)
    assert "multiples of 16" in found.lines[1]
    assert found.estimates == gs.fit([], pairs=pairs).estimates


def test_few_pixels_and_fractions_are_refused(tmp_path):
    for values, words in (
        (np.arange(35, dtype=np.uint16).reshape(5, 7), "5 x 7 pixels are too few"),
        (np.linspace(0, 1, 900).reshape(30, 30), "fractions up to 1"),
    ):
        np.save(tmp_path / "a.npy", values)
        with pytest.raises(gs.GpusimError, match=words):
            gs.fit(flats=tmp_path / "a.npy", files=[])
