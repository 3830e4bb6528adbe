"""Scenes from an encoded video, decoded by FFmpeg's libraries (PyAV).

Frames become reflectances, as photographs do.

The tags of the file (ITU-T H.273) set the meaning of its codes: BT.709 and BT.601 (the inverse of
the camera's curve, BT.709-6, 1.2), sRGB, pure powers, PQ (SMPTE ST 2084) and HLG (ARIB STD-B67),
the last two with white at the 203 cd/m2 and 75 % of ITU-R BT.2408. Without a tag the matrix and
range are chosen as players do: BT.709 from 576 rows, else BT.601, and limited range.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NoReturn

import numpy as np

from gpusim.apps.video.codecs import EXACT, converter, pyav
from gpusim.apps.video.scenes import check_size
from gpusim.domain.display import DISPLAYS, P3_PRIMARIES, Display
from gpusim.domain.errors import BadFile, UnknownName
from gpusim.domain.scene import Scene
from gpusim.io.files import open_file, reading
from gpusim.io.scene.photo import lift
from gpusim.io.scene.scenes import picture

SUFFIXES = (".mp4", ".mkv", ".mov", ".webm", ".avi")
TRANSFERS = {
    1: "bt709",
    6: "bt709",
    14: "bt709",
    15: "bt709",
    4: "gamma2.2",
    5: "gamma2.8",
    8: "linear",
    13: "srgb",
    16: "pq",
    18: "hlg",
}
PRIMARIES = {
    1: DISPLAYS["srgb"].primaries,
    9: ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),
    12: P3_PRIMARIES,
}
UNTAGGED = (0, 2)
MATRICES = {1: "bt709", 5: "bt601", 6: "bt601", 9: "bt2020"}
FULL_RANGE = 2
LENGTH = re.compile(r"(\d+):(\d\d):(\d\d(?:\.\d+)?)")  # hours, minutes, seconds
# frames between neighbours; frames by which storage order may lag behind display order
GAP, MOST_LATE = (Fraction(3, 2), 16)
# decoders raise errors for damage instead of concealing it
STRICT = {"err_detect": "crccheck+explode"}
PQ_WHITE, HLG_WHITE = 203 / 10000, 0.75  # relative to the largest light and the largest code


class Film:
    """Frames of a video file.

    Args:
        path: Path of the file.
        transfer: Transfer function of TRANSFERS in place of the file's tag.
        options: Options of `gpusim.picture`.

    Raises:
        BadFile, UnknownName: If the file is not a video or has unknown tags.
    """

    is_still = False

    def __init__(self, path: Path, transfer: str | None = None, **options):
        self.path, self._options, self.names = path, options | {"name": path.stem}, [str(path)]
        if transfer is not None and transfer not in TRANSFERS.values():
            raise UnknownName("transfer function", transfer, set(TRANSFERS.values()))
        self._av = pyav()
        open_file(path).close()  # refuses a folder or a pipe
        with self._reading(), self._av.open(str(path)) as container:
            if not container.streams.video:
                raise BadFile(path, "has no pictures; wanted a video")
            stream = container.streams.video[0]
            context = stream.codec_context
            tags = (
                context.color_trc,
                context.color_primaries,
                context.colorspace,
                context.color_range,
            )
            self._format, rows = context.pix_fmt or "", context.height
            self.count = stream.frames or self._count_frames(container, stream)
        if not self.count:
            raise BadFile(path, "has no frames")
        self._read_tags(tags, transfer, rows)
        self._at: tuple | None = None  # the number of the next frame, and the frames from it on
        self._last: tuple | None = None  # the number of a frame, and its scene
        self._shape = next(self.between(0, 1)).shape

    def _refuse(self, why: str) -> NoReturn:
        """Raise BadFile."""
        raise BadFile(self.path, why)

    def _count_frames(self, container, stream):
        """Return the number of frames of a file without that entry.

        Raises BadFile if the last ones are missing.
        """
        shown, end = [], Fraction(0)  # times of the frames, and end of the last one [s]
        for packet in container.demux(stream):
            if packet.size:
                shown.append((packet.pts or 0) * stream.time_base)
                end = max(end, shown[-1] + (packet.duration or 0) * stream.time_base)
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
        return len(shown)

    def _read_tags(self, tags, transfer, rows):
        """Set the meaning of codes from the tags. Raises BadFile."""
        curve, primaries, matrix, extent = tags
        if transfer is None and curve not in TRANSFERS:
            tag = "not tagged" if curve in UNTAGGED else f"tag {curve}"
            known = " or ".join(sorted(set(TRANSFERS.values())))
            self._refuse(
                f"its transfer function is {tag}, so the meaning of its codes is unknown; give "
                f"--transfer {known}"
            )
        if primaries not in (*UNTAGGED, *PRIMARIES):
            self._refuse(
                f"its primaries have the tag {primaries}; wanted BT.709, BT.2020 or Display P3"
            )
        self._transfer = TRANSFERS[curve] if transfer is None else transfer
        self._primaries = PRIMARIES.get(primaries, PRIMARIES[1])
        if self._format.startswith(("yuv", "nv", "p0")):
            known = MATRICES.get(matrix) or (
                None if matrix not in UNTAGGED else "bt709" if rows >= 576 else "bt601"
            )
            if known is None:
                self._refuse(f"its matrix has the tag {matrix}; wanted BT.601, BT.709 or BT.2020")
            extent = "full" if extent == FULL_RANGE or self._format.startswith("yuvj") else "tv"
            self._scale = f"in_color_matrix={known}:in_range={extent}:out_range=full"
        else:
            self._scale = "out_range=full"

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
                    codes = self._codes(frame)
                    break
            else:
                self._refuse(f"ends before its frame {number} of {self.count}: it is truncated")
        scene = self._lift(codes)
        return check_size(
            scene, getattr(self, "_shape", scene.shape), f"{self.path}, frame {number}", "its first"
        )

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
            context = container.streams.video[0].codec_context
            context.thread_type, context.options = "AUTO", STRICT
            yield from container.decode(video=0)

    def _codes(self, frame):
        """Return RGB codes of a frame (rows, cols, 3), uint8, or uint16 for more than 8 bits."""
        deep = max(part.bits for part in frame.format.components) > 8
        convert = converter(
            f"{EXACT}:{self._scale}",
            "rgb48le" if deep else "rgb24",
            frame.width,
            frame.height,
            frame.format,
            frame.time_base,
        )
        return convert(frame).to_ndarray()

    def _lift(self, codes):
        """Return the scene of RGB codes."""
        curve = light_of(self._transfer, 65535 if codes.dtype == np.uint16 else 255)
        scene = picture(codes, curve=curve, **self._options)
        if self._primaries == PRIMARIES[1]:
            return scene
        to_srgb = DISPLAYS["srgb"].rgb_from_xyz @ Display("film", self._primaries).xyz_from_rgb
        light = np.tensordot(to_srgb.astype(np.float32), np.moveaxis(curve[codes], -1, 0), 1)
        # colours outside sRGB are clipped
        return replace(scene, content=lift(np.maximum(light, 0)))


@cache
def light_of(transfer: str, most: int) -> np.ndarray:
    """Return the light of every code 0 .. most, white 1, float32. transfer: of TRANSFERS."""
    code = np.arange(most + 1) / most
    if transfer == "bt709":
        light = np.where(code < 0.081, code / 4.5, ((code + 0.099) / 1.099) ** (1 / 0.45))
    elif transfer == "srgb":
        light = DISPLAYS["srgb"].decode(code)
    elif transfer == "pq":
        m1, m2, c1, c2, c3 = 2610 / 16384, 2523 / 32, 3424 / 4096, 2413 / 128, 2392 / 128
        root = code ** (1 / m2)
        light = (np.maximum(root - c1, 0) / (c2 - c3 * root)) ** (1 / m1) / PQ_WHITE
    elif transfer == "hlg":
        light = _hlg(code) / _hlg(np.array(HLG_WHITE))
    else:
        light = code ** {"linear": 1.0, "gamma2.2": 2.2, "gamma2.8": 2.8}[transfer]
    return light.astype(np.float32)


def _hlg(code):
    a, b = 0.17883277, 0.28466892
    c = 0.5 - a * np.log(4 * a)
    return np.where(code <= 0.5, code**2 / 3, (np.exp((np.maximum(code, 0.5) - c) / a) + b) / 12)
