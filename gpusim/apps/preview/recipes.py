"""How others make a picture again: a command line, a cell of a notebook, and the address of a page."""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from shlex import join
from typing import Any
from urllib.parse import quote

from gpusim.apps.preview.state import State
from gpusim.io.camera.cameras import anchor_paths, camera_names, camera_table
from gpusim.io.frame.frames import FORMATS

CAMERA = "camera.toml"
SAVED = tuple(suffix for suffix in FORMATS if suffix not in (".tiff", ".jpeg"))  # without synonyms


@dataclass(frozen=True)
class Start:
    """How a preview was started, as words of a command line.

    Attributes:
        scenes: The scenes, with their options.
        device: The device; "": any.
        is_moving: Whether the scenes move: `gpusim video` makes their frames.
        unwritten: Options that have no text here.
    """

    scenes: tuple[str, ...] = ()
    device: str = ""
    is_moving: bool = False
    unwritten: tuple[str, ...] = ()


START = Start()  # of a preview whose scenes are charts and files


def command_line(state: State, number: int, start: Start = START) -> str:
    """Return the command line of a frame, with the camera's file and the scene's files beside it.

    number: Of the frame.
    """
    given = state.scene.is_given
    is_moving = given and start.is_moving
    scene = [*start.scenes] if given else state.scene.words()
    words = ["gpusim", "video" if is_moving else "simulate", *scene, "--camera", CAMERA]
    options = {"light": state.light, "luminance": state.luminance, "tolerance": state.asked}
    for option, value in options.items():
        if value is not None:
            words += [f"--{option}", repr(value) if isinstance(value, float) else str(value)]
    words += ["--device", start.device] if start.device else []
    words += ["--seed", str(state.seed)]
    if is_moving:
        return join([*words, "-o", "frames/frame.npz"])
    return join([*words, "--frame", str(number), "-o", "frame.npz"])


def notes_on_command(state: State, number: int, start: Start = START) -> list[str]:
    """Return what a user of the command line must know, as sentences."""
    notes = [f"Save {CAMERA} next to it."]
    files = [*state.scene.files, *state.used_files]
    if files:
        notes.append(f"It reads {', '.join(files)} from the same folder.")
    if len(state.scene.files) > 1 and state.scene.name not in state.scene.files:
        notes[-1] = f"It reads a folder {state.scene.name} with {', '.join(state.scene.files)}."
    if state.scene.is_given and start.is_moving:
        notes.append(f"The picture is its frame {number}.")
    if start.unwritten:
        notes.append(f"Add {', '.join(start.unwritten)} as this preview was started.")
    return notes


def notebook_cell(
    state: State, number: int, start: Start = START, is_panorama: bool = False
) -> str:
    """Return Python that makes a frame again, with the files that it reads in its folder.

    number: Of the frame. is_panorama: Whether the scene is one. The scenes that the preview was
    started with are a variable `scene`. Raises as `State.table` does.
    """
    lines = ["from pathlib import Path", "", "import gpusim as gs", ""]
    files = _paths(state)
    if files:
        lines.insert(0, "import hashlib")
        lines += [f"for name, sha in {files!r}.items():"]
        lines += ["    assert hashlib.sha256(Path(name).read_bytes()).hexdigest() == sha, name"]
    text = camera_text(state)
    quoted = repr(text) if "'''" in text else f"r'''\n{text}'''"
    lines += [f"Path({CAMERA!r}).write_text({quoted})", f"camera = gs.open_camera({CAMERA!r})"]
    if state.scene.is_given:
        lines += ["# scene: the one that this preview was started with"]
    else:
        arguments: dict[str, Any] = state.scene.arguments()
        arguments |= {"light": state.light, "luminance": state.luminance}
        size = arguments.pop("size", None) if is_panorama else None
        given = [f", {key}={value!r}" for key, value in arguments.items() if value is not None]
        lines += [f"scene = gs.open_scene({state.scene.name!r}{''.join(given)})"]
        lines += [f"scene = gs.view_panorama(scene, camera, size={size})"] * is_panorama
    if any(word == "--capture" for word in start.unwritten):
        lines += [
            "# this preview merges the frames of a capture: use its `take` for the same frame"
        ]
    device = f", device={start.device!r}" if start.device else ""
    lines += [
        f"simulate = gs.Simulator(camera, tolerance={state.asked!r}{device})",
        f"frame = simulate(scene, seed={state.seed}, first={number})",
        "frame",
    ]
    return "\n".join(lines) + "\n"


def _paths(state):
    """Return the relative path of each file of the settings, and its SHA-256."""
    scene = state.scene
    folder = "" if scene.name in scene.files else f"{scene.name}/"
    return {f"{folder}{name}": sha for name, sha in scene.files.items()} | state.used_files


def camera_text(state: State) -> str:
    """Return a camera file: of a built-in camera only what was changed, if that is enough.

    Raises as `State.table` does.
    """
    import tomli_w

    table = state.table()
    if state.camera in camera_names():
        own = replace(state, changes={}).table()
        changed: dict[str, Any] = {"base": state.camera, "name": table["name"]}
        for section, keys in table.items():
            if isinstance(keys, dict):
                before = own.get(section, {})
                new = {key: value for key, value in keys.items() if before.get(key) != value}
                changed |= {section: new} if new else {}
        text = tomli_w.dumps(changed)
        if _table_of(text) == table:  # a mosaic, for example, changes other keys of its base
            return text
    return state.toml()


def _table_of(text):
    """Return the keys of a camera file with this text, with those of its base."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, CAMERA)
        path.write_text(text)
        return anchor_paths(*camera_table(path))


def address_of(page: str, state: State) -> str:
    """Return the address of the page with these settings. page: Its address without them."""
    return f"{page}?state={quote(state.link(), safe='')}"
