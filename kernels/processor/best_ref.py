"""Demosaicking by weighted colour differences, float64, adapted to noise and lens blur.

c = sgn(s) sqrt|s| with s = x + o (domain "root") or c = x ("linear"), x = (DN - black_level) scale.
The variance of x is g x + r^2. The variance of c is v = g / 4 everywhere if o = 3 g / 8 + r^2 / g
(Anscombe 1948), and g c + r^2 in "linear". In "root" g is at least r / 20, so o and v vanish with
the noise.

1. Along each axis, with b = 2 c[0] - c[-2] - c[2], B = (c[-1] + c[1] - c[-3] - c[3]) / 2 (the other
   colour's b), and sums over the two neighbours:
       a = clip((<b B> + 2 P) / (<B B> + 2 P + 10 v), 0, 1)
   gives the other colour  h = (c[-1] + c[1]) / 2 + a b / 4  and the difference  d = +-(h - c),
   green - other. a is Hamilton-Adams' 1 if both colours bend in the same way (Kiku et al. 2014: the
   Laplacian's gain, regressed).
2. Green at red and blue: each of the four sides has the weight (E + sum of |d[-1] - d[1]| over 4
   pixels outwards, 3 across)^-2 (Pekkucuksen and Altunbasak 2010). The weighted means of two sets of
   taps, S = (.6 .4) and L = (.2 .2 .2 .2 .2), are blended: G = c + S + alpha (L - S),
   alpha = (A t^2 + Z L^2) / (t^2 + L^2), t = T (level + K). Far differences help if the colours are
   similar, and mislead if they are not.
3. Red and blue: with F measured at its sites, a gain
       A = clip((<l(G) l(F)> + n P) / (<l(G)^2> + n P + 5 n v), 0, 1)
   over the n sites within 3 pixels, l = (b of the row, b of the column), and F = A G + the mean of
   the two pairs of neighbouring F - A G with weights 1 / (|p - q| + D + 2 sqrt v): first across the
   diagonals, then along the axes.

With noise, every value e is drawn towards the mean m of its neighbours (bilinear's for green; the
four nearest of the same colour for measured ones): m + y s, s = (z^2 + k v) / (z^2 + K v), z = y =
e - m. In "root", to keep means:

    m and e are squares, y = e - m, z = (1 - f) y / (2 sqrt m) + f (sqrt e - sqrt m),

f being 2/3 of the share of shot noise in the variance. z is the difference in the domain in which
the noise has no skew (photons: the power 2/3, Anscombe 1953; read noise: the values), because y s
then has the mean of y. Means of roots get back their loss (`root_loss`), by the share of the
variance that they remove on flat fields: KEPT remains. Codes of red and blue have a factor: the
root of `balance` in "root", `balance` in "linear"; their noise has it too.
"""

import numpy as np

from gpusim.kernels.processor.bilinear_ref import bilinear
from gpusim.kernels.processor.levels import root_loss

EDGE, DARK, ALIKE = 5 / 255, 10 / 255, 2 / 255  # E, K, D
COLORED = 0.3  # T
# of the variance: in interpolated red and blue, and in green before shrinkage
KEPT_FOUND = 0.34
KEPT_GREEN = 0.45
RIM = 14


