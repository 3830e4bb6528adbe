"""Pictures of several cameras as one, and the keys in which the cameras differ."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusim.apps.preview.control import as_text
from gpusim.apps.preview.controls import CONTROLS
from gpusim.apps.preview.state import State
from gpusim.domain.errors import BadData
from gpusim.io.camera.cameras import camera_table

AMPLIFIED = 4  # differences of codes
OWN = "this camera"  # in comparisons

Codes = NDArray[np.uint8]


def compare(codes: Codes, others: Sequence[Codes], how: str, split: float) -> Codes:
    """Return one picture of several.

    Args:
        codes: The picture of this camera, shape (rows, cols, 3).
        others: Those of the others, at least one, of the same shape.
        how: One of `gpusim.apps.preview.state.COMPARISONS`. "split": this one left of a line,
            another right of it. "difference": grey where they are equal, AMPLIFIED. "blink": the
            other one if `split` is below 0.5.
        split: Place of the line, as a part of the width.

    Returns:
        Codes, shape (rows, cols, 3); side by side (rows, cols * pictures, 3).

    Raises:
        BadData: The shapes differ.
    """
    for other in others:
        if codes.shape != other.shape:
            raise BadData(
                f"the other camera's frame has {other.shape[1]}x{other.shape[0]} pixels; wanted "
                f"{codes.shape[1]}x{codes.shape[0]}, as this one's has"
            )
    if how == "side by side":
        return np.concatenate([codes, *others], axis=1)
    if how == "difference":
        apart = codes.astype(np.int16) - others[0]
        return np.clip(128 + AMPLIFIED * apart, 0, 255).astype(np.uint8)
    if how == "blink":
        return others[0] if split < 0.5 else codes
    at = round(split * codes.shape[1])
    joined = np.concatenate([codes[:, :at], others[0][:, at:]], axis=1)
    joined[:, max(at - 1, 0) : at + 1] = 255
    return joined


def name_pictures(state: State) -> tuple[str, ...]:
    """Return the name of each picture that is shown, from the left; none without a comparison."""
    if state.against is None:
        return ()
    if state.compare == "blink":
        return (state.against if state.split < 0.5 else OWN,)
    if state.compare == "difference":
        return (f"{OWN} minus {state.against}, times {AMPLIFIED}",)
    return (OWN, *state.other_names)


def list_differences(states: Sequence[State]) -> list[tuple[str, ...]]:
    """Return the settings in which states differ: a label with its unit, and each one's value."""
    rows = []
    tables = [camera_table(state.camera)[1] for state in states]
    names = [state.camera for state in states]
    if len({*names}) > 1:
        rows.append(("camera", *names))
    for control in CONTROLS.values():
        values = [
            _format(state.value(control, table))
            for state, table in zip(states, tables, strict=True)
        ]
        if len({*values}) > 1:
            label = f"{control.label} [{control.unit}]" if control.unit else control.label
            rows.append((label, *values))
    return rows


def describe_step(before: State, after: State) -> str:
    """Return what changed from one state to the next, in a few words."""
    if before.camera != after.camera:
        return f"camera {after.camera}"
    for name in {*before.changes} | {*after.changes}:
        old, new = (state.changes.get(name, "the file's") for state in (before, after))
        if old != new:
            control = CONTROLS[name]
            return f"{control.label} {_format(new)} {control.unit}".rstrip()
    parts = {
        "light": after.light or "the scene's light",
        "luminance": after.luminance,
        "scene": f"scene {' '.join(after.scene.words()) or 'as started'}",
        "tolerance": after.tolerance,
        "view": after.view,
        "marks_clipped": f"clipping {'marked' if after.marks_clipped else 'not marked'}",
        "is_live": "live" if after.is_live else "still",
        "against": f"against {after.against}" if after.against else "no comparison",
        "compare": after.compare,
        "frame": after.frame,
        "seed": after.seed,
    }
    for name, words in parts.items():
        if getattr(before, name) != getattr(after, name):
            return f"{words}" if isinstance(words, str) else f"{name} {_format(words)}"
    return "snapshots"


def _format(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else as_text(value)
