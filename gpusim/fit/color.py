"""Colour response of a camera from a ColorChecker in one or two lights."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from gpusim.color.color import color_matrix
from gpusim.data.colorimetry import cmf
from gpusim.data.lights import light_of
from gpusim.data.reflectances import reflectances
from gpusim.data.weights import product_weights
from gpusim.domain.errors import BadData
from gpusim.domain.spectrum import Spectrum, photons_from_energy
from gpusim.fit.chart_finding import COLUMNS, ROWS, Patches, read_patches
from gpusim.fit.curve_prior import NODES
from gpusim.fit.estimate import Estimate, Part, Plot
from gpusim.fit.planes import checked_frames
from gpusim.fit.sensitivity import Sensitivity, fit_sensitivity, guess_light
from gpusim.io.raw.raw_frame import RawFrame

GUESSES = (
    "A",
    "blackbody-3200K",
    "daylight-4000K",
    "daylight-5000K",
    "daylight-5500K",
    "D65",
    "daylight-7500K",
)
LEAST_PATCHES = 18
STEEP = 0.02  # slope of the light over half of the chart that is worth a line
VISIBLE = 1.0  # CIEDE2000 of a patch that is worth a line
TRAINING = "objects"
OTHERS = ("munsell", "dupont", "objects", "skin")  # surfaces whose colour errors are expected


def fit_color(
    frames: RawFrame | Sequence[RawFrame],
    *,
    lights: Sequence[str | Spectrum] | str | None = None,
    black: ArrayLike | None = None,
    corners: ArrayLike | None = None,
    falloff: np.ndarray | None = None,
) -> Part:
    """Fit spectral sensitivities and colour matrices to frames of a ColorChecker.

    Args:
        frames: One frame for each light.
        lights: Light of each frame, names or relative power in energy units; None: the likeliest of usual ones.
        black: Black level [DN], see `gpusim.fit.planes.light_values`.
        corners: x and y [pixel] of the middles of dark skin, bluish green, black and white, shape (4, 2); None: they
            are searched.
        falloff: Response to even light over the frame [1], shape (rows, cols), which is divided out; or None.

    Returns:
        Estimates of peaks and matrices, and the setting sensor.sensitivity.

    Raises:
        BadData: No chart is found, too many patches are clipped, or frames and lights do not fit one another.
    """
    every = checked_frames(frames, "chart")
    surfaces = np.clip(reflectances("colorchecker").at(NODES, outside=None), 0, 1)
    luminance = surfaces @ np.interp(NODES, cmf().wavelengths, cmf().values[1])
    charts = [read_patches(frame, luminance, black, corners, falloff) for frame in every]
    for chart in charts:
        if 24 - len(chart.clipped) < LEAST_PATCHES:
            raise BadData(
                f"{chart.name or 'chart'}: {len(chart.clipped)} of 24 patches are clipped; expose less, white to 80 % "
                "of "
                "the range"
            )
        if not (chart.means > 0).all():
            raise BadData(
                f"{chart.name or 'chart'}: a patch is darker than the black level; give more light, or the right black"
            )
    names, photons, fit, is_guessed = _fit(charts, lights, surfaces)
    sources = tuple(chart.name for chart in charts)
    parts = [_matrix(fit, name, light) for name, light in zip(names, photons, strict=True)]
    differences = (
        [
            _differences(fit, chart, light, number)
            for number, (chart, light) in enumerate(zip(charts, photons, strict=True))
        ]
        if len(fit.letters) >= 3
        else []
    )
    estimates = _peaks(fit, sources)
    for one in parts:
        estimates |= {
            key: Estimate(value[0], value[1], value[2], "", sources, "XYZ of surfaces in D65")
            for key, value in one.items()
        }
    expected = {}
    if len(fit.letters) >= 3:
        expected = {
            name: _expected_errors(fit, light) for name, light in zip(names, photons, strict=True)
        }
    for name, sizes in expected.items():
        for share, errors in sizes.items():
            middle = float(np.median(errors))
            low, high = _interval(errors, middle)
            estimates[f"dE2000 of other surfaces in {name}, {share}"] = Estimate(
                middle, low, high, "", sources, f"expected; of {', '.join(OTHERS)}"
            )
    table = {"wavelengths_nm": NODES.tolist()} | {
        letter: np.round(curve, 5).tolist()
        for letter, curve in zip(fit.letters, fit.values, strict=True)
    }
    return Part(
        "colour",
        estimates,
        {"sensor": {"sensitivity": table}},
        _plots(fit, charts, names, differences),
        _describe_misfit(fit, charts, names, differences),
        (*_unknown(fit, charts, names, is_guessed), *_describe_expected(expected)),
    )


def _fit(charts: list[Patches], lights, surfaces):
    """Return names of the lights, their photons, the sensitivities, and whether the lights are guessed."""
    if isinstance(lights, (str, Spectrum)):
        lights = [lights]
    letters = charts[0].letters
    column, row = np.meshgrid(np.linspace(-1, 1, COLUMNS), np.linspace(-1, 1, ROWS))
    places = np.stack([column.ravel(), row.ravel()], axis=1)

    def fit(chosen, known, **options):
        used = [~np.isin(np.arange(24), chart.clipped) for chart in chosen]
        return fit_sensitivity(
            letters,
            [chart.means for chart in chosen],
            [chart.errors for chart in chosen],
            known,
            surfaces,
            places,
            used,
            **options,
        )

    if lights is not None:
        if len(lights) != len(charts):
            raise BadData(
                f"chart: {len(charts)} frames and {len(lights)} lights; give one light for each frame"
            )
        photons = [photons_from_energy(light_of(light)) for light in lights]
        names = [light if isinstance(light, str) else light.name or "a light" for light in lights]
        return names, photons, fit(charts, photons), False
    candidates = {name: photons_from_energy(light_of(name)) for name in GUESSES}
    names = [
        guess_light(candidates, lambda light, one=chart: fit([one], [light], draws=0))[0]
        for chart in charts
    ]
    photons = [candidates[name] for name in names]
    return names, photons, fit(charts, photons), True


def _peaks(fit: Sensitivity, sources):
    found = {}
    for k, (letter, curve) in enumerate(zip(fit.letters, fit.values, strict=True)):
        top = int(np.argmax(curve))
        low, high = _interval(fit.draws[:, k, top], curve[top])
        found[f"sensor.sensitivity of {letter} at {NODES[top]:g} nm"] = Estimate(
            float(curve[top]), low, high, "", sources,
            "its peak; the largest of all channels is 1",
        )  # fmt: skip
    return found


def _interval(draws, value):
    """Return the ends of the interval of 95 %, which holds the value."""
    low, high = np.quantile(draws, (0.025, 0.975))
    return float(min(low, value)), float(max(high, value))


def _matrix(fit: Sensitivity, name, light):
    """Return {key: (value, low, high)} of the matrix from white-balanced channels to XYZ."""
    if len(fit.letters) < 3:
        return {}
    drawn = []
    for values in (fit.values, *fit.draws):
        transform = color_matrix(Spectrum(NODES, values), light, TRAINING)
        drawn.append(transform.xyz * transform.white)
    table = np.array(drawn)
    spread = 1.96 * table[1:].std(0, ddof=1)
    return {
        f"color matrix {xyz} from {letter} in {name}": (
            float(table[0, row, col]),
            float(table[0, row, col] - spread[row, col]),
            float(table[0, row, col] + spread[row, col]),
        )
        for row, xyz in enumerate("XYZ")
        for col, letter in enumerate(fit.letters)
    }


def _expected_errors(fit: Sensitivity, light) -> dict[str, np.ndarray]:
    """Return CIEDE2000 of other surfaces, their 95 % and the largest, if the camera has each of the drawn curves.

    Through a matrix of least squares, which amplifies errors more than the camera file's if there are four channels.
    """
    from gpusim.measure.difference import ciede2000

    tables = [np.clip(reflectances(name).at(NODES, outside=None), 0, 1) for name in OTHERS]
    weights = np.concatenate(tables) * product_weights(NODES, light)
    transform = color_matrix(fit.spectrum, light, TRAINING, method="pseudo-inverse")
    seen = np.stack([weights @ one.T for one in (fit.values, *fit.draws)])
    main = seen[0].sum(0).argmax()
    seen *= (seen[0, :, main].sum() / seen[:, :, main].sum(1))[:, None, None]  # in one exposure
    white = (product_weights(NODES, light) @ fit.values.T).max()
    xyz = np.maximum(seen / white @ transform.xyz.T, 0)
    errors = ciede2000(xyz[1:], np.broadcast_to(xyz[0], xyz[1:].shape), _white())
    return {"95 %": np.quantile(errors, 0.95, axis=1), "the largest": errors.max(1)}


def _white():
    """Return XYZ of D65, Y = 1."""
    eye = product_weights(NODES, cmf(), light_of("D65")).sum(1)
    return eye / eye[1]


def _differences(fit: Sensitivity, chart: Patches, light, number):
    """Return CIEDE2000 of the measured patches from the fitted camera's, (24,), and their display RGB (24, 3)."""
    from gpusim.domain.display import DISPLAYS
    from gpusim.measure.difference import ciede2000

    transform = color_matrix(fit.spectrum, light, TRAINING)
    white = (fit.scales[number] * product_weights(NODES, light) @ fit.values.T).max()
    seen, wanted = chart.means / white, fit.predicted[number] / white
    xyz = [np.maximum(one @ transform.xyz.T, 0) for one in (seen, wanted)]
    found = ciede2000(xyz[0][None], xyz[1][None], _white())[0]
    shown = DISPLAYS["srgb"].rgb_from_xyz @ xyz[0].T
    return found, np.clip(shown.T, 0, 1) ** (1 / 2.2)


