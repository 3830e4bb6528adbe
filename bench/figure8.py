"""Figure 8 of Farrell & Wandell: sharpness of a sensor 0, 10 and 40 um out of focus, ISO 12233.

    python bench/figure8.py [--device auto] [--out figure8.png] [--json bench/results/figure8.json]

Prints MTF50 [cycle/mm on the sensor] from two sources: `gpusim.measure.sfr` on a picture from the
whole simulator, including bilinear demosaicking and colour, and the formula of lens, pixel and
demosaicking. The picture shows the three edges and their curves.

The last row is the formula with the pixel and the angle of ISETCam, the chapter's software: samples
of 5 degrees / 512, spread by a Gaussian of a quarter of a pixel that is cut off at the pixel, and
interpolated linearly; light with equal photons; an edge of slope 7/3, with frequencies along the
pixel rows instead of the edge's normal (a factor of cos 23 degrees); no correction for the
quarter-pixel bins; luminance of the camera's RGB.
"""

from dataclasses import replace

import numpy as np

from gpusim import Noise, Simulator, chart, open_camera
from gpusim.data.lights import illuminant
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.domain.spectrum import photons_from_energy
from gpusim.io.atomic import check_output
from gpusim.measure import EdgeResponse, mtf50, sfr

DEFOCUS = (0.0, 10e-6, 40e-6)  # [m]
ANGLE, FINE = 5.0, 2  # [degree], scene samples per pixel
SIZE = 240, 160  # columns and rows [pixel]
TURN, STEEP = np.radians(ANGLE), np.arctan(3 / 7)  # of the edge here, and of the chapter's software
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # ITU-R BT.709
NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)
WAVELENGTHS = np.arange(400.0, 701.0, 10.0)


def camera_at(defocus):
    """Return the figure's camera without noise and converter. defocus: of the sensor [m]."""
    camera = open_camera("figure8")
    return replace(
        camera,
        sensor=replace(camera.sensor, bits=FLOAT_BITS, noise=Noise(photon="none")),
        optics=replace(camera.optics, defocus=defocus, relative_illumination="none"),
        processor=replace(camera.processor, scaling="normalised"),
    )


def picture(defocus, device="auto"):
    """Return the frame of a slanted edge, contrast 4, in D65."""
    scene = chart(
        "slanted-edge", size=SIZE, samples_per_pixel=FINE, angle_deg=ANGLE, wavelengths=WAVELENGTHS
    )
    return Simulator(camera_at(defocus), device=device)(scene)


def luminance(frame):
    """Return the luminance of the linear display picture, white 1, shape (rows, cols)."""
    return frame.linear.astype(np.float64) @ frame.camera.display.xyz_from_rgb[1]


def defocused_otf(frequency, wavelength, f_number, defocus):
    """Return the transfer function of a circular pupil [1], shape of `frequency` [cycle/m].

    wavelength, defocus: [m]. Autocorrelation of the pupil with a path difference at the edge of W =
    defocus / (8 N^2): with s = f lambda N, 4 / pi int_0^(1 - s) sqrt(1 - (u + s)^2) cos(8 pi W s u)
    du, W in waves. The substitution u = (1 - s) sin t removes the square root's singularity.
    Source: Hopkins 1955, Proc. R. Soc. A 231.
    """
    waves = defocus / (8 * f_number**2 * wavelength)
    s = np.minimum(np.abs(frequency) * wavelength * f_number, 1.0)[..., None]
    t = np.pi / 4 * (NODES + 1)
    u = (1 - s) * np.sin(t)
    root = np.sqrt(np.maximum(1 - (u + s) ** 2, 0))
    return (root * np.cos(8 * np.pi * waves * s * u) * (1 - s) * np.cos(t) * WEIGHTS).sum(-1)


def bilinear_transfer(x, y):
    """Return the mean transfer of bilinear demosaicking for R, G, B, shape (3, F).

    x, y: [cycle/pixel]. Each of the four places of the mosaic is a mean of neighbours. An edge that
    meets all places at all phases sees their average.
    """
    x, y = np.cos(2 * np.pi * x), np.cos(2 * np.pi * y)
    green = 0.5 + (x + y) / 4
    red = (1 + x) * (1 + y) / 4
    return np.stack([red, green, red])


def box(camera):
    """Return the transfer function of the pixel's square aperture. x, y: [cycle/pixel]."""
    side = np.sqrt(camera.sensor.fill_factor)
    return lambda x, y: np.sinc(side * x) * np.sinc(side * y)


def chapter_pixel(camera):
    """Return ISETCam's counterpart, as described in the module's docstring."""
    step = (
        2 * camera.optics.focal_length * np.tan(np.radians(2.5)) / 512 / camera.sensor.pixel_pitch
    )  # [pixel]
    taps = np.ceil(1 / step)
    place = np.arange(taps) - (taps - 1) / 2
    weights = np.exp(-((4 * place / taps) ** 2) / 2)
    weights /= weights.sum()

    def along(f):  # Gaussian, two cells of linear interpolation, one of the scene's samples
        return weights @ np.cos(2 * np.pi * step * place[:, None] * f) * np.sinc(step * f) ** 3

    return lambda x, y: along(x) * along(y)


