"""Files of simulated frames."""

from pathlib import Path

import numpy as np

from gpusim.domain.errors import OutOfRange, UnknownName
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.io.archive import write_archive
from gpusim.io.exr import write_rgb_exr
from gpusim.io.frame.dng import check_dng, write_dng
from gpusim.io.frame.images import write_png, write_tiff

# the first is the default
BITS = {".png": (8, 16), ".tif": (16, 8, 32), ".tiff": (16, 8, 32), ".exr": (32, 16)}
LABEL = "label_"  # begins the keys of labels in archives
FORMATS = (*BITS, ".dng", ".npz")


def frame_format(path) -> str:
    """Return the output format of a path's suffix. Raises UnknownName."""
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        raise UnknownName("output format", suffix or str(path), FORMATS)
    return suffix


def check_format(path, camera, bits=None):
    """Raise OutOfRange unless the path's format can hold the camera's frames in these bits.

    camera: with binning applied to its sensor. Raises UnknownName for an unknown suffix.
    """
    suffix = frame_format(path)
    if bits is not None and bits not in BITS.get(suffix, (bits,)):
        allowed = " or ".join(map(str, sorted(BITS[suffix])))
        raise OutOfRange(f"bits of a {suffix} output", bits, allowed)
    if suffix != ".dng":
        return
    sensor, table = camera.sensor, camera.processor.table
    check_dng(() if sensor.stacked or sensor.is_monochrome else sensor.cfa, sensor.channels)
    if not sensor.is_monochrome and table is not None and table.layout.outputs != sensor.channels:
        found = f"filters with the outputs {', '.join(table.layout.outputs)}"
        allowed = "filters with the camera's channels as outputs: a raw converter needs their white"
        raise OutOfRange("processor.table with a .dng output", found, allowed)


def write_frame(path, frame, bits=None):
    """Write one frame (gpusim.pipeline.simulator.Frame) in the format of the path's suffix.

    - .png: display codes of 8 bits, or of 16, tagged with the display.
    - .tif: the same, 16 bits by default; 32 bits are linear display RGB as floats.
    - .exr: linear display RGB, floats of 32 bits or of 16, with the display's chromaticities.
    - .dng: digital numbers with the tags for raw converters, see `_write_raw`.
    - .npz: `electrons` (mean, float32 [e-]), `dn` (uint16, or float32 without a converter [DN]),
      both (rows, cols) or, of stacked pixels, (C, rows, cols), `exposure_time_s`, `black_level`,
      `white_level`, `gain_dn_per_e`, `cfa`, `channels`; `depth_m` and `label_NAME` of a scene that
      has them, see `gpusim.carry_labels`.

    bits: bits of a sample, not used for .dng and .npz; None is the first of BITS. Raises
    UnknownName, BadFile, and OutOfRange if the format cannot hold the frame.
    """
    check_format(path, frame.camera, bits)
    suffix, sensor, display = frame_format(path), frame.camera.sensor, frame.camera.display
    bits = bits or BITS.get(suffix, (None,))[0]
    if suffix == ".png":
        write_png(path, frame.codes(bits), display)
    elif suffix in (".tif", ".tiff"):
        write_tiff(path, frame.linear if bits == 32 else frame.codes(bits), display)
    elif suffix == ".exr":
        write_rgb_exr(path, frame.linear, half=bits == 16, display=display)
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
    )
