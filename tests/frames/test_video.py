"""Videos: what is resumed or made in parts is what one run makes, and what is decoded is what was encoded."""

import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from fractions import Fraction

import av
import colour
import numpy as np
import pytest
from cameras import PHONE
from devices import KINDS
from PIL import Image

import gpusim as gs
from gpusim.apps.video.codecs import CODECS, Encoder
from gpusim.apps.video.manifest import keep_manifest
from gpusim.apps.video.pipeline import ahead, in_groups
from gpusim.apps.video.scenes import Moving, Still
from gpusim.apps.video.segments import Shard, segments_of
from gpusim.apps.video.video import frames, within_period
from gpusim.apps.video.video_frames import Film
from gpusim.cli.main import main
from gpusim.data.transfers import TRANSFERS, light_of
from gpusim.domain.errors import BadFile, OutOfRange
from gpusim.pipeline.simulator import Simulator

COUNT = 8
ASKED = ["--camera", "phone", "--seed", "3", "--segment", "3"]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """A folder of photographs whose light grows and whose colours change, so that exposure and plans follow."""
    folder = tmp_path_factory.mktemp("pictures")
    random = np.random.default_rng(4)
    for number in range(COUNT):
        picture = random.random((24, 36, 3)) ** (3 - number / 4)
        picture[:, : 4 * number] *= (1, 0.3, 0.1)
        Image.fromarray(np.uint8(255 * picture)).resize((72, 66)).save(
            folder / f"in_{number + 7:03d}.png"
        )
    return folder


def made(capsys, *arguments):
    """What a command that succeeds prints."""
    assert main(["video", *map(str, arguments)]) == 0, capsys.readouterr().err
    return capsys.readouterr().out


