"""What `gpusim preview` shows first, and how its command line is written again."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusim.apps.preview.recipes import START, Start
from gpusim.apps.preview.scene_choice import OPTIONS, SceneChoice, is_file_name
from gpusim.apps.preview.uploads import sha_of
from gpusim.data.charts import CHARTS
from gpusim.data.lights import FILES
from gpusim.io.scene.bands import find_bands
from gpusim.io.scene.envi import data_files
from gpusim.io.scene.option_texts import format_option

if TYPE_CHECKING:
    from gpusim.apps.video.scenes import Scenes
    from gpusim.cli.preview import PreviewRequest

MOVES = "frames fps pan roll zoom zooming shake travel transfer any_order".split()
NAMED = {"bands": "band"}  # option of `open_scene` -> of the command line


@dataclass(frozen=True)
class First:
    """What pages show first.

    Attributes:
        scene: The scene, "" for scenes that move and scenes that no page can name.
        known: SHA-256 -> path of the files of the command line.
        settings: Other fields of the state: light, luminance and their files.
        start: The command line.
    """

    scene: SceneChoice
    known: dict[str, Path] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    start: Start = START


def read_start(request: "PreviewRequest", scenes: "Scenes") -> First:
    """Return what pages show first.

    Args:
        request: Options of the command.
        scenes: Its scenes.

    Returns:
        The scene, its light and the files.

    Raises:
        BadFile: If a file cannot be read.
    """
    start = _describe(request, scenes)
    if len(request.scene) > 1 or not scenes.is_still:
        return First(SceneChoice(), start=start)
    (name,) = request.scene
    paths = _files_of(name)
    light = request.light
    lamps = [Path(light)] if light and light.lower().endswith(FILES) else []
    known = {sha_of(path): path.absolute() for path in (*paths, *lamps)}
    shas = {path.name: sha for sha, path in known.items()}
    files = {path.name: shas[path.name] for path in paths}
    own = SceneChoice(Path(name).name if files else name, files, request.size, _options(request))
    names = [path.name for path in (*paths, *lamps)]
    if not own.is_sound or len({*names}) < len(names) or not all(map(is_file_name, names)):
        return First(SceneChoice(), start=start)
    settings: dict[str, Any] = {"light": light, "luminance": request.luminance}
    if lamps:
        settings |= {"light": lamps[0].name, "files": {lamps[0].name: shas[lamps[0].name]}}
    return First(own, known, settings, start)


def _files_of(name):
    """Return the paths of a scene's files."""
    path = Path(name)
    if name in CHARTS:
        return ()
    if path.is_dir():
        return find_bands(path).files
    return (path, *data_files(path)) if path.suffix.lower() == ".hdr" else (path,)


def _options(request):
    """Return the options of the scene as texts."""
    found = {}
    for name in OPTIONS:
        own = NAMED.get(name, name)
        if request.is_given(own) and request.is_changed(own):
            value = getattr(request, own)
            is_list = own == "band"
            found[name] = ",".join(value) if is_list else format_option(name, value)
    return found


def _describe(request, scenes):
    """Return the command line's words for the scenes, the device and the capture."""
    scene = list(request.scene)
    given = {name: text for name, text in _options(request).items() if name != "bands"}
    for name in ("size", "light", "luminance"):
        if getattr(request, name) is not None:
            given[name] = format_option(name, getattr(request, name))
    given |= {name: _text(getattr(request, name)) for name in MOVES if request.is_given(name)}
    pairs = [*given.items(), *(("band", text) for text in request.band)]
    for name, text in pairs:
        scene += _words(f"--{name.replace('_', '-')}", text)
    device = request.device if request.is_given("device") else ""
    unwritten = [f"--{name}" for name in ("actor", "capture") if request.is_given(name)]
    return Start(tuple(scene), device, not scenes.is_still, tuple(unwritten))


def _text(value):
    """Return the text of a value; "" of a flag."""
    if isinstance(value, tuple):
        return ",".join(map(repr, value))
    return "" if value is True else repr(value) if isinstance(value, float) else str(value)


def _words(flag, text):
    """Return an option; a text that looks like one itself is joined to its flag."""
    if not text:
        return [flag]
    return [f"{flag}={text}"] if text.startswith("-") else [flag, text]
