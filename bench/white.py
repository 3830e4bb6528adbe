"""White balance: the error of every estimate on photographs in several lights.

    python bench/white.py --photos FOLDER... [--lights six | unlisted] [--device opencl:0]

Every photograph is the scene, as reflectances in each light, for several cameras: the phone, the
camera of Figure 8, and the phone with the measured curves of a Nikon D5100 (National Physical
Laboratory, in colour-science). The thumbnails are those of the simulated, noisy pictures. The
table has the angle between the estimate and the camera's response to white [degree], mean /
median / largest, and for "bayesian" how its confidence agrees with its errors.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from results import Tables, finish, parser, ready, start

from gpusim.color.balance import ESTIMATES, blocks_of, estimate_white
from gpusim.color.color import color_matrix, transform_set
from gpusim.color.likely_light import CLOSE
from gpusim.color.rendering import efficiency
from gpusim.domain.spectrum import Spectrum
from gpusim.io.camera.cameras import open_camera
from gpusim.io.scene.scenes import open_scene
from gpusim.kernels.processor.bilinear import bilinear
from gpusim.kernels.processor.thumbnail import thumbnail
from gpusim.pipeline.developer import CLIPPED
from gpusim.pipeline.simulator import Simulator

LIGHTS = {
    "six": ("A", "D50", "D65", "D75", "FL11", "LED-B1"),
    # none of these is among the lights that the estimates compare with
    "unlisted": ("blackbody-2850K", "D55", "FL7", "FL3.14", "LED-B4", "LED-V1"),
}


def cameras():
    """Return the cameras by name."""
    import colour

    phone = open_camera("phone")
    measured = colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"]
    # relative to its largest value; the phone's peak is near 0.5. Nothing is seen below the table.
    nodes = np.append(360.0, measured.wavelengths)
    values = 0.5 * np.pad(measured.values, ((1, 0), (0, 0))).T
    curves = Spectrum(nodes, np.ascontiguousarray(values), "D5100")
    nikon = replace(phone, sensor=replace(phone.sensor, qe=curves))
    return {"phone": phone, "figure8": open_camera("figure8"), "D5100 curves": nikon}


def angle(one, other):
    """Return the angle between two responses [degree]."""
    cosine = one @ other / np.linalg.norm(one) / np.linalg.norm(other)
    return float(np.rad2deg(np.arccos(min(cosine, 1))))


def measure(camera, device, photos, lights):
    """Return rows (light, method, angle [degree], confidence or None, folder), one per estimate."""
    sensor = camera.sensor
    qe = efficiency(camera, sensor.channels)
    training = camera.processor.training
    transforms = transform_set(qe, training, channels=sensor.channels)
    simulator, found = Simulator(camera, device=device), []
    span = sensor.white_level - sensor.dark_level
    ceiling = CLIPPED * sensor.saturation * sensor.gain_dn_per_electron / span
    for light in lights:
        white = color_matrix(qe, light, training).white
        for photo in photos:
            frame = simulator(open_scene(photo, light=light))
            values = bilinear(
                frame.raw,
                phase="".join(sensor.cfa),
                black_level=sensor.dark_level,
                scale=1 / span,
                device=simulator.device,
            )
            for method in ESTIMATES:
                rows, cols = blocks_of(method, values.shape[1:])
                small = thumbnail(
                    np.asarray(values), ceiling, rows=rows, cols=cols, device=simulator.device
                )
                estimate = estimate_white(small, method, transforms)
                error = angle(estimate.white, white)
                found.append((light, method, error, estimate.confidence, photo.parent.name))
    return found


def spread(errors):
    """Return mean / median / largest in words."""
    return f"{np.mean(errors):.1f} / {np.median(errors):.1f} / {np.max(errors):.1f}"


def main():
    """Print the tables, and write them if requested."""
    made = parser(__doc__)
    made.add_argument("--photos", nargs="+", required=True, help="folders of photographs")
    made.add_argument("--lights", choices=LIGHTS, default="six")
    arguments = made.parse_args()
    device, old = ready(arguments, "white")
    photos = [path for folder in arguments.photos for path in sorted(Path(folder).glob("*.*"))]
    lights, tables = LIGHTS[arguments.lights], Tables()
    found = {name: measure(camera, device, photos, lights) for name, camera in cameras().items()}
    rows = [row for of in found.values() for row in of]
    tables.table(
        f"{len(photos)} photographs, {len(found)} cameras: angle to white [degree], "
        "mean / median / largest",
        "method",
        *lights,
        "all",
    )
    for method in ESTIMATES:
        errors = {light: [row[2] for row in rows if row[:2] == (light, method)] for light in lights}
        all_errors = [error for of in errors.values() for error in of]
        tables.row(method, *(spread(of) for of in errors.values()), spread(all_errors))
    parts = found | {
        folder: [row for row in rows if row[4] == folder]
        for folder in sorted({row[4] for row in rows})
    }
    tables.table("The same by camera, and by folder", "method", *parts)
    for method in ESTIMATES:
        tables.row(
            method, *(spread([row[2] for row in of if row[1] == method]) for of in parts.values())
        )
    tables.table(
        f"Confidence of bayesian, and the share of its errors up to {CLOSE:g} degrees",
        "confidence",
        "pictures",
        "mean confidence",
        "share",
    )
    sure = [(row[3], row[2] <= CLOSE) for row in rows if row[3] is not None]
    for least, most in ((0, 0.6), (0.6, 0.75), (0.75, 0.85), (0.85, 1.01)):
        inside = np.array([one for one in sure if least <= one[0] < most])
        if len(inside):
            tables.row(
                f"{least:.2f} .. {min(most, 1):.2f}",
                str(len(inside)),
                f"{inside[:, 0].mean():.2f}",
                f"{inside[:, 1].mean():.2f}",
            )
    finish(arguments, "white", device, tables.rows, old, columns=tables.columns)


if __name__ == "__main__":
    start(main)
