"""Speed of field-varying blur against SciPy's overlap-add with the same kernels, in one run.

    python bench/field.py [--device opencl] [--bands 4] [--json bench/results/field-NAME.json]

8 x 8 kernels of 31 x 31 (rotating comatic Gaussians), bilinear between them, a 1080p scene with 60
highlights of 1e5; milliseconds are per band. The error is the 99.9 % quantile of |difference| over
the local value, against float64.
"""

import numpy as np
from results import add_repeat, compared, count, parser, ready, start

from gpusim.bench.baseline import overlap_add as by_scipy
from gpusim.kernels.optics.field import field, transfer
from gpusim.optics.field import overlap_add

SHAPE, SIZE, GRID = (1080, 1920), 31, 8


def comatic(places):
    """Return a Gaussian that turns and grows with the field, with an outward tail."""
    y, x = np.mgrid[-(SIZE // 2) : SIZE // 2 + 1, -(SIZE // 2) : SIZE // 2 + 1]
    kernels = []
    for row, col in places:
        v, u = row / SHAPE[0] - 0.5, col / SHAPE[1] - 0.5
        r, angle = np.hypot(v, u), np.arctan2(v, u)
        along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        core = np.exp(-(along**2 + across**2) / (2 * (1 + 2 * r) ** 2))
        tail = r * np.exp(
            -((along - 6 * r) ** 2) / (2 * (1 + 6 * r) ** 2) - across**2 / (2 * (1 + 3 * r) ** 2)
        )
        kernels.append((core + tail) / (core + tail).sum())
    return np.stack(kernels)[:, None]


def main():
    """Time both in turns, and print times, ratio and errors."""
    made = parser(__doc__)
    made.add_argument("--bands", type=count, default=4)
    add_repeat(made, 4)
    arguments = made.parse_args()
    device, old = ready(arguments, "field")
    random = np.random.default_rng(0)
    planes = random.random((arguments.bands, *SHAPE), np.float32) + 0.5
    for plane in planes:
        plane[tuple(random.integers(0, n, 60) for n in SHAPE)] = 1e5
    blur = overlap_add(comatic, SHAPE, (GRID, GRID), window="bilinear")
    inputs = blur.stage_inputs
    tables = transfer(device, inputs["kernels"], inputs["edges"])
    inputs["coefficients"] = device.array(inputs["coefficients"])
    one = np.ones((1, 1), np.float32)

    def ours():
        results = [
            field(
                plane[None],
                mix=one,
                border="zero",
                threshold=100.0,
                tables=tables,
                device=device,
                **inputs,
            )
            for plane in planes
        ]
        device.sync()
        return np.concatenate([device.numpy(result) for result in results])

    forms = {
        "SciPy, overlap-add": lambda: np.stack([by_scipy(plane, blur) for plane in planes]),
        "gpusim": ours,
    }
    truth, errors = (
        np.stack([by_scipy(plane.astype(np.float64), blur, np.float64) for plane in planes]),
        {},
    )
    for name, form in forms.items():
        local = np.abs(form() - truth) / truth
        errors[name] = f"local, 99.9 %: {np.quantile(local, 0.999):.1e}, largest {local.max():.1e}"
    compared(
        arguments,
        "field",
        device,
        old,
        forms,
        {"gpusim": "SciPy, overlap-add"},
        errors,
        dict.fromkeys(forms, arguments.bands),
        size=SHAPE[::-1],
        bands=arguments.bands,
    )


if __name__ == "__main__":
    start(main)
