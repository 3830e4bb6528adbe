"""Images as float64 sums: each sample's light is spread by the pupil of its place and distance. Shares no code."""

import numpy as np

FINE = 4  # pupil samples between two frequencies of a period: the rim's error is below 1e-4 of the transfer


def waves(lens, x, y, place=(0.0, 0.0), distance=None):
    """Return the wavefront [m] at pupil points (1 the rim), of a thin lens with Seidel sums.

    place: field point (down, across), 1 the corner. distance: of the object [m].
    """
    high = np.hypot(*place)
    down, across = np.divide(place, high) if high else (0.0, 1.0)
    along, square = across * x + down * y, x * x + y * y
    w040, w131, w222, w220, w311 = lens.wavefront.seidel
    total = w040 * square**2 + w131 * high * square * along + w222 * high**2 * along**2
    total = total + w220 * high**2 * square + w311 * high**3 * along
    total = total * (lens.wavefront.reference * 1e-9)
    if distance is not None:  # vergence times half the squared height of the ray
        aperture = lens.focal_length / lens.f_number / 2
        total = (
            total + (1 / lens.object_distance - 1 / distance) * (aperture * aperture) / 2 * square
        )
    return total


def transfer(lens, nm, pitch, period, place=(0.0, 0.0), distance=None, aperture=1.0):
    """Return the transfer function at multiples of 1 / period cycles a pixel, with them: (n, n) and (n,).

    It is the autocorrelation of the sampled pupil, times the pixel's. Beyond the cut-off there is nothing.
    """
    working = lens.f_number * (1 + lens.focal_length / (lens.object_distance - lens.focal_length))
    q = nm * 1e-9 * working / pitch
    last = int(period / q)
    step = 2 * q / period / FINE  # a frequency f displaces the pupil by 2 q f
    reach = int(np.ceil(1 / step)) + 1
    at = step * np.arange(-reach, reach + 1)
    y, x = at[:, None], at
    inside = np.clip((1 - np.hypot(x, y)) / step + 0.5, 0, 1)  # the rim cuts samples
    field = inside * np.exp(2j * np.pi * waves(lens, x, y, place, distance) / (nm * 1e-9))
    size = 2 * len(at)
    size = 1 << (size - 1).bit_length()
    spectrum = np.fft.fft2(field, (size, size))
    correlation = np.fft.ifft2(np.abs(spectrum) ** 2)
    lags = FINE * np.arange(-last, last + 1)
    found = correlation[np.ix_(lags, lags)] / inside.sum()
    found[last, last] = 1  # a square counts what the rim cuts less
    f = np.arange(-last, last + 1) / period
    box = np.sinc(aperture * f)
    return found * box[:, None] * box, f


class Sum:
    """An image of points in a period, at whole pixels of a frame in its middle."""

    def __init__(self, period, shape):
        self.period, self.shape, self._image = period, shape, np.zeros((period, period))

    def add(self, light, y, x, table, f):
        """Spread points of light at (y, x) [pixel], flat arrays, by one transfer function."""
        down = np.exp(-2j * np.pi * f[:, None] * np.ravel(y))
        across = np.exp(-2j * np.pi * np.ravel(x)[:, None] * f)
        spectrum = table * ((down * np.ravel(light)) @ across)
        whole = np.zeros((self.period, self.period), complex)
        at = np.rint(f * self.period).astype(int) % self.period
        np.add.at(whole, (at[:, None], at), spectrum)
        self._image += np.fft.ifft2(whole).real

    @property
    def frame(self):
        """The frame's pixels."""
        return self._image[: self.shape[0], : self.shape[1]]
