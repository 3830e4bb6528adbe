"""Drafts of half as many rows and columns: while a slider moves, they take a quarter of the time."""

from dataclasses import replace

import numpy as np

from gpusim.domain.camera import Camera
from gpusim.domain.content import Content
from gpusim.domain.scene import PLANE, Scene
from gpusim.optics.geometry import DistortionGrid
from gpusim.pipeline.cache import same
from gpusim.pipeline.loop import Loop
from gpusim.pipeline.planning import draft_key
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.draft import sketch_plan

LEAST = 64  # samples along a side


def halve_scene(scene: Scene) -> Scene | None:
    """Return a scene of half as many rows and columns, of means of 2 x 2 samples; None if that is not possible.

    Materials, which are numbers, are those of every other sample.

    Args:
        scene: The scene. Its samples are pixels, in host memory, without distance, layers or view.
    """
    if (
        scene.samples_per_pixel != 1
        or scene.margin
        or scene.depth is not None
        or scene.layers
        or scene.projection != PLANE
        or not scene.view.is_plain
        or not scene.content.is_seen
        or min(scene.content.shape) < LEAST
    ):
        return None
    return replace(scene, content=_halve(scene.content), labels={})


def _halve(content: Content) -> Content:
    rows, cols = (n // 2 * 2 for n in content.shape)
    if content.labels is not None:
        return content.with_samples(lambda array: array[..., :rows:2, :cols:2].copy())

    def mean(array):
        parts = [array[..., y:rows:2, x:cols:2].astype(np.float32) for y in (0, 1) for x in (0, 1)]
        found = sum(parts[1:], parts[0]) / 4
        return (found.round() if array.dtype.kind in "iu" else found).astype(array.dtype)

    return content.with_samples(mean)


def coarsen(camera: Camera) -> Camera:
    """Return the camera with pixels twice as large, for a scene that was halved."""
    sensor = camera.sensor
    return replace(camera, sensor=replace(sensor, pixel_pitch=2 * sensor.pixel_pitch))


class HalfLoop:
    """A loop of a halved scene, whose pixels have the light of one pixel of the whole one.

    Its plan is made from that of the whole scene's loop. Nothing is planned.
    """

    def __init__(self):
        self._scene: tuple[Scene | None, Scene | None] = None, None  # whole and halved
        self._of: tuple = (
            None,
            None,
        )  # plan of the whole scene that the loop begins with, and its camera
        self._loop: Loop | None = None

    def update(self, whole: Loop, camera: Camera, scene: Scene) -> Loop | None:
        """Return the loop with a camera; None if there is none for this scene, or before its first plan.

        Args:
            whole: Loop of the whole scene.
            camera: The camera, for the whole scene.
            scene: The whole scene.

        Raises:
            GpusimError: As `Loop.update` and `Loop.expose` do.
        """
        plan, by = whole.before.plan or self._of
        if plan is None or plan.scene is not scene:  # not yet planned
            plan, by = self._of
        if (
            plan is None
            or plan.scene is not scene
            or plan.find(DistortionGrid) is not None
            or not same(draft_key(by), draft_key(camera))  # it would have to be planned
        ):
            return None
        if self._scene[0] is not scene:
            self._scene = scene, halve_scene(scene)
        half = self._scene[1]
        if half is None:
            return None
        if self._loop is None or self._of[0] is not plan or self._loop.scene is not half:
            begun = coarsen(by)
            rough = sketch_plan(plan, begun, half)
            if rough is None:
                return None
            if self._loop is None or self._loop.scene is not half:
                self._loop = Simulator(begun, device=whole.simulator.device).loop(half)
                self._loop.update(brightness=0.25)  # pixels have four times the area
            self._loop.update(camera=begun)
            self._loop.restart(rough, begun)
            self._of = plan, by
        self._loop.update(camera=coarsen(camera), drafts=True)
        self._loop.expose()
        return self._loop
