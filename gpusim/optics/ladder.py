"""The far field of a lens: Gaussians of increasing widths whose sum falls like its tail.

Far from a point its light falls as t_3 r^-3 + t_5 r^-5 + t_7 r^-7, whatever the wavefront (see
`tail`). With

    r^-p = 2^(1 - p/2) / Gamma(p/2)  integral of  sigma^-p exp(-r^2 / 2 sigma^2)  d ln sigma,

trapezoids at sigma_g = sigma_0 ratio^g turn such a tail into Gaussians of the energies

    w_g = sum over p of  t_p  2^(1 - p/2) / Gamma(p/2)  ln(ratio)  2 pi sigma_g^(2 - p),

whose transfer function is a sum of exp(-2 pi^2 sigma_g^2 f^2). The rest of the lens ends a few
sigma_0 from the point. A blur of so much of the surroundings, plus Gaussians over an endless world,
is the lens in that world.
"""

from math import gamma, log, pi

import numpy as np
from numpy.polynomial.polynomial import polyvander

from gpusim.domain.pupil import Pupil

RATIO = 1.6  # of neighbours' widths, by default: the sum of so few ripples by 1e-3 of the tail, which averages out
LEAST = 4.0  # [sample] of a Gaussian that grids of splines carry
REACH = 4.4  # in units of the tail's smallest Gaussian over RATIO: where what is left of the lens has ended
WIDEST = 4.0  # periods: beyond it a Gaussian is as its limit, but for a power of its width
POWERS = (3, 5, 7)  # of the tail
# powers of sigma with which a Gaussian approaches its limit
LIMITS = {"edge": 1, "zero": 2, "reflect": np.inf, None: np.inf}


def gaussians(reach: float, longest: float, ratio: float = RATIO) -> np.ndarray:
    """Return standard deviations [sample], the last of them infinite, for the light left out within `reach`.

    Args:
        reach: Samples around the frame that take part in the blur.
        longest: Side of the world that a transform repeats [sample].
        ratio: Of neighbours' widths.
    """
    first = max(ratio * reach / REACH, LEAST)
    count = max(int(np.ceil(log(WIDEST * longest / first) / log(ratio))), 1) + 1
    return np.append(first * ratio ** np.arange(count), np.inf)


def energies(sigmas, tails, border: str | None = None) -> np.ndarray:
    """Return energies of Gaussians, shape (..., G), of tails, shape (..., 3).

    Args:
        sigmas: See `gaussians`.
        tails: See `tail`.
        border: Rule of the world, which shares out the light between the last Gaussian and
            infinity; None: all of it goes to the infinite Gaussian, as in a transfer function.
    """
    finite, ratio = sigmas[:-1], sigmas[1] / sigmas[0]
    each, more, near = np.empty((3, len(finite))), np.empty(3), np.empty(3)
    for k, p in enumerate(POWERS):
        part = 2 ** (1 - p / 2) / gamma(p / 2) * log(ratio)
        each[k] = part * 2 * pi * finite ** (2.0 - p)
        # sums of all wider Gaussians' energies, over the last one's, and of their share in it
        more[k] = 1 / (ratio ** (p - 2) - 1)
        near[k] = 1 / (ratio ** (p - 2 + LIMITS[border]) - 1)
    found = np.append(tails @ each, np.zeros((*tails.shape[:-1], 1)), axis=-1)
    last = tails * each[:, -1]
    found[..., -2] += last @ near
    found[..., -1] = last @ more - last @ near
    return found


def edge_tail(pupil: Pupil) -> float:
    """Return the energy per square sample times r^3 / q that a pupil's edges spread far from a point."""
    edges = pupil.outline + 2 * np.pi * pupil.obscuration
    return float(edges / (np.pi * pupil.area) / (2 * np.pi**3))


def tail(pupil: Pupil, q, waves, variance: float) -> np.ndarray:
    """Return t_3, t_5, t_7 of every wavelength in the mean over directions, shape (L, 3).

    t_3 is q times `edge_tail`. Each point of the pupil's rim spreads its light about the place
    where its ray lands, b from the image: the tail is t_3 (r^2 + b^2) / (r (r^2 - b^2)^2) = t_3
    (r^-3 + 3 b^2 r^-5 + 5 b^4 r^-7 + ...). A blur with variance v along an axis adds v / 4 of the
    Laplacian's mean, 9 r^-5.

    Args:
        pupil: The pupil.
        q: Wavelength times f-number over the distance of samples, shape (L,).
        waves: Wavefronts of the wavelengths, see `Optics.waves`.
        variance: Sum along both axes of the variances of everything that spreads light a little:
            the samples' aperture, a low-pass filter's spots and a diffuser [sample^2].
    """
    q, inner = np.asarray(q, np.float64), pupil.obscuration
    cusp = edge_tail(pupil) * q
    squares = _squares(waves, q, 1.0)
    if inner:  # the rims' lengths weigh them
        both = squares, _squares(waves, q, inner)
        squares = np.tensordot(both, (1 / (1 + inner), inner / (1 + inner)), (0, 0))
    spread = 9 / 4 * variance
    # factor of |s|^3 in the transfer function of a round pupil in focus
    cubic = 2 / (3 * pi) * ((1 + 1 / inner) / (1 - inner**2) if inner else 1.0)
    third = 9 / (16 * pi**4) * cubic * q**3
    fifth = cusp * (3 * squares[:, 0] + spread) + third
    return np.stack([cusp, fifth, 5 * cusp * squares[:, 1]], axis=1)


def _squares(waves, q, radius):
    """Means of b^2 and b^4, b how far from the image the rays through a rim land [sample], shape (L, 2)."""
    angle = np.linspace(0, 2 * pi, 64, endpoint=False)
    order, by = waves.shape[1] - 1, np.arange(1, waves.shape[1])
    x, y = polyvander(radius * np.cos(angle), order), polyvander(radius * np.sin(angle), order)
    along = np.einsum("lij,ai,aj->la", waves[:, 1:] * by[:, None], x[:, :-1], y, optimize=True)
    across = np.einsum("lij,ai,aj->la", waves[:, :, 1:] * by, x, y[:, :-1], optimize=True)
    square = (2 * q[:, None]) ** 2 * (along**2 + across**2)
    return np.stack([square.mean(axis=1), (square**2).mean(axis=1)], axis=1)