def best(
    raw, *, phase, black_level, scale, domain="root", noise=(0.0, 0.0), blur=0.0, balance=(1.0, 1.0)
):
    """Return the stage's result, see `best.py`."""
    if 1 in raw.shape:
        return bilinear(raw, phase=phase, black_level=black_level, scale=scale)
    longest = 0.945 - 1.7 * min(blur, 0.9) ** 2  # A
    shortest = -0.7 + 0.5 * min(blur, 0.9) ** 2  # Z
    prior = 20 / 255**2 / (1 + (2.5 * blur) ** 4)  # P
    x = (np.asarray(raw, np.float64) - black_level) * scale
    gain, read = noise[0] * scale, noise[1] * scale
    noisy = gain > 0 or read > 0
    offset, constant, slope = 0.0, read**2, gain
    if domain == "root":
        if noisy:
            # r^2 / g would grow beyond all light if shot noise vanishes
            gain = max(gain, read / 20)
            offset = 0.375 * gain + read**2 / gain
        constant, slope = gain / 4, 0.0
    factors = dict(zip("RGB", (balance[0], 1.0, balance[1]), strict=True))
    c = np.pad(x + offset, RIM, mode="reflect")
    if domain == "root":
        c = np.sign(c) * np.sqrt(np.abs(c))
        factors = {letter: np.sqrt(factor) for letter, factor in factors.items()}
    letters = np.array(list(phase))[
        np.add.outer(2 * (np.arange(c.shape[0]) % 2), np.arange(c.shape[1]) % 2)
    ]
    is_green = letters == "G"
    own = np.vectorize(factors.get)(letters)
    c = c * own
    variance = lambda level, of=1.0: of * (of * constant + slope * np.maximum(level, 0))  # noqa: E731

    differences, steps = [], []
    for axis in (1, 0):
        at = lambda plane, n, axis=axis: np.roll(plane, -n, axis)  # noqa: E731  the rim takes the wrong ends
        bend = 2 * c - at(c, -2) - at(c, 2)
        other = (at(c, -1) + at(c, 1) - at(c, -3) - at(c, 3)) / 2
        near = lambda plane: np.roll(plane, 1, axis) + np.roll(plane, -1, axis)  # noqa: B023, E731
        damping = 10 * variance(near(c) / 2, np.roll(own, 1, axis))
        a = np.clip((near(bend * other) + 2 * prior) / (near(other**2) + 2 * prior + damping), 0, 1)
        d = np.where(is_green, -1, 1) * (near(c) / 2 + a * bend / 4 - c)
        step = np.abs(at(d, -1) - at(d, 1))
        differences.append(d)
        steps.append(step + np.roll(step, 1, 1 - axis) + np.roll(step, -1, 1 - axis))
    short, far, weights = [], [], []
    for axis, d, step in zip((1, 0), differences, steps, strict=True):
        for side in (-1, 1):
            out = [np.roll(d, -side * n, axis) for n in range(5)]
            short.append(0.6 * out[0] + 0.4 * out[1])
            far.append(sum(out) / 5)
            weights.append((EDGE + sum(np.roll(step, -side * n, axis) for n in range(4))) ** -2)
    short = np.average(short, axis=0, weights=weights)
    far = np.average(far, axis=0, weights=weights)
    tent = lambda plane, axis: (2 * plane + np.roll(plane, 1, axis) + np.roll(plane, -1, axis)) / 4  # noqa: E731
    like = (COLORED * (np.maximum(tent(tent(c, 0), 1), 0) + DARK)) ** 2
    alpha = (longest * like + shortest * far**2) / (like + far**2)
    green = np.where(is_green, c, c + short + alpha * (far - short))
    kept = c
    if noisy:
        drawn = _Shrinkage(
            domain == "root", variance, offset, root_loss(gain, read) if domain == "root" else None
        )
        cross, corners, apart = (drawn.mean(c, *places) for places in (AXES, DIAGONALS, FAR_AXES))
        kept = drawn(c, np.where(is_green, corners, apart), own, 0.2, 3, 1.0)
        green = np.where(is_green, kept, drawn(green, cross, 1.0, 0, 3.5, KEPT_GREEN))

    bends = lambda plane: [  # noqa: E731
        2 * plane - np.roll(plane, 2, axis) - np.roll(plane, -2, axis) for axis in (0, 1)
    ]
    square = sum(b * b for b in bends(green))
    product = sum(b * b_own for b, b_own in zip(bends(green), bends(c), strict=True))
    planes = {"G": green}
    for color in "RB":
        sites = letters == color
        n = _window(sites)
        with np.errstate(invalid="ignore"):
            a = np.clip(
                (_window(sites * product) + n * prior)
                / (_window(sites * square) + n * prior + 5 * n * variance(green)),
                0,
                1,
            )
        limit = ALIKE + 2 * np.sqrt(variance(green, factors[color]))
        diagonal = _blend(c, green, a, limit, DIAGONALS)
        known = np.where(is_green, 0, np.where(sites, c, diagonal))
        planes[color] = np.where(
            sites, kept, np.where(is_green, _blend(known, green, a, limit, AXES), diagonal)
        )
    result = np.stack([planes[color][RIM:-RIM, RIM:-RIM] / factors[color] for color in "RGB"])
    measured = np.stack([letters[RIM:-RIM, RIM:-RIM] == color for color in "RGB"])
    if domain == "root":
        found = np.where(measured, 0, [[[1]], [[0]], [[1]]]) * noisy
        result = result * np.abs(result) - offset
        if noisy:
            result += found * (1 - KEPT_FOUND) * drawn.deficit(result + offset)
    return result if noisy else np.where(measured, x, result)


