"""Pictures through the cells of a pupil, as lenslets or an array of cameras divide them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import pi, prod
from typing import Any

import numpy as np

from gpusim.backends.tape import Tape, recording
from gpusim.color.rendering import choose_colors, planes_of
from gpusim.domain.account import UNKNOWN, Account
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, DoesNotFit, OutOfRange
from gpusim.domain.light_field import LightField
from gpusim.domain.mask import LEAST_LIGHT, pupil_cells
from gpusim.domain.scene import Scene, View, checked_scene
from gpusim.domain.short_repr import shorten_repr
from gpusim.domain.view_images import ViewImages
from gpusim.optics.cells import relative_difference
from gpusim.pipeline.cache import Cache
from gpusim.pipeline.simulator import Simulator
from gpusim.pipeline.step import Rate, Values
from gpusim.planner.plan import Plan

NODES, DISTANCES = (
    7,
    7,
)  # wavelengths, and distances of a scene, for which a difference is predicted
SAME_RADIUS = 0.01  # part by which a light field's radius may differ from the entrance pupil's


@dataclass(frozen=True, eq=False)
class Views:
    """Light of a scene through each cell of a lens's pupil, at the sensor.

    `np.asarray` returns the rates with an axis of channels, (T, S, C, rows, cols).

    Attributes:
        rates: Electrons per second of every pixel in each channel, as if it had all filters, a device array
            (T, S C, rows, cols), the channels of a cell one after the other [e-/s]. Each cell diffracts.
        shares: Light of each cell over the light of the whole lens (T, S) [1].
        plans: Plans of the cells by (row, column).
        simulator: The simulator of the whole lens.
        scene: The scene, or the light field.
    """

    rates: Any
    shares: np.ndarray
    plans: dict[tuple[int, int], Plan]
    simulator: Simulator
    scene: Scene | LightField

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        found = np.array(self.simulator.device.numpy(self.rates), dtype, copy=copy)
        return found.reshape(*self.shares.shape, -1, *found.shape[2:])

    def __repr__(self):
        return shorten_repr(
            f"Views({self.scene.name} by {self.simulator.camera.name}, rates {tuple(self.rates.shape)} on "
            f"{self.simulator.device.name})"
        )

    @property
    def total(self) -> np.ndarray:
        """Sum over the cells, (C, rows, cols) [e-/s]: the picture of a lens whose cells do not interfere."""
        return np.asarray(self).sum(axis=(0, 1), dtype=np.float64)

    def pictures(self) -> ViewImages:
        """Return the views as linear pictures in the display's colours, all of one brightness, white 1.

        White is a perfect white diffuser in the scene's light; if the light is not known, the brightest value.

        Returns:
            The pictures, for example for `gpusim.refocus`.
        """
        (at, made), areas = next(iter(self.plans.items())), self.areas
        even = np.divide(1, areas, out=np.zeros(areas.shape), where=areas > LEAST_LIGHT)
        values = np.moveaxis(np.asarray(self), 2, -1) * even[:, :, None, None, None]
        rates = made.white_rate
        white = None if rates is None else rates / areas[at]
        return show_views(values, self.simulator.camera, made, areas, white)

    @property
    def areas(self) -> np.ndarray:
        """Share of each cell's square through which light passes, (T, S) [1]."""
        area = self.simulator.camera.optics.pupil.area * pi / 4  # of the square around the pupil
        return np.minimum(self.shares * self.shares.size * area, 1.0)

    @property
    def account(self) -> Account:
        """Errors of the rates: of each cause the largest of all cells, relative to the cell's own picture."""
        found: dict = {}
        for made in self.plans.values():
            for name, bound in made.account.bounds.items():
                found[name] = bound.largest(found.get(name, bound))
        seconds = next(iter(self.plans.values())).account.seconds
        if isinstance(self.scene, LightField):
            found["blur by depth within the cells of a light field"] = UNKNOWN
        return Account(found, seconds)

    @cached_property
    def difference(self) -> float:
        """Predicted RMS difference of `total` from the whole lens's picture, by diffraction at the cells, over its RMS.

        On the axis, by the scene's own frequencies and distances.
        """
        return predict_difference(
            next(iter(self.plans.values())), self.simulator.camera, self.shares.shape
        )