def _describe_misfit(fit: Sensitivity, charts, names, differences):
    lines = []
    for chart, name, (found, _) in zip(charts, names, differences, strict=False):
        used = ~np.isin(np.arange(24), chart.clipped)
        if found[used].max() > VISIBLE:
            worst = int(np.argmax(np.where(used, found, 0)))
            lines.append(
                f"chart in {name}: patch {worst + 1} misses the fitted camera by {found[worst]:.2g} dE2000, all by "
                f"{found[used].mean():.2g} on average: reflectances, glare or a light other than {name}"
            )
    for name, slope in zip(names, fit.slopes, strict=True):
        if np.abs(slope).max() > STEEP:
            lines.append(
                f"chart in {name}: the light changes by {200 * np.abs(slope).max():.2g} % over the chart, which was "
                "divided out"
            )
    return tuple(lines)


def _describe_expected(expected):
    """Return lines of lights in which colours may miss by more than is visible."""
    lines = []
    for name, sizes in expected.items():
        most = {share: np.quantile(errors, 0.975) for share, errors in sizes.items()}
        if most["the largest"] > VISIBLE:
            lines.append(
                f"colours in {name}: dE2000 of other surfaces up to {most['95 %']:.2g} for 95 % of them and "
                f"{most['the largest']:.2g} for the worst are possible; charts in further lights narrow this"
            )
    return tuple(lines)