def refused(capsys, *arguments):
    """What a command that is refused says: one line."""
    assert main(["video", *map(str, arguments)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def files(folder):
    return {
        path.name: path.read_bytes() for path in folder.iterdir() if not path.name.endswith(".json")
    }


@pytest.mark.parametrize(
    ("moving", "device", "suffix"),
    [
        *((moving, device, ".png") for moving in (False, True) for device in ("numpy", *KINDS)),
        *((False, device, ".dng") for device in KINDS),
    ],
)
def test_resumed_and_in_parts_are_the_frames_of_one_run(
    moving, device, suffix, pictures, tmp_path, capsys
):
    asked = [pictures, "--device", device, "--exposure", "auto", *ASKED]
    if moving:
        asked += [
            "--shake",
            "2",
            "--zoom",
            "1.1",
            "--zooming",
            "1.3",
            "--pan",
            "10,-20",
            "--roll",
            "30",
        ]
    if device != "numpy":
        asked += ["--tolerance", "0.5" if moving else "video"]
    whole, resumed, parts = (tmp_path / name for name in ("whole", "resumed", "parts"))
    for folder in (whole, resumed, parts):
        folder.mkdir()
    made(capsys, *asked, "-o", whole / f"a{suffix}")
    expected = files(whole)
    assert len(expected) == COUNT and len(set(expected.values())) == COUNT

    made(capsys, *asked, "-o", resumed / f"a{suffix}")
    for number in (1, 4, 5):
        (resumed / f"a_{number:04d}{suffix}").unlink()
    assert "5 frames were there" in made(capsys, *asked, "-o", resumed / f"a{suffix}")
    assert files(resumed) == expected

    for shard in ("2/3", "0/3", "1/3"):
        made(capsys, *asked, "-o", parts / f"a{suffix}", "--shard", shard)
    assert files(parts) == expected


@pytest.mark.parametrize("device", KINDS)
def test_lossless_videos_and_arrays_hold_the_frames_of_a_stream(device, tmp_path, capsys):
    """Of a scene that rests: its exposure is metered once."""
    scene = gs.chart("deadleaves", size=(72, 48))
    simulator = gs.Simulator(
        within_period(gs.open_camera("phone"), Fraction(30)), device=device, tolerance="video"
    )
    asked = [
        "deadleaves",
        "--size",
        "72x48",
        "--device",
        device,
        "--tolerance",
        "video",
        "--frames",
        "7",
        *ASKED,
    ]
    loop = simulator.loop(scene)
    for codec, output in (("ffv1-raw", "raw"), ("ffv1-linear", "linear")):
        path = tmp_path / f"{codec}.mkv"
        for shard in ("1/2", "0/2"):
            made(capsys, *asked, "-o", path, "--codec", codec, "--shard", shard)
        assert path.exists() and not path.with_name(path.name + ".parts").exists()
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            found = [frame.to_ndarray() for frame in container.decode(stream)]
            assert abs(stream.average_rate - 30) < 0.01
        assert len(found) == 7
        for number, frame in enumerate(found):
            values = np.array(simulator.device.numpy(loop.output(output, seed=3, first=number)))
            if output == "linear":
                values = np.rint(
                    65535 * np.clip(np.moveaxis(values, 0, -1).astype(np.float64), 0, 1)
                )
                assert np.abs(frame - values).max() <= 1  # float32 products round
            else:
                assert np.array_equal(frame, values)
    made(capsys, *asked, "-o", tmp_path / "a.npy")
    for number in range(7):
        planes = np.array(simulator.device.numpy(loop.output("linear", seed=3, first=number)))
        stored = np.load(tmp_path / f"a_{number:04d}.npy")
        assert stored.flags.c_contiguous and np.array_equal(stored, np.moveaxis(planes, 0, -1))


def decoded(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        context = stream.codec_context
        frames = [
            (frame.pts * frame.time_base, frame.to_ndarray()) for frame in container.decode(stream)
        ]
        return frames, (
            context.color_primaries,
            context.color_trc,
            context.colorspace,
            context.color_range,
        )


@pytest.mark.parametrize("codec", ["h264", "h265"])
@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_an_encoded_video_in_parts_is_that_of_one_run(codec, suffix, pictures, tmp_path, capsys):
    asked = [
        pictures,
        "--device",
        "numpy",
        "--codec",
        codec,
        "--quality",
        "6",
        "--exposure",
        "1/40",
        "--fps",
        "25",
        *ASKED,
    ]
    whole, parts = tmp_path / f"whole{suffix}", tmp_path / f"parts{suffix}"
    made(capsys, *asked, "-o", whole)
    for shard in ("0/2", "1/2"):
        made(capsys, *asked, "-o", parts, "--shard", shard)
    (one, tags), (other, _) = decoded(whole), decoded(parts)
    assert len(one) == COUNT and tags == (1, 13, 1, 1)
    for number, ((at, frame), (its, again)) in enumerate(zip(one, other, strict=True)):
        assert abs(at - number / 25) < 2e-3 and abs(its - at) < 2e-3  # Matroska counts milliseconds
        assert np.array_equal(frame, again)

    simulate = gs.Simulator(
        replace(
            gs.open_camera("phone"),
            sensor=replace(gs.open_camera("phone").sensor, exposure_time=1 / 40),
        ),
        device="numpy",
    )
    codes = simulate(gs.open_scene(pictures / "in_007.png"), seed=3).rgb / 255.0
    luma = codes @ (0.2126, 0.7152, 0.0722)  # BT.709-6, 3.2; 219 steps from 16 on
    scale = 4 if codec == "h265" else 1
    frame = one[0][1][: len(codes)] / scale
    # a quantiser's step at the rate factor 6 is 1.25 (ITU-T H.264, 8.5.9), its error half of it; luma is rounded
    assert (
        np.sqrt(np.mean((frame - 16 - 219 * luma) ** 2)) < 1.25
        and abs(np.mean(frame - 16 - 219 * luma)) < 0.3
    )


def test_light_of_codes_is_that_of_the_standards():
    code = np.arange(1024) / 1023
    models = colour.models
    for name, expected in (
        ("bt709", models.oetf_inverse_BT709(code)),
        ("srgb", models.eotf_sRGB(code)),
        ("pq", models.eotf_ST2084(code) / 203),
        ("gamma2.2", code**2.2),
        ("linear", code),
        ("hlg", models.oetf_inverse_BT2100_HLG(code) / models.oetf_inverse_BT2100_HLG(0.75)),
    ):
        found = light_of(name, code)
        # BT.709's two parts meet to 1e-4 where they are joined; constants of the standards have 4 to 8 digits
        assert np.abs(found - expected).max() < 2e-4 * max(1, expected.max()), name
    assert set(TRANSFERS.values()) == {
        "bt709",
        "srgb",
        "pq",
        "hlg",
        "linear",
        "gamma2.2",
        "gamma2.8",
    }


def film(path, frames, codec, stored, given, tags):
    with av.open(str(path), "w") as container:
        stream = container.add_stream(
            codec, rate=25, options={"qp": "0"} if codec == "libx264rgb" else {}
        )
        stream.width, stream.height, stream.pix_fmt = frames[0].shape[1], frames[0].shape[0], stored
        context = stream.codec_context
        context.color_primaries, context.color_trc, context.colorspace, context.color_range = tags
        for number, values in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(values, format=given)
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


@pytest.mark.parametrize(("bits", "tag"), [(8, 1), (8, 13), (16, 16), (16, 18), (16, 8)])
def test_a_film_is_read_as_its_tags_say(bits, tag, tmp_path):
    random, kind = np.random.default_rng(1), np.uint8 if bits == 8 else np.uint16
    codes = [random.integers(0, 2**bits, (40, 56, 3)).astype(kind) for _ in range(5)]
    path = tmp_path / "a.mkv"
    codec, pixels = ("libx264rgb", "rgb24") if bits == 8 else ("ffv1", "gbrp16le")
    film(path, codes, codec, pixels, pixels, (1, tag, 0, 2))
    found = Film(path, luminance=50.0)
    assert found.count == 5
    for first, end in ((0, 5), (3, 5), (2, 4), (0, 1)):
        for number, scene in enumerate(found.between(first, end), first):
            assert np.array_equal(scene.content.codes, codes[number])
            light = light_of(TRANSFERS[tag], np.arange(2**bits) / (2**bits - 1))
            assert np.array_equal(scene.content.curve, light.astype(np.float32))


def test_wide_gamuts_become_srgb_light(tmp_path):
    """Grey stays grey, BT.2020's green is beyond sRGB's, and its light is as the standard's primaries say."""
    codes = np.zeros((8, 12, 3), np.uint16)
    codes[:, :6], codes[:, 6:] = 32768, (30000, 40000, 35000)
    film(tmp_path / "a.mkv", [codes], "ffv1", "gbrp16le", "gbrp16le", (9, 8, 0, 2))
    content = next(Film(tmp_path / "a.mkv").between(0, 1)).content
    matrix = colour.matrix_RGB_to_RGB("ITU-R BT.2020", "ITU-R BT.709", None)
    for at, code in ((0, codes[0, 0]), (11, codes[0, 11])):
        expected = matrix @ (code / 65535)
        assert np.allclose(
            content.planes[:, 0, at], expected, atol=2e-4
        )  # chromaticities of three digits


def test_codes_of_luma_and_chroma_come_back(tmp_path):
    """A smooth picture by H.264, of the best quality: to the rounding of luma, chroma and codes."""
    y, x = np.mgrid[:48, :64]
    smooth = np.stack([40 + 3 * x, 60 + 2 * y, 90 + x + y], axis=-1).astype(np.uint8)
    encoder = Encoder(CODECS["h264"], (48, 64), Fraction(24), PHONE.display, (), 0)
    assert list(encoder.segment(tmp_path / "0.nut", [smooth] * 3)) == [0, 1, 2]
    encoder.join(tmp_path / "a.mp4", [(0, tmp_path / "0.nut")])
    for scene in Film(tmp_path / "a.mp4").between(0, 3):
        wrong = scene.content.codes.astype(int) - smooth
        assert np.abs(wrong).max() <= 4 and np.abs(wrong.mean(axis=(0, 1))).max() < 0.3


def test_a_killed_run_leaves_nothing_half_written_and_goes_on(pictures, tmp_path, capsys):
    """Killed at several moments, and gone on with to the end."""
    expected, folder = tmp_path / "whole.mkv", tmp_path / "killed"
    folder.mkdir()
    asked = [pictures, "--device", "numpy", "--codec", "ffv1-raw", *ASKED]
    made(capsys, *asked, "-o", expected)
    for seconds in (1.5, 2.5, 4.0):
        process = subprocess.Popen(
            [sys.executable, "-m", "gpusim", "video", *map(str, asked), "-o", folder / "a.mkv"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        time.sleep(seconds)
        process.send_signal(signal.SIGKILL)
        process.wait()
        left = {
            path.name
            for path in folder.rglob("*")
            if path.is_file() and not path.name.startswith(".gpusim")
        }
        assert left <= {"a.mkv", "video.json", *(f"{first:08d}.nut" for first in (0, 3, 6))}
        if (folder / "a.mkv").exists():
            break
    else:
        made(capsys, *asked, "-o", folder / "a.mkv")
    (one, _), (other, _) = decoded(expected), decoded(folder / "a.mkv")
    assert all(np.array_equal(a, b) for (_, a), (_, b) in zip(one, other, strict=True))


def test_what_is_wrong_is_said_in_a_line_and_nothing_is_written(pictures, tmp_path, capsys):
    out, asked = tmp_path / "out", ["--camera", "phone", "--device", "numpy"]
    out.mkdir()
    gap, mixed, plain = (tmp_path / name for name in ("gap", "mixed", "plain"))
    for folder, names in ((gap, (1, 2, 4)), (mixed, (1, 2)), (plain, ())):
        folder.mkdir()
        for number in names:
            Image.new("RGB", (40, 30 + 2 * number * (folder is mixed))).save(
                folder / f"a{number}.png"
            )
    (plain / "notes.txt").write_text("")
    untagged = tmp_path / "untagged.mkv"
    film(untagged, [np.zeros((8, 8, 3), np.uint8)], "libx264rgb", "rgb24", "rgb24", (1, 2, 0, 2))
    png, mp4, chart = out / "a.png", out / "a.mp4", ["flat", "--size", "33x40"]
    for words, arguments in {
        "number 3 is missing": [gap, "-o", png],
        "no scene files in it": [plain, "-o", png],
        "one size": [mixed, "-o", png, "--exposure", "1/40"],
        "even numbers": [*chart, "-o", mp4],
        "unknown codec": [*chart, "-o", mp4, "--codec", "mpeg2"],
        "unknown output format": [*chart, "-o", out / "a.gif"],
        "ffv1-raw in .mp4": [*chart, "-o", mp4, "--codec", "ffv1-raw"],
        "--quality: only .mp4, .mkv, .y4m, .jpg, .jpeg, .webp files have one": [
            *chart,
            "-o",
            png,
            "--quality",
            "20",
        ],
        "up to 2 shards": [*chart, "--frames", "5", "--segment", "4", "--shard", "0/3", "-o", png],
        "frame's period": [*chart, "--exposure", "1/20", "-o", png],
        "not tagged": [untagged, "-o", png],
        "no such file": [tmp_path / "none.mp4", "-o", png],
        "up to 1": [untagged, "--transfer", "srgb", "--frames", "2", "-o", png],
        "only a video has codes": [*chart, "--transfer", "srgb", "-o", png],
        "give only the video": [untagged, "flat", "-o", png],
        "scenes make as many frames": [pictures, "--frames", "3", "-o", png],
    }.items():
        assert words in refused(capsys, *arguments, *asked), words
        left = {path.name for path in out.rglob("*")}
        # the first frame is of the right size; else what failed leaves nothing that a corrected run would trip over
        assert left <= ({"a_0000.png", "a_video.json"} if words == "one size" else set()), words
        for name in left:
            (out / name).unlink()
    for wrong in (
        ["--shard", "2/2"],
        ["--shard", "1"],
        ["--fps", "0"],
        ["--frames", "0"],
        ["--quality", "101"],
    ):
        with pytest.raises(SystemExit) as status:
            main(["video", "flat", *asked, "-o", str(png), *wrong])
        assert status.value.code == 2 and capsys.readouterr().err.count("\n") == 1


def test_another_video_is_not_gone_on_with(tmp_path, capsys):
    asked = [
        "flat",
        "--size",
        "40x30",
        "--frames",
        "2",
        "--device",
        "numpy",
        "-o",
        tmp_path / "a.png",
    ]
    (tmp_path / "a_0001.png").write_bytes(b"mine")
    assert "exists, and no video was begun here" in refused(capsys, *asked, "--camera", "phone")
    (tmp_path / "a_0001.png").unlink()
    made(capsys, *asked, "--camera", "phone")
    before = files(tmp_path)
    assert "other camera" in refused(capsys, *asked, "--camera", "mono")
    assert "other seed" in refused(capsys, *asked, "--camera", "phone", "--seed", "1")
    (tmp_path / "a_video.json").write_text("{")
    assert "not a manifest" in refused(capsys, *asked, "--camera", "phone")
    assert files(tmp_path) == before


def test_a_file_that_has_changed_is_another_video(tmp_path, capsys):
    for number, grey in enumerate((50, 200)):
        Image.new("L", (40, 30), grey).save(tmp_path / "a.png")
        asked = [
            tmp_path / "a.png",
            "--frames",
            "2",
            "--segment",
            "1",
            "--camera",
            "phone",
            "--device",
            "numpy",
            "-o",
            tmp_path / "out.png",
            "--shard",
            f"{number}/2",
        ]
        if number:
            assert "contents of files" in refused(capsys, *asked)
        else:
            made(capsys, *asked)


def test_a_video_of_another_scale_is_not_resumed(tmp_path, capsys):
    """Twice the light for the same numbers is another video."""
    np.save(tmp_path / "planes.npy", np.full((24, 32, 3), 0.5, np.float32))
    asked = [
        tmp_path / "planes.npy",
        "--camera",
        "phone",
        "--device",
        "numpy",
        "--exposure",
        "0.01",
    ]
    asked += ["--wavelengths", "450,550,650", "--kind", "radiance", "--frames", "2"]
    made(capsys, *asked, "--scale", "1e15", "-o", tmp_path / "a.png")
    (tmp_path / "a_0001.png").unlink()
    assert "other scale" in refused(capsys, *asked, "--scale", "2e15", "-o", tmp_path / "a.png")
    assert "1 frame" in made(capsys, *asked, "--scale", "1e15", "-o", tmp_path / "a.png")


def test_a_manifest_of_a_faster_shard_is_not_written_over(tmp_path, monkeypatch):
    path = tmp_path / "video.json"

    def faster(_, target):
        target.write_text('{"seed": 1}')
        raise FileExistsError

    monkeypatch.setattr("gpusim.apps.video.manifest.os.link", faster)
    with (
        pytest.raises(BadFile, match="other seed"),
        keep_manifest(path, {"seed": 2}, "it", lambda: True),
    ):
        pass
    assert path.read_text() == '{"seed": 1}' and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(("codec", "runs"), [("h264", 40), ("h265", 10)])
def test_an_encoder_gives_the_same_frames_each_time(codec, runs, tmp_path):
    """x264's look-ahead did not, where rows are not whole macroblocks."""
    random = np.random.default_rng(0)
    base = np.kron(random.integers(0, 255, (25, 40, 3)), np.ones((8, 8, 1))).astype(np.uint8)
    frames = [
        np.clip(np.roll(base, 3 * k, 1) + random.integers(-8, 8, base.shape), 0, 255).astype(
            np.uint8
        )
        for k in range(5)
    ]
    if codec == "h265":
        frames = [frame / np.float32(255) for frame in frames]
    found = set()
    for _ in range(runs):
        junk = [
            random.random(random.integers(1000, 300000)) for _ in range(5)
        ]  # memory is not what it was
        list(
            Encoder(CODECS[codec], (200, 320), Fraction(30), PHONE.display).segment(
                tmp_path / "0.nut", frames
            )
        )
        found.add(b"".join(frame.tobytes() for _, frame in decoded(tmp_path / "0.nut")[0]))
        del junk
    assert len(found) == 1
    if codec == "h265":  # as x265 itself says in the stream: with a pool of workers it may hang
        assert b" numa-pools=none no-wpp " in (tmp_path / "0.nut").read_bytes()


def test_sizes_that_an_encoder_does_not_take_are_refused(tmp_path, capsys):
    asked = ["flat", "--camera", "phone", "--device", "numpy", "-o", tmp_path / "a.mp4"]
    assert "64 columns" in refused(capsys, *asked, "--size", "48x32", "--codec", "h265")
    made(capsys, *asked, "--size", "64x64", "--codec", "h265")


def test_a_truncated_video_is_no_short_one(tmp_path, capsys):
    random = np.random.default_rng(2)
    path = tmp_path / "a.mkv"
    film(
        path,
        [random.integers(0, 65536, (40, 56, 3)).astype(np.uint16) for _ in range(8)],
        "ffv1",
        "gbrp16le",
        "gbrp16le",
        (1, 13, 0, 2),
    )
    cut = tmp_path / "cut.mkv"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert "truncated" in refused(
        capsys, cut, "--camera", "phone", "--device", "numpy", "-o", tmp_path / "a.png"
    )
    (tmp_path / "text.mp4").write_text("no video")
    assert "not a video" in refused(
        capsys, tmp_path / "text.mp4", "--camera", "phone", "-o", tmp_path / "a.png"
    )
    assert not list(tmp_path.glob("a_*"))


def test_a_full_disk_is_one_line(pictures, tmp_path, capsys, monkeypatch):
    def full(*_):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr("gpusim.io.atomic.os.replace", full)
    monkeypatch.setattr(
        "gpusim.apps.video.manifest.os.link", lambda source, path: shutil.copyfile(source, path)
    )
    error = refused(
        capsys,
        "flat",
        "--size",
        "40x30",
        "--camera",
        "phone",
        "--device",
        "numpy",
        "-o",
        tmp_path / "a.mp4",
    )
    assert "No space left" in error and not list(tmp_path.rglob("*.mp4"))


@pytest.mark.parametrize("device", KINDS)
def test_uncompressed_video_holds_luma_and_chroma_of_the_frames(device, tmp_path, capsys):
    """Of BT.709 in limited range, resumed and in parts; another program reads it."""
    asked = ["deadleaves", "--size", "72x48", "--device", device, "--exposure", "1/50"]
    asked += ["--frames", "7", "--shake", "2", "--zoom", "1.1", *ASKED]
    path = tmp_path / "a.y4m"
    for shard in ("1/2", "0/2"):
        assert not path.exists()
        made(capsys, *asked, "-o", path, "--shard", shard)
    assert [one.name for one in tmp_path.iterdir()] == ["a.y4m"]
    made(capsys, *asked, "-o", tmp_path / "one.y4m")
    assert (tmp_path / "one.y4m").read_bytes() == path.read_bytes()
    made(capsys, *asked, "-o", tmp_path / "a.png")
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.average_rate == 30 and stream.codec_context.color_range == 1  # limited
        found = [frame.to_ndarray() for frame in container.decode(stream)]
    assert len(found) == 7
    for number, stored in enumerate(found):
        rgb = np.asarray(Image.open(tmp_path / f"a_{number:04d}.png")) / 255.0
        luma = rgb @ (0.2126, 0.7152, 0.0722)
        # rounded once to codes: half a code, and the scaler's integers another
        assert np.abs(stored[:48] - (16 + 219 * luma)).max() <= 1
        means = rgb.reshape(24, 2, 36, 2, 3).mean((1, 3))
        y = means @ (0.2126, 0.7152, 0.0722)
        for plane, channel, scale in ((48, 2, 1.8556), (60, 0, 1.5748)):
            chroma = stored[plane : plane + 12].reshape(24, 36)
            expected = 128 + 224 * (means[..., channel] - y) / scale
            # a cubic of the neighbours is not their mean: only the place is judged, by neighbours
            errors = {
                shift: np.sqrt(np.mean((chroma - np.roll(expected, shift, 1))[:, 1:-1] ** 2))
                for shift in (-1, 0, 1)
            }
            assert errors[0] < 0.5 * min(errors[-1], errors[1])


def test_chroma_of_an_uncompressed_video_lies_between_its_pixels(tmp_path):
    """As the header says; half a pixel to the left, chroma would be 0.9 codes less."""
    codes = np.zeros((8, 64, 3), np.uint8)
    codes[..., 0] = 4 * np.arange(64)
    encoder = Encoder(CODECS["y4m"], (8, 64), Fraction(30), PHONE.display)
    path = tmp_path / "a.y4m"
    with open(path, "wb") as file:
        encoder.write_raw(file.fileno(), 0, codes)
    assert b"C420jpeg" in path.read_bytes()[:60]
    with av.open(str(path)) as container:
        (stored,) = (frame.to_ndarray() for frame in container.decode(video=0))
    red = stored[10:].reshape(4, 32)[:, 2:-2]
    r = (4 * np.arange(64).reshape(32, 2).mean(1) / 255)[2:-2]
    expected = 128 + 224 * (r - 0.2126 * r) / 1.5748
    assert abs(np.mean(red - expected)) < 0.3


def test_an_uncompressed_video_on_a_full_disk_is_one_line(tmp_path, capsys, monkeypatch):
    def full(*_):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr("gpusim.apps.video.codecs.os.pwrite", full)
    asked = ["flat", "--size", "40x30", "--camera", "phone", "--device", "numpy"]
    assert "No space left" in refused(capsys, *asked, "-o", tmp_path / "a.y4m")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".mkv", ".y4m", ".png"])
def test_what_was_made_before_a_damaged_scene_stays(suffix, pictures, tmp_path, capsys):
    folder = tmp_path / "scenes"
    shutil.copytree(pictures, folder)
    damaged = sorted(folder.iterdir())[7]
    damaged.write_bytes(damaged.read_bytes()[:2000])
    asked = [folder, "--device", "numpy", "--exposure", "1/50", *ASKED, "-o"]
    error = refused(capsys, *asked, tmp_path / f"a{suffix}")
    assert damaged.name in error and "truncated" in error
    assert not (tmp_path / f"a{suffix}").exists()
    assert not [path for path in tmp_path.rglob(".gpusim*")]
    found = {path.name for path in tmp_path.rglob(f"*{'.png' if suffix == '.png' else '.nut'}")}
    if suffix == ".png":  # frame 7 is damaged
        assert found - {path.name for path in folder.iterdir()} == {
            f"a_{number:04d}.png" for number in range(7)
        }
    else:  # segments of three frames
        assert found == {"00000000.nut", "00000003.nut"}


def test_an_interrupt_leaves_nothing_half_written(tmp_path):
    for suffix in (".mkv", ".y4m", ".png"):
        asked = ["deadleaves", "--size", "160x120", "--shake", "2", "--zoom", "1.1"]
        asked += ["--camera", "phone", "--device", "numpy", "--frames", "2000"]
        process = subprocess.Popen(
            [sys.executable, "-m", "gpusim", "video", *asked, "-o", str(tmp_path / f"a{suffix}")],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        before, deadline = set(tmp_path.rglob("*")), time.monotonic() + 60
        while set(tmp_path.rglob("*")) == before and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.5)  # some frames later
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=60)
        assert process.returncode not in (0, None) and b"Traceback" not in error
        assert not [path for path in tmp_path.rglob(".gpusim*")]
        assert not (tmp_path / "a.mkv").exists() and not (tmp_path / "a.y4m").exists()
    for path in tmp_path.glob("a_*.png"):
        Image.open(path).load()


@pytest.mark.parametrize("has_lamp", [False, True])
def test_segments_of_views_begin_with_one_plan_if_it_serves(has_lamp, monkeypatch):
    """With a lamp it does not fit the light of a view: the segment's first frame gets its own."""
    random = np.random.default_rng(5)
    picture = random.uniform(0.2, 0.3, (64, 600, 3))
    if has_lamp:
        picture[30:33, 530:533] = 300.0
    scene = gs.scene_from(picture * 1e17, [450, 550, 650])
    camera = gs.open_camera("phone")
    camera = replace(camera, sensor=replace(camera.sensor, exposure_time=0.01))
    simulator = gs.Simulator(camera, device="auto", tolerance="video")
    moving = Moving(Still(scene, 12), gs.Motion((0.0, 18.0), zoom=3.0), Fraction(1))
    plans, planned = [], Simulator.plan

    def counted(self, *arguments, **others):
        plans.append(planned(self, *arguments, **others))
        return plans[-1]

    monkeypatch.setattr(Simulator, "plan", counted)
    segments = [[a, *range(a, a + 3)] for a in range(0, 12, 3)]
    run = [one.values for one in frames(simulator, moving, segments, output="raw")]
    assert len(plans) == (4 if has_lamp else 1)
    for number in (3, 9):
        alone = [[number, *range(number, number + 3)]]
        for one in frames(simulator, moving, alone, output="raw"):
            assert np.array_equal(one.values, run[one.number])
    if has_lamp:
        for number in (0, 3, 6, 9):
            shown = next(moving.between(number, number + 1))
            raw = simulator.loop(shown).output("raw", first=number)
            assert np.array_equal(simulator.device.numpy(raw), run[number])


@pytest.mark.parametrize("fails", ["", "items", "work"])
def test_groups_are_worked_on_at_the_same_time_and_end_whole(fails):
    """At most `held` items are at work; an error of the items leaves the groups before whole."""
    sizes, held, at_work, most, whole, abandoned = [3, 1, 4, 5], 4, set(), [0], [], []

    def items():
        for number in range(sum(sizes)):
            if fails == "items" and number == 9:
                raise BadFile("a", "truncated")
            at_work.add(number)
            most[0] = max(most[0], len(at_work))
            yield number

    def work(group, arriving):
        done = 0
        try:
            for number in arriving:
                if fails == "work" and number == 5:
                    raise BadFile("b", "full")
                time.sleep(0.002)
                at_work.discard(number)
                done += 1
                yield group, number
            whole.append(group)
        except BadFile:
            raise
        except Exception:
            abandoned.append(group)
            raise

    results, error = [], None
    try:
        for result in in_groups(items(), sizes, work, workers=2, held=held):
            results.append(result)
    except BadFile as found:
        error = str(found)
    groups = [group for group, size in enumerate(sizes) for _ in range(size)]
    # one item more is taken before it waits, and one is counted until its result is taken
    assert most[0] <= held + 2
    for group in range(len(sizes)):
        own = [number for of, number in results if of == group]
        assert own == sorted(own) and all(groups[number] == group for number in own)
    if not fails:
        assert sorted(number for _, number in results) == list(range(13)) and len(whole) == 4
    elif fails == "items":
        assert "truncated" in error and sorted(whole) == [0, 1, 2] and abandoned == [3]
    else:
        assert "full" in error and 2 not in whole


def test_exposure_ends_with_the_frame():
    camera = gs.open_camera("phone")
    automatic = replace(camera, sensor=replace(camera.sensor, exposure_time=None))
    assert within_period(automatic, Fraction(50)).sensor.auto_exposure.longest == 0.02
    short = replace(
        automatic, sensor=replace(automatic.sensor, auto_exposure=gs.AutoExposure(longest=0.001))
    )
    assert within_period(short, Fraction(50)).sensor.auto_exposure.longest == 0.001
    with pytest.raises(OutOfRange, match="period"):
        within_period(
            replace(camera, sensor=replace(camera.sensor, exposure_time=0.021)), Fraction(50)
        )


@pytest.mark.parametrize("frames", [1, 5, 24, 25, 100])
@pytest.mark.parametrize("length", [1, 7, 24, 200])
def test_shards_have_every_segment_once(frames, length):
    segments = segments_of(frames, length)
    assert [number for segment in segments for number in segment] == list(range(frames))
    for count in range(1, len(segments) + 1):
        parts = [Shard(number, count).of(segments) for number in range(count)]
        assert all(parts) and [one for part in parts for one in part] == segments


def test_items_come_in_order_and_what_is_raised_is_raised_where_they_are_taken():
    def some():
        yield from range(5)
        raise BadFile("a", "truncated")

    taken = []
    with pytest.raises(BadFile, match="truncated"):
        for item in ahead(some(), 2):
            taken.append(item)
    assert taken == list(range(5))

    closed = []

    def endless():
        try:
            while True:
                yield 0
        finally:
            closed.append(True)

    items = ahead(endless(), 2)
    assert next(items) == 0
    items.close()
    assert closed
