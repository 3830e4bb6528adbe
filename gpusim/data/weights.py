"""Quadrature of spectral integrals: weights that turn a sum over a scene's wavelengths into the integral."""

import functools
from collections.abc import Callable
from math import prod

import numpy as np

from gpusim.data.colorimetry import LUMINOUS_EFFICACY, cmf
from gpusim.domain.camera import Camera
from gpusim.domain.content import Content
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.interpolation import is_regular, line_weights, node_weights, spectral_weights
from gpusim.domain.scene import Scene
from gpusim.domain.spectrum import Spectrum, energy_from_photons, seen_band

STEP = 0.1  # [nm]; lines narrower than this must be given as such in the tables


def product_weights(nodes, *factors: Spectrum) -> np.ndarray:
    """Weights w with  sum_i w_i R(nodes_i) = integral of R(lambda) prod(factors)(lambda) dlambda  for smooth R.

    The factors (light, quantum efficiency, transmission) may be as spiky as their tables; only R, the scene's
    reflectance, is interpolated (`spectral_weights`): w_i is the integral of the factors times the cardinal spline of
    node i. A trapezoid sum over the nodes instead errs by up to 66 % under a fluorescent lamp (10 nm nodes).

    nodes: the scene's wavelengths [nm], shape (L,); what lies outside them is not seen. One node stands for the band
    that `seen_band` says, in which R does not change. factors: each one function or N
    of them; the functions broadcast. Returns shape (..., L), the unit of the factors' product times nm.
    Raises BadData when a factor has no wavelength in common with the scene.
    """
    grid, product = product_on_grid(nodes, *factors)
    nodes = np.asarray(nodes, np.float64)
    return product @ _splines(nodes.tobytes(), grid.tobytes())


@functools.lru_cache(maxsize=4)  # a preview asks for the same again and again; one has about 1 MB
def _splines(nodes: bytes, grid: bytes) -> np.ndarray:
    """Return the cardinal splines of the nodes on a grid, see `spectral_weights`."""
    at, on = np.frombuffer(nodes), np.frombuffer(grid)
    return spectral_weights(at, on) if len(at) > 1 else np.ones((len(on), 1))


def product_on_grid(nodes, *factors: Spectrum) -> tuple[np.ndarray, np.ndarray]:
    """Return fine wavelengths [nm], and there the product of factors times the weights of an integral.

    See `product_weights`. The grid is the range that all have in common.
    """
    nodes = np.asarray(nodes, np.float64)
    band = seen_band(nodes)
    for factor in factors:
        if factor.wavelengths[-1] <= band[0] or factor.wavelengths[0] >= band[1]:
            raise BadData(
                f"{factor.name or 'a spectrum'} covers {factor.wavelengths[0]:g} .. "
                f"{factor.wavelengths[-1]:g} nm, the scene {nodes[0]:g} .. {nodes[-1]:g} nm: no overlap"
            )
    tables, (low, high) = [nodes if len(nodes) > 1 else np.array(band)], band
    for factor in factors:  # beyond, a factor is zero
        low, high = max(low, factor.wavelengths[0]), min(high, factor.wavelengths[-1])
        tables.append(factor.wavelengths)
    count = max(2, int(np.ceil((high - low) / STEP)) + 1)
    grid = np.unique(np.concatenate([np.linspace(low, high, count), *tables]))
    grid = grid[(grid >= low) & (grid <= high)]
    product = np.ones(len(grid))
    for factor in factors:
        product = product * factor.at(grid)
    steps = np.diff(grid)
    trapezoid = np.zeros(len(grid))
    trapezoid[:-1] += steps / 2
    trapezoid[1:] += steps / 2
    return grid, product * trapezoid


