"""A scene with depth as a camera sees it from another place: near things move more than far ones."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from gpusim.domain.account import Bound
from gpusim.domain.camera import Camera
from gpusim.domain.content import Basis, Content, Cube, Materials
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.scene import Layer, Scene, checked_scene

JUMP = 0.5  # [sample] difference of displacement between neighbours that are different surfaces
MOST_SHEETS = 6  # surfaces that a depth map is cut into
STEPS, SETTLED = 60, 1e-4  # of the search for a sample's place, and its precision [sample]
LOST = 0.01  # [sample] error of a place that counts as not found: its light is a guess
LEAST = 0.01  # of a picture's mean brightness: errors in darker places are relative to it
BORDERS = {"zero": "grid-constant", "edge": "nearest", "reflect": "reflect", "scene": "nearest"}


class Surface(NamedTuple):
    """A surface. known: share of its light that is from the scene, 0 .. 1; the rest is continued."""

    content: Content
    alpha: np.ndarray
    depth: np.ndarray
    known: np.ndarray


@dataclass(frozen=True, eq=False)
class Moved:
    """A scene from another place.

    Attributes:
        scene: The scene, with a layer for each surface.
        guessed: Coverage of each sample by light that the scene does not have: surfaces that were
            hidden, for which their own surroundings are taken, and steep ones, (rows, cols).
        error: Largest distance of a sample that is not guessed from its place [sample].
        between: Error of light and coverage between samples, relative to the brightness of the
            picture there, but at least LEAST of its mean, (rows, cols).
    """

    scene: Scene
    guessed: np.ndarray
    error: float
    between: np.ndarray


def samples_per_radian(scene: Scene, camera: Camera) -> float:
    """Return the distance of the picture's plane from the pupil [sample]: a slope times it is a place.

    Args:
        scene: The scene.
        camera: The camera.

    Returns:
        The distance, from the scene's field of view if it has one.
    """
    if scene.fov:
        return scene.samples[1] / (2 * np.tan(scene.fov / 2))
    pitch = camera.sensor.pixel_pitch / scene.samples_per_pixel
    return camera.optics.image_distance / pitch


def move_camera(scene: Scene, camera: Camera, place: tuple[float, float, float]) -> Scene:
    """Return a scene with depth as the camera sees it from another place.

    Args:
        scene: The scene, with depth. Its view is kept.
        camera: The camera, for its focal length if the scene has no field of view.
        place: Movement of the camera down, right and ahead [m].

    Returns:
        A scene with a layer for each surface.

    Raises:
        BadData: The scene has no depth.
        OutOfRange: The camera moves past a surface.
    """
    return see_from(scene, camera, place).scene


def see_from(scene: Scene, camera: Camera, place: tuple[float, float, float]) -> Moved:
    """Return a scene from another place, and the places whose light is guessed, see `move_camera`.

    A sample at the place p of the picture and the distance Z moves to (p Z - f (down, right)) /
    (Z - ahead). Where a map of distances jumps, it is cut into surfaces, and each goes on behind the
    nearer ones with the light and the distance of its nearest sample.

    Args:
        scene: As for `move_camera`.
        camera: As for `move_camera`.
        place: As for `move_camera`.

    Returns:
        The scene and the guess.
    """
    checked_scene(scene)
    move = np.asarray(place, np.float64)
    if move.shape != (3,) or not np.isfinite(move).all():
        raise BadData(f"place of the camera = {place!r}: wanted three finite numbers [m]")
    if scene.depth is None:
        raise BadData(
            f"{scene.name}: a camera that changes its place needs the scene's depth; pan or turn it, or give "
            "the scene distances"
        )
    nearest = min(
        float(np.min(one)) for one in (scene.depth, *(layer.depth for layer in scene.layers))
    )
    if not move[2] < nearest:
        raise OutOfRange(
            "movement of the camera", f"{move[2]:g} m ahead", f"less than {nearest:g} m"
        )
    focal = samples_per_radian(scene, camera)
    if not move.any():
        nothing = np.zeros(scene.content.shape, np.float32)
        return Moved(scene, nothing, 0.0, nothing)
    mode = BORDERS[scene.border]
    sheets = list_surfaces(scene, focal, move)
    layers, parts, worst, through = [], [], 0.0, np.ones(scene.content.shape)
    guessed = np.zeros(scene.content.shape)
    for sheet in sheets:
        places, depth, error = find_places(sheet.depth, focal, move)
        lost = error > LOST
        worst = max(worst, float(error[~lost].max(initial=0)))
        alpha = np.clip(
            _at(sheet.alpha, places, 1, mode if sheet is not sheets[-1] else "nearest"), 0, 1
        )
        known = np.where(lost, 0, np.clip(_at(sheet.known, places, 1, "nearest"), 0, 1))
        guessed += through * alpha * (1 - known)
        through = through * (1 - alpha)
        planes = np.stack([_at(one, places, 3, mode) for one in sheet.content.planes])
        if sheet.content.planes.min() >= 0:
            np.maximum(planes, 0, out=planes)  # splines ring next to steps
        content = sheet.content.with_planes(planes.astype(np.float32))
        layers.append(Layer(content, alpha.astype(np.float32), depth))
        before, after = (one.entry_spectra.sum(axis=1) for one in (sheet.content, content))
        bright = np.tensordot(after, content.planes, 1)
        finer = _at(np.tensordot(before, sheet.content.planes, 1), places, 5, mode)
        if content.planes.min() >= 0:
            np.maximum(finer, 0, out=finer)
        parts.append((bright, np.abs(bright - finer), alpha, _between(sheet.alpha, places)))
    *front, back = layers
    moved = replace(
        scene,
        content=back.content,
        depth=np.asarray(back.depth),
        layers=tuple(layer for layer in order_layers(front, back.depth) if layer.alpha.any()),
    )
    return Moved(moved, guessed.astype(np.float32), worst, _compose_errors(parts))


def _between(alpha, places):
    """Return the error of a coverage that is linear between its samples.

    An edge that covers f of a sample is off by up to f (1 - f) and by the fraction of a sample by
    which it moves, and by half of a second difference, which is less where a coverage changes slowly.
    """
    alpha = np.asarray(alpha, np.float64)
    second = [
        np.abs(scipy.ndimage.convolve1d(alpha, [1, -2, 1], axis=axis, mode="nearest"))
        for axis in (0, 1)
    ]
    second = scipy.ndimage.maximum_filter(np.maximum(*second), 3, mode="nearest")
    error = np.minimum(alpha * (1 - alpha), second / 2)
    if not error.any():
        return error
    error = _at(scipy.ndimage.maximum_filter(error, 3, mode="nearest"), places, 1, "nearest")
    return np.minimum(error, np.abs(places - np.rint(places)).sum(axis=0))


def _compose_errors(parts):
    """Return the error of layers over the brightness of their picture. parts: of layers, nearest first.

    Each is the brightness, its error, the coverage and its error, (rows, cols).
    """
    *front, (light, error, _, _) = parts
    for own, wrong, alpha, uneven in reversed(front):
        error = alpha * wrong + (1 - alpha) * error + uneven * np.abs(own - light)
        light = alpha * own + (1 - alpha) * light
    least = max(LEAST * float(light.mean()), np.finfo(np.float32).tiny)
    return (error / np.maximum(light, least)).astype(np.float32)


def between_error(between: np.ndarray, mean: np.ndarray, sigma: np.ndarray) -> Bound:
    """Return the error of light that is interpolated between samples: see `Moved.between`.

    Args:
        between: Relative error of each pixel.
        mean: Mean electrons, shape (..., rows, cols).
        sigma: Noise of each pixel [e-].
    """
    return _bound(between * np.maximum(mean, LEAST * mean.mean()), mean, sigma)


def guess_error(guessed: np.ndarray, mean: np.ndarray, sigma: np.ndarray) -> Bound:
    """Return the error of guessed light, if hidden surfaces are no brighter than the brightest pixel.

    Args:
        guessed: Coverage of each pixel by a guess.
        mean: Mean electrons, shape (..., rows, cols).
        sigma: Noise of each pixel [e-].
    """
    if not guessed.any():
        return Bound()
    return _bound(guessed * np.maximum(mean, mean.max() - mean), mean, sigma)


def _bound(error, mean, sigma):
    """Return the bound of an error of mean electrons."""
    power = float(np.mean(np.square(mean, dtype=np.float64)))
    rms = float(np.sqrt(np.mean(np.square(error, dtype=np.float64)) / power)) if power else 0.0
    sigmas = error / np.maximum(sigma, 1e-9)
    return Bound(rms, float(np.quantile(sigmas, 0.999)), float(sigmas.max()))


def list_surfaces(scene: Scene, focal: float, move: np.ndarray) -> list[Surface]:
    """Return the layers of a scene and the surfaces of its own content, nearest first.

    Args:
        scene: The scene, with depth.
        focal: Distance of the picture's plane from the pupil [sample].
        move: Largest movement down, right and ahead [m]: it says which jumps of the distance show.

    Returns:
        The surfaces; the last one covers everything.
    """
    layers = [
        Surface(
            mix_entries(layer.content),
            np.asarray(layer.alpha, np.float32),
            np.broadcast_to(np.asarray(layer.depth, np.float64), scene.content.shape),
            np.ones(scene.content.shape, np.float32),
        )
        for layer in scene.layers
    ]
    return layers + cut_surfaces(scene, focal, move)


def cut_surfaces(scene, focal, move) -> list[Surface]:
    """Return the surfaces of a scene's own content, nearest first; the last one covers everything."""
    content, depth = mix_entries(scene.content), np.asarray(scene.depth, np.float64)
    reach = np.hypot(*(np.array(depth.shape) / 2))
    slope = focal * np.hypot(move[0], move[1]) + abs(move[2]) * reach  # [sample m]
    limits = _limits(depth, slope)
    sheets, nearer = [], 0.0
    for limit in [*limits, np.inf]:
        own = (depth > nearer) & (depth <= limit)
        index = None
        if not own.all():
            index = scipy.ndimage.distance_transform_edt(
                ~own, return_distances=False, return_indices=True
            )
        alpha = (depth <= limit).astype(np.float32)
        if index is None:
            sheets.append(Surface(content, alpha, depth, np.ones(depth.shape, np.float32)))
        else:
            filled = content.with_planes(content.planes[:, index[0], index[1]])
            sheets.append(Surface(filled, alpha, depth[index[0], index[1]], own.astype(np.float32)))
        nearer = limit
    return sheets


