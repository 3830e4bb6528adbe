"""Good videos of several codecs and containers, for mutations."""

import io
from fractions import Fraction

import numpy as np

# container, codec, pixel format, options
KINDS = (
    ("mp4", "libx264", "yuv420p", {"g": "2"}),
    ("mov", "libx264", "yuv444p", {"qp": "0"}),
    ("matroska", "ffv1", "yuv420p10le", {"level": "3", "slicecrc": "1"}),
    ("matroska", "ffv1", "gbrp16le", {}),
    ("avi", "mjpeg", "yuvj420p", {}),
    ("matroska", "mpeg2video", "yuv420p", {}),
    ("webm", "libvpx-vp9", "yuv420p", {"cpu-used": "8"}),
)


def good_films(random) -> list[bytes]:
    """Bytes of short videos, tagged with sRGB's curve; some are turned, or have pixels that are not square."""
    import av

    found = []
    for number, (container, codec, pixels, options) in enumerate(KINDS):
        data = io.BytesIO()
        with av.open(data, "w", format=container) as file:
            stream = file.add_stream(codec, rate=Fraction(30000, 1001), options=options)
            stream.width, stream.height, stream.pix_fmt = 48, 32, pixels
            context = stream.codec_context
            context.color_primaries, context.color_trc, context.colorspace = 1, 13, 1
            if number % 2:
                context.sample_aspect_ratio = Fraction(4, 3)
            elif container in ("mp4", "mov"):
                stream.set_display_rotation(90)
            for at in range(4):
                values = random.integers(0, 256, (32, 48, 3), np.uint8)
                frame = av.VideoFrame.from_ndarray(values, format="rgb24").reformat(format=pixels)
                frame.pts, frame.time_base = at, Fraction(1001, 30000)
                file.mux(stream.encode(frame))
            file.mux(stream.encode(None))
        found.append(data.getvalue())
    return found


def read_film(path):
    """Read all frames of a video."""
    from gpusim.apps.video.video_frames import Film

    film = Film(path, "srgb")
    for _ in film.between(0, film.count):
        pass
