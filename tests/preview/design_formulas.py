"""What the textbook says of two designs of the camera "mono": MTF and noise, NumPy float64, without gpusim."""

import colour
import numpy as np

A = {"f_number": 4, "pitch": 5.86, "full_well": 32400}  # pitch [um], full well [e-]
B = {"f_number": 8, "pitch": 3.45, "full_well": 10500}
# the data sheet of the camera "mono": electrons and relative responses
READ, DARK, PRNU, DSNU = 7.2, 5.0, 0.005, 2.0
DIGITAL = 4095 - 64  # digital numbers from black to the white level
ANGLE, SAMPLES = np.radians(5), 4  # of the chart's edge; scene samples per pixel
FREQUENCIES = np.linspace(0, 1, 201)  # [cycle/pixel]


def expected_mtf(design, efficiency):
    """Return the transfer of lens and pixel along rows, that of the edge, and wavelength times f-number over the pitch.

    The first two are at FREQUENCIES.

    A diffraction-limited lens with a circular pupil transfers a spatial frequency v as
    2/pi (acos x - x sqrt(1 - x^2)), x = wavelength N v; a square pixel as a sinc. Wavelengths count by the
    photons of D65 times the quantum efficiency. The edge's normal is turned by ANGLE, and each sample of the
    chart is a mean over its cell: a smaller sinc.

    Source: Goodman, Introduction to Fourier Optics, 3rd edition, section 6.3, circular pupil.
    """
    nodes = np.arange(400.0, 701.0, 10.0)
    d65 = colour.SDS_ILLUMINANTS["D65"]
    weights = np.interp(nodes, *efficiency) * nodes * [d65[one] for one in nodes]
    weights[[0, -1]] /= 2  # a trapezoid sum
    cut = 1e-3 * nodes * design["f_number"] / design["pitch"]  # [pixel/cycle]
    x = np.minimum(cut[:, None] * FREQUENCIES, 1)
    lens = weights / weights.sum() @ (2 / np.pi * (np.arccos(x) - x * np.sqrt(1 - x**2)))
    along = np.sinc(FREQUENCIES * np.cos(ANGLE)) * np.sinc(FREQUENCIES * np.sin(ANGLE))
    cells = np.sinc(FREQUENCIES * np.cos(ANGLE) / SAMPLES)
    cells = cells * np.sinc(FREQUENCIES * np.sin(ANGLE) / SAMPLES)
    return lens * np.sinc(FREQUENCIES), lens * along * cells, float(weights @ cut / weights.sum())


def edge_error(design, rows, cols, expected, cut):
    """Return the largest error of an edge's response in a part of rows x cols pixels, at FREQUENCIES.

    Window: the kink -4/pi v of the transfer at 0 is a tail 2 q / (pi^3 x^2) of the line spread, q = `cut`. A
    Hamming window of reach R cuts 4 q / (pi^3 R) (1 + 0.46 (pi Si(pi) - 2)) = 11 q / (pi^3 R) of the light
    away, and the response is too high by this part.
    Noise: a quarter-pixel bin is a mean of rows / 4 pixels. The response is a sum of 8 R differences of bins,
    windowed (mean square 0.397): by parts, each bin counts with 2 pi f / 4. Half of the variance is along
    the response. Five standard deviations.
    Bins: 1e-3, the middles of pixels in a bin are not spread evenly.
    """
    reach = (cols - rows * np.tan(ANGLE)) / 2
    light = 0.95 * design["full_well"]  # the bright side, which the exposure is set by
    noise = variance(light, design) ** 0.5 / (0.75 * light)  # the sides are 4:1
    bins = 0.5 * 0.397 * 8 * reach / (rows / 4)
    return (
        11 * cut / (np.pi**3 * reach) * expected
        + 5 * noise * bins**0.5 * 2 * np.pi * FREQUENCIES / 4
        + 1e-3
    )


def variance(electrons, design=A, seconds=0.05, gain=1.0):
    """Return the variance of a raw value [e-^2]: shot noise, dark current, read-out, patterns, rounding."""
    per_number = design["full_well"] / DIGITAL / gain
    return (
        electrons + DARK * seconds + READ**2
        + (PRNU * electrons) ** 2 + DSNU**2 + per_number**2 / 12
    )  # fmt: skip


def half(response):
    """Return the frequency at which a response falls to a half, and its slope there."""
    k = int(np.flatnonzero(response <= 0.5)[0])
    slope = (response[k] - response[k - 1]) / (FREQUENCIES[k] - FREQUENCIES[k - 1])
    return FREQUENCIES[k] + (0.5 - response[k]) / slope, abs(slope)
