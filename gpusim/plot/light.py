"""Pictures of light: radiance of a scene, spectra of patches, and irradiance behind a lens."""

from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np
import scipy

from gpusim.backends import Device
from gpusim.data.colorimetry import LUMINOUS_EFFICACY, cmf
from gpusim.data.weights import electrons_per_content, xyz_per_content
from gpusim.domain.camera import Camera, checked_camera
from gpusim.domain.content import Basis
from gpusim.domain.display import Display
from gpusim.domain.errors import BadData, check_known
from gpusim.domain.noise import Noise
from gpusim.domain.processor import Processor
from gpusim.domain.scene import Scene, View, checked_scene
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.domain.spectrum import (
    LONGEST,
    SHORTEST,
    Spectrum,
    energy_from_photons,
)
from gpusim.measure.ideal import pixel_sums, sample_sums
from gpusim.measure.spectra import (
    MODES,
    ORDER,
    QUANTITIES,
    patch_content,
    patch_spectrum,
)
from gpusim.optics.outside import rule_of
from gpusim.plot.canvas import STYLES, axes_of, finish, image, panels, picture_size, readable, srgb

UNSEEN = (0.4, 0.4, 0.4)
BRIGHT = 99.5  # percentile of the luminance shown as white if the white is unknown


def scene(scene: Scene, ax: Any = None) -> Any:
    """Plot a scene's radiance in sRGB.

    A white diffuser in the scene's light is white. If the light is unknown, the brightest 0.5 % of
    the pixels are white.

    Args:
        scene: scene to plot.
        ax: matplotlib axes; None makes a new figure.

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type, or the light is invisible.
        Missing: if matplotlib is not installed.
    """
    codes, white = radiance_codes(scene)
    rows, cols = scene.shape
    return image(
        axes_of(ax, picture_size(scene.shape)),
        codes,
        f"{scene.name}: radiance, {cols} x {rows} pixels, white {white:.3g} cd/m²",
    )


def radiance_codes(scene: Scene, step: int = 1) -> tuple[np.ndarray, float]:
    """Return sRGB codes 0 .. 1 (rows, cols, 3) of a scene's radiance.

    Also returns the luminance of white [cd m-2]. step: above 1, only one of `step` samples is used.
    """
    scene = _apply_view(checked_scene(scene, True))
    weights, white = _eye(scene)
    if step > 1:
        window = slice(scene.margin, -scene.margin or None, step)
        xyz = sample_sums(scene, weights, (window, window))
    else:
        xyz = pixel_sums(scene, weights)
    if white is not None:
        luminance = float(weights[1].sum())
        return srgb(xyz / luminance, white), luminance
    bright = float(np.percentile(xyz[1], BRIGHT)) or 1.0
    return srgb(xyz / bright), bright


def spectra(scene: Scene, at: Any = None, ax: Any = None, *, quantity: str = "radiance") -> Any:
    """Plot mean spectra of a scene's patches, each in its own colour.

    Args:
        scene: scene to plot.
        at: a pixel (column, row) or a region (left, top, right, bottom) of the frame, right and
            bottom exclusive; a list of them; None is the whole frame.
        ax: matplotlib axes; None makes a new figure.
        quantity: "radiance" [W m-2 sr-1 nm-1], "photons" [photon s-1 m-2 sr-1 nm-1] or, if the
            light is known, "reflectance".

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type, or reflectance needs a known light.
        Missing: if matplotlib is not installed.
        OutOfRange: if a place is outside the frame.
        UnknownName: if the quantity is unknown.
    """
    check_known("quantity", quantity, QUANTITIES)
    scene = _apply_view(checked_scene(scene, True))
    if quantity == "reflectance" and not scene.light_is_known:
        raise BadData(
            f"spectra: {scene.name} is radiance of an unknown light; wanted another quantity than "
            "reflectance"
        )
    found = [
        (*patch_spectrum(scene, place, quantity), _patch_color(scene, place), name)
        for place, name in zip(*_places(scene, at), strict=True)
    ]
    ax = axes_of(ax)
    for (wavelengths, values, color, name), style in zip(found, cycle(STYLES)):
        ax.plot(wavelengths, values, color=color, linestyle=style, label=name)
    ax.set_xlim(scene.wavelengths[0], scene.wavelengths[-1])
    ax.set_ylim(bottom=min(0.0, *(float(values.min()) for _, values, *_ in found)))
    ax.ticklabel_format(axis="y", scilimits=(-2, 3))
    unit = QUANTITIES[quantity]
    return finish(
        ax,
        scene.name,
        f"{quantity} of {'a patch' if len(found) == 1 else 'patches'}",
        "wavelength [nm]",
        f"{quantity} {unit}",
    )


