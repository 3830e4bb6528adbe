"""Tone curve of a camera that writes display codes, such as JPEG, from a ramp of known light."""

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.fit.estimate import Estimate, Part, Plot

COUNT = 13  # nodes of the curve
LEAST = 8  # levels of light
FALLS = 0.02  # of the codes' range by which a curve may fall before it is no tone curve
CELLS = 64  # levels of light that pixels are gathered in
WHITE = 0.98  # code up to which a ramp must go
CLIPPED = 0.02  # share of pixels at the largest code that tells where white is


def fit_tone(
    codes: ArrayLike,
    light: ArrayLike,
    *,
    largest: float = 255.0,
    white: float | None = None,
    source: str = "ramp",
) -> Part:
    """Fit a tone curve to display codes of known light.

    Args:
        codes: Codes of the pixels, such as 0 .. 255 of a JPEG, any shape; of colours the luminance or green.
        light: Linear light on them, same shape: of the ramp, or a raw frame of the same exposure above black.
        largest: Code of display white.
        white: Light that is display white; None: the least light that reaches the largest code, else the most.
        source: Name of the file.

    Returns:
        The setting processor.tone and an interval for each node.

    Raises:
        BadData: Codes and light do not fit one another, or codes do not rise with the light.
        OutOfRange: `largest` or `white` is not positive.
    """
    codes, light = (np.asarray(one, np.float64).ravel() for one in (codes, light))
    if codes.shape != light.shape or not codes.size or not np.isfinite(codes + light).all():
        raise BadData(
            f"{source}: {codes.size} codes and {light.size} values of light; wanted finite numbers of one shape"
        )
    for name, value in (("largest", largest), ("white", white)):
        if value is not None and not 0 < value < np.inf:
            raise OutOfRange(name, value, "a positive number")
    shown, light = codes / largest, np.maximum(light, 0)
    if white is None:
        white = _white(shown, light)
    x, y, error = _levels(shown, light / white)
    if len(x) < LEAST:
        raise BadData(
            f"{source}: {len(x)} levels of light, wanted {LEAST} or more from black to white; shoot a ramp or a step "
            "wedge"
        )
    nodes, values, errors = _curve(x, y, error, source)
    estimates = {
        f"processor.tone at {at:.3f}": Estimate(
            float(value),
            float(value - 1.96 * sigma),
            float(value + 1.96 * sigma),
            "",
            (source,),
            "encoded as sRGB",
        )
        for at, value, sigma in zip(nodes, values, errors, strict=True)
    }
    tone = np.round(np.stack([nodes, values], axis=1), 6).tolist()
    left = y - scipy.interpolate.PchipInterpolator(nodes, values)(np.clip(x, 0, nodes[-1]))
    unexplained: tuple[str, ...] = ()
    if np.abs(left).max() > 0.01 + 4 * np.median(error):
        unexplained = (
            f"tone: codes miss the curve by up to {100 * np.abs(left).max():.2g} % of white: local tone mapping, "
            "a colour "
            "matrix, or a ramp that is not even",
        )
    unknown = []
    if x.min() > 0.1:
        unknown.append(
            f"tone below {100 * x.min():.2g} % (encoded): no light there; shoot a ramp from black"
        )
    if y.max() < WHITE:
        unknown.append(
            f"tone above {100 * y.max():.2g} % (encoded): no light there, the curve goes on to white; shoot a "
            "ramp that "
            "reaches white"
        )
    return Part(
        "tone",
        estimates,
        {"processor": {"tone": tone}},
        _plots(x, y, nodes, values, left),
        unexplained,
        tuple(unknown),
    )


def ramp_light(
    shape: tuple[int, int], low: float = 0.0, high: float = 1.0, decades: float = 0.0
) -> np.ndarray:
    """Return the light of a ramp along the columns.

    Args:
        shape: Rows and columns.
        low: Light at the left edge.
        high: Light at the right edge.
        decades: If positive, the ramp is logarithmic and begins that many decades below `high`.

    Returns:
        Light, shape (rows, cols).
    """
    position = (np.arange(shape[1]) + 0.5) / shape[1]
    level = high * 10 ** (decades * (position - 1)) if decades else low + (high - low) * position
    return np.broadcast_to(level, shape).copy()