class _Computing(Cache):
    """Keeps nothing: each value is computed, on the tape of the capture."""

    def run(self, name, function, args, kwargs, numbers) -> Any:
        """Return `function(*args, **kwargs, **numbers)`."""
        return function(*args, **kwargs, **numbers)


class ViewCapture:
    """Takes `Views` of a scene frame after frame. Plans and tables of the cells are made once.

    Args:
        simulator: The simulator.
        scene: A scene, or a light field with as many views as there are cells.
        views: Rows and columns of cells (T, S); None: the light field's, or 9 x 9.

    Raises:
        BadData: The lens has no pupil that can be cut, or the light field is of another lens.
        DoesNotFit: The views need more memory than the device has.
        OutOfRange: There are fewer than one or more than 256 cells along an axis.
    """

    def __init__(
        self,
        simulator: Simulator,
        scene: Scene | LightField,
        views: tuple[int, int] | None = None,
    ):
        self.simulator, self.scene = simulator, checked_source(scene)
        self.shape = _choose_shape(scene, views)
        camera, device = simulator.camera, simulator.device
        self.shares, cells = divide_pupil(camera, self.shape)
        if isinstance(scene, LightField):
            check_radius(camera, scene)
        self._cells = {
            at: simulator.apart(
                camera.with_(optics=replace(camera.optics, pupil=pupil)), Cache()
            )  # a cache keeps one table of a name
            for at, pupil in cells.items()
        }
        some = simulator.plan(self._scene_of(next(iter(cells))))
        channels, size = len(some.weights), prod(some.scene.shape)
        needed = 2 * 4 * prod(self.shape) * channels * size  # each view, and their stack
        if needed > device.memory:
            raise DoesNotFit(
                f"{self.shape[0]} x {self.shape[1]} views", needed, device.memory, device.name
            )
        self.plans = {at: own.plan(self._scene_of(at)) for at, own in self._cells.items()}
        self._tape = Tape()
        self._taken_of: Scene | LightField | None = None
        self._rates: Any = None

    def __repr__(self):
        rows, cols = self.shape
        return shorten_repr(
            f"ViewCapture({self.scene.name} by {self.simulator.camera.name}, {rows} x {cols} cells)"
        )

    def _scene_of(self, at: tuple[int, int]) -> Scene:
        """Return the scene that a cell sees."""
        if not isinstance(self.scene, LightField):
            return self.scene
        return align_view(self.scene, at, self.simulator.camera)

    def __call__(self, scene: Scene | LightField | None = None) -> Views:
        """Return the views of the scene, or of another one of the same kind, on whose plans they are made.

        Args:
            scene: Another scene; None: the one of the last call.

        Returns:
            The views. The next call rewrites their rates.

        Raises:
            BadData: The plans do not serve that scene.
        """
        if scene is not None and scene is not self.scene:
            self._change(checked_source(scene))
        device = self.simulator.device
        if self._taken_of is self.scene and self._tape.is_replayable and self._tape.commands:
            self._tape.replay()
        else:
            with recording(self._tape):
                found = device.stack(list(self._rates_of_cells()))
                form = self.shape[0], self.shape[1] * found.shape[1], *found.shape[2:]
                self._rates = device.reshape(found, form)
            self._taken_of = self.scene
        return Views(self._rates, self.shares, self.plans, self.simulator, self.scene)

    def _change(self, scene):
        """Use another scene. Raises BadData if the plans do not serve it."""
        before, self.scene = self.scene, scene
        try:
            scenes = {at: self._scene_of(at) for at in self.plans}
            for at, made in self.plans.items():
                if why := made.misfit(scenes[at]):
                    raise BadData(f"views of {scene.name}: {why}; make another ViewCapture for it")
            self.plans = {
                at: replace(made, scene=scenes[at], content=scenes[at].content)
                for at, made in self.plans.items()
            }
        except BadData:
            self.scene = before
            raise

    def _rates_of_cells(self) -> Iterator[Any]:
        """Yield electrons per second (C, rows, cols) of each cell, zeros of those without light."""
        device, empty = self.simulator.device, None
        made = next(iter(self.plans.values()))
        shape = len(made.weights), *made.scene.shape
        for at in np.ndindex(self.shape):
            if at in self.plans:
                yield self._values_of(at)["electrons"]
            else:
                empty = device.array(np.zeros(shape, np.float32)) if empty is None else empty
                yield empty

    def _values_of(self, at: tuple[int, int]) -> Values:
        """Return the values of a cell's frame. Its tables are kept."""
        own, made = self._cells[at], self.plans[at]
        values = Values(dict.fromkeys(Rate, _Computing()) | {Rate.CAMERA: own.tables})
        values.use(own.imaging.steps(made))
        values.give(content=made.content, view=made.scene.view)
        values.set_numbers(exposure_time=1.0)
        return values


