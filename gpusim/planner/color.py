"""From camera channels to display colours: the matrix that a known light, camera and set of surfaces call for."""

from dataclasses import dataclass

import numpy as np

from gpusim.data.colorimetry import cmf
from gpusim.data.lights import illuminant
from gpusim.domain.display import DISPLAYS, Display
from gpusim.domain.errors import BadData
from gpusim.domain.spectrum import Spectrum, energy_from_photons, photons_from_energy
from gpusim.planner.weights import product_weights

# XYZ to the cone-like primaries of CIECAM97s, in which the white is adapted (Lam 1985; Lindbloom's digits).
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])

# Of white in the strongest channel, weighed against colour errors where more than three channels leave a choice. At
# 1e5 electrons shot noise is a third of the colour error of a good camera: it bars the matrices that gain a fraction of
# that error as a small difference of large responses (clear against red + green + blue: 5 times the noise).
WHITE_ELECTRONS = 1e5


@dataclass(frozen=True, eq=False)
class ColorTransform:
    """Linear maps from camera responses that are normalised so that perfect white has 1 in its strongest channel.

    matrix: to linear display RGB, white = (1, 1, 1); shape (3, C).
    xyz: to the XYZ of the surfaces in the target light, white Y = 1; shape (3, C).
    white: response to perfect white in the scene's light, largest entry 1; shape (C,). As the `ceiling` of
        processor.color, times what saturation is in units of white, it keeps blown-out highlights neutral.
    """

    matrix: np.ndarray
    xyz: np.ndarray
    white: np.ndarray


def color_matrix(qe: Spectrum, light: Spectrum, reflectances: Spectrum, *, target_light: Spectrum | None = None,
                 display: Display = DISPLAYS["srgb"]) -> ColorTransform:
    """Find the colour transform of a camera that sees surfaces in `light` and shows them as if in `target_light`.

    qe: quantum efficiency of the C channels [e-/photon], shape (C, L) or (L,), infrared filter included.
    light, target_light: photon radiance, any scale, shape (L,); target_light None: CIE D65.
    reflectances: the training surfaces [1], shape (N, L). Their wavelengths bound the integrals.
    The XYZ of the surfaces are met with the least squared error among the matrices that map perfect white exactly to
    the target's white, which is then adapted to the display's (Bradford). Of more than three channels, some are nearly
    a mixture of others (a clear pixel of red, green and blue), and the least squares alone would amplify noise many
    times; there the expected error of white's shot noise (WHITE_ELECTRONS) counts as well.
    Raises BadData when wavelengths do not overlap or the surfaces do not determine the matrix.
    Source: Farrell & Wandell, section 6.2, L = (H' diag(d1) S) [C' diag(d2) S]^-1; the constraint: Finlayson & Drew
    1997, Color Research and Application 22, 2-15.
    """
    if target_light is None:
        target_light = photons_from_energy(illuminant("D65"))
    nodes, surfaces = reflectances.wavelengths, np.atleast_2d(reflectances.values)
    camera_weights = np.atleast_2d(product_weights(nodes, qe, light))
    xyz_weights = product_weights(nodes, cmf(), energy_from_photons(target_light))
    channels = len(camera_weights)
    if len(surfaces) < channels:
        raise BadData(f"color matrix: {len(surfaces)} training reflectances cannot determine {channels} channels")
    camera_white, xyz_white = camera_weights.sum(1), xyz_weights.sum(1)
    if not (camera_white > 0).all() or not xyz_white[1] > 0:
        raise BadData(f"color matrix: a channel, or the eye, sees nothing of the light in {nodes[0]:g} .. "
                      f"{nodes[-1]:g} nm")
    camera, xyz = camera_weights @ surfaces.T / camera_white.max(), xyz_weights @ surfaces.T / xyz_white[1]
    camera_white, xyz_white = camera_white / camera_white.max(), xyz_white / xyz_white[1]
    if np.linalg.matrix_rank(camera) < channels:
        raise BadData(f"color matrix: the camera's responses to the {len(surfaces)} training reflectances span only "
                      f"{np.linalg.matrix_rank(camera)} of {channels} dimensions")
    to_xyz = _fit(camera, xyz, camera_white, xyz_white)
    display_white = display.xyz_from_rgb.sum(1)
    gains = (BRADFORD @ display_white) / (BRADFORD @ xyz_white)
    adapt = np.linalg.solve(BRADFORD, gains[:, None] * BRADFORD)
    return ColorTransform(display.rgb_from_xyz @ adapt @ to_xyz, to_xyz, camera_white)


def _fit(camera, xyz, camera_white, xyz_white):
    """Return the (3, C) matrix that takes `camera` (C, N) nearest to `xyz` (3, N), and white exactly to white.

    Shot noise of variance white / WHITE_ELECTRONS adds tr(M diag(variance) M') to the expected square of each of the N
    errors; as C more columns of `camera` that should come out as 0, it is part of the same least squares.
    """
    if len(camera_white) > 3:
        noise = np.diag(np.sqrt(camera.shape[1] * camera_white / WHITE_ELECTRONS))
        camera, xyz = np.hstack([camera, noise]), np.hstack([xyz, np.zeros((len(xyz), len(noise)))])
    fixed = np.outer(xyz_white, camera_white) / (camera_white @ camera_white)
    free = np.linalg.qr(camera_white[:, None], mode="complete")[0][:, 1:]  # directions that white has no part in
    return fixed + np.linalg.lstsq((free.T @ camera).T, (xyz - fixed @ camera).T, rcond=None)[0].T @ free.T