AXES = ((0, -1), (0, 1), (-1, 0), (1, 0))
DIAGONALS = ((-1, -1), (1, 1), (-1, 1), (1, -1))
FAR_AXES = ((0, -2), (0, 2), (-2, 0), (2, 0))


class _Shrinkage:
    """Draws codes towards a mean of others if they differ by no more than noise."""

    def __init__(self, root, variance, offset, loss):
        self.root, self.variance, self.offset, self.loss = root, variance, offset, loss

    def mean(self, code, *places):
        """Return the mean of neighbours; in "root" the mean of their squares."""
        values = code * np.abs(code) if self.root else code
        return sum(np.roll(values, place, (0, 1)) for place in places) / len(places)

    def deficit(self, square):
        """Return the difference between mean and square of mean roots."""
        near, far, *terms = self.loss.astype(np.float64)
        return np.polyval(terms, np.minimum(1, far / (near + np.abs(square))))

    def __call__(self, code, mean, factor, kept, reach, left):
        """Return the shrunk codes.

        factor: of these codes. left: share of the noise's variance in them.
        """
        if not self.root:
            change, v = code - mean, self.variance(mean, factor)
            return mean + change * (change**2 + kept * v) / (change**2 + reach * v + 1e-20)
        v = self.variance(mean, factor)
        square = code * np.abs(code)
        square = square + (1 - left) * self.deficit(square)  # left is 1 if the factor is not
        level = np.maximum((4 * mean + square) / 5, v)
        photons = np.maximum(level - self.offset * factor**2, 0) / np.maximum(
            level - 1.5 * v, 1e-20
        )
        power = photons * 2 / 3
        root = lambda a: np.sign(a) * np.sqrt(np.abs(a))  # noqa: E731
        z = (1 - power) * (square - mean) / (2 * np.sqrt(level)) + power * (
            root(square) - root(mean)
        )
        square = mean + (square - mean) * (z**2 + kept * v) / (z**2 + reach * v + 1e-20)
        return np.sign(square) * np.sqrt(np.abs(square))


def _window(plane):
    """Return the sum over 7 x 7 pixels."""
    for axis in (0, 1):
        plane = sum(np.roll(plane, n, axis) for n in range(-3, 4))
    return plane


def _blend(samples, green, a, limit, places):
    """Return A G + the mean of two pairs of neighbouring samples - A G, weighted."""
    p, q, r, s = (
        np.roll(samples, (-dy, -dx), (0, 1)) - a * np.roll(green, (-dy, -dx), (0, 1))
        for dy, dx in places
    )
    return a * green + np.average(
        [(p + q) / 2, (r + s) / 2],
        axis=0,
        weights=[1 / (np.abs(p - q) + limit), 1 / (np.abs(r - s) + limit)],
    )