def _patch_color(scene, place):
    """Return the line colour of a patch; grey if it is invisible."""
    return _color(scene, patch_content(scene, place))


def _color(scene, content):
    """Return the line colour of a spectrum; grey if it is invisible."""
    try:
        weights, white = _eye(scene)
    except BadData:
        return UNSEEN
    xyz = weights @ content
    return readable(srgb(0.4 / xyz[1] * xyz[:, None, None], white)[0, 0]) if xyz[1] > 0 else UNSEEN


def inspect(scene: Scene, *, quantity: str = "radiance") -> Any:
    """Show a scene next to the spectra of the pixels that are clicked in it.

    A right click removes all spectra. The figure is updated while its window, or a notebook's
    `%matplotlib widget`, is open.

    Args:
        scene: scene to show.
        quantity: quantity of the spectra, see `spectra`.

    Returns:
        The matplotlib figure.

    Raises:
        GpusimError: as raised by `scene` and `spectra`.
    """
    scene = _apply_view(checked_scene(scene, True))
    figure, axes = panels(None, 1, 2, (11.0, 4.4))
    left, right = axes[0]
    draw_scene(scene, left)
    spectra(scene, None, right, quantity=quantity)
    places: list[tuple[int, int]] = []

    def on_click(event):
        if event.inaxes is not left:
            return
        rows, cols = scene.shape
        places[:] = (
            []
            if event.button == 3
            else [
                *places,
                (
                    min(max(round(event.xdata), 0), cols - 1),
                    min(max(round(event.ydata), 0), rows - 1),
                ),
            ]
        )
        right.clear()
        spectra(scene, places or None, right, quantity=quantity)
        for mark in list(left.lines):
            mark.remove()
        for line, (col, row) in zip(right.lines, places, strict=False):
            left.plot(col, row, "s", color=line.get_color(), markeredgecolor="w")
        figure.canvas.draw_idle()

    figure.canvas.mpl_connect("button_press_event", on_click)
    return figure


draw_scene = scene  # a name that no argument hides


def optical_image(
    camera: Camera, scene: Scene, ax: Any = None, *, device: Device | str = "auto"
) -> Any:
    """Plot the irradiance behind a camera's lens in sRGB.

    The image of a white diffuser is white. The camera's sensor is replaced by one with the colour
    matching functions of the CIE 1931 observer on the same pixels: the image has all blur and
    fall-off, and of the sensor only pitch and aperture.

    Args:
        camera: camera with the lens.
        scene: scene to image.
        ax: matplotlib axes; None makes a new figure.
        device: see `gpusim.Simulator`.

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type.
        Missing: if matplotlib is not installed.
        GpusimError: as raised by `Simulator`.
    """
    codes, lux = irradiance_codes(camera, scene, device)
    rows, cols = codes.shape[:2]
    return image(
        axes_of(ax, picture_size((rows, cols))),
        codes,
        f"{scene.name} behind {camera.name}: irradiance, "
        f"f/{camera.optics.f_number:g}, white {lux:.3g} lx",
    )


def irradiance_codes(
    camera: Camera, scene: Scene, device: Device | str = "auto"
) -> tuple[np.ndarray, float]:
    """Return sRGB codes 0 .. 1 (rows, cols, 3) of the irradiance behind a lens.

    Also returns the illuminance of white [lx].
    """
    from gpusim.pipeline.simulator import Simulator

    observer, scene = observer_camera(checked_camera(camera)), checked_scene(scene)
    loop = Simulator(observer, device=device).loop(scene)
    return observed_codes(observer, scene, loop.simulator.device.numpy(loop.output("electrons")))


