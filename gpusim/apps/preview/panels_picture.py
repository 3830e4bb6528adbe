"""Panels of the picture: colours of a ColorChecker, and errors and times of the plan."""

import numpy as np

from gpusim.apps.preview.curves import ACCENT, Mark
from gpusim.apps.preview.figures import Bars, Note, Part
from gpusim.apps.preview.measures import Inputs, Where
from gpusim.domain.errors import BadData
from gpusim.measure.checker import checker_of
from gpusim.plot.canvas import srgb
from gpusim.plot.errors import UNITS

SHORTEST = 0.005  # [ms] of a step that is shown


def checker(found: Inputs, where: Where, chosen, kept) -> list[Part]:
    """Return the colour error of each patch of a ColorChecker."""
    patches = kept("checker", (found.scene,), lambda: checker_of(found.scene))
    if patches is None:
        raise BadData(
            'the scene is no ColorChecker: wanted the chart "colorchecker" of 48 rows or more, at '
            "rest and in a known light"
        )
    linear = found.arrays["linear"]
    if linear.shape[:2] != found.scene.shape:
        raise BadData("the frame is binned: wanted as many pixels as the scene has")
    assert found.rendering is not None  # it comes with "linear"
    diffuser, display = found.rendering.diffuser, found.operated.display
    errors = patches.differences(linear, diffuser, display)
    codes = (255 * srgb(patches.true.T[..., None])[:, 0] + 0.5).astype(np.uint8)
    names = [f"patch {number}" for number in range(1, 25)]
    colors = {
        name: "#" + bytes(color.tolist()).hex() for name, color in zip(names, codes, strict=True)
    }
    values = dict(zip(names, map(float, errors), strict=True))
    mean = f"mean Delta E 2000 {errors.mean():.2f}, largest {errors.max():.2f}"
    return [
        Bars("colour error", "CIEDE2000", values, colors, Mark(float(errors.mean()), "mean")),
        Note(f"{mean}; patch 1 is dark skin, 24 black"),
    ]


def plan(found: Inputs, where: Where, chosen, kept) -> list[Part]:
    """Return the predicted error of each cause, and the time of each step when it ran last."""
    parts: list[Part] = []
    if found.account is None:
        parts.append(Note("a draft: its error is not predicted"))
    else:
        name, errors = found.account.by_cause(found.tolerance)
        limit = None if found.tolerance is None else getattr(found.tolerance, name)
        mark = Mark(limit, f"tolerance {limit:.2g}") if limit else None
        colors = dict.fromkeys(errors, ACCENT) | {"all together": "currentColor"}
        parts.append(Bars("predicted error", UNITS[name], errors, colors, mark, "{:.2g}"))
        if found.account.unknown:
            parts.append(Note(f"not known: {'; '.join(found.account.unknown)}"))
    ms = {step: spent for step, spent in found.ms.items() if spent >= SHORTEST}
    words = "time of each step when it ran last"
    if ms:
        parts.append(Bars(words, f"{sum(ms.values()):.3g} ms in all", ms))
    return parts
