"""Simulated frames as files."""

from pathlib import Path

import numpy as np

from gpusim.domain.errors import OutOfRange, UnknownName
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.io.atomic import atomic_path
from gpusim.io.dng import write_dng
from gpusim.io.exr import write_rgb_exr
from gpusim.io.images import write_png

FORMATS = (".png", ".exr", ".dng", ".npz")


def frame_format(path) -> str:
    """Return the format that the path's suffix stands for. Raises UnknownName."""
    suffix = Path(path).suffix.lower()
    if suffix not in FORMATS:
        raise UnknownName("output format", suffix or str(path), FORMATS)
    return suffix


def check_format(path, camera):
    """Raise OutOfRange unless the path's format can hold what `camera` takes; UnknownName.

    camera: as operated, its sensor binned.
    """
    if frame_format(path) != ".dng":
        return
    sensor = camera.sensor
    shown = ("stacked pixels" if sensor.stacked else "float32 without a converter" if sensor.bits == FLOAT_BITS else
             f"the mosaic {'/'.join(sensor.cfa)}" if not (sensor.is_monochrome or sensor.bayer_phase) else None)
    if shown:
        raise OutOfRange("raw values for a .dng output", shown,
                         "digital numbers of a Bayer mosaic or a monochrome sensor; .npz holds any")
    table = camera.processor.table
    if table is not None and table.layout.gives_xyz:
        raise OutOfRange("processor.table with a .dng output", "filters that give XYZ", "those that give the camera's "
                         "channels: a raw converter needs their colour matrix")
    if not sensor.is_monochrome and camera.processor.color == "none":
        raise OutOfRange("processor.color with a .dng output", f'"{camera.processor.color}"',
                         '"white-preserving" or another colour matrix: a raw converter needs one')


def write_frame(path, frame):
    """Write one frame (gpusim.simulator.Frame) in the format of the path's suffix.

    .png: display codes. .exr: linear display RGB. .dng: digital numbers with what a raw converter needs.
    .npz: `electrons` (mean, float32 [e-]), `dn` (uint16, or float32 without a converter [DN]), both (rows, cols) or, of
    stacked pixels, (C, rows, cols), `exposure_time_s`, `black_level`, `white_level`, `gain_dn_per_e`, `cfa`,
    `channels`. Raises UnknownName, BadFile and, for what a .dng cannot hold, OutOfRange.
    """
    check_format(path, frame.camera)
    suffix, sensor = frame_format(path), frame.camera.sensor
    if suffix == ".png":
        write_png(path, frame.rgb, frame.camera.display)
    elif suffix == ".exr":
        write_rgb_exr(path, frame.linear, display=frame.camera.display)
    elif suffix == ".dng":
        colors = {} if sensor.is_monochrome else {"color_matrix": frame.rendering.camera_from_xyz,
                                                  "as_shot_neutral": frame.rendering.neutral,
                                                  "light": frame.camera.processor.target}
        write_dng(path, frame.raw, "" if sensor.is_monochrome else "".join(sensor.cfa), round(sensor.dark_level),
                  sensor.white_level, camera_name=f"gpusim {frame.camera.name}", **colors)
    else:
        with atomic_path(path) as temporary:
            np.savez_compressed(temporary, electrons=frame.mean, dn=frame.raw, cfa=np.array(sensor.cfa),
                                channels=np.array(sensor.channels), exposure_time_s=frame.exposure_time,
                                black_level=sensor.dark_level, white_level=sensor.white_level,
                                gain_dn_per_e=sensor.gain_dn_per_electron)