def exact(defocus, weights, light, angle=TURN, pixel=None, fine=np.inf):
    """Return the formula's EdgeResponse along the normal.

    Lens (mean over each channel's light), pixel, demosaicking. weights: of the camera's R, G, B,
    each normalised to the step, shape (3,). light: photon radiance. fine: scene samples per pixel,
    which also blur as boxes; the value FINE has no alias below 0.5 cycle/pixel.
    """
    camera = camera_at(defocus)
    pitch, optics = camera.sensor.pixel_pitch, camera.optics
    f = np.linspace(0, 0.5, 251)
    x, y = f * np.cos(angle), f * np.sin(angle)
    spectral = camera.sensor.qe.at(WAVELENGTHS) * light.at(WAVELENGTHS)
    lens = np.stack(
        [
            defocused_otf(f / pitch, 1e-9 * wavelength, optics.f_number, defocus)
            for wavelength in WAVELENGTHS
        ]
    )
    channels = (spectral / spectral.sum(1, keepdims=True)) @ lens * bilinear_transfer(x, y)
    channels = channels * (pixel or box)(camera)(x, y) * np.sinc(x / fine) * np.sinc(y / fine)
    return EdgeResponse(f, weights @ channels, np.array(angle), f / (pitch * 1e3))


def along_rows(found):
    """Return the response with frequencies along the pixel rows, not the edge's normal."""
    turned = np.cos(found.angle)
    return replace(found, frequencies=found.frequencies * turned, per_mm=found.per_mm * turned)


def chapter(defocus):
    """Return the formula for the chapter's software, frequencies along the rows."""
    light = photons_from_energy(illuminant("D65"))
    light = replace(light, values=np.ones_like(light.values))
    found = along_rows(exact(defocus, LUMINANCE, light, STEEP, chapter_pixel))
    return replace(
        found,
        response=found.response * np.sinc(found.frequencies / 4) * np.sinc(found.frequencies / 2),
    )


def shown_weights(frame):
    """Return the weights of R, G, B in display luminance, each normalised to a neutral step."""
    weights = (
        frame.camera.display.xyz_from_rgb[1]
        @ frame.rendering.display_from_camera
        * frame.rendering.neutral
    )
    return weights / weights.sum()


def main():
    """Print the table and save the picture."""
    import results  # tests load only this file

    made = results.parser(__doc__)
    made.add_argument("--out", default="figure8.png")
    arguments = made.parse_args()
    device, old = results.ready(arguments, "figure8")
    check_output(arguments.out)
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    light = photons_from_energy(illuminant("D65"))
    figure, axes = pyplot.subplots(2, 3, figsize=(11, 7), height_ratios=(1, 1.2))
    rows = {
        name: []
        for name in (
            "measured, luminance",
            "formula with the scene's samples",
            "formula, luminance",
            "formula, red channel",
            "formula, green channel",
            "formula, slope 7/3, along rows",
            "as the chapter's software",
        )
    }
    for defocus, (above, below) in zip(DEFOCUS, axes.T, strict=True):
        frame = picture(defocus, device)
        measured, weights = (
            sfr(luminance(frame), frame.camera.sensor.pixel_pitch),
            shown_weights(frame),
        )
        curves = [
            measured,
            exact(defocus, weights, light, fine=FINE),
            exact(defocus, weights, light),
            *(exact(defocus, row, light) for row in np.eye(3)[:2]),
            along_rows(exact(defocus, weights, light, STEEP)),
            chapter(defocus),
        ]
        for name, curve in zip(rows, curves, strict=True):
            rows[name].append(mtf50(curve))
        middle = np.s_[SIZE[1] // 2 - 24 : SIZE[1] // 2 + 24, SIZE[0] // 2 - 24 : SIZE[0] // 2 + 24]
        above.imshow(frame.rgb[middle], interpolation="nearest")
        above.set_title(f"{1e6 * defocus:g} µm from focus")
        above.set_axis_off()
        below.plot(curves[1].per_mm, np.abs(curves[1].response), "k--", lw=1, label="formula")
        inside = measured.frequencies <= 0.5
        below.plot(measured.per_mm[inside], measured.response[inside], "k", label="measured")
        for plane, color in zip(
            sfr(frame.linear, frame.camera.sensor.pixel_pitch).response, "rgb", strict=True
        ):
            below.plot(measured.per_mm[inside], plane[inside], color, lw=0.8, alpha=0.7)
        below.axhline(0.5, color="0.8", lw=0.8, zorder=0)
        below.set(
            xlabel="cycles/mm on the sensor",
            ylim=(0, 1.05),
            xlim=(0, measured.per_mm[inside][-1]),
            title=f"50 % at {rows['measured, luminance'][-1]:.1f} cycles/mm",
        )
    axes[1, 0].set_ylabel("SFR")
    axes[1, 0].legend(frameon=False)
    figure.tight_layout()
    figure.savefig(arguments.out, dpi=100)
    tables = results.Tables()
    tables.table(
        "MTF50 [cycles/mm on the sensor]",
        "out of focus",
        *(f"{1e6 * defocus:g} um" for defocus in DEFOCUS),
    )
    for name, found in rows.items():
        tables.row(name, *(f"{value:.1f}" for value in found))
    results.finish(arguments, "figure8", device, tables.rows, old, columns=tables.columns)
    print(arguments.out)


if __name__ == "__main__":
    from results import start

    start(main)
