"""Scenes of a client that are kept open, so that the page returns to them at once."""

from dataclasses import dataclass, replace
from threading import Lock
from weakref import WeakValueDictionary

from gpusim.apps.preview.scene_choice import MOST_PIXELS, SceneChoice
from gpusim.apps.preview.uploads import Uploads
from gpusim.domain.errors import BadFile, GpusimError
from gpusim.domain.memory import limit_memory
from gpusim.domain.scene import Scene
from gpusim.io.scene.scenes import open_scene

MOST_MEMORY = 2**31  # [byte] that a file or a chart may need while it is read
MOST_OPEN, MOST_HELD = 8, 2**29  # open scenes, and their content [byte]

# charts that a client holds, shared by all clients; keys of their choices -> scenes
CHARTS: WeakValueDictionary[str, Scene] = WeakValueDictionary()


@dataclass(frozen=True)
class Recent:
    """A scene that was shown. picture: a small one of it, as a data address."""

    choice: SceneChoice
    picture: str


class Shelf:
    """Opened scenes of a client.

    Attributes:
        uploads: The files of the client.
        recent: The scenes that were shown, by the keys of their choices, the first one first.
    """

    def __init__(self, uploads: Uploads | None = None):
        self.uploads = uploads or Uploads()
        self.recent: dict[str, Recent] = {}
        self._lock = Lock()  # pages open scenes in other threads than the device's
        self._open: dict[str, Scene] = {}  # by the key of the choice, the last used one last

    def open(self, choice: SceneChoice) -> Scene:
        """Return the scene of a choice, in its own light. Raises as `open_scene` does, and Wanted."""
        with self._lock:
            scene = self._open.get(choice.key)
        if scene is None:
            scene = self._read(choice)
        self.put(choice, scene)
        return scene

    def put(self, choice: SceneChoice, scene: Scene):
        """Keep an open scene, and leave the ones that were used longest ago."""
        with self._lock:
            self._open.pop(choice.key, None)
            self._open[choice.key] = scene
            held = sum(one.content.nbytes for one in self._open.values())
            for key in list(self._open)[:-1]:
                if len(self._open) <= MOST_OPEN and held <= MOST_HELD:
                    break
                held -= self._open.pop(key).content.nbytes

    def forget_scenes(self) -> None:
        """Free the open scenes. They are opened again when they are shown."""
        with self._lock:
            self._open.clear()

    def _read(self, choice):
        arguments = choice.arguments()
        if not choice.files:
            scene = CHARTS.get(choice.key)
            if scene is None:
                with limit_memory(MOST_MEMORY):
                    scene = CHARTS[choice.key] = open_scene(choice.name, **arguments)
            return scene
        if choice.name in choice.files and len(choice.files) == 1:
            path = self.uploads.path(choice.name, choice.files[choice.name])
        else:
            path = self.uploads.together(choice.files)
            path = path / choice.name if choice.name in choice.files else path
        try:
            if self.uploads.is_known(choice.files):
                return self._open_path(path, choice, arguments)
            with limit_memory(MOST_MEMORY):
                scene = self._open_path(path, choice, arguments)
        except GpusimError as error:
            raise self.uploads.shorten(error) from error
        rows, cols = scene.shape
        if rows * cols > MOST_PIXELS:
            raise BadFile(
                choice.name,
                f"{cols} x {rows} pixels; allowed are {MOST_PIXELS / 1e6:.0f} million; make it smaller",
            )
        return scene

    def _open_path(self, path, choice, arguments):
        """Return the scene of a path; a size is of the view if it is a panorama."""
        if "size" not in choice.takes:
            arguments = {name: value for name, value in arguments.items() if name != "size"}
        scene = open_scene(path, **arguments)
        return scene if choice.name in choice.files else replace(scene, name=choice.name)
