"""Panels of the lens: modulation transfer of the system and of an edge, and the point spread."""

import numpy as np

from gpusim.apps.preview.curves import ACCENT, Axis, Chart, Line, Mark, channel_color
from gpusim.apps.preview.figures import Image, Note, Part
from gpusim.apps.preview.measures import Inputs, Where
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, GpusimError
from gpusim.domain.spectrum import energy_from_photons
from gpusim.measure.lens import field_place, lens_mtf, pixel_mtf, point_spread
from gpusim.measure.sfr import EdgeResponse, mtf50, sfr
from gpusim.optics.lenses import lens_of

LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear RGB, as Rec. 709 and sRGB have it
FREQUENCIES = np.linspace(0, 1, 101)  # [cycle/pixel]


def mtf(found: Inputs, where: Where, chosen, kept) -> list[Part]:
    """Return the transfer of lens and pixel at the pointer's place, and of the selected edge."""
    camera, direction = found.camera, chosen["direction"]
    place = _place(found, where)
    light, words = _light(found.scene)
    sensor = camera.sensor
    key = camera.optics, sensor.qe, sensor.pixel_pitch, sensor.aperture, direction, place, light
    lines = kept("mtf", key, lambda: system_mtf(camera, direction, place, light))
    marks, notes = [Mark(0.5, "Nyquist")], [f"{words}; field ({place[0]:.2f}, {place[1]:.2f})"]
    if sensor.binning != (1, 1):
        notes.append("the curves are of single pixels, before binning")
    elif where.part is None:
        notes.append("select a slanted edge with 'edge' for its response")
    elif found.account is not None and "blur left out" in found.account.bounds:
        notes.append(
            "no response of the edge: the tolerance leaves the lens's blur out of this picture; "
            "choose the tolerance 'exact' to measure it"
        )
    else:
        try:
            edge = edge_response(found, where)
        except GpusimError as error:
            notes.append(str(error))
        else:
            response = np.asarray(edge.response)
            lines = [*lines, Line("edge", edge.frequencies, response, ACCENT, "5 2")]
            half = float(mtf50(edge))
            marks.append(Mark(half, "MTF50 of the edge"))
            angle = float(np.degrees(edge.angle))
            notes.append(f"MTF50 {half:.3f} cycle/pixel, edge at {angle:.1f} degrees")
    y = Axis("modulation transfer", 0.0, 1.05)
    chart = Chart(f"MTF, {direction}", Axis("frequency [cycle/pixel]", 0, 1), y, lines, marks)
    return [chart, *(Note(text) for text in notes)]


def system_mtf(camera: Camera, direction: str, place, light) -> list[Line]:
    """Return a line of lens and pixel for each channel, and one of the pixel alone.

    place: field point (y, x). light: see `gpusim.measure.lens.sensed_light`. Frequencies are in
    cycle/pixel.
    """
    sensor = camera.sensor
    on_sensor = FREQUENCIES / sensor.pixel_pitch
    pixel = np.abs(pixel_mtf(camera, on_sensor, direction))
    lines = [
        Line(
            f"{letter}, lens and pixel",
            FREQUENCIES,
            pixel * lens_mtf(camera, letter, on_sensor, direction, place, light),
            channel_color(letter),
        )
        for letter in sensor.channels
    ]
    return [*lines, Line("pixel", FREQUENCIES, pixel, dash="1 3")]


def edge_response(found: Inputs, where: Where) -> EdgeResponse:
    """Return the response of the edge in the selected part of the linear picture, in luminance.

    Raises GpusimError if there is none.
    """
    linear = found.arrays["linear"]
    return sfr(np.asarray(linear[where.region(linear.shape[:2])], np.float64) @ LUMINANCE)


def psf(found: Inputs, where: Where, chosen, kept) -> list[Part]:
    """Return the point spread of a channel at the pointer's place in the field."""
    camera, place = found.camera, _place(found, where)
    light, words = _light(found.scene)
    sensor = camera.sensor
    letter = chosen["channel"]
    key = camera.optics, sensor.qe, sensor.pixel_pitch, sensor.aperture, letter, place, light
    energy, step = kept("psf", key, lambda: point_spread(camera, letter, place, light))
    title = f"point spread, channel {letter}"
    frame = tuple(1e6 * side for side in sensor.aperture)
    return [
        Image(title, "[µm]", energy, 1e6 * step, (frame[0], frame[1])),
        Note(f"{words}; field ({place[0]:.2f}, {place[1]:.2f}), 1 is the frame's corner"),
    ]


def _place(found, where):
    """Return the field point of the pixel under the pointer; the axis if the blur is uniform."""
    shape = found.scene.shape
    if lens_of(found.camera).is_uniform:
        return 0.0, 0.0
    place = field_place(found.camera, shape, *where.pixel(shape))
    return round(place[0], 3), round(place[1], 3)


def _light(scene):
    """Return the scene's light in energy units, and its name in words."""
    if not scene.light_is_known:
        return "D65", "in D65, because the scene's light is unknown"
    light = energy_from_photons(scene.illuminant)
    if not light.values.max() > 0:
        raise BadData(f"{scene.name}: its light is dark; wanted light for the lens to transfer")
    return light, f"in {light.name or 'the light of the scene'}"
