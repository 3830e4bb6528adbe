"""Encoded videos by FFmpeg's libraries (PyAV).

Segments are encoded independently, then joined without re-encoding.

The number of encoder threads is fixed, because the output depends on it. x264 uses no look-ahead:
with it the output differed between runs (heights that are not whole macroblocks). x265 has threads
for frames but no pool of workers: with a pool, the end of a stream sometimes hangs (x265 4.2: the
look-ahead's worker wakes nobody if its pictures were taken while it still counted as busy, and
their taker waits for ever). Without a pool x265 has no wavefronts either: 1920 x 1080 takes 145 ms
a frame on two cores instead of 98 ms.

Colours are tagged: the display's primaries and curve, and for luma and chroma the matrix of BT.709
in limited range.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from threading import local
from typing import Any

import numpy as np

from gpusim.domain.display import DISPLAYS, Display, decoding
from gpusim.domain.errors import BadFile, Conflict, GpusimError, OutOfRange, UnknownName
from gpusim.io.atomic import atomic_path
from gpusim.io.files import reading

# ITU-T H.273: primaries, transfer functions, matrices; and libavutil's ranges
PRIMARIES = {"srgb": 1, "display-p3": 12}
UNKNOWN, SRGB_CURVE, LINEAR, RGB, BT709 = 2, 13, 8, 0, 1
LIMITED, FULL = 1, 2
# Equal results on all processors
EXACT = "flags=accurate_rnd+full_chroma_int+full_chroma_inp+bitexact+bicubic"
# FFmpeg's cubics multiply chroma by 1.08 if they double it without a change to RGB
EXACT_LINEAR = EXACT.replace("bicubic", "bilinear")
TO_LUMA = f"{EXACT}:in_range=full:out_range=tv:out_color_matrix=bt709"
SAME_CODES = "in_range=tv:out_range=tv:in_color_matrix=bt709:out_color_matrix=bt709"
TO_HALF_CHROMA = f"{EXACT_LINEAR}:{SAME_CODES}"


@dataclass(frozen=True)
class Codec:
    """A codec and its settings.

    Attributes:
        encoder: Name of the encoder in FFmpeg.
        output: Output of `Simulator.stream`.
        stored: Pixel format in the file, as FFmpeg names it.
        given: Pixel format of the frames before the conversion.
        containers: Suffixes of files that hold it.
        options: Options of the encoder.
        quality: Name of the encoder's option for the quality.
    """

    encoder: str
    output: str
    stored: str
    given: str
    containers: tuple[str, ...]
    options: tuple[tuple[str, str], ...]
    quality: str = ""


LEAST_H265 = 64  # pixels along each axis; libx265 ends the process for fewer
PART = ".nut"  # suffix of a segment's file, a container for any encoder
DELAY = 2  # frames by which libx265 decodes a frame before it is shown
MOST_FACTOR = 51  # largest constant rate factor of 8 bits
RAW_FRAME = b"FRAME\n"
RAW = ".y4m"  # suffix of uncompressed videos
LOSSLESS = ("level", "3"), ("slicecrc", "1")  # FFV1 with a checksum of each slice
CONTAINERS = (".mp4", ".mkv")
# as good as "veryfast" (35.6 against 35.5 dB of noisy frames), in two thirds of its time; files are 7 % larger
X264 = ("preset", "superfast"), ("threads", "4"), ("mbtree", "0"), ("rc-lookahead", "0")
X265 = ("preset", "superfast"), ("x265-params", "log-level=error:pools=none:frame-threads=4")
CODECS = {
    "h264": Codec("libx264", "codes", "yuv420p", "rgb24", CONTAINERS, X264, "crf"),
    "h265": Codec("libx265", "linear", "yuv420p10le", "yuv444p10le", CONTAINERS, X265, "crf"),
    "h265-12": Codec("libx265", "linear", "yuv420p12le", "yuv444p12le", CONTAINERS, X265, "crf"),
    "ffv1-raw": Codec("ffv1", "raw", "gray16le", "gray16le", (".mkv",), LOSSLESS),
    "ffv1-linear": Codec("ffv1", "linear", "gbrp16le", "gbrp16le", (".mkv",), LOSSLESS),
    "y4m": Codec("rawvideo", "codes", "yuv420p", "rgb24", (RAW,), ()),
}


def pyav():
    """Return the package. Raises GpusimError if it is not installed."""
    try:
        import av
        import av.filter
    except ImportError as error:
        why = f"encoded videos need PyAV ({error}); pip install 'gpusim[video]'"
        raise GpusimError(why) from error
    # No log. With one, threads of the decoders wait for Python's lock to report damage, while its
    # holder waits for them to close the file: a deadlock
    av.logging.set_level(None)
    return av


def converter(
    scale: str,
    stored: str,
    width: int,
    height: int,
    given: Any,
    time_base: Fraction,
    threads: int = 0,
) -> Callable:
    """Return a function that converts frames to another pixel format.

    Args:
        scale: Options of FFmpeg's scaler.
        stored: Pixel format of the results.
        width: Columns of the frames.
        height: Rows of the frames.
        given: VideoFormat of the frames.
        time_base: Time base of the frames [s].
        threads: Threads of a conversion. 0: one for each processor core.
    """
    graph = pyav().filter.Graph()
    graph.threads = threads
    parts = [
        graph.add_buffer(width=width, height=height, format=given, time_base=time_base),
        graph.add("scale", scale),
        graph.add("format", stored),
        graph.add("buffersink"),
    ]
    for part, following in pairwise(parts):
        part.link_to(following)
    graph.configure()

    def convert(frame):
        graph.push(frame)
        return graph.pull()

    return convert


def set_decoding_times(packets: list) -> list:
    """Return the last packets of a segment, in the order of decoding, with times that a container takes.

    libx265 does not set these times in a segment that is shorter than its delay. They are then what
    its memory held, and FFmpeg refuses some.
    """
    if packets and not -DELAY <= (packets[0].dts or 0) <= packets[0].pts:
        for number, packet in enumerate(packets):
            packet.dts = number - DELAY
    return packets


@contextmanager
def _writing(path):
    """Yield the container of a new file; errors of FFmpeg become BadFile."""
    av = pyav()
    try:
        with atomic_path(path) as temporary, av.open(str(temporary), "w") as container:
            yield container
    except av.error.FFmpegError as error:
        raise BadFile(path, f"cannot be encoded: {error.strerror}") from error


def codec_of(path: Path, name: str | None) -> Codec:
    """Return the codec of an output file.

    Args:
        path: Path of the file.
        name: Name of CODECS. None: h264, or y4m for its files.

    Raises:
        UnknownName, OutOfRange: If there is no such codec, or the file cannot hold it.
        GpusimError: If PyAV does not have its encoder.
    """
    if name is None:
        name = "y4m" if path.suffix.lower() == RAW else "h264"
    if name not in CODECS:
        raise UnknownName("codec", name, CODECS)
    codec, known = CODECS[name], pyav().codecs_available
    if path.suffix.lower() not in codec.containers:
        allowed = f"{' or '.join(codec.containers)} files for it"
        raise OutOfRange("--codec", f"{name} in {path.suffix}", allowed)
    if codec.encoder not in known:
        there = [other for other, one in CODECS.items() if one.encoder in known]
        raise GpusimError(
            f"codec {name}: this PyAV has no encoder {codec.encoder}; it has encoders for "
            f"{', '.join(there) or 'none of the codecs'}"
        )
    return codec


def _rows(plane, channels) -> np.ndarray:
    """Return the memory of a plane of bytes, (rows, channels times columns)."""
    return np.frombuffer(plane, np.uint8).reshape(plane.height, -1)[:, : channels * plane.width]


class Encoder:
    """Encodes frames into the files of segments.

    Args:
        codec: Codec.
        shape: Rows and columns.
        rate: Frames per second.
        display: Display of the codes.
        tone: Tone curve of the processor.
        quality: Constant rate factor. None: the encoder's default.

    Raises:
        OutOfRange: If the codec cannot hold this size, or for another quality than 0 .. MOST_FACTOR.
        Conflict: If the codec has no quality.
    """

    def __init__(
        self,
        codec: Codec,
        shape,
        rate: Fraction,
        display: Display,
        tone: tuple | str = (),
        quality: float | None = None,
    ):
        rows, cols = shape
        if codec.stored.startswith("yuv420") and (rows % 2 or cols % 2):
            allowed = "even numbers of columns and rows, or --codec ffv1-linear"
            raise OutOfRange("frame size of an encoded video", f"{cols}x{rows}", allowed)
        if codec.encoder == "libx265" and min(rows, cols) < LEAST_H265:
            allowed = f"{LEAST_H265} columns and rows or more, or --codec h264"
            raise OutOfRange("frame size of h265", f"{cols}x{rows}", allowed)
        if quality is not None and not codec.quality:
            is_raw = codec.encoder == "rawvideo"
            reason = "an uncompressed video has none" if is_raw else "ffv1 is lossless"
            raise Conflict("--quality", reason, "leave it out")
        if quality is not None and quality > MOST_FACTOR:
            raise OutOfRange("--quality of an encoded video", quality, f"0 .. {MOST_FACTOR}")
        self.codec, self.rate, self.shape = codec, rate, shape
        self._display, self._tone = display, tone
        self._threads = local()
        self._options = dict(codec.options)
        if quality is not None:
            self._options[codec.quality] = f"{quality:g}"

    def segment(self, path: Path, frames: Iterable[np.ndarray]) -> Iterator[int]:
        """Write a file of frames: codes and linear are (rows, cols, 3), raw is (rows, cols).

        Yields the number of each frame that was taken; the file exists when all were. Raises
        BadFile.
        """
        av = pyav()
        with _writing(path) as container:
            stream, change = self._stream(container), self._converter(av)
            for number, values in enumerate(frames):
                frame = self._frame(av, values)
                frame.pts, frame.time_base = number, 1 / self.rate
                container.mux(stream.encode(change(frame)))
                yield number
            container.mux(set_decoding_times(stream.encode(None)))

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame before it is encoded."""
        rows, cols = self.shape
        return rows * cols * {"codes": 3, "raw": 2}.get(self.codec.output, 12)

    @cached_property
    def _raw_header(self):
        """Header of an uncompressed video. Source: the manual page yuv4mpeg(5) of mjpegtools.

        Chroma lies between the pixels that it is the mean of, as in JPEG.
        """
        rows, cols = self.shape
        rate = f"{self.rate.numerator}:{self.rate.denominator}"
        return (
            f"YUV4MPEG2 W{cols} H{rows} F{rate} Ip A1:1 C420jpeg XYSCSS=420JPEG "
            "XCOLORRANGE=LIMITED\n"
        ).encode()

    def raw_place(self, number: int) -> int:
        """Return the first byte of a frame in an uncompressed video."""
        rows, cols = self.shape
        return len(self._raw_header) + number * (len(RAW_FRAME) + rows * cols * 3 // 2)

    def write_raw(self, file: int, number: int, values: np.ndarray) -> None:
        """Write a frame to its place in an uncompressed video, in any thread.

        Args:
            file: Number of the open file.
            number: Number of the frame.
            values: Codes (rows, cols, 3).
        """
        av = pyav()
        if not hasattr(self._threads, "change"):
            self._threads.change = self._converter(av)
        frame = self._frame(av, values)
        frame.pts, frame.time_base = number, 1 / self.rate
        changed = self._threads.change(frame)
        before = b"" if number else self._raw_header
        parts = [np.frombuffer(before + RAW_FRAME, np.uint8)]
        parts += [np.ravel(_rows(plane, 1)) for plane in changed.planes]
        data: Any = np.concatenate(parts)
        place = self.raw_place(number) - len(before)
        while len(data):
            done = os.pwrite(file, data, place)
            data, place = data[done:], place + done

    def join(self, path: Path, parts: list[tuple[int, Path]]):
        """Join the files of segments, each with the number of its first frame. Raises BadFile."""
        # decoders take frames in another order than they show them, and start this many frames
        # earlier
        delay = max(
            (number - shown for _, part in parts for number, shown, _ in self._packets(part)),
            default=0,
        )
        with _writing(path) as container:
            stream = self._stream(container)  # its encoder yields no frames, only the header
            for first, part in parts:
                for number, shown, packet in self._packets(part):
                    packet.time_base, packet.stream = 1 / self.rate, stream
                    packet.pts, packet.dts = first + shown, first + number - delay
                    packet.duration = 1
                    container.mux(packet)

    def _packets(self, part):
        """Return storage number, display number and packet of each frame in a segment's file."""
        with reading(part, "a segment of this video"), pyav().open(str(part)) as source:
            packets = [packet for packet in source.demux(video=0) if packet.size]
            shown = [round(packet.pts * packet.time_base * self.rate) for packet in packets]
            return [
                (number, at - min(shown), packet)
                for number, (at, packet) in enumerate(zip(shown, packets, strict=True))
            ]

    def _stream(self, container):
        """Return a stream of this codec in an output file."""
        rows, cols = self.shape
        stream = container.add_stream(self.codec.encoder, rate=self.rate, options=self._options)
        stream.width, stream.height, stream.pix_fmt = cols, rows, self.codec.stored
        stream.codec_context.sample_aspect_ratio = 1
        self._tag(stream.codec_context)
        return stream

    def _tag(self, context):
        """Set the tags of the colours."""
        display = self._display
        known = UNKNOWN
        if display.name in DISPLAYS and display.encodes_like(DISPLAYS[display.name]):
            known = PRIMARIES.get(display.name, UNKNOWN)
        curve = SRGB_CURVE if display.curve == "srgb" else UNKNOWN
        if self.codec.output == "raw":
            tags = UNKNOWN, UNKNOWN, UNKNOWN, FULL
        elif self.codec.given == self.codec.stored:
            tags = known, LINEAR, RGB, FULL
        else:
            tags = known, curve, BT709, LIMITED
        context.color_primaries, context.color_trc, context.colorspace, context.color_range = tags

    def _converter(self, av):
        """Return a function from a frame in the given format to one in the stored format.

        It has one thread: several frames are converted at the same time.
        """
        if self.codec.given == self.codec.stored:
            return lambda frame: frame
        (rows, cols), given = self.shape, av.VideoFormat(self.codec.given)
        words = TO_LUMA if self.codec.given == "rgb24" else TO_HALF_CHROMA
        return converter(words, self.codec.stored, cols, rows, given, 1 / self.rate, threads=1)

    def _frame(self, av, values):
        """Return a frame in the given format."""
        if self.codec.given == "gbrp16le":
            values = np.rint(np.clip(values, 0, 1) * np.float32(65535)).astype(np.uint16)
        elif self.codec.output == "linear":
            return self._luma_and_chroma(av, values)
        if self.codec.given != "rgb24":
            return av.VideoFrame.from_ndarray(np.ascontiguousarray(values), format=self.codec.given)
        rows, cols = self.shape
        frame = av.VideoFrame(cols, rows, self.codec.given)
        # NumPy lets other threads run, `from_ndarray` does not
        _rows(frame.planes[0], 3)[:] = values.reshape(rows, -1)
        return frame

    def _luma_and_chroma(self, av, values):
        """Return a frame of luma and chroma in limited range: black 16, white 235 at 8 bits.

        Source: ITU-R BT.709-6, 3.2 to 3.5.
        """
        root = np.sqrt(np.clip(values, 0, 1))
        codes = self._codes[np.rint(root * np.float32(len(self._codes) - 1)).astype(np.int32)]
        r, g, b = np.moveaxis(codes, -1, 0)
        y = np.float32(0.2126) * r + np.float32(0.7152) * g + np.float32(0.0722) * b
        rows, cols = self.shape
        frame = av.VideoFrame(cols, rows, self.codec.given)
        steps = 2 ** (frame.format.components[0].bits - 8)
        parts = y, (b - y) * np.float32(1 / 1.8556), (r - y) * np.float32(1 / 1.5748)
        for plane, part, zero, span in zip(
            frame.planes, parts, (16, 128, 128), (219, 224, 224), strict=True
        ):
            stored = np.zeros((rows, plane.line_size // 2), "<u2")
            stored[:, :cols] = np.rint(part * np.float32(span * steps) + np.float32(zero * steps))
            plane.update(stored)
        return frame

    @cached_property
    def _codes(self):
        """Codes 0 .. 1, indexed by the square root of the light: they are nearly uniform in it."""
        codes, light = np.arange(2**14) / (2**14 - 1), np.linspace(0, 1, 2**17) ** 2
        values = np.interp(light, decoding(self._display, self._tone)(codes), codes)
        return values.astype(np.float32)
