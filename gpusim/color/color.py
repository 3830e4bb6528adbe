"""Colour matrices from camera channels to a display, for a known light and training surfaces."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpusim.color.root_polynomial import EXPONENTS, terms_of, weigh_terms
from gpusim.data.colorimetry import BRADFORD, adaptation, cmf
from gpusim.data.lights import illuminant
from gpusim.data.reflectances import reflectances as measured
from gpusim.data.weights import product_weights
from gpusim.domain.display import DISPLAYS, Display
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.spectrum import Spectrum, energy_from_photons, photons_from_energy

METHODS = (
    "white-preserving",
    "pseudo-inverse",
    "ridge",
    "cielab",
    "diagonal",
    "fixed-diagonal",
    *EXPONENTS,
)

# Electrons of white in the strongest channel, for the balance of noise and colour error with more
# than three channels. At 1e5 electrons shot noise is a third of the colour error of a good
# camera. This excludes matrices that gain a fraction of that error as a small difference of large
# responses (clear minus red + green + blue has 5 times the noise).
WHITE_ELECTRONS = 1e5

EXCELLENT_SNR = 40.0  # signal-to-noise ratio that ISO 12232 calls excellent

# Evenly spaced in reciprocal temperature, 25 MK-1 apart, as colour differences are (Tominaga &
# Wandell 2002). Then lamps off that line: halophosphate and three-band fluorescent, a white diode.
LIGHTS = (
    "blackbody-2500K",
    "blackbody-2667K",
    "A",
    "blackbody-3077K",
    "blackbody-3333K",
    "blackbody-3636K",
    "daylight-4000K",
    "daylight-4444K",
    "daylight-5000K",
    "daylight-5714K",
    "D65",
    "daylight-8000K",
    "daylight-10000K",
    "FL2",
    "FL11",
    "LED-B3",
)
REACH = 2.0  # radius around a white in which transforms are mixed, over the second-nearest distance
FINE, STEP = 1.0, 10.0  # [nm] of wavelengths beyond a set of surfaces: compared, and added to it


@dataclass(frozen=True, eq=False)
class ColorTransform:
    """Maps from camera responses that are 1 for perfect white in its strongest channel.

    The matrices are multiplied by the responses, F = C, or by their root-polynomial terms (see
    `gpusim.color.root_polynomial.terms_of`).

    Attributes:
        matrix: To linear display RGB, shape (3, F). White becomes (1, 1, 1), approximately if the
            method does not preserve white.
        xyz: To the XYZ of the surfaces in the target light, white Y = 1, shape (3, F).
        white: Response to perfect white in the scene's light, largest entry 1, shape (C,).
            Multiplied by saturation in units of white, it is the `ceiling` of processor.color,
            which keeps blown-out highlights neutral.
    """

    matrix: np.ndarray
    xyz: np.ndarray
    white: np.ndarray


@dataclass(frozen=True, eq=False)
class _Training:
    """Responses of camera (C, N) and eye (3, N) to surfaces, and to white (largest or Y 1)."""

    camera: np.ndarray
    xyz: np.ndarray
    camera_white: np.ndarray
    xyz_white: np.ndarray


def color_matrix(
    qe: Spectrum,
    light: Spectrum | str,
    reflectances: Spectrum | str,
    *,
    method: str = "white-preserving",
    target_light: Spectrum | str = "D65",
    display: Display = DISPLAYS["srgb"],
    snr: float = EXCELLENT_SNR,
    channels: Iterable[str] = "RGB",
) -> ColorTransform:
    """Find the colour transform from surfaces seen in `light` to surfaces shown in `target_light`.

    If there are more than three channels, some are nearly a mixture of others (a clear pixel of
    red, green and blue). Minimising only the colour error would then amplify noise many times.
    "white-preserving" and "cielab" therefore add the expected error of shot noise
    (WHITE_ELECTRONS); "pseudo-inverse" does not.

    Args:
        qe: Quantum efficiency of the C channels [e-/photon], shape (C, L) or (L,), with infrared
            filter.
        light: Photon radiance of the scene's light in any scale, shape (L,), or name of an
            illuminant.
        reflectances: Training surfaces [1], shape (N, L), or name of a set. Their wavelengths bound
            the integrals.
        method: All but "diagonal" minimise an error of the training surfaces' XYZ in the target
            light. "white-preserving": squared error, among the matrices that map white exactly to
            the target's white. "pseudo-inverse": squared error, L = (H' diag(d1) S) [C' diag(d2)
            S]^-1, without a condition on white. "ridge": expected squared error with the shot noise
            of every surface, see `snr`; white and all colours come out darker, more so in less
            light. "cielab": mean CIELAB difference with exact white, by search that starts from
            "white-preserving". "fixed-diagonal": L = D F with the white-preserving matrix F for the
            target light; D scales the cone-like responses (Bradford) of F for the scene's light
            until white is exact (von Kries's rule after a matrix). "diagonal": channels R, G, B are
            the display's primaries, each scaled until white is exact. It does not correct crosstalk
            of the filters, and ignores other channels. "root-polynomial": as "white-preserving", of
            the 6 terms r, g, b and the square roots of rg, gb, rb; for three channels. Errors count
            as CIELAB's slope does, and with the expected error of shot noise; colours far from the
            surfaces' stay near those of "white-preserving". All terms are proportional to the light,
            so that the hue does not change with exposure. "root-polynomial-3": also the 7 cube roots
            of products of three.
        target_light: Light of the rendered surfaces, as `light`.
        display: Its white, to which the target's is adapted (Bradford), and its primaries.
        snr: Only for "ridge": signal-to-noise ratio of white in the strongest channel [1], that is
            snr^2 electrons.
        channels: Only for "diagonal": a letter for each channel, in the order of `qe`.

    Returns:
        The transform.

    Raises:
        BadData: Wavelengths do not overlap, the surfaces do not determine the matrix, or the method
            needs other channels.
        OutOfRange: `snr` is not positive.
        UnknownName: Method, light or set is not known.

    Source:
        Farrell & Wandell, section 6.2 and Figure 11; Finlayson & Drew 1997, Color Research and
        Application 22, 2-15 (white-preserving); Finlayson, Mackiewicz & Hurlbert 2015, IEEE Trans.
        Image Processing 24, 1460-1470 (root-polynomial).
    """
    if method not in METHODS:
        raise UnknownName("color matrix method", method, METHODS)
    if not snr > 0:
        raise OutOfRange("snr", snr, "snr > 0")
    nodes, surfaces = _surfaces(reflectances, qe)
    eye = product_weights(nodes, cmf(), energy_from_photons(_photons(target_light)))
    seen = _training(nodes, surfaces, qe, _photons(light), eye)
    adapt = adaptation(seen.xyz_white, display.xyz_from_rgb.sum(1))
    if method == "diagonal":
        matrix = _channels_as_primaries(seen.camera_white, channels)
        return ColorTransform(
            matrix, np.linalg.solve(adapt, display.xyz_from_rgb @ matrix), seen.camera_white
        )
    if method == "fixed-diagonal":
        fixed = _white_preserving(
            _check_rank(_training(nodes, surfaces, qe, _photons(target_light), eye))
        )
        shown = fixed @ seen.camera_white
        if not (BRADFORD @ shown > 0).all():
            raise BadData(
                f"color matrix: the matrix for {_name(target_light)} takes white in {_name(light)} to XYZ "
                f"{np.round(shown, 4).tolist()}, which cannot be scaled to white"
            )
        to_xyz = adaptation(shown, seen.xyz_white) @ fixed
    else:
        fit = {
            "white-preserving": _white_preserving,
            "cielab": _least_in_cielab,
            "pseudo-inverse": lambda of: _least_squares(of.camera, of.xyz, 0.0),
            "ridge": lambda of: _least_squares(of.camera, of.xyz, of.camera.sum(1) / snr**2),
            **dict.fromkeys(EXPONENTS, lambda of: _white_preserving_roots(of, method)),
        }[method]
        to_xyz = fit(_check_rank(seen))
    return ColorTransform(display.rgb_from_xyz @ adapt @ to_xyz, to_xyz, seen.camera_white)


def camera_matrix(qe: Spectrum, light: Spectrum | str, reflectances: Spectrum | str) -> np.ndarray:
    """Return the matrix from the XYZ of surfaces in a light to the camera's responses.

    White with Y = 1 becomes white with a largest response of 1. For three channels it is the
    inverse of the white-preserving `color_matrix` with the light as target; for more it is the
    least squares solution among matrices that preserve white.

    Args:
        qe: See `color_matrix`.
        light: See `color_matrix`.
        reflectances: See `color_matrix`.

    Returns:
        Matrix, shape (C, 3).

    Raises:
        BadData: See `color_matrix`.
        UnknownName: See `color_matrix`.
    """
    nodes, surfaces = _surfaces(reflectances, qe)
    photons = _photons(light)
    seen = _training(
        nodes, surfaces, qe, photons, product_weights(nodes, cmf(), energy_from_photons(photons))
    )
    if len(seen.camera) == 3:
        return np.linalg.inv(_white_preserving(_check_rank(seen)))
    return _white_preserving(_Training(seen.xyz, seen.camera, seen.xyz_white, seen.camera_white))


def _photons(light):
    return photons_from_energy(illuminant(light)) if isinstance(light, str) else light


def _name(light):
    return light if isinstance(light, str) else light.name or "a light"


def sees_beyond(qe: Spectrum, end: float) -> np.ndarray:
    """Return the channels that see more beyond a wavelength than before, such as near-infrared pixels.

    Args:
        qe: See `color_matrix`.
        end: The wavelength [nm].

    Returns:
        True or False for each channel, shape (C,).
    """
    rows = np.atleast_2d(qe.values)
    if not (rows[:, qe.wavelengths > end] > 0).any():
        return np.zeros(len(rows), bool)
    at = np.arange(qe.wavelengths[0], _end_of_response(qe) + FINE, FINE)
    seen = np.atleast_2d(qe.at(at))
    return seen[:, at > end].sum(axis=1) > seen[:, at <= end].sum(axis=1)


def _end_of_response(qe):
    """Return the wavelength [nm] at which the last channel has fallen to 0, or the table's end."""
    positive = np.flatnonzero((np.atleast_2d(qe.values) > 0).any(axis=0))
    return qe.wavelengths[min(positive[-1] + 1, len(qe.wavelengths) - 1)]


def _surfaces(reflectances, qe):
    """Return wavelengths [nm] and values (N, L) of training surfaces.

    Measured sets end at 700 nm. For a camera that `sees_beyond` that they keep their last value there.
    """
    chosen = measured(reflectances) if isinstance(reflectances, str) else reflectances
    nodes, values = chosen.wavelengths, np.atleast_2d(chosen.values)
    if not sees_beyond(qe, nodes[-1]).any():
        return nodes, values
    more = np.arange(nodes[-1] + STEP, _end_of_response(qe) + STEP, STEP)
    held = np.repeat(values[:, -1:], len(more), axis=1)
    return np.append(nodes, more), np.hstack([values, held])


def _training(nodes, surfaces, qe, light, eye):
    """Return responses of the camera in `light`, and of the eye with weights `eye` (3, L)."""
    weights = np.atleast_2d(product_weights(nodes, qe, light))
    camera_white, xyz_white = weights.sum(1), eye.sum(1)
    if not (camera_white > 0).all() or not xyz_white[1] > 0:
        raise BadData(
            f"color matrix: a channel, or the eye, sees nothing of the light in {nodes[0]:g} .. "
            f"{nodes[-1]:g} nm"
        )
    return _Training(
        weights @ surfaces.T / camera_white.max(),
        eye @ surfaces.T / xyz_white[1],
        camera_white / camera_white.max(),
        xyz_white / xyz_white[1],
    )


def _check_rank(of):
    """Return the training. Raise BadData if it does not determine the matrix."""
    channels, count = of.camera.shape
    if count < channels:
        raise BadData(
            f"color matrix: {count} training reflectances cannot determine {channels} channels"
        )
    rank = np.linalg.matrix_rank(of.camera)
    if rank < channels:
        raise BadData(
            f"color matrix: the camera's responses to the {count} training reflectances span only {rank} of "
            f"{channels} dimensions"
        )
    return of


def _least_squares(camera, xyz, variance):
    """Return the (3, C) matrix M that maps `camera` (C, N) nearest to `xyz` (3, N), with noise.

    The noise `variance` (C,), summed over the N surfaces, adds tr(M diag(variance) M') to the
    expected squared error. In the least squares problem it is C more columns of `camera` whose
    result should be 0.
    """
    noise = np.diag(np.broadcast_to(np.sqrt(variance), len(camera)))
    camera, xyz = np.hstack([camera, noise]), np.hstack([xyz, np.zeros((len(xyz), len(noise)))])
    return np.linalg.lstsq(camera.T, xyz.T, rcond=None)[0].T


def _split_white(of):
    """Return one matrix (3, C) that maps white to white, and directions (C, C - 1) without it."""
    white = of.camera_white
    return np.outer(of.xyz_white, white) / (white @ white), np.linalg.qr(
        white[:, None], mode="complete"
    )[0][:, 1:]


def _white_preserving(of):
    """Return the least squares matrix among those that map white to white.

    For C > 3, noise with the variance of white counts as well.
    """
    fixed, free = _split_white(of)
    camera, missing = of.camera, of.xyz - fixed @ of.camera
    if len(camera) > 3:
        noise = np.diag(np.sqrt(camera.shape[1] * of.camera_white / WHITE_ELECTRONS))
        camera, missing = np.hstack([camera, noise]), np.hstack([missing, -fixed @ noise])
    return fixed + _least_squares(free.T @ camera, missing, 0.0) @ free.T


def _white_preserving_roots(of, method):
    """Return the matrix of root-polynomial terms that maps white to white, with noise."""
    channels, surfaces = of.camera.shape
    count = len(EXPONENTS[method])
    if channels != 3 or surfaces < count:
        raise BadData(
            f"color matrix: method {method!r} needs 3 channels and {count} training reflectances or more, got "
            f"{channels} and {surfaces}; use another method"
        )
    bright = of.xyz[1] / of.xyz_white[1]
    seen, wanted = weigh_terms(
        of.camera, of.xyz, bright, of.camera_white, _white_preserving(of), count
    )
    terms = _Training(seen, wanted, terms_of(of.camera_white, count), of.xyz_white)
    fixed, free = _split_white(terms)
    return fixed + _least_squares(free.T @ seen, wanted - fixed @ seen, 0.0) @ free.T


def _least_in_cielab(of):
    """Return the matrix with the least mean CIELAB difference that maps white to white.

    Difference: sqrt((Delta E*ab 1976)^2 + its variance from shot noise of each surface, if C > 3).
    """
    from scipy.optimize import minimize

    start, free = _white_preserving(of), _split_white(of)[1]
    wanted, white = _lab(of.xyz, of.xyz_white), of.xyz_white[:, None]
    slopes = _lab_slopes(of.xyz, white)

    def matrix(steps):
        return start + steps.reshape(3, -1) @ free.T

    def difference(steps, smooth=0.0):
        squares = ((_lab(matrix(steps) @ of.camera, of.xyz_white) - wanted) ** 2).sum(0)
        if len(of.camera) > 3:
            noise = np.einsum("lxn,xc->lcn", slopes, matrix(steps)) ** 2
            squares += np.einsum("lcn,cn->n", noise, of.camera) / WHITE_ELECTRONS
        return np.sqrt(squares + smooth**2).mean()

    # The root has a corner at 0, which stalls gradient searches. It is rounded far below a visible
    # difference.
    steps = minimize(difference, np.zeros(free.shape[1] * 3), args=(1e-2,), method="BFGS").x
    return matrix(steps) if difference(steps) < difference(np.zeros_like(steps)) else start


def _lab(xyz, white):
    """Return CIELAB of XYZ (3, N), linear near and below black. Source: CIE 15:2018, 8.2.1."""
    ratio = xyz / white[:, None]
    x, y, z = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def _lab_slopes(xyz, white):
    """Return the derivatives of CIELAB with respect to X, Y and Z, (3, 3, N)."""
    ratio = xyz / white
    slopes = (
        np.where(ratio > (6 / 29) ** 3, np.cbrt(np.maximum(ratio, 1e-9)) ** -2, (29 / 6) ** 2)
        / 3
        / white
    )
    return np.array([[0, 116, 0], [500, -500, 0], [0, 200, -200]])[:, :, None] * slopes


def _channels_as_primaries(white, letters):
    """Return the matrix (3, C) that shows channels R, G and B as primaries, white as (1, 1, 1)."""
    letters = list(letters)
    if len(letters) != len(white) or any(letters.count(letter) != 1 for letter in "RGB"):
        raise BadData(
            f"color matrix: method 'diagonal' needs channels R, G and B, each named once; got "
            f"{''.join(letters)!r} for {len(white)} channel(s); use another method"
        )
    chosen = [letters.index(letter) for letter in "RGB"]
    return np.eye(len(white))[chosen] / white


@dataclass(frozen=True, eq=False)
class TransformSet:
    """Colour transforms of a set of lights, computed once, selected by the camera's white.

    Attributes:
        names: Names of the K lights.
        channels: A letter for each channel, if known.
        transforms: Transform of each light.
        responses: Camera responses to the N training surfaces in each light, in units of white's
            strongest channel, shape (K, C, N).
        target_white: Response to white in the target light, largest entry 1, shape (C,).
    """

    names: tuple[str, ...]
    channels: tuple[str, ...]
    transforms: tuple[ColorTransform, ...]
    responses: np.ndarray
    target_white: np.ndarray

    @property
    def whites(self) -> np.ndarray:
        """Responses to white in each light, largest entry 1, shape (K, C)."""
        return np.stack([transform.white for transform in self.transforms])

    def at(self, white: np.ndarray) -> ColorTransform:
        """Return the transform for a camera white: the one of a light, or a mixture of the nearest.

        Transforms after white balance, M diag(white), are mixed: the given white becomes display
        white if the method preserves white. Weights are 1/d - 1/r for distances d below r in log
        chromaticity; r is REACH times the distance of the second nearest light. Between two
        neighbours on a line of lights almost only these two count. The result is continuous
        everywhere.

        Args:
            white: Response to white, any scale, shape (C,).

        Returns:
            The transform.

        Raises:
            BadData: The white has the wrong shape or is not positive.

        Source:
            a local form of Shepard 1968, Proc. ACM, 517-524.
        """
        white, whites = np.asarray(white, np.float64), self.whites
        if white.shape != whites.shape[1:] or not (np.isfinite(white).all() and (white > 0).all()):
            raise BadData(f"white {white.tolist()}: wanted {whites.shape[1]} positive numbers")
        white = white / white.max()
        distances = np.linalg.norm(chromaticity(white) - chromaticity(whites), axis=1)
        nearest = distances.argmin()
        if distances[nearest] == 0 or len(distances) == 1:
            mixture = np.eye(len(distances))[nearest]
        else:
            mixture = np.maximum(1 / distances - 1 / (REACH * np.partition(distances, 1)[1]), 0)
            mixture /= mixture.sum()
        count = self.transforms[0].matrix.shape[1]
        gains = terms_of(whites, count) / terms_of(white, count)
        matrix, xyz = (
            np.einsum(
                "k,kpc,kc->pc",
                mixture,
                np.stack([getattr(transform, part) for transform in self.transforms]),
                gains,
            )
            for part in ("matrix", "xyz")
        )
        return ColorTransform(matrix, xyz, white)


def transform_set(
    qe: Spectrum,
    reflectances: Spectrum | str,
    lights: Sequence[Spectrum | str] = LIGHTS,
    *,
    channels: Sequence[str] = (),
    **options: Any,
) -> TransformSet:
    """Compute the transforms of a set of lights in advance.

    Args:
        qe: See `color_matrix`.
        reflectances: See `color_matrix`.
        lights: Names or photon radiances.
        channels: A letter for each channel, necessary for "diagonal" and for estimates of the light
            that use certain channels.
        options: Other arguments of `color_matrix`.

    Returns:
        The transforms.

    Raises:
        BadData: There are no lights; see also `color_matrix`.
        OutOfRange: See `color_matrix`.
        UnknownName: See `color_matrix`.

    Source:
        Farrell & Wandell, section 6.2 and Figure 12.
    """
    if not len(lights):
        raise BadData("transform set: no lights")
    named: dict[str, Any] = {"channels": channels} if channels else {}
    transforms = tuple(
        color_matrix(qe, light, reflectances, **named, **options) for light in lights
    )
    nodes, surfaces = _surfaces(reflectances, qe)
    weights = [
        np.atleast_2d(product_weights(nodes, qe, _photons(light)))
        for light in (*lights, options.get("target_light", "D65"))
    ]
    responses = np.stack([w @ surfaces.T / w.sum(1).max() for w in weights[:-1]])
    white = weights[-1].sum(1)
    return TransformSet(
        tuple(_name(light) for light in lights),
        tuple(channels),
        transforms,
        responses,
        white / white.max(),
    )


def chromaticity(white):
    """Return logarithms of responses (..., C) minus their mean, independent of brightness."""
    logs = np.log(white)
    return logs - logs.mean(-1, keepdims=True)