def _unknown(fit: Sensitivity, charts, names, is_guessed):
    lines = [
        "quantum efficiency: a chart tells relative sensitivities; sensor.sensitivity_peak sets the level, "
        "which needs a "
        "measured number of photons",
        f"sensitivity below {NODES[0]:g} and above {NODES[-1]:g} nm: the chart's reflectances end there",
    ]
    if is_guessed:
        lines.append(
            f"light of the chart: not given, {' and '.join(names)} assumed as the likeliest of "
            f"{', '.join(GUESSES)}; give its name or spectrum"
        )
    if len(charts) == 1:
        lines.append(
            "fine structure of the sensitivities: one light; a second one, such as A next to daylight, narrows them"
        )
    if len(fit.letters) < 3:
        lines.append("colour matrix: fewer than three channels")
    for chart in charts:
        if chart.clipped:
            lines.append(
                f"{chart.name or 'chart'}: patches {', '.join(str(k + 1) for k in chart.clipped)} are clipped and not "
                "used; expose less"
            )
    return tuple(lines)


def _plots(fit: Sensitivity, charts, names, differences):
    colours = {"R": "tab:red", "G": "tab:green", "B": "tab:blue"}

    def draw_curves(figure):
        axes = figure.subplots()
        low, high = np.quantile(fit.draws, (0.025, 0.975), axis=0)
        for k, (letter, curve) in enumerate(zip(fit.letters, fit.values, strict=True)):
            colour = colours.get(letter, "0.4")
            axes.plot(NODES, curve, color=colour, label=letter)
            axes.fill_between(NODES, low[k], high[k], color=colour, alpha=0.2, linewidth=0)
        axes.set(xlabel="wavelength [nm]", ylabel="relative sensitivity per photon", ylim=(0, None))
        axes.legend()

    def draw_patches(figure):
        rows = figure.subplots(len(differences), 1, squeeze=False)[:, 0]
        for axes, name, (found, colour) in zip(rows, names, differences, strict=True):
            axes.bar(np.arange(1, 25), found, color=colour, edgecolor="0.5", linewidth=0.5)
            axes.set(ylabel=f"dE2000 in {name}", xlim=(0.3, 24.7))
        rows[-1].set_xlabel("patch, 1 dark skin to 24 black")

    def draw_responses(figure):
        axes = figure.subplots()
        for number, chart in enumerate(charts):
            for k, letter in enumerate(chart.letters):
                miss = 100 * (chart.means[:, k] / fit.predicted[number, :, k] - 1)
                axes.plot(
                    np.arange(1, 25) + 0.1 * number,
                    miss,
                    "o+x"[number % 3],
                    color=colours.get(letter, "0.4"),
                )
        axes.axhline(0, color="0.7", linewidth=0.8)
        axes.set(xlabel="patch", ylabel="response less the model's [%]")

    plots = [
        Plot(
            "Spectral sensitivity",
            "Electrons per photon of lens, filters and photodetector, relative to the largest; bands hold 95 %.",
            draw_curves,
        ),
        Plot(
            "ColorChecker: residuals",
            "Patches of each channel less the fitted camera's.",
            draw_responses,
        ),
    ]
    if differences:
        plots.append(
            Plot(
                "ColorChecker: colour differences",
                "CIEDE2000 between the measured patches and the fitted camera's, both through its colour matrix. Bars "
                "have the patches' colours.",
                draw_patches,
            )
        )
    return tuple(plots)