def _limits(depth, slope) -> list[float]:
    """Return the distances that separate surfaces, nearest first: few that cut most jumps of a map."""
    near, far = [], []
    for axis in (0, 1):
        one, other = (
            np.moveaxis(depth, axis, 0)[:-1].ravel(),
            np.moveaxis(depth, axis, 0)[1:].ravel(),
        )
        jumps = np.abs(slope / one - slope / other) > JUMP
        near.append(np.minimum(one, other)[jumps])
        far.append(np.maximum(one, other)[jumps])
    low, high = np.concatenate(near), np.concatenate(far)
    found: list[float] = []
    while len(low) and len(found) < MOST_SHEETS - 1:
        # the distance that lies within the most jumps
        ends = np.concatenate([low, high])
        order = np.argsort(ends, kind="stable")
        open_ = np.cumsum(np.where(order < len(low), 1, -1))
        best = int(np.argmax(open_))
        limit = float(np.sqrt(ends[order[best]] * ends[order[best + 1]]))
        found.append(limit)
        cut = (low <= limit) & (high > limit)
        low, high = low[~cut], high[~cut]
    return sorted(found)


def find_places(depth, focal, move, vergence=0.0):
    """Return where samples of the moved picture are in the scene, their new distance, and the error of the search.

    places: rows and columns (2, rows, cols) [index]. vergence: reciprocal of the distance of things that
    stay at their places while the camera moves across the view [1/m].
    """
    shape = depth.shape
    middle = (np.array(shape) - 1) / 2
    grid = np.indices(shape, np.float64) - middle[:, None, None]
    distance, places, error = depth, grid, np.zeros(shape)
    is_flat = np.ptp(depth) == 0
    for _ in range(1 if is_flat else STEPS):
        shift = focal * move[:2, None, None] * (1 / distance - vergence)
        found = grid * (1 - move[2] / distance) + shift
        error = np.abs(found - places).max(axis=0)
        places = found
        if error.max() < SETTLED:
            break
        if not is_flat:
            distance = _at(depth, places + middle[:, None, None], 1, "nearest")
    return places + middle[:, None, None], distance - move[2], error * (not is_flat)


