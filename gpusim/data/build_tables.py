"""Build the tables of this folder.

Usage: `python -m gpusim.data.build_tables ISETCAM_REFLECTANCES.npz ISETCAM_SPECTRA.npz`. Run it by
hand when a source changes. The tables are part of the package; nothing here runs in use. README.md
of this folder names every source.
"""

import sys
from pathlib import Path

import numpy as np

from gpusim.domain.spectrum import Spectrum

HERE = Path(__file__).parent

REFLECTANCE_SETS = {
    "macbeth": "macbethChart",
    "munsell": "MunsellSamples_Vhrel",
    "dupont": "DupontPaintChip_Vhrel",
    "objects": "Objects_Vhrel",
    "nature": "Nature_Vhrel",
    "skin": "Caucasian_Vhrel",
    "colorchecker-sg": "gretagDigitalColorSG",
}  # our name: ISETCam's file in data/surfaces/reflectances
DISPLAYS = {
    "lcd-apple": "LCD_Apple",
    "lcd-dell": "LCD_Dell",
    "crt-dell": "CRT_Dell",
    "oled-sony": "OLED_Sony",
}


def build_cie(path=HERE / "cie.npz"):
    """Build colour matching functions, illuminants, daylight basis and ColorChecker.

    Their source is colour-science.
    """
    import colour
    from colour.colorimetry import SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES as DAYLIGHT

    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    lights = {
        name: light for name, light in colour.SDS_ILLUMINANTS.items() if not name.startswith("ISO")
    }
    wavelengths = np.arange(300.0, 831.0, 5.0)
    powers = np.full((len(lights), len(wavelengths)), np.nan)  # NaN: outside the published table
    for row, light in zip(powers, lights.values(), strict=True):
        row[np.searchsorted(wavelengths, light.wavelengths)] = light.values
    checker = colour.SDS_COLOURCHECKERS["ISO 17321-1"]
    np.savez_compressed(
        path,
        cmf_wavelengths=cmfs.wavelengths,
        cmf=cmfs.values.T,
        daylight_wavelengths=DAYLIGHT["S0"].wavelengths,
        daylight=[DAYLIGHT[s].values for s in ("S0", "S1", "S2")],
        illuminant_names=list(lights),
        illuminant_wavelengths=wavelengths,
        illuminants=powers,
        colorchecker_names=list(checker),
        colorchecker_wavelengths=checker["white 9.5 (.05 D)"].wavelengths,
        colorchecker=[patch.values for patch in checker.values()],
    )


def build_reflectances(source, path=HERE / "reflectances.npz"):
    """Build measured reflectances at 400, 410 .. 700 nm (ISETCam), without samples with NaN."""
    tables = {}
    with np.load(source) as isetcam:
        # the source has steps of 5 nm, but was measured at 10 nm (macbeth: 4 nm)
        step = slice(None, None, 2)
        for name, theirs in REFLECTANCE_SETS.items():
            samples = isetcam[f"refl_{theirs}"][step].T
            tables[name] = samples[np.isfinite(samples).all(1)].astype(np.float32)
        np.savez_compressed(path, wavelengths=isetcam["wave"][step], **tables)


def build_displays(source, path=HERE / "displays.npz"):
    """Build radiance of measured displays' primaries at 400, 410 .. 700 nm, and curve exponents."""
    tables = {}
    with np.load(source, allow_pickle=True) as isetcam:
        for name, theirs in DISPLAYS.items():
            curve = isetcam[f"disp_gamma_{theirs}"][:, :3].mean(axis=1)
            curve = (curve - curve[0]) / (curve[-1] - curve[0])
            codes = np.arange(256) / 255
            exponents = np.arange(1.5, 3, 0.01)
            error = np.abs(codes[:, None] ** exponents - curve[:, None]).max(axis=0)
            tables[f"{name} spectra"] = isetcam[f"disp_spd_{theirs}"][:, :3].T.astype(np.float32)
            tables[f"{name} exponent"] = exponents[error.argmin()]
            print(
                f"{name}: exponent {exponents[error.argmin()]:.2f}, off by {error.min():.3f} of white at most"
            )
        np.savez_compressed(path, wavelengths=isetcam["wave"], **tables)


def build_srgb(path=HERE / "srgb.npz"):
    """Build reflectance spectra of the sRGB primaries: `smoothest_primaries` at 360 .. 780 nm.

    Their colours hold for cubic splines through the nodes, because the simulation interpolates
    reflectances with them.
    """
    from scipy.interpolate import CubicSpline

    from gpusim.data.colorimetry import xyz
    from gpusim.data.lights import illuminant
    from gpusim.data.srgb import srgb_to_xyz

    wavelengths = np.arange(360.0, 781.0, 10.0)  # common range of the tables of D65 and observer
    fine = np.linspace(360, 780, 4201)
    cardinal = CubicSpline(wavelengths, np.eye(len(wavelengths)))(fine).T
    light = illuminant("D65")
    # response to each unit entry: the result is linear in the table
    responses = xyz(Spectrum(fine, cardinal), light).T / xyz(light)[1]
    np.savez_compressed(
        path, wavelengths=wavelengths, primaries=smoothest_primaries(responses, srgb_to_xyz())
    )


def smoothest_primaries(responses, targets):
    """Return three smooth spectra within 0 .. 1 that add up to 1 and have given tristimulus values.

    They minimise the sum of squared first differences of all three.

    Args:
        responses: XYZ of a unit entry at each of the L nodes, shape (3, L).
        targets: XYZ of the primaries in columns.

    Returns:
        Spectra, shape (3, L).

    Raises:
        RuntimeError: The search failed.

    Source:
        Mallett & Yuksel, "Spectral primary decomposition for rendering with sRGB reflectance", EGSR
        2019.
    """
    from scipy.optimize import minimize

    nodes = responses.shape[1]
    difference = np.diff(np.eye(nodes), axis=0)
    roughness = difference.T @ difference
    # Unknowns: red and blue; green is the rest to 1, which makes white exactly 1.
    hessian = 2 * np.block([[2 * roughness, roughness], [roughness, 2 * roughness]])
    equal = np.kron(np.eye(2), responses)
    wanted = np.concatenate([targets[:, 0], targets[:, 2]])
    sums = np.hstack([np.eye(nodes), np.eye(nodes)])
    start = np.linalg.lstsq(equal, wanted)[0]
    found = minimize(
        lambda x: 0.5 * x @ hessian @ x,
        start,
        jac=lambda x: hessian @ x,
        method="SLSQP",
        bounds=[(0, 1)] * (2 * nodes),
        options={"maxiter": 1000, "ftol": 1e-14},
        constraints=[
            {"type": "eq", "fun": lambda x: equal @ x - wanted, "jac": lambda x: equal},
            {"type": "ineq", "fun": lambda x: 1 - sums @ x, "jac": lambda x: -sums},
        ],
    )
    if not found.success:
        raise RuntimeError(f"sRGB primaries: {found.message}")
    red, blue = np.clip(found.x.reshape(2, nodes), 0, 1)
    return np.stack([red, np.clip(1 - red - blue, 0, 1), blue])


if __name__ == "__main__":
    build_cie()
    build_reflectances(sys.argv[1])
    build_displays(sys.argv[2])
    build_srgb()