def sampling_difference(
    nodes, mean: np.ndarray, moments: np.ndarray, share: np.ndarray, *factors: Spectrum
):
    """Return how far two models of a spectrum between its samples differ, relative rms of the channels [1].

    On regular wavelengths the models are the spline of frames and cubics through four neighbours, which differ about
    as much as the spline errs; on others the straight lines of frames and monotone cubics (PCHIP). Also returns
    how far the spline differs from straight lines.

    mean: mean spectrum, (L,). moments: second moments of spectra, (L, L). share: of the pixels of each channel, (C,).
    """
    grid, product = product_on_grid(nodes, *factors)
    own = spectral_weights(nodes, grid)

    def size(weights):
        return float(np.sqrt(max(share @ np.einsum("cl,lm,cm->c", weights, moments, weights), 0)))

    whole = size(product @ own)
    if not whole > 0:
        return 0.0, 0.0
    if is_regular(nodes):
        found = size(product @ (own - node_weights(nodes, grid))) / whole
        return found, size(product @ (own - line_weights(nodes, grid))) / whole
    from scipy.interpolate import PchipInterpolator

    difference = product @ (own @ mean - PchipInterpolator(nodes, mean)(grid))
    seen = share @ (product @ (own @ mean)) ** 2
    return (float(np.sqrt(share @ difference**2 / seen)) if seen > 0 else 0.0), 0.0


def xyz_per_content(nodes: np.ndarray, light: Spectrum) -> np.ndarray:
    """Return XYZ [cd m-2 if `light` is radiance] for content 1 at each of a scene's wavelengths, shape (3, L).

    The light between and beyond the wavelengths is the light that frames integrate. light: of photons. Raises BadData
    if the eye sees none of the wavelengths.
    """
    return LUMINOUS_EFFICACY * product_weights(nodes, energy_from_photons(cmf()), light)


def electrons_per_content(
    scene: Scene,
    camera: Camera,
    cache: Callable = lambda _, function, *args: function(*args),
) -> np.ndarray:
    """Return electrons per second in each channel for content 1 at each of the scene's wavelengths, shape (C, L).

    cache: function `cache(name, function, *args)` that may return an earlier result. Raises BadData if the camera sees
    none of the light.
    """
    optics, sensor = camera.optics, camera.sensor
    nodes, factors = scene.wavelengths, [scene.illuminant, sensor.qe]
    constant = prod(sensor.aperture) * optics.irradiance_factor
    if isinstance(optics.transmission, Spectrum):
        factors.append(optics.transmission)
    else:
        constant *= optics.transmission
    try:
        weights = constant * cache("electrons", product_weights, nodes, *factors)
    except BadData as error:
        raise BadData(f"{scene.name} by {camera.name}: {error}") from None
    if not (weights > 0).any():
        raise BadData(
            f"{scene.name}: camera {camera.name} sees none of its light "
            f"({nodes[0]:g} .. {nodes[-1]:g} nm)"
        )
    return weights


def check_light(scene: Scene, content: Callable[[], Content], camera: Camera):
    """Raise OutOfRange for light on the sensor at wavelengths at which its curves are not known.

    content: gives the scene's content, in host memory, if it must be read.
    """
    nodes, qe, through = scene.wavelengths, camera.sensor.qe, camera.optics.transmission
    known = qe.wavelengths[0] - 1e-6, qe.wavelengths[-1] + 1e-6  # [nm]
    if nodes[0] >= known[0] and nodes[-1] <= known[1]:
        return
    factors = [scene.illuminant, *([through] if isinstance(through, Spectrum) else [])]
    tables = [nodes, *(factor.wavelengths for factor in factors)]
    grid = np.unique(np.concatenate(tables))
    first, last = max(table[0] for table in tables), min(table[-1] for table in tables)
    grid = grid[(grid >= first) & (grid <= last)]
    light = np.interp(grid, nodes, content().lit)
    for factor in factors:
        light = light * factor.at(grid)
    lit = light > 0
    lit = lit[1:] | lit[:-1]  # of the intervals: a ramp is light
    if not lit.any():
        return
    first, last = grid[:-1][lit][0], grid[1:][lit][-1]
    if first < known[0] or last > known[1]:
        raise OutOfRange(
            f"sensor.qe of {camera.name}",
            f"{qe.wavelengths[0]:g} .. {qe.wavelengths[-1]:g} nm",
            f"as far as the light of {scene.name}, {first:g} .. {last:g} nm; a curve that is 0 beyond its "
            'ends can be extended with zeros: qe_ends = "zero" in the camera file',
        )
