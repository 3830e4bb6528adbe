"""Video files of other programs: geometry, rate and codes are what FFmpeg and the standards say."""

import struct
import subprocess
import sys
from fractions import Fraction
from types import SimpleNamespace

import av
import colour
import numpy as np
import pytest
from cameras import PHONE

import gpusim as gs
from gpusim.apps.video.codecs import CODECS, Encoder, set_decoding_times
from gpusim.apps.video.video_frames import Film
from gpusim.cli.main import main
from gpusim.domain.errors import BadFile

TAGS = (1, 13, 1, 1)  # BT.709 primaries, sRGB curve, BT.709 matrix, limited range
ONE = 1 << 16


def planes_of(frame):
    """The planes of a frame, without padding."""
    kind = "<u2" if frame.format.components[0].bits > 8 else np.uint8
    return [
        np.frombuffer(part, kind).reshape(part.height, -1)[:, : part.width] for part in frame.planes
    ]


def frame_of(planes, pixels, shape):
    frame = av.VideoFrame(shape[1], shape[0], pixels)
    for part, values in zip(frame.planes, planes, strict=True):
        stored = np.zeros((part.height, part.line_size // values.itemsize), values.dtype)
        stored[:, : part.width] = values
        part.update(stored)
    return frame


def write(path, frames, pixels, tags=TAGS, codec="ffv1", rate=Fraction(25), times=None, **options):
    """Write a video of lists of planes. options: of the stream; `before` is called with it."""
    before, aspect = options.pop("before", None), options.pop("aspect", None)
    extra = options.pop("extra", ())
    rows, cols = frames[0][0].shape
    with av.open(str(path), "w") as file:
        stream = file.add_stream(codec, rate=rate, options=options)
        stream.width, stream.height, stream.pix_fmt = cols, rows, pixels
        context = stream.codec_context
        context.color_primaries, context.color_trc, context.colorspace, context.color_range = tags
        if aspect:
            context.sample_aspect_ratio = aspect
        if before:
            before(stream)
        for add in extra:
            add(file)
        for number, planes in enumerate(frames):
            frame = frame_of(planes, pixels, (rows, cols))
            frame.pts = number if times is None else times[number]
            frame.time_base = 1 / rate if times is None else Fraction(1, 1000)
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    return path


def ramp(rows=48, cols=64):
    """Planes of yuv444p: luma grows along rows and columns, chroma is grey."""
    y, x = np.mgrid[:rows, :cols]
    grey = np.full((rows, cols), 128, np.uint8)
    return [(20 + 2 * x + y).astype(np.uint8), grey, grey]


def first(path, transfer=None):
    film = Film(path, transfer)
    return film, next(film.between(0, 1))


def luma_of(codes):
    """Luma of 8 bits in limited range of grey codes."""
    return 16 + codes[..., 1].astype(float) * 219 / (255 if codes.dtype == np.uint8 else 65535)


# a, b, c, d of libavutil's display matrix: the point (p, q) is shown at (a p + c q, b p + d q)
TURNS = [
    (1, 0, 0, 1),
    (0, 1, -1, 0),
    (-1, 0, 0, -1),
    (0, -1, 1, 0),
    (-1, 0, 0, 1),
    (1, 0, 0, -1),
    (0, 1, 1, 0),
    (0, -1, -1, 0),
]


@pytest.mark.parametrize("turn", TURNS)
def test_display_matrices_turn_and_mirror(turn, tmp_path):
    a, b, c, d = turn
    matrix = [a * ONE, b * ONE, 0, c * ONE, d * ONE, 0, 0, 0, 1 << 30]
    planes = ramp()
    path = write(
        tmp_path / "a.mp4",
        [planes] * 2,
        "yuv444p",
        codec="libx264",
        qp="0",
        before=lambda stream: stream.set_display_matrix(matrix),
    )
    film, scene = first(path)
    found = luma_of(scene.content.codes)
    q, p = np.mgrid[:48, :64]
    down, right = b * p + d * q, a * p + c * q
    expected = np.zeros((down.max() - down.min() + 1, right.max() - right.min() + 1))
    expected[down - down.min(), right - right.min()] = planes[0]
    assert found.shape == expected.shape
    assert np.abs(found - expected).max() < 0.5  # codes of 8 bits are rounded: half a step
    assert any("display matrix" in note for note in film.notes) == (turn != TURNS[0])


def test_a_rotation_as_ffmpeg_sets_it_by_degrees(tmp_path):
    """set_display_rotation(90) is counter-clockwise in PyAV's and FFmpeg's convention."""
    planes = ramp()
    path = write(
        tmp_path / "a.mp4",
        [planes],
        "yuv444p",
        codec="libx264",
        qp="0",
        before=lambda stream: stream.set_display_rotation(90),
    )
    with av.open(str(path)) as file:
        assert next(file.decode(video=0)).rotation == 90
    _, scene = first(path)
    assert np.abs(luma_of(scene.content.codes) - np.rot90(planes[0])).max() < 0.5


def test_other_angles_are_refused(tmp_path):
    path = write(
        tmp_path / "a.mp4",
        [ramp()],
        "yuv444p",
        codec="libx264",
        before=lambda stream: stream.set_display_rotation(30),
    )
    with pytest.raises(BadFile, match="other than 0, 90, 180 or 270"):
        Film(path)


@pytest.mark.parametrize(
    ("aspect", "size"),
    [((2, 1), (48, 128)), ((16, 11), (48, 93)), ((1, 2), (96, 64)), ((1, 1), (48, 64))],
)
@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_pixels_that_are_not_square(suffix, aspect, size, tmp_path):
    planes = ramp()
    path = write(
        tmp_path / f"a{suffix}",
        [planes],
        "yuv444p",
        codec="libx264",
        qp="0",
        aspect=Fraction(*aspect),
    )
    film, scene = first(path)
    assert scene.shape == size
    assert any("square" in note for note in film.notes) == (aspect != (1, 1))
    # a linear ramp stays one, sample by sample at the centres of the new pixels, away from the edges
    y, x = ((np.arange(n) + 0.5) * old / n - 0.5 for n, old in zip(size, (48, 64), strict=True))
    wanted = 20 + 2 * x + y[:, None]
    assert np.abs(luma_of(scene.content.codes) - wanted)[8:-8, 8:-8].max() < 1.2  # rounded twice


def test_square_pixels_after_a_turn(tmp_path):
    path = write(
        tmp_path / "a.mp4",
        [ramp()],
        "yuv444p",
        codec="libx264",
        aspect=Fraction(2),
        before=lambda stream: stream.set_display_rotation(-90),
    )
    assert first(path)[1].shape == (128, 48)


@pytest.mark.parametrize(
    "rate", [Fraction(24000, 1001), Fraction(25), Fraction(30000, 1001), Fraction(60), Fraction(50)]
)
@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_the_rate_is_kept(rate, suffix, tmp_path, capsys):
    path = write(tmp_path / f"a{suffix}", [ramp()] * 6, "yuv444p", codec="libx264", rate=rate)
    film, _ = first(path)
    assert film.rate == rate and not any("apart" in note for note in film.notes)
    if rate == Fraction(30000, 1001):
        out = tmp_path / f"out{suffix}"
        assert (
            main(["video", str(path), "--camera", "phone", "--device", "numpy", "-o", str(out)])
            == 0
        )
        capsys.readouterr()
        with av.open(str(out)) as file:
            assert file.streams.video[0].average_rate == rate
            times = [frame.time for frame in file.decode(video=0)]
        assert np.abs(np.array(times) - np.arange(6) * 1001 / 30000).max() < 1e-3  # milliseconds


def test_a_rate_that_varies_is_noted(tmp_path):
    times = [0, 33, 67, 167, 200, 233, 333, 367]
    path = write(tmp_path / "a.mkv", [ramp()] * 8, "yuv444p", rate=Fraction(30), times=times)
    film, _ = first(path)
    (note,) = (note for note in film.notes if "apart" in note)
    assert "33 .. 100 ms" in note


def flat(values, shape=(16, 32)):
    return [np.full(shape, value, np.uint16) for value in values]


@pytest.mark.parametrize("bits", [10, 12])
@pytest.mark.parametrize(
    ("matrix", "weights"), [(1, (0.2126, 0.0722)), (6, (0.299, 0.114)), (9, (0.2627, 0.0593))]
)
@pytest.mark.parametrize("is_full", [False, True])
def test_deep_codes_are_by_the_integers_of_the_standards(bits, matrix, weights, is_full, tmp_path):
    """Every value by the formulas of BT.601, BT.709 and BT.2020 (H.273, 8.3), in the test's float64."""
    scale, random = 2 ** (bits - 8), np.random.default_rng(bits + matrix)
    shape = (16, 32)
    planes = [random.integers(100 * scale, 150 * scale, shape).astype(np.uint16) for _ in range(3)]
    planes[0][0], planes[0][1], planes[0][2] = 16 * scale, 235 * scale, 141 * scale
    for part in planes[1:]:
        part[:3] = 128 * scale
    path = write(
        tmp_path / "a.mkv", [planes], f"yuv444p{bits}le", (1, 13, matrix, 2 if is_full else 1)
    )
    codes = first(path)[1].content.codes
    y, cb, cr = (part.astype(float) for part in planes)
    if is_full:
        y, cb, cr = y / (2**bits - 1), *((c - 2 ** (bits - 1)) / (2**bits - 1) for c in (cb, cr))
    else:
        y = (y - 16 * scale) / (219 * scale)
        cb, cr = ((c - 128 * scale) / (224 * scale) for c in (cb, cr))
    kr, kb = weights
    r, b = y + 2 * (1 - kr) * cr, y + 2 * (1 - kb) * cb
    expected = np.stack([r, (y - kr * r - kb * b) / (1 - kr - kb), b], axis=-1)
    # float32 has 24 bits; the result is rounded to 16
    assert np.abs(codes / 65535 - np.clip(expected, 0, 1)).max() < 0.52 / 65535
    judge = colour.YCbCr_to_RGB(
        np.stack(planes, -1).astype(float),
        K=np.array([kr, kb]),
        in_bits=bits,
        in_int=True,
        in_legal=not is_full,
        out_legal=False,
        clamp_int=False,
    )
    assert np.abs(codes / 65535 - np.clip(judge, 0, 1)).max() < 1e-4 or is_full
    if not is_full:
        assert (codes[0] == 0).all() and (codes[1] == 65535).all()
        assert np.abs(codes[2] / 65535 - 125 / 219).max() < 1e-5


@pytest.mark.parametrize(
    ("pixels", "bits"), [("yuv420p10le", 10), ("yuv422p12le", 12), ("yuv420p12le", 12)]
)
def test_white_grey_and_colour_of_subsampled_codes(pixels, bits, tmp_path):
    """Luma 940 of 10 bits is code 1, 564 is (564 - 64) / 876, and a flat colour keeps its chroma."""
    scale = 2 ** (bits - 8)
    luma = np.full((16, 32), 940 * scale // 4, np.uint16)
    luma[:, :16] = 564 * scale // 4
    chroma = [
        np.full((8 if "420" in pixels else 16, 16), 512 * scale // 4, np.uint16) for _ in "ab"
    ]
    for part in chroma:
        part[:, :8] = 307 * scale // 4
    scene = first(write(tmp_path / "a.mkv", [[luma, *chroma]], pixels))[1]
    codes, y, c = scene.content.codes, 500 / 876, (307 - 512) / 896
    assert (codes[4:12, -4:] == 65535).all() and scene.content.curve[codes[8, -1, 0]] == 1
    r, b = y + 2 * c * 0.7874, y + 2 * c * 0.9278
    g = (y - 0.2126 * r - 0.0722 * b) / 0.7152
    assert np.abs(codes[4:12, :4] / 65535 - (r, g, b)).max() < 1e-5


def test_rgb_of_limited_range_and_of_ten_bits(tmp_path):
    for limited, black, white in ((1, 64, 940), (2, 0, 1023)):
        planes = [np.full((8, 16), white, np.uint16) for _ in range(3)]  # green, blue, red
        planes[0][:, :8] = black
        tags = (1, 13, 0, limited)
        codes = first(write(tmp_path / "a.mkv", [planes], "gbrp10le", tags))[1].content.codes
        assert (codes[:, 8:] == 65535).all() and (codes[:, :8] == (65535, 0, 65535)).all()


SD = {
    # primaries, matrix, rows -> the name of the colour space that is used, in colour-science
    (6, 6, 48): "SMPTE C",
    (5, 5, 48): "ITU-R BT.470 - 625",
    (2, 6, 48): "SMPTE C",
    (2, 5, 48): "ITU-R BT.470 - 625",
    (2, 2, 480): "SMPTE C",
    (2, 2, 576): "ITU-R BT.470 - 625",
    (2, 9, 48): "ITU-R BT.2020",
    (9, 2, 48): "ITU-R BT.2020",
}


@pytest.mark.parametrize("case", SD, ids=str)
def test_primaries_of_the_tags_and_of_half_set_ones(case, tmp_path):
    primaries, matrix, rows = case
    planes = flat((500, 480, 560), (rows, 32))
    film, scene = first(
        write(tmp_path / "a.mkv", [planes], "yuv444p10le", (primaries, 13, matrix, 1))
    )
    kr, kb = (0.2627, 0.0593) if "2020" in SD[case] else (0.299, 0.114)
    y, cb, cr = 436 / 876, (480 - 512) / 896, (560 - 512) / 896
    r, b = y + 2 * (1 - kr) * cr, y + 2 * (1 - kb) * cb
    codes = np.array([r, (y - kr * r - kb * b) / (1 - kr - kb), b])
    light = colour.models.eotf_sRGB(codes)
    matrix_rgb = colour.matrix_RGB_to_RGB(SD[case], "ITU-R BT.709", None)
    expected = np.maximum(matrix_rgb @ light, 0)
    # chromaticities and matrices of standards have three to four digits
    assert np.allclose(scene.content.planes[:, 0, 0], expected, atol=4e-4)
    assert any("not tagged" in note for note in film.notes) == (2 in case[:2])


def test_tags_that_are_not_supported_are_one_line(tmp_path):
    for tags, words in (
        ((11, 13, 1, 1), "primaries"),
        ((9, 16, 10, 1), "non-constant"),
        ((1, 9, 1, 1), "transfer"),
        ((1, 2, 1, 1), "--transfer"),
    ):
        path = write(tmp_path / "a.mkv", [flat((500, 512, 512))], "yuv444p10le", tags)
        with pytest.raises(BadFile, match=words) as caught:
            Film(path)
        assert "\n" not in str(caught.value)


def test_streams_and_alpha_that_are_not_used_are_noted(tmp_path):
    def add_sound(file):
        sound = file.add_stream("aac", rate=48000)
        frame = av.AudioFrame(format="fltp", layout="mono", samples=1024)
        for part in frame.planes:
            part.update(bytes(part.buffer_size))
        frame.sample_rate, frame.pts = 48000, 0
        file.mux(sound.encode(frame))
        file.mux(sound.encode(None))

    path = write(tmp_path / "a.mp4", [ramp()] * 3, "yuv444p", codec="libx264", extra=(add_sound,))
    film, _ = first(path)
    assert film.count == 3
    assert any(note.startswith("streams that are not used: 1 (audio") for note in film.notes)
    alpha = [*ramp(), np.full((48, 64), 99, np.uint8)]
    film, scene = first(write(tmp_path / "b.mkv", [alpha], "yuva444p"))
    assert "its alpha is not used" in film.notes and film.notes == scene.notes


def test_interlaced_frames_are_noted(tmp_path):
    path = write(
        tmp_path / "a.mkv",
        [[np.full((64, 64), 90, np.uint8), *(np.full((32, 32), 128, np.uint8) for _ in "ab")]] * 4,
        "yuv420p",
        codec="mpeg2video",
        flags="+ilme+ildct",
        rate=Fraction(25),
    )
    with av.open(str(path)) as file:
        assert next(file.decode(video=0)).interlaced_frame
    assert any("interlaced" in note for note in Film(path).notes)


@pytest.mark.parametrize("name", CODECS)
def test_what_is_written_is_tagged_and_white_is_the_standards(name, tmp_path):
    codec, rate = CODECS[name], Fraction(30000, 1001)
    values = {
        "codes": np.full((64, 96, 3), 255, np.uint8),
        "linear": np.ones((64, 96, 3), np.float32),
        "raw": np.full((64, 96), 1023, np.uint16),
    }[codec.output].copy()
    values[:32] = 0
    encoder = Encoder(codec, (64, 96), rate, PHONE.display, (), 0 if codec.quality else None)
    list(encoder.segment(tmp_path / "0.nut", [values] * 3))
    for suffix in codec.containers:
        if suffix == ".y4m":
            with open(tmp_path / f"a{suffix}", "wb") as file:
                for number in range(3):
                    encoder.write_raw(file.fileno(), number, values)
        else:
            encoder.join(tmp_path / f"a{suffix}", [(0, tmp_path / "0.nut")])
        with av.open(str(tmp_path / f"a{suffix}")) as file:
            stream = file.streams.video[0]
            found = stream.codec_context
            tags = found.color_primaries, found.color_trc, found.colorspace, found.color_range
            assert stream.average_rate == rate and (stream.sample_aspect_ratio or 1) == 1
            luma = planes_of(next(file.decode(video=0)))
        # the header of a .y4m names only the range
        known = {"ffv1-raw": (2, 2, 2, 2), "ffv1-linear": (1, 8, 0, 2), "y4m": (2, 2, 2, 1)}
        assert tags == known.get(name, TAGS)
        black, white = {
            "h264": (16, 235),
            "h265": (64, 940),
            "h265-12": (256, 3760),
            "y4m": (16, 235),
            "ffv1-linear": (0, 65535),
            "ffv1-raw": (0, 1023),
        }[name]
        assert (luma[0][:24] == black).all() and (luma[0][40:] == white).all()
        if name.startswith("h26"):
            assert all(
                (part == 8 * black).all() for part in luma[1:]
            )  # 128 at 8 bits, where black is 16


def test_colours_that_are_written_are_what_colour_science_says(tmp_path):
    """10 and 12 bits: flat patches of saturated colours, away from their edges."""
    light = np.zeros((64, 128, 3), np.float32)
    patches = np.array([(0.7, 0.1, 0.1), (0.1, 0.6, 0.2), (0.05, 0.1, 0.8), (0.4, 0.4, 0.05)])
    for at, patch in enumerate(patches):
        light[:, 32 * at : 32 * at + 32] = patch
    for name, bits in (("h265", 10), ("h265-12", 12)):
        encoder = Encoder(CODECS[name], (64, 128), Fraction(24), PHONE.display, (), 0)
        list(encoder.segment(tmp_path / "0.nut", [light]))
        encoder.join(tmp_path / "a.mkv", [(0, tmp_path / "0.nut")])
        with av.open(str(tmp_path / "a.mkv")) as file:
            y, cb, cr = planes_of(next(file.decode(video=0)))
        found = np.stack([y[32, 16::32], cb[16, 8::16], cr[16, 8::16]], -1).astype(float)
        codes = colour.models.eotf_inverse_sRGB(patches)
        expected = colour.RGB_to_YCbCr(
            codes,
            K=colour.WEIGHTS_YCBCR["ITU-R BT.709"],
            out_bits=bits,
            out_int=False,
            out_legal=True,
        ) * (2**bits - 1)
        # half a step of rounding, and half of x265's quantiser step at the rate factor 0
        assert np.abs(found - expected).max() < 1.6 * 2 ** (bits - 10)


READ = """
import sys, av
from pathlib import Path
from gpusim.apps.video.video_frames import Film
from gpusim.domain.errors import BadFile
av.logging.set_level(av.logging.FATAL)  # as another thread of a program may do at any time
av.logging.set_level = lambda level: None
for number in range(12):
    try:
        film = Film(Path(sys.argv[1]), "srgb")
        for scene in film.between(0, film.count):
            pass
        print("read")
    except BadFile as error:
        print("refused", str(error).count(chr(10)))
"""


def test_damaged_videos_are_refused_every_time_whatever_the_log(tmp_path):
    random = np.random.default_rng(4)
    frames = [
        [random.integers(16, 235, (96, 128)).astype(np.uint8)]
        + [random.integers(16, 240, (48, 64)).astype(np.uint8) for _ in "ab"]
        for _ in range(40)
    ]
    path = write(tmp_path / "a.mp4", frames, "yuv420p", codec="libx264", g="10", qp="35")
    data = bytearray(path.read_bytes())
    for place in random.integers(len(data) // 4, len(data) * 2 // 3, 16):
        data[place] ^= 0x55
    path.write_bytes(data)
    done = subprocess.run(
        [sys.executable, "-c", READ, str(path)], capture_output=True, text=True, timeout=60
    )
    assert done.stdout.split("\n")[:12] == ["refused 0"] * 12, done.stderr


def test_notes_of_a_video_are_reported(tmp_path, capsys):
    path = write(
        tmp_path / "a.mp4",
        [ramp()],
        "yuv444p",
        codec="libx264",
        before=lambda stream: stream.set_display_rotation(90),
    )
    out = str(tmp_path / "o.png")
    assert main(["video", str(path), "--camera", "phone", "--device", "numpy", "-o", out]) == 0
    assert "note: turned or mirrored" in capsys.readouterr().out
    assert gs.open_scene(tmp_path / "o_0000.png").shape == (64, 48)


def test_frames_before_an_edit_list_are_not_shown(tmp_path):
    """As by `ffmpeg -ss`: the file keeps them to decode the others. FFmpeg's count of shown frames is the judge."""
    path = tmp_path / "a.mp4"
    options = {"avoid_negative_ts": "disabled", "use_editlist": "1"}
    with av.open(str(path), "w", options=options) as file:
        stream = file.add_stream("libx264", rate=Fraction(30), options={"bf": "2", "qp": "0"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv444p"
        context = stream.codec_context
        context.color_primaries, context.color_trc, context.colorspace, context.color_range = TAGS
        for number in range(20):
            planes = [np.full((48, 64), value, np.uint8) for value in (40 + 8 * number, 128, 128)]
            frame = frame_of(planes, "yuv444p", (48, 64))
            frame.pts, frame.time_base = number - 4, Fraction(1, 30)
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    with av.open(str(path)) as file:
        assert file.streams.video[0].frames == 20
        shown = sum(1 for _ in file.decode(video=0))
    film, scene = first(path)
    assert film.count == shown == 16 == len(list(film.between(0, 16)))
    assert abs(luma_of(scene.content.codes)[0, 0] - (40 + 8 * 4)) < 0.5


@pytest.mark.parametrize(
    "options", [{"movflags": "frag_keyframe+empty_moov"}, {"movflags": "faststart"}]
)
def test_fragmented_and_streamable_files(options, tmp_path):
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w", options=options) as file:
        stream = file.add_stream("libx264", rate=Fraction(24), options={"g": "4"})
        stream.width, stream.height, stream.pix_fmt = 50, 38, "yuv420p"  # cropped from 64 x 48
        context = stream.codec_context
        context.color_primaries, context.color_trc, context.colorspace, context.color_range = TAGS
        for number in range(12):
            grey = np.full((38, 50, 3), 60 + number, np.uint8)
            frame = av.VideoFrame.from_ndarray(grey, format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, 24)
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    film, scene = first(path)
    assert (film.count, film.rate, scene.shape) == (12, 24, (38, 50))
    assert len(list(film.between(0, 12))) == 12 and film.notes == ()


def boxed(name, content):
    return len(content + name + b"....").to_bytes(4, "big") + name + content


def with_clap(data, clap):
    """An MP4 whose only track has a CleanApertureBox; its moov comes after the media data."""
    for_sizes = [b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"avc1"]
    data, at, box = bytearray(data), 0, boxed(b"clap", clap)
    for name in for_sizes:
        at = data.index(name, at)
        size = int.from_bytes(data[at - 4 : at], "big") + len(box)
        data[at - 4 : at] = size.to_bytes(4, "big")
    end = at - 4 + size - len(box)
    data[end:end] = box
    return bytes(data)


def test_the_clean_aperture_of_mp4(tmp_path):
    planes = ramp()
    path = write(tmp_path / "a.mp4", [planes] * 2, "yuv444p", codec="libx264", qp="0")
    # 40 x 30 with its middle 3 right of and 2 above the frame's
    numbers = (40, 1, 30, 1, 3, 1, -4, 2)
    path.write_bytes(with_clap(path.read_bytes(), struct.pack(">8i", *numbers)))
    with av.open(str(path)) as file:
        assert sum(1 for _ in file.decode(video=0)) == 2  # the file is sound
    film, scene = first(path)
    left, top = 12 + 3, 9 - 2
    wanted = planes[0][top : top + 30, left : left + 40]
    assert np.abs(luma_of(scene.content.codes) - wanted).max() < 0.5
    assert any("left 15, top 7, right 9, bottom 11" in note for note in film.notes)


def element(number, content):
    """An EBML element with a size of eight bytes."""
    name = number.to_bytes((number.bit_length() + 7) // 8, "big")
    return name + (1 << 56 | len(content)).to_bytes(8, "big") + content


def elements(data):
    at = 0
    while at < len(data):
        sizes = []
        for marker in (0, 1):
            length = 9 - data[at].bit_length()
            value = int.from_bytes(data[at : at + length], "big")
            sizes.append(value & ((1 << 7 * length) - 1) if marker else value)
            at += length
        yield sizes[0], data[at : at + sizes[1]]
        at += sizes[1]


def with_crop(data, path=(0x18538067, 0x1654AE6B, 0xAE, 0xE0)):
    """A Matroska file whose video element also has PixelCropLeft 6, Top 4, Right 2 and Bottom 8."""
    if not path:
        more = ((0x54CC, 6), (0x54BB, 4), (0x54DD, 2), (0x54AA, 8))
        return data + b"".join(element(number, bytes([value])) for number, value in more)
    return b"".join(
        element(number, with_crop(content, path[1:]) if number == path[0] else content)
        for number, content in elements(data)
    )


def test_the_crop_of_matroska(tmp_path):
    planes = ramp()
    path = write(tmp_path / "a.mkv", [planes] * 2, "yuv444p", codec="libx264", qp="0")
    assert not first(path)[0].notes
    path.write_bytes(with_crop(path.read_bytes()))
    film, scene = first(path)
    assert np.abs(luma_of(scene.content.codes) - planes[0][4:-8, 6:-2]).max() < 0.5
    assert any("left 6, top 4, right 2, bottom 8" in note for note in film.notes)


def test_luma_above_white_is_noted(tmp_path):
    luma = np.full((16, 32), 940, np.uint16)
    luma[:4, :16] = 1000
    planes = [luma, *flat((512, 512), (16, 32))]
    film, scene = first(write(tmp_path / "a.mkv", [planes], "yuv444p10le"))
    assert (scene.content.codes == 65535).all()
    assert any(note.startswith("12 % of its first frame are brighter") for note in film.notes)


@pytest.mark.parametrize("count", [1, 2, 3, 5])
@pytest.mark.parametrize("name", ["h264", "h265"])
def test_short_segments_are_written(name, count, tmp_path):
    """libx265 leaves the times of decoding of few frames unset: FFmpeg refused the file now and then."""
    for _ in range(5):
        made = Encoder(CODECS[name], (64, 128), Fraction(24), PHONE.display, (), 0)
        kind = np.uint8 if name == "h264" else np.float32
        list(made.segment(tmp_path / "0.nut", np.zeros((count, 64, 128, 3), kind)))
        with av.open(str(tmp_path / "0.nut")) as file:
            shown = [frame.time for frame in file.decode(video=0)]
        # a container begins with the first time of decoding
        np.testing.assert_allclose(np.subtract(shown, shown[0]), np.arange(count) / 24, atol=1e-4)


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ([(0, -(2**62)), (1, 1 - 2**62)], [-2, -1]),
        ([(0, 2**40)], [-2]),
        ([(0, 0), (1, 1)], [0, 1]),
        ([(4, 2), (3, 3)], [2, 3]),
        ([], []),
    ],
)
def test_times_of_decoding_that_were_not_set(given, wanted):
    """No frame is decoded after it is shown, or much earlier; times that can be are kept."""
    packets = [SimpleNamespace(pts=shown, dts=decoded) for shown, decoded in given]
    assert [packet.dts for packet in set_decoding_times(packets)] == wanted