def observer_camera(camera: Camera) -> Camera:
    """Return a camera whose pixels have the colour matching functions of the CIE 1931 observer.

    Its stacked pixels collect for 1 s without noise. Lens, pitch and aperture are the camera's.
    """
    eye = energy_from_photons(cmf())
    edge = np.array([[0.0]] * 3)
    observer = Spectrum(
        np.concatenate(
            [
                [SHORTEST],
                [eye.wavelengths[0] - 1],
                eye.wavelengths,
                [eye.wavelengths[-1] + 1],
                [LONGEST],
            ]
        ),
        np.concatenate([edge, edge, eye.values / eye.values.max(), edge, edge], axis=1),
        "CIE 1931 observer",
    )
    sensor = replace(
        camera.sensor,
        qe=observer,
        channels=tuple("XYZ"),
        cfa=("XYZ",),
        stacked=True,
        bits=FLOAT_BITS,
        noise=Noise(),
        microlens=None,
        vignetting=None,
        exposure_time=1.0,
        binning=(1, 1),
        gain=None,
        conversion_gain=None,
        adc_range=None,
        black_level=0,
        analog_offset=0.0,
        row_time=0.0,
    )
    return replace(
        camera,
        sensor=sensor,
        processor=Processor(color="none", white_balance="none"),
        display=Display(),
    )


def observed_codes(observer: Camera, scene: Scene, electrons) -> tuple[np.ndarray, float]:
    """Return sRGB codes and the illuminance of white from the output "electrons" of a scene.

    observer: result of `observer_camera`. electrons: (3, rows, cols). See `irradiance_codes`.
    """
    height, width = observer.sensor.aperture
    peak = float(energy_from_photons(cmf()).values.max())
    to_lux = LUMINOUS_EFFICACY * peak / (height * width)
    xyz = to_lux * np.asarray(electrons, np.float64)
    if scene.light_is_known:
        white = to_lux * electrons_per_content(scene, observer).sum(1)
        return srgb(xyz / white[1], white / white[1]), float(white[1])
    bright = float(np.percentile(xyz[1], BRIGHT)) or 1.0
    return srgb(xyz / bright), bright


def _eye(scene):
    """Return weights of a scene's wavelengths for XYZ [cd m-2], and the white of its light.

    The white has luminance 1; it is None if the light is unknown.
    """
    weights = xyz_per_content(scene.wavelengths, scene.illuminant)
    if not scene.light_is_known:
        return weights, None
    white = weights.sum(1)
    if not white[1] > 0:
        raise BadData(f"{scene.name}: its light is invisible; wanted light within 360 .. 830 nm")
    return weights, white / white[1]


def _places(scene, at):
    """Return the patches and their names."""
    if at is None:
        return [(0, 0, *scene.shape[::-1])], ["all of the frame"]
    places = (
        list(at)
        if isinstance(at, (list, tuple, np.ndarray)) and len(at) and np.ndim(at[0])
        else [at]
    )
    return places, [
        "({})".format(", ".join(map(str, place))) if np.ndim(place) else str(place)
        for place in places
    ]


def _apply_view(scene) -> Scene:
    """Return the scene as seen in its view, resampled by splines of fifth order.

    Source: Thevenaz, Blu and Unser, Interpolation revisited, IEEE Trans. Med. Imaging 19 (2000).
    """
    if scene.view.is_plain:
        return scene
    content = scene.content.on_host()
    if type(content) is not Basis:  # splines overshoot, which a basis may
        content = Basis(
            content.wavelengths, content.bands_at(slice(None)), np.eye(len(content.wavelengths))
        )
    middle = [(n - 1) / 2 for n in content.shape]
    y, x = np.indices(content.shape)
    y, x = scene.view.place(y - middle[0], x - middle[1], scene.samples_per_pixel)
    planes = np.stack(
        [
            scipy.ndimage.map_coordinates(
                plane.astype(np.float64),
                [y + middle[0], x + middle[1]],
                order=ORDER,
                mode=MODES[rule_of(scene.border)],
            )
            for plane in content.planes
        ]
    )
    return replace(scene, content=content.with_planes(planes), view=View())
