"""Colour of a camera: all ways to choose its matrix, right and wrong light, estimated light.

    python bench/color.py [--json bench/results/color-NAME.json]       # tables of matrices
    python bench/color.py --scenes --device opencl:0 [--photo kodim01.png ...]   # and estimates of the light

CIEDE2000 between the 24 ColorChecker patches through the matrix and their colours in D65, mean /
maximum, without noise. The light is estimated from thumbnails of simulated, noisy pictures. For
each estimate the table has the angle to the true white [degree], and the mean CIEDE2000 of the
ColorChecker in this light with the stored transform that the estimate selects.
"""

import numpy as np
from results import Tables, finish, parser, ready, start

from gpusim.color.balance import ESTIMATES, blocks_of, estimate_white
from gpusim.color.color import METHODS, color_matrix, transform_set
from gpusim.color.root_polynomial import terms_of
from gpusim.data.charts import chart
from gpusim.data.colorimetry import xyz
from gpusim.data.lights import illuminant
from gpusim.data.reflectances import reflectances
from gpusim.data.weights import product_weights
from gpusim.domain.display import DISPLAYS
from gpusim.domain.spectrum import photons_from_energy
from gpusim.io.camera.cameras import open_camera
from gpusim.io.scene.scenes import open_scene
from gpusim.kernels.processor.bilinear import bilinear
from gpusim.kernels.processor.thumbnail import thumbnail

LIGHTS = ("D65", "A", "FL11", "FL2")
PATCHES = reflectances("colorchecker")
CEILING = 0.95  # of saturation: next to a clipped pixel, interpolated values are a little lower


def differences(qe, light, matrix):
    """Return CIEDE2000 of the 24 patches in `light` through a matrix to linear sRGB."""
    import colour

    weights = product_weights(PATCHES.wavelengths, qe, photons_from_energy(illuminant(light)))
    seen = weights @ PATCHES.values.T / weights.sum(1).max()
    shown = DISPLAYS["srgb"].xyz_from_rgb @ matrix @ terms_of(seen.T, matrix.shape[1]).T
    wanted = xyz(PATCHES, illuminant("D65")) / xyz(illuminant("D65"))[1]
    white = np.array([0.3127, 0.3290])
    return colour.delta_E(
        colour.XYZ_to_Lab(shown.T, white), colour.XYZ_to_Lab(wanted, white), method="CIE 2000"
    )


def matrices(tables, qe):
    """Print the errors of each method, trained on objects and on Munsell chips."""
    for training in ("objects", "munsell"):
        tables.table(
            f"CIEDE2000 of the ColorChecker, mean / max; trained on {training!r}", "method", *LIGHTS
        )
        for method in METHODS:
            errors = [
                differences(qe, light, color_matrix(qe, light, training, method=method).matrix)
                for light in LIGHTS
            ]
            tables.row(method, *(f"{error.mean():.2f} / {error.max():.1f}" for error in errors))
        balanced = transform_set(
            qe, training, ["D65"]
        )  # F D: balance the channels, then the matrix for daylight
        errors = [
            differences(qe, light, balanced.at(color_matrix(qe, light, training).white).matrix)
            for light in LIGHTS
        ]
        tables.row(
            "only the stored D65 matrix (F D)",
            *(f"{error.mean():.2f} / {error.max():.1f}" for error in errors),
        )


def right_and_wrong(tables, qe):
    """Print Figure 12 of Farrell & Wandell: each light's transform in each light."""
    tables.table(
        "Transform of one light (column) in another (row): mean CIEDE2000", "scene", *LIGHTS
    )
    for light in LIGHTS:
        tables.row(
            light,
            *(
                f"{differences(qe, light, color_matrix(qe, taken, 'objects').matrix).mean():.2f}"
                for taken in LIGHTS
            ),
        )


def estimates(tables, camera, device, photos):
    """Print every estimate in every light, for a chart, discs of surfaces and photographs."""
    from gpusim.pipeline.simulator import Simulator  # the other tables need no device

    sensor = camera.sensor
    transforms = transform_set(sensor.qe, camera.processor.training, channels=sensor.channels)
    simulator = Simulator(camera, device=device)
    saturation = (
        sensor.saturation * sensor.gain_dn_per_electron / (sensor.white_level - sensor.dark_level)
    )
    scenes = {
        "colorchecker": lambda light: chart("colorchecker", light=light),
        "dead leaves, objects": lambda light: chart("deadleaves", light=light, surfaces="objects"),
        "dead leaves, nature": lambda light: chart("deadleaves", light=light, surfaces="nature"),
    }
    scenes |= {path: lambda light, path=path: open_scene(path, light=light) for path in photos}
    for light in (*LIGHTS, "daylight-8000K"):
        own = color_matrix(sensor.qe, light, camera.processor.training)
        best, daylight = (
            differences(sensor.qe, light, transform.matrix).mean()
            for transform in (own, transforms.at(transforms.target_white))
        )
        tables.table(
            f"{light}: angular error [degree], mean CIEDE2000 (given light {best:.2f}, as if D65 "
            f"{daylight:.2f})",
            "scene",
            *ESTIMATES,
        )
        over_photos: list = []
        for name, scene in scenes.items():
            frame = simulator(scene(light))
            values = bilinear(
                frame.raw,
                phase="".join(sensor.cfa),
                black_level=sensor.dark_level,
                scale=1 / (sensor.white_level - sensor.dark_level),
                device=simulator.device,
            )
            errors = []
            for method in ESTIMATES:
                rows, cols = blocks_of(method, values.shape[1:])
                small = thumbnail(
                    np.asarray(values),
                    CEILING * saturation,
                    rows=rows,
                    cols=cols,
                    device=simulator.device,
                )
                white = estimate_white(small, method, transforms).white
                cosine = white @ own.white / np.linalg.norm(white) / np.linalg.norm(own.white)
                shown = differences(sensor.qe, light, transforms.at(white).matrix).mean()
                errors.append((np.rad2deg(np.arccos(min(cosine, 1))), shown))
            if name in photos:
                over_photos.append(errors)
            else:
                tables.row(name, *(f"{angle:.1f}, {shown:.1f}" for angle, shown in errors))
        if photos:
            tables.row(
                f"{len(photos)} photographs, mean",
                *(f"{a:.1f}, {s:.1f}" for a, s in np.mean(over_photos, 0)),
            )


def main():
    """Print the tables, and write them if requested."""
    made = parser(__doc__)
    made.add_argument("--camera", default="phone")
    made.add_argument(
        "--scenes",
        action="store_true",
        help="also simulate scenes to estimate their light",
    )
    made.add_argument("--photo", nargs="*", default=[], help="photographs for these scenes")
    arguments = made.parse_args()
    device, old = ready(arguments, "color")
    camera, tables = open_camera(arguments.camera), Tables()
    matrices(tables, camera.sensor.qe)
    right_and_wrong(tables, camera.sensor.qe)
    if arguments.scenes:
        estimates(tables, camera, device, arguments.photo)
    finish(arguments, "color", device, tables.rows, old, camera=camera.name, columns=tables.columns)


if __name__ == "__main__":
    start(main)