def expose_views(
    simulator: Simulator, scene: Scene | LightField, views: tuple[int, int] | None = None
) -> Views:
    """Return the light of a scene through each cell of the lens's pupil.

    A cell is a lens of its own: with the whole field, depth and wavefront, and with the diffraction of the cell. The
    light of a point over all cells is the whole lens's, but cells spread it more, see `Views.difference`. A light
    field's views have no more depth: blur within a cell is left out, and the plans say that it cannot be judged.

    Args:
        simulator: The simulator.
        scene: A scene, or a light field with as many views as there are cells.
        views: Rows and columns of cells (T, S); None: the light field's, or 9 x 9.

    Returns:
        The views.

    Raises:
        BadData: The lens has no pupil that can be cut, or the light field is of another lens.
        DoesNotFit: The views need more memory than the device has.
        OutOfRange: There are fewer than one or more than 256 cells along an axis.
    """
    return ViewCapture(simulator, scene, views)()


def show_views(
    values: np.ndarray,
    camera: Camera,
    plan: Plan,
    areas: np.ndarray,
    white: np.ndarray | None = None,
    pitch: float = 1.0,
) -> ViewImages:
    """Return views as linear pictures in the display's colours.

    Args:
        values: Light of every channel in each view, all of one brightness, in any unit, (T, S, rows, cols, C).
        camera: The camera.
        plan: Plan of the scene, for its light.
        areas: Share of each cell's square through which light passes, (T, S) [1].
        white: Value of white in each channel (C,); None: the largest value is 1.
        pitch: Distance of the values [pixel].
    """
    scene, letters = plan.scene, camera.sensor.channels
    light = scene.illuminant if scene.light_is_known else None
    colors = choose_colors(plan.white_rate, light, camera)
    planes = [letters.index(letter) for letter in planes_of(camera)]
    matrix = colors.at(1.0, 1.0, 1.0).linear_matrix
    linear = values[..., planes] @ matrix.T
    brightest = linear.max() if white is None else white[planes] @ matrix[1]
    return ViewImages.of(linear / max(brightest, 1e-300), camera, 1 / pitch, light=areas)


