"""Scenes from an encoded video, decoded by FFmpeg's libraries (PyAV).

Frames become reflectances, as photographs do. `codes` gives the meaning of their codes, `shape`
their geometry.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from gpusim.apps.video.codecs import pyav
from gpusim.apps.video.codes import BT709, Tags, read_coding
from gpusim.apps.video.crop import Crop, read_crop
from gpusim.apps.video.scenes import check_size
from gpusim.apps.video.shape import Turn, read_matrix, square_size
from gpusim.data.transfers import TRANSFERS
from gpusim.domain.display import DISPLAYS, Display
from gpusim.domain.errors import BadFile, check_known
from gpusim.domain.memory import require_memory
from gpusim.domain.scene import Scene
from gpusim.io.account import Fields
from gpusim.io.files import name_in_errors, open_file, reading
from gpusim.io.scene.photo import lift
from gpusim.io.scene.scenes import picture

SUFFIXES = (".mp4", ".mkv", ".mov", ".webm", ".avi", ".m4v", ".mpg", ".ts", ".mts", ".mxf")
LENGTH = re.compile(r"(\d+):(\d\d):(\d\d(?:\.\d+)?)")  # hours, minutes, seconds
# frames between neighbours; frames by which storage order may lag behind display order
GAP, MOST_LATE = (Fraction(3, 2), 16)
# decoders raise errors for damage instead of concealing it
STRICT = {"err_detect": "crccheck+explode"}
# Side data of frames that say nothing about light or geometry
IGNORED = (
    *("SEI_UNREGISTERED", "*TIMECODE", "MOTION_VECTORS", "VIDEO_ENC_PARAMS", "FILM_GRAIN*"),
    *("PANSCAN", "VIDEO_HINT", "REGIONS_OF_INTEREST", "DETECTION_BBOXES"),
)
ROUNDING = Fraction(1, 500)  # [s]; times in Matroska are whole milliseconds
FASTEST = 10**5  # [frame/s]
BYTES_PER_PIXEL = 64  # a decoder's references, planes of float32, codes and coefficients


class Film:
    """Frames of a video file.

    Args:
        path: Path of the file.
        transfer: Transfer function in place of the file's tag, one of `gpusim.data.transfers.TRANSFERS`.
        options: Options of `gpusim.picture`.

    Attributes:
        count: Number of frames.
        rate: Frames per second, or None if the file does not have it.
        notes: What was guessed, and what is not used.

    Raises:
        BadFile, UnknownName: If the file is not a video, has unknown tags or a geometry that is not
            supported.
    """

    is_still = False

    def __init__(self, path: Path, transfer: str | None = None, **options):
        self.path, self.names = path, [str(path)]
        if transfer is not None:
            check_known("transfer function", transfer, sorted(set(TRANSFERS.values())))
        self._av = pyav()
        open_file(path).close()  # refuses a folder or a pipe
        with self._reading(), self._av.open(str(path)) as container:
            self._number = self._choose(container)
            stream = container.streams[self._number]
            notes = [*_unused_streams(container, stream)]
            shown = self._times(container, stream)
            self.count = len(shown)
            if not self.count:
                raise BadFile(path, "has no frames")
            self.rate, more = _rate(stream, shown)
            notes += more
        with self._reading(), self._av.open(str(path)) as container:
            stream = container.streams[self._number]
            self._require_memory(stream.codec_context.width, stream.codec_context.height)
            stated = _tags(stream.codec_context)
            frame = next(self._decode_of(container), None)
            if frame is None:
                raise BadFile(path, "has no frame that can be decoded")
            aspect = Fraction(stream.sample_aspect_ratio or 1)
        with name_in_errors(path):
            tags, more = _merge(stated, _tags(frame))
            notes += more
            side = Fields(
                {one.type.name: one for one in frame.side_data}, "not used, of its frames"
            )
            self._place(frame, side, aspect, notes)
            self._require_memory(*self._size)
            self._coding = read_coding(tags, frame.format, frame.width, frame.height, transfer)
        notes += self._coding.notes
        above = self._coding.share_above_white(frame)
        if above > 0:
            notes.append(f"{100 * above:.2g} % of its first frame are brighter than white: clipped")
        if frame.interlaced_frame:
            notes.append("interlaced: both fields of a frame are taken as of one time")
        side.ignore(*IGNORED)
        self.notes = (*notes, *side.notes())
        self._options = {"name": path.stem, "notes": self.notes} | options
        self._at: tuple | None = None  # the number of the next frame, and the frames from it on
        self._last: tuple | None = None  # the number of a frame, and its scene
        self._shape = next(self.between(0, 1)).shape

    def _refuse(self, why: str) -> NoReturn:
        """Raise BadFile."""
        raise BadFile(self.path, why)

    def _require_memory(self, cols, rows):
        """Raise DoesNotFit for frames that are too large."""
        require_memory(f"{self.path}: frames of {cols} x {rows}", BYTES_PER_PIXEL * cols * rows)

    def _choose(self, container):
        """Return the index of the first stream of pictures. Raises BadFile."""
        streams = [stream for stream in container.streams.video if not _is_cover(stream)]
        if not streams:
            self._refuse("has no pictures; wanted a video")
        return streams[0].index

    def _place(self, frame, side, aspect, notes):
        """Set turn and size of frames. side: Fields of its side data."""
        if "SPHERICAL" in side or ("STEREO3D" in side and _is_stereo(side.take("STEREO3D"))):
            self._refuse(
                "its frames are of a whole sphere or of two eyes; convert it to flat frames of one eye"
            )
        self._turn, stretch = Turn(), Fraction(1)
        matrix = side.take("DISPLAYMATRIX")
        if matrix is not None:
            self._turn, stretch = read_matrix(bytes(matrix))
        if self._turn != Turn():
            notes.append("turned or mirrored as its display matrix says")
        aspect *= 1 / stretch if self._turn.swaps else stretch
        stored = frame.width, frame.height
        self._size = square_size(*stored, aspect)
        with open_file(self.path) as file:
            self._crop = read_crop(file, self._number, *stored)
        if self._crop != Crop():
            if self._size != stored:
                self._refuse(
                    "its container crops frames whose pixels are not square; crop it first"
                )
            left, top, right, bottom = self._crop
            notes.append(
                f"cropped by its container: left {left}, top {top}, right {right}, bottom {bottom}"
            )
        if self._size != stored:
            notes.append(
                f"its pixels have a width of {float(aspect):.4g} heights: {stored[0]} x {stored[1]} are "
                f"interpolated to {self._size[0]} x {self._size[1]} square ones"
            )

    def _times(self, container, stream):
        """Return the time of every frame that is shown [s], in storage order.

        Raises BadFile if the last ones are missing.
        """
        base, entries = stream.time_base, stream.index_entries or ()
        if entries and len(entries) == stream.frames:  # all of them, by the times of decoding
            return [one.timestamp * base for one in entries if not one.is_discard]
        stored, shown, end = 0, [], Fraction(0)  # times of frames, and end of the last one [s]
        for packet in container.demux(stream):
            stored += packet.size > 0
            if packet.size and not packet.is_discard:
                shown.append((packet.pts or 0) * base)
                end = max(end, shown[-1] + (packet.duration or 0) * base)
        if stored < stream.frames:
            self._refuse(f"has {stored} of its {stream.frames} frames: it is truncated")
        # of this stream, in Matroska
        length = LENGTH.fullmatch(stream.metadata.get("DURATION", ""))
        if length:
            hours, minutes, seconds = map(Fraction, length.groups())
            duration = 3600 * hours + 60 * minutes + seconds
        else:  # of the file: sound may be longer
            is_alone = len(container.streams) == 1
            duration = Fraction((container.duration or 0) if is_alone else 0, 1_000_000)
        rate = stream.average_rate or Fraction(0)
        # these times are whole milliseconds, and the last frame may have no duration
        if (duration - end) * rate > Fraction(3, 4):
            self._refuse(
                f"ends at {float(end):.3f} of its {float(duration):.3f} s: it is truncated"
            )
        gaps = [(later - at) * rate < GAP for at, later in pairwise(sorted(shown))]
        if sorted(shown) != shown and all(gaps[:-MOST_LATE]) and not all(gaps):
            self._refuse("one of its last frames is missing: it is truncated")
        return shown

    def between(self, first: int, end: int) -> Iterator[Scene]:
        """See `gpusim.apps.video.scenes.Scenes`."""
        for number in range(first, end):
            if self._last is None or self._last[0] != number:
                self._last = number, self._scene(number)
            yield self._last[1]

    def _scene(self, number):
        if self._at is None or self._at[0] > number:
            self._at = 0, self._decode()
        begun, decoded = self._at
        with self._reading():
            for at, frame in enumerate(decoded, begun):
                if at == number:
                    self._at = number + 1, decoded
                    if frame.is_corrupt:
                        self._refuse(f"its frame {number} is damaged")
                    codes = self._turn.apply(self._cut(self._coding.rgb(frame, self._size)))
                    break
            else:
                self._refuse(f"ends before its frame {number} of {self.count}: it is truncated")
        scene = self._lift(codes)
        return check_size(
            scene, getattr(self, "_shape", scene.shape), f"{self.path}, frame {number}", "its first"
        )

    def _cut(self, codes):
        """Return codes without the columns and rows that the container crops."""
        left, top, right, bottom = self._crop
        return codes[top : len(codes) - bottom, left : codes.shape[1] - right]

    @contextmanager
    def _reading(self):
        """Raise errors of FFmpeg as BadFile."""
        with reading(self.path, "a video"):
            try:
                yield
            except self._av.error.FFmpegError as error:
                raise BadFile(self.path, f"not a video, or truncated ({error.strerror})") from error

    def _decode(self):
        with self._av.open(str(self.path)) as container:
            yield from self._decode_of(container)

    def _decode_of(self, container):
        """Yield the frames of an open container.

        Threads decode slices, not frames: with a log (`av.logging.set_level`), threads of frames
        wait for Python's lock to report damage, and its holder waits for them to close the file.
        """
        stream = container.streams[self._number]
        stream.codec_context.thread_type, stream.codec_context.options = "SLICE", STRICT
        yield from container.decode(stream)

    def _lift(self, codes):
        """Return the scene of RGB codes."""
        curve = self._coding.curve
        scene = picture(codes, curve=curve, **self._options)
        if self._coding.primaries == BT709:
            return scene
        own = Display("film", self._coding.primaries)
        to_srgb = DISPLAYS["srgb"].rgb_from_xyz @ own.xyz_from_rgb
        light = np.tensordot(to_srgb.astype(np.float32), np.moveaxis(curve[codes], -1, 0), 1)
        # colours outside sRGB are clipped
        return replace(scene, content=lift(np.maximum(light, 0)))


def _is_cover(stream):
    """Return whether a stream is a still picture, such as the cover of an album."""
    return bool(stream.disposition & pyav().stream.Disposition.attached_pic)


def _is_stereo(data):
    """Return whether frames hold two views. data: libavutil's AVStereo3D."""
    return bool(np.frombuffer(bytes(data)[:4], "=i4").any())


