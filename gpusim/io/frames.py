"""Simulated frames as files."""

from pathlib import Path

import numpy as np

from gpusim.domain.errors import UnknownName
from gpusim.io.atomic import atomic_path
from gpusim.io.dng import write_dng
from gpusim.io.exr import write_rgb_exr
from gpusim.io.images import write_png


def write_frame(path, frame):
    """Write one frame (gpusim.scheduler.Frame) in the format of the path's suffix.

    .png: display codes. .exr: linear display RGB. .dng: digital numbers with what a raw converter needs.
    .npz: `electrons` (mean, float32 [e-]), `dn` (uint16 [DN]), `exposure_time_s`, `black_level`, `white_level`,
    `gain_dn_per_e`, `cfa`. Raises UnknownName and BadFile.
    """
    suffix = Path(path).suffix.lower()
    sensor = frame.camera.sensor
    if suffix == ".png":
        write_png(path, frame.rgb)
    elif suffix == ".exr":
        write_rgb_exr(path, frame.linear)
    elif suffix == ".dng":
        colors = {} if sensor.is_monochrome else {"color_matrix": frame.rendering.camera_from_xyz,
                                                  "as_shot_neutral": frame.rendering.neutral}
        write_dng(path, frame.raw, "" if sensor.is_monochrome else "".join(sensor.cfa), sensor.black_level,
                  sensor.white_level, camera_name=f"gpusim {frame.camera.name}", **colors)
    elif suffix == ".npz":
        with atomic_path(path) as temporary:
            np.savez_compressed(temporary, electrons=frame.mean, dn=frame.raw, cfa=np.array(sensor.cfa),
                                exposure_time_s=frame.exposure_time, black_level=sensor.black_level,
                                white_level=sensor.white_level, gain_dn_per_e=sensor.gain_dn_per_electron)
    else:
        raise UnknownName("output format", suffix or str(path), FORMATS)


FORMATS = (".png", ".exr", ".dng", ".npz")
