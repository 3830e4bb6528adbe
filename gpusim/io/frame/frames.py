"""Files of simulated frames."""

from pathlib import Path

import numpy as np

from gpusim.domain.errors import OutOfRange, UnknownName
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.io.archive import write_archive
from gpusim.io.atomic import atomic_path
from gpusim.io.exr import write_rgb_exr
from gpusim.io.frame.dng import check_dng, check_readable, write_dng
from gpusim.io.frame.images import write_jpeg, write_png, write_tiff, write_webp

# the first is the default
BITS = {".png": (8, 16), ".tif": (16, 8, 32), ".tiff": (16, 8, 32), ".exr": (32, 16)}
JPEG = (".jpg", ".jpeg")
LOSSY = (*JPEG, ".webp")  # formats with a quality
BITS |= dict.fromkeys(LOSSY, (8,)) | {".npy": (32, 16, 8)}
LABEL = "label_"  # begins the keys of labels in archives
RAW_ARRAY = ".raw.npy"
WITHOUT_PICTURE = (".dng", ".npz", RAW_ARRAY)  # files that no setting of the picture changes
FORMATS = (*BITS, *WITHOUT_PICTURE)
QUALITY = 95  # of LOSSY formats


def suffix_of(path) -> str:
    """Return the suffix of a frame's file, with .raw of .raw.npy."""
    path = Path(path)
    return "".join(path.suffixes[-2:]) if path.name.lower().endswith(RAW_ARRAY) else path.suffix


def frame_format(path) -> str:
    """Return the output format of a path's suffix. Raises UnknownName."""
    suffix = suffix_of(path).lower()
    if suffix not in FORMATS:
        raise UnknownName("output format", suffix or str(path), FORMATS)
    return suffix


def check_format(path, camera, bits=None, quality=None):
    """Raise OutOfRange unless the path's format can hold the camera's frames in these bits.

    quality: of a format of LOSSY, 1 .. 100. camera: with binning applied to its sensor. Raises UnknownName
    for an unknown suffix.
    """
    suffix = frame_format(path)
    if bits is not None and bits not in BITS.get(suffix, (bits,)):
        allowed = " or ".join(map(str, sorted(BITS[suffix])))
        raise OutOfRange(f"bits of a {suffix} output", bits, allowed)
    if quality is not None and (suffix not in LOSSY or quality not in range(1, 101)):
        allowed = "1 .. 100, for .jpg and .webp only"
        raise OutOfRange(f"quality of a {suffix} output", quality, allowed)
    if suffix != ".dng":
        return
    sensor, table = camera.sensor, camera.processor.table
    cfa = () if sensor.stacked or sensor.is_monochrome else sensor.cfa
    check_dng(cfa, sensor.channels)
    check_readable(cfa)
    if not sensor.is_monochrome and table is not None and table.layout.outputs != sensor.channels:
        found = f"filters with the outputs {', '.join(table.layout.outputs)}"
        allowed = "filters with the camera's channels as outputs: a raw converter needs their white"
        raise OutOfRange("processor.table with a .dng output", found, allowed)


def write_frame(path, frame, bits=None, quality=None):
    """Write one frame (gpusim.pipeline.simulator.Frame) in the format of the path's suffix.

    - .png: display codes of 8 bits, or of 16, tagged with the display.
    - .tif: the same, 16 bits by default; 32 bits are linear display RGB as floats.
    - .exr: linear display RGB, floats of 32 bits or of 16, with the display's chromaticities.
    - .jpg: display codes of 8 bits with the display's profile, every pixel in colour.
    - .webp: the same, colour of 2 x 2 pixels; without loss at quality 100.
    - .npy: linear display RGB, float32 (rows, cols, 3), or display codes of 16 or 8 bits; .raw.npy:
      digital numbers, as `dn` below.
    - .dng: digital numbers with the tags for raw converters, see `_write_raw`.
    - .npz: `electrons` (mean, float32 [e-]), `dn` (uint16, or float32 without a converter [DN]),
      both (rows, cols) or, of stacked pixels, (C, rows, cols), `exposure_time_s`, `black_level`,
      `white_level`, `gain_dn_per_e`, `cfa`, `channels`; `depth_m` and `label_NAME` of a scene that
      has them, see `gpusim.carry_labels`.

    bits: bits of a sample, not used for .dng, .npz and .raw.npy; None is the first of BITS. quality:
    of a format of LOSSY, 1 .. 100; None is QUALITY. Raises UnknownName, BadFile, and OutOfRange if the format
    cannot hold the frame.
    """
    check_format(path, frame.camera, bits, quality)
    suffix, sensor, display = frame_format(path), frame.camera.sensor, frame.camera.display
    bits = None if suffix in WITHOUT_PICTURE else bits or BITS[suffix][0]
    if suffix == ".png":
        write_png(path, frame.codes(bits), display)
    elif suffix in (".tif", ".tiff"):
        write_tiff(path, frame.linear if bits == 32 else frame.codes(bits), display)
    elif suffix == ".exr":
        write_rgb_exr(path, frame.linear, half=bits == 16, display=display)
    elif suffix in LOSSY:
        write = write_jpeg if suffix in JPEG else write_webp
        write(path, frame.codes(8), display, quality or QUALITY)
    elif suffix in (".npy", RAW_ARRAY):
        array = frame.linear if bits == 32 else frame.codes(bits) if bits else frame.raw
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            np.save(file, np.ascontiguousarray(array))
    elif suffix == ".dng":
        _write_raw(path, frame)
    else:
        arrays = {
            "electrons": frame.mean,
            "dn": frame.raw,
            "cfa": np.array(sensor.cfa),
            "channels": np.array(sensor.channels),
            "exposure_time_s": frame.exposure_time,
            "black_level": sensor.dark_level,
            "white_level": sensor.white_level,
            "gain_dn_per_e": sensor.gain_dn_per_electron,
        }
        write_archive(path, arrays | named_labels(frame.labels))


def named_labels(labels: dict) -> dict:
    """Return labels of `gpusim.carry_labels` by their keys in files: depth_m, label_NAME."""
    return {
        "depth_m" if name == "depth" else f"{LABEL}{name}": label for name, label in labels.items()
    }


def _write_raw(path, frame):
    """Write digital numbers as a DNG.

    Black is the mean without light or dark current; white is the lowest of full well and converter
    limit. The matrices come from `gpusim.color.camera_profile`. The noise is the part that changes
    from frame to frame, in units with black 0 and white 1: photons, dark current and read noise.
    """
    sensor = frame.camera.sensor
    gain, black = sensor.gain_dn_per_electron, sensor.dark_level
    white = sensor.white_level
    if sensor.bits != FLOAT_BITS:
        white = min(white, round(black + gain * sensor.saturation))
    noise = None
    # else S is not above 0, as a DNG requires
    if frame.averaged is not None and sensor.noise.photon != "none":
        noise = RawNoise.of(sensor, frame.averaged).profile((white - black) / gain)
    cfa = () if sensor.stacked or sensor.is_monochrome else sensor.cfa
    matrices, neutral = None, None
    if not sensor.is_monochrome:
        matrices, neutral = frame.color_profile, frame.rendering.neutral
    write_dng(
        path,
        frame.raw,
        cfa,
        black,
        white,
        matrices,
        neutral,
        channels=sensor.channels,
        noise=noise,
        camera_name=f"gpusim {frame.camera.name}",
        exposure_time=frame.exposure_time,
    )