def _unused_streams(container, used):
    """Return notes on the other streams of a file."""
    names = [
        f"{stream.index} ({stream.type}{', a cover' if _is_cover(stream) else ''})"
        for stream in container.streams
        if stream.index != used.index
    ]
    return Fields(names, "streams that are not used").notes()


def _tags(source):
    """Return the tags of a codec context or a frame."""
    return Tags(
        *(int(tag) for tag in (source.color_trc, source.color_primaries)),
        int(source.colorspace),
        int(source.color_range),
    )


def _merge(stated, own):
    """Return the tags of frames, completed by the file's; and notes if they disagree."""
    merged, notes = [], []
    for name, file, frame in zip(Tags._fields, stated, own, strict=True):
        unknown = (0,) if name == "range" else (2,)
        merged.append(file if frame in unknown else frame)
        if frame not in unknown and file not in unknown and file != frame:
            notes.append(
                f"its {name} is tagged {file} by the file and {frame} by its frames: {frame}"
            )
    return Tags(*merged), notes


def _rate(stream, shown) -> tuple[Fraction | None, list[str]]:
    """Return the frames per second, and notes if they are not constant or unknown."""
    times: Any = sorted(shown)
    gaps = [later - at for at, later in pairwise(times)]
    rate = stream.average_rate
    if not rate and gaps and times[-1] > times[0]:
        rate = Fraction(len(gaps)) / (times[-1] - times[0])
    rate = Fraction(rate or 0).limit_denominator(1001)
    if not 0 < rate <= FASTEST:
        return None, ["its frame rate is unknown"]
    if gaps and max(gaps) - min(gaps) > max(ROUNDING, 2 * stream.time_base):
        low, high = (1000 * float(gap) for gap in (min(gaps), max(gaps)))
        words = (
            f"its frames are {low:.4g} .. {high:.4g} ms apart: taken as {float(rate):.5g} a second"
        )
        return rate, [words]
    return rate, []
