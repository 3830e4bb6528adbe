"""Training pictures: photographs as they are, and as cameras without noise see them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gpusim.apps.l3.train import training_camera
from gpusim.apps.network.layout import PIECE, TILE
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, BadFile, OutOfRange
from gpusim.io.scene.photo import lift, open_photo
from gpusim.io.scene.scenes import open_scene
from gpusim.pipeline.simulator import Simulator

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
TIME = 0.01  # [s] of exposure; it cancels


def find_pictures(places: Iterable[str | Path]) -> list[Path]:
    """Return picture files, and those of folders, in alphabetical order.

    Args:
        places: Files and folders.

    Raises:
        BadFile: There is no such place, or a folder has no pictures.
    """
    found: list[Path] = []
    for place in map(Path, places):
        if place.is_file():
            found.append(place)
            continue
        if not place.exists():
            raise BadFile(place, "no such file or folder; wanted pictures, or a folder of them")
        inside = sorted(
            path
            for path in place.iterdir()
            if path.suffix.lower() in SUFFIXES and path.name[:1] != "."
        )
        if not inside:
            raise BadFile(place, f"has no pictures; wanted files that end in {', '.join(SUFFIXES)}")
        found += inside
    return found


def read_tiles(
    paths: Sequence[Path],
    cameras: Sequence[Camera],
    device="auto",
    progress: Callable[[Sequence[Path]], Iterable[Path]] = iter,
) -> tuple[np.ndarray, list[Path]]:
    """Return squares of the pictures as training wants them.

    Each part of a picture serves as it is, sharp. The cameras and none of them take turns to see it
    too, without noise, through lens and filters, white balanced.

    Args:
        paths: Pictures.
        cameras: Cameras with red, green and blue filters.
        device: Name of the device, or a Device.
        progress: Function around the iteration over pictures.

    Returns:
        Square roots of linear colours, white 65535, shape (N, 3, TILE, TILE), uint16; and the
        pictures that were used. Grey ones, and ones smaller than PIECE, are left out.

    Raises:
        BadData: No picture is large enough.
        BadFile: A picture cannot be read.
        OutOfRange: A camera has no mosaic of three channels.
    """
    for camera in cameras:
        if not {*"RGB"} <= {*camera.sensor.channels}:
            allowed = "a camera with red, green and blue filters"
            raise OutOfRange("camera to train the network for", camera.name, allowed)
    simulators = [Simulator(training_camera(camera), device=device) for camera in cameras]
    loops: list = [None] * len(simulators)
    tiles, used, turn = [], [], 0
    for path in progress(paths):
        scene = open_scene(path)
        light, _, _ = open_photo(path).light()
        if light.shape[-1] != 3 or min(light.shape[:2]) < PIECE:
            continue
        used.append(path)
        for part in _pieces(np.moveaxis(light, -1, 0)):
            tiles += _tiles(part)
            turn += 1
            for number, simulator in enumerate(simulators):
                if turn % (len(simulators) + 1) != number:
                    continue
                piece = replace(scene, content=lift(part), border="reflect")
                if loops[number] is None:
                    loops[number] = simulator.loop(piece, TIME)
                loop = loops[number].update(scene=piece)
                electrons = simulator.device.numpy(loop.output("electrons"))
                rates = loop.plan.white_rate
                at = [simulator.camera.sensor.channels.index(letter) for letter in "RGB"]
                tiles += _tiles(electrons[at] / (rates[at] * TIME)[:, None, None])
    if not tiles:
        raise BadData(f"training pictures: none of {PIECE}x{PIECE} pixels or more in colour")
    return np.stack(tiles), used


def _pieces(light) -> Iterator[np.ndarray]:
    """Yield parts of PIECE x PIECE pixels that cover a picture (3, rows, cols)."""
    starts = [
        sorted({*range(0, size - PIECE + 1, PIECE), size - PIECE} if size >= PIECE else ())
        for size in light.shape[1:]
    ]
    for y in starts[0]:
        for x in starts[1]:
            yield np.ascontiguousarray(light[:, y : y + PIECE, x : x + PIECE])


def _tiles(light) -> list[np.ndarray]:
    """Return the tiles of a piece of linear colours."""
    roots = np.rint(65535 * np.sqrt(np.clip(light, 0, 1))).astype(np.uint16)
    return [
        roots[:, y : y + TILE, x : x + TILE]
        for y in range(0, PIECE, TILE)
        for x in range(0, PIECE, TILE)
    ]