def _at(values, places, order, mode):
    """Return an array interpolated at places."""
    return scipy.ndimage.map_coordinates(
        np.asarray(values, np.float64), places, order=order, mode=mode
    )


def order_layers(layers, behind):
    """Return layers whose distances do not overlap, as a scene wants them."""
    farthest, found = float(np.min(behind)), []
    for layer in reversed(layers):
        depth = np.asarray(layer.depth)
        covered = layer.alpha > 0
        # places that a layer does not cover have no distance of their own
        low, high = (
            (float(depth[covered].min()), float(depth[covered].max()))
            if covered.any()
            else (farthest, farthest)
        )
        found.insert(0, replace(layer, depth=np.clip(depth, low, high)))
        farthest = low
    return found


def mix_entries(content: Content) -> Content:
    """Return content on the host that interpolates: a Basis or a Cube."""
    content = content.on_host()
    if isinstance(content, Basis | Cube):
        return content
    spectra = content.entry_spectra
    if not isinstance(content, Materials) or len(spectra) > spectra.shape[1]:
        return Cube(content.wavelengths, content.bands_at(slice(None)).astype(np.float32))
    planes = [
        np.where(content.ids == k, content.shading, np.float32(0)) for k in range(len(spectra))
    ]
    return Basis(content.wavelengths, np.stack(planes), spectra)