def predict_difference(plan: Plan, camera: Camera, shape: tuple[int, int]) -> float:
    """Return the predicted RMS difference between the added pictures of cells and the whole lens's picture.

    Args:
        plan: Plan of the scene, for its light in each channel.
        camera: The camera with the whole lens.
        shape: Rows and columns of cells (T, S).
    """
    scene, optics = plan.scene, camera.optics
    content, wavelengths = scene.content.on_host(), scene.wavelengths
    some = np.unique(np.linspace(0, len(wavelengths) - 1, NODES).round().astype(int))
    weights = plan.weights * content.mean_spectrum()
    nearest = np.abs(wavelengths[:, None] - wavelengths[some]).argmin(axis=1)
    spectra = np.stack([weights[:, nearest == n].sum(axis=1) for n in range(len(some))], axis=1)
    ratio, margin = scene.samples_per_pixel, scene.margin
    inner = slice(margin, -margin or None)
    distances: list[tuple[float | None, float]] = [(None, 1.0)]
    if scene.depth is not None:
        diopters = 1 / np.asarray(scene.depth, np.float64)[inner, inner].ravel()
        middles = np.quantile(diopters, (np.arange(DISTANCES) + 0.5) / DISTANCES)
        distances = [(1 / one, 1 / DISTANCES) for one in middles.tolist()]
    return relative_difference(
        optics,
        shape,
        content.weigh(plan.weights, (inner, inner)),
        spectra / spectra.sum(axis=1, keepdims=True),
        wavelengths[some],
        camera.sensor.pixel_pitch / ratio,
        tuple((np.array(camera.sensor.aperture) / camera.sensor.pixel_pitch * ratio).tolist()),
        distances,
    )


def checked_source(scene: Any) -> Scene | LightField:
    """Return a scene or a light field. Raises BadData for anything else."""
    return scene if isinstance(scene, LightField) else checked_scene(scene)


def _choose_shape(scene, views):
    if not isinstance(scene, LightField):
        return tuple(views or (9, 9))
    if views is not None and tuple(views) != scene.shape:
        raise BadData(
            f"views {views[0]} x {views[1]}: {scene.name} has {scene.shape[0]} x {scene.shape[1]}; leave them out"
        )
    return scene.shape


def divide_pupil(camera: Camera, shape: tuple[int, int]) -> tuple[np.ndarray, dict]:
    """Return the light of the cells of a camera's pupil, over all of it, and their pupils.

    Args:
        camera: The camera.
        shape: Rows and columns of cells (T, S).

    Returns:
        Shares (T, S) that add up to 1, and the pupils of the cells through which light passes, by (row, column).

    Raises:
        BadData: The lens is no pupil with a wavefront.
        OutOfRange: There are fewer than one or more than 256 cells along an axis.
    """
    optics, found, shares = camera.optics, {}, np.zeros(shape)
    for j, row in enumerate(pupil_cells(shape)):
        for i, cell in enumerate(row):
            try:
                own = optics.with_mask(cell).pupil
            except OutOfRange:
                continue  # no light passes
            shares[j, i] = own.area / optics.pupil.area
            if shares[j, i] >= LEAST_LIGHT:
                found[j, i] = own
    return shares / shares.sum(), found


def check_radius(camera: Camera, light_field: LightField) -> None:
    """Raise OutOfRange if a light field's radius is not the one of a camera's entrance pupil."""
    optics = camera.optics
    wanted = optics.focal_length / (2 * optics.f_number)
    if abs(light_field.radius / wanted - 1) > SAME_RADIUS:
        raise OutOfRange(
            f"radius of {light_field.name}",
            f"{light_field.radius:.6g} m",
            f"the entrance pupil's, {wanted:.6g} m; f-number "
            f"{optics.focal_length / (2 * light_field.radius):.4g} has this radius",
        )


def align_view(light_field: LightField, at: tuple[int, int], camera: Camera) -> Scene:
    """Return one view as the camera sees it, without depth, moved by the defocus of the light field's plane.

    A thing out of focus by the displacement d of the sensor is seen -d / (2 N (1 + |m|)) (x, y) from its place, (x, y)
    the middle of the cell in radii of the pupil.
    """
    scene, optics = light_field.view(*at), camera.optics
    scene = replace(scene, depth=None, layers=())
    if light_field.object_distance == optics.object_distance:
        return scene
    moved = optics.displacement(optics.diopters(light_field.object_distance))
    across = -moved / (2 * optics.working_f_number) / camera.sensor.pixel_pitch
    middle = (2 * np.array(at) + 1) / light_field.shape - 1
    shift = -across * middle  # the view looks at the place that is shown in the middle
    return replace(scene, view=scene.view.compose(View(tuple(shift.tolist()))))
