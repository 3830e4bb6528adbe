"""Which pixels of a chip are dead or hot, as a map for `processor.defects`.

Ports: response [1], dark [e- s-1] float32 of the chip, either or none -> (out_rows, out_cols) uint8:

    flag = 255 if response = 0 or dark > least, of any of the pixels that become one; else 0.

Binned pixels are those of `sensor.bin`. The same on every device. NaN is no defect.
"""

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.kernels.sensor.bin import binned_shape
from gpusim.kernels.stage import Case, stage


@stage
def flag(device, response=None, dark=None, *, least=0.0, binning=(1, 1), stride=(1, 1)):
    """Map of dead and hot pixels.

    response: relative, shape (rows, cols); dark: dark current beyond the common one [e- s-1], of the same shape; see
    `sensor.pattern`. least: dark current of a hot pixel [e- s-1], exclusive. binning, stride: as for `sensor.bin`.
    Returns shape `binned_shape((rows, cols), binning, stride)`, 255 at defects. Raises BadData, OutOfRange.
    """
    rows, cols = checked(response, dark, least)
    out_shape = binned_shape((rows, cols), binning, stride)
    planes = [None if plane is None else device.array(plane) for plane in (response, dark)]
    use = [int(plane is not None) for plane in planes]
    flags = device.empty(out_shape, np.uint8)
    device.launch(
        "sensor.flag",
        "flag",
        out_shape,
        *(planes[1 - n] if plane is None else plane for n, plane in enumerate(planes)),
        flags,
        *use,
        float(least),
        *map(int, binning),
        *map(int, stride),
        cols,
        *out_shape,
    )
    return flags


def checked(response, dark, least):
    """Rows and columns of the chip; raises BadData as `flag`."""
    shapes = {tuple(plane.shape) for plane in (response, dark) if plane is not None}
    if len(shapes) != 1 or len(min(shapes)) != 2 or 0 in min(shapes):
        raise BadData(
            f"defects: planes of shapes {sorted(shapes)}, wanted response, dark or both, (rows, cols)"
        )
    if least != least:
        raise BadData("defects: least is NaN, wanted a dark current")
    return min(shapes)


def cases():
    """With and without each plane, binned in mosaics and not, odd sizes, NaN, infinities, denormals, -0."""
    random = np.random.default_rng(14)
    for rows, cols, binning, stride in (
        (1, 1, (1, 1), (1, 1)),
        (13, 37, (1, 1), (1, 1)),
        (33, 45, (2, 2), (2, 2)),
        (41, 70, (3, 2), (4, 1)),
        (64, 64, (8, 8), (1, 1)),
    ):
        planes = {
            "response": np.where(random.random((rows, cols)) < 0.02, 0, 1).astype(np.float32),
            "dark": np.where(random.random((rows, cols)) < 0.02, 5.0, 0).astype(np.float32),
        }
        hard = np.resize(
            [np.nan, np.inf, -np.inf, 1e-45, -0.0, 3.0, np.nextafter(np.float32(3), np.float32(9))],
            7,
        )
        for plane in planes.values():
            plane.flat[:: max(1, plane.size // 7)][:7] = hard[
                : len(plane.flat[:: max(1, plane.size // 7)][:7])
            ]
        for chosen in (("response",), ("dark",), ("response", "dark")):
            yield Case(
                f"{rows}x{cols}, binning {binning}, stride {stride}, {' '.join(chosen)}",
                {
                    "least": 3.0,
                    "binning": binning,
                    "stride": stride,
                    **{name: planes[name] for name in chosen},
                },
                0.0,
                "comparisons alone",
                metric="exact",
            )
    yield Case(
        "any dark current",
        {"dark": np.array([[0, 1e-45, -1, np.nan, np.inf]], np.float32)},
        0.0,
        "comparisons alone; denormals count",
        metric="exact",
    )


def bench(rows, cols):
    """A thousandth of the pixels dead, as many hot."""
    random = np.random.default_rng(14)
    return {
        "response": (random.random((rows, cols)) > 1e-3).astype(np.float32),
        "dark": (random.random((rows, cols)) < 1e-3).astype(np.float32),
    }