def _white(shown, light):
    at_top = shown >= 1
    return float(np.percentile(light[at_top], 5)) if at_top.mean() > CLIPPED else float(light.max())


def _levels(shown, light):
    """Return encoded light, mean code and its standard error of levels of light up to white."""
    encoded = DISPLAYS["srgb"].encode(np.clip(light, 0, 1))
    inside = (light <= 1) & (shown < 1)
    number = np.minimum((encoded * CELLS).astype(int), CELLS - 1)
    rows = []
    for one in range(CELLS):
        chosen = inside & (number == one)
        if chosen.sum() < 4:
            continue
        own = shown[chosen]
        rows.append(
            (
                encoded[chosen].mean(),
                own.mean(),
                np.hypot(own.std(ddof=1), 1e-3) / np.sqrt(len(own)),
            )
        )
    return np.array(rows).reshape(-1, 3).T


def _curve(x, y, error, source):
    """Return nodes, values and standard errors of a rising curve from black to white."""
    order = np.argsort(x)
    x, y, error = x[order], y[order], np.maximum(error[order], 2e-4)
    rising = np.maximum.accumulate(y)
    if (rising - y).max() > FALLS + 5 * error.max():
        raise BadData(
            f"{source}: codes fall while the light rises; give the light of the ramp, or shoot it with one exposure"
        )
    top = 1.0
    nodes = np.unique(np.concatenate([[0.0], np.linspace(max(x.min(), 1e-3), top, COUNT - 1)]))
    start = np.interp(
        nodes, np.append(np.insert(x, 0, 0), top + 1e-6), np.append(np.insert(rising, 0, 0), 1.0)
    )
    start = np.maximum.accumulate(start + 1e-4 * np.arange(len(nodes)))
    steps = np.diff(start / start[-1])

    def values_of(logs):
        steps = np.exp(logs)
        return np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])

    def miss(logs):
        curve = scipy.interpolate.PchipInterpolator(nodes, values_of(logs))
        return (curve(x) - y) / error

    found = scipy.optimize.least_squares(miss, np.log(np.maximum(steps, 1e-5)), bounds=(-14, 3))
    values = values_of(found.x)
    jacobian = np.stack(
        [(values_of(found.x + 1e-5 * one) - values) / 1e-5 for one in np.eye(len(found.x))],
        axis=1,
    )
    freedom = max(len(x) - len(found.x), 1)
    scale = max(2 * found.cost / freedom, 1.0)
    covariance = scale * np.linalg.pinv(found.jac.T @ found.jac)
    errors = np.sqrt(np.maximum(np.diag(jacobian @ covariance @ jacobian.T), 0))
    return nodes, values, errors


def _plots(x, y, nodes, values, left):
    def draw_curve(figure):
        axes = figure.subplots()
        fine = np.linspace(0, nodes[-1], 300)
        axes.plot(fine, scipy.interpolate.PchipInterpolator(nodes, values)(fine), color="tab:blue")
        axes.plot(nodes, values, "o", color="tab:blue", markersize=4)
        axes.plot(x, y, ".", color="0.3", markersize=3)
        axes.plot([0, 1], [0, 1], color="0.8", linewidth=0.8)
        axes.set(xlabel="linear light, encoded as sRGB", ylabel="displayed value, encoded")

    def draw_left(figure):
        axes = figure.subplots()
        axes.plot(x, 100 * left, ".")
        axes.axhline(0, color="0.7", linewidth=0.8)
        axes.set(xlabel="linear light, encoded as sRGB", ylabel="residual [% of white]")

    return (
        Plot("Tone curve", "Levels of the ramp and the fitted curve with its nodes.", draw_curve),
        Plot("Tone curve: residuals", "Levels less the curve.", draw_left),
    )
