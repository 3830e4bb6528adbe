"""Colour, sharpness, distortion, shading and tone as parts of one fit: shots in, parts out."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.fit.color import fit_color
from gpusim.fit.distortion import fit_distortion
from gpusim.fit.estimate import Part
from gpusim.fit.lateral_color import lateral_curves
from gpusim.fit.planes import channel_blocks, light_values, main_channel
from gpusim.fit.shading import falloff_map, fit_shading, measure_shading
from gpusim.fit.sharpness import fit_sharpness
from gpusim.fit.shots import Known, Shot
from gpusim.fit.tone import fit_tone, ramp_light
from gpusim.io.raw.raw_frame import RawFrame


def chart_part(shots: Sequence[Shot], known: Known) -> Part:
    """Return the colour of frames of a ColorChecker. Options: light (one for each frame), corners."""
    frames = _read(shots)
    lights = known.options.get("light")
    return fit_color(
        frames,
        lights=[lights] if isinstance(lights, str) else lights,
        black=_black(frames, known),
        corners=known.options.get("corners"),
        falloff=known.shared.get("falloff"),
    )


def edges_part(shots: Sequence[Shot], known: Known) -> Part:
    """Return the blur of frames of slanted edges. Options: pitch [m], f_number."""
    frames = _read(shots)
    pitch, is_assumed = _pitch(known)
    number = known.options.get("f_number") or frames[0].f_number
    sensor = known.base.sensor
    found = fit_sharpness(
        frames,
        black=_black(frames, known),
        pitch=pitch,
        f_number=number or known.base.optics.f_number,
        aperture=(sensor.aperture[0] / sensor.pixel_pitch, sensor.aperture[1] / sensor.pixel_pitch),
        falloff=known.shared.get("falloff"),
        lateral_color=known.shared.get("lateral_color"),
    )
    settings = {key: dict(values) for key, values in found.settings.items()}
    unknown = list(found.unknown)
    if number:
        settings["optics"]["f_number"] = float(number)
    else:
        unknown.append(
            f"f-number: not in the files, the base's {known.base.optics.f_number:g} is taken for diffraction"
        )
    if is_assumed:
        unknown.append(_pitch_line(known))
    return replace(found, settings=settings, unknown=tuple(unknown))


def grid_part(shots: Sequence[Shot], known: Known) -> Part:
    """Return distortion and lateral colour of views of a checkerboard. Options: pitch [m], focal_length [m]."""
    frames = _read(shots)
    pitch, _ = _pitch(known)
    return fit_distortion(
        frames,
        black=_black(frames, known),
        pitch=pitch,
        focal_length=known.options.get("focal_length"),
    )


def shading_part(shots: Sequence[Shot], known: Known) -> Part:
    """Return the fall-off of the light of flats through the lens."""
    frames = _read(shots)
    return fit_shading(frames, black=_black(frames, known))


def ramp_part(shots: Sequence[Shot], known: Known) -> Part:
    """Return the tone curve of pictures of a ramp along the columns.

    Options: ramp, a table of low, high and decades, see `gpusim.fit.tone.ramp_light`; or a raw frame of the same
    exposure among the shots, with as many pixels.
    """
    codes, raws = [], []
    for shot in shots:
        if shot.path.suffix.lower() in (".jpg", ".jpeg", ".png"):
            codes.append((_codes(shot), shot.path.name))
        else:
            raws.append(shot.read())
    if not codes:
        raise BadData("ramp: no JPEG or PNG among the frames, whose codes have a tone curve")
    picture, name = codes[0]
    if raws:
        light, picture = _raw_light(raws[0], picture, known)
    else:
        light = ramp_light(picture.shape, **_ramp_options(known.options))
    found = fit_tone(picture, light, source=name)
    if raws or "ramp" in known.options:
        return found
    line = (
        "light of the ramp: not given, an even one from black to white along the columns is assumed; "
        "give a raw of it"
    )
    return replace(found, unknown=(*found.unknown, line))


def shared_results(kind: str, shots: Sequence[Shot], part: Part, known: Known) -> dict[str, Any]:
    """Return what later parts take from a part: the fall-off over the frame, lateral colour by channel.

    Args:
        kind: Kind of the shots.
        shots: The shots.
        part: What they gave.
        known: What was known.

    Returns:
        Values by name, of `Known.shared`.
    """
    if kind == "shading":
        frames = _read(shots)
        found = measure_shading(frames, black=_black(frames, known))
        shape = frames[0].values.shape
        return {"falloff": falloff_map(found[main_channel(tuple(found))], shape)}
    if kind == "grid":
        lateral = lateral_curves(part.estimates)
        return {"lateral_color": lateral} if lateral else {}
    return {}


def _read(shots) -> list[RawFrame]:
    return [shot.read() for shot in shots]


def _black(frames, known: Known):
    """Return the measured black level, or None for the frames' own."""
    if known.gain or frames[0].black_level is None:
        return known.black_level
    return None


def _pitch(known: Known):
    """Return the pixel pitch [m], and whether it is the base's."""
    given = known.options.get("pitch")
    return (given, False) if given else (known.base.sensor.pixel_pitch, True)


def _pitch_line(known: Known):
    return (
        f"pixel pitch: no raw file states it, the base's {known.base.sensor.pixel_pitch * 1e6:.4g} um is taken; a base "
        "with the camera's own pitch scales the point spreads"
    )


def _codes(shot: Shot):
    """Return the luma of a picture's codes, (rows, cols)."""
    from PIL import Image

    with Image.open(shot.path) as picture:
        return np.asarray(picture.convert("L"), np.float64)


def _raw_light(frame: RawFrame, picture, known: Known):
    """Return the light of a raw frame and the codes of its picture, in blocks of the mosaic's period."""
    values = light_values(frame, _black([frame], known))
    blocks, block = channel_blocks(frame, values)
    rows, cols = picture.shape
    if abs(rows - values.shape[0]) > 64 or abs(cols - values.shape[1]) > 64:
        raise BadData(
            f"{frame.name}: {values.shape[1]} x {values.shape[0]} pixels, its picture {cols} x {rows}; give a raw "
            "and a "
            "JPEG of full size of the same exposure"
        )
    light = blocks[list(frame.channels).index(main_channel(frame.channels))]
    rows, cols = (min(a, b // c) for a, b, c in zip(light.shape, picture.shape, block, strict=True))
    whole = picture[: rows * block[0], : cols * block[1]]
    return light[:rows, :cols], whole.reshape(rows, block[0], cols, block[1]).mean((1, 3))


def _ramp_options(options: Mapping[str, Any]):
    given = options.get("ramp", {})
    known = ("low", "high", "decades")
    if not isinstance(given, Mapping) or not given.keys() <= set(known):
        raise BadData(f"options: ramp = {given!r}: wanted a table of {', '.join(known)}")
    return given
