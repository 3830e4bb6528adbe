"""`gpusim simulate --views`: pictures through the cells of a pupil, and raw frames behind lenslets."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gpusim.domain.account import STATUS
from gpusim.domain.errors import BadData, BadFile

if TYPE_CHECKING:  # the command line starts without them
    from gpusim.captures.lenslet_frames import LensletExposure
    from gpusim.cli.simulate import SimulateRequest
    from gpusim.domain.scene import Scene
    from gpusim.domain.view_images import ViewImages
    from gpusim.pipeline.simulator import Simulator

VIEWS, RAW = ".npz", ".npy"


def simulate_views(request: "SimulateRequest") -> int:
    """Write the views of a scene, and the raw frame of a camera with lenslets.

    Args:
        request: Options of the command, with the numbers of views.

    Returns:
        The exit status: 1 if a view does not meet the tolerance, 3 if that cannot be judged.

    Raises:
        GpusimError: An option or a file is wrong.
    """
    from gpusim.captures.lenslet_frames import expose_lenslets
    from gpusim.captures.views import expose_views
    from gpusim.io.atomic import atomic_path, check_output
    from gpusim.io.frame.view_images import save_views

    _check(request)
    assert request.views is not None
    for path in request.out:
        check_output(path)
    camera, scene = request.open_camera(), request.open_scene()
    has_lenslets = camera.sensor.lenslets is not None
    if not has_lenslets and any(Path(path).suffix == RAW for path in request.out):
        raise BadData(
            f"camera {camera.name}: without lenslets there is no raw frame of views; write {VIEWS}, or set [sensor] "
            "lenslets"
        )
    wants_views = any(Path(path).suffix == VIEWS for path in request.out)
    if has_lenslets and wants_views:
        _check_decodable(camera)
    simulator = request.open_simulator(camera)
    if not has_lenslets:
        for name in ("exposure", "seed", "frame"):
            request.refuse(name, "views have no noise without lenslets")
    request.refuse_unread("simulate --views")
    if not has_lenslets:
        views = expose_views(simulator, scene, request.views)
        pictures = views.pictures() if wants_views else None
        print(views)
        print(
            f"  added, they differ from the picture of the whole lens by {views.difference:.2g} rms"
        )
    else:
        exposure = expose_lenslets(simulator, scene, request.views)
        raw = exposure.raw(seed=request.seed, first=request.frame)
        raw = np.asarray(simulator.device.numpy(raw))
        views = exposure.views
        print(exposure)
        pictures = _decode(simulator, scene, exposure, raw, request.views) if wants_views else None
    for path in request.out:
        if pictures is not None and Path(path).suffix == VIEWS:
            save_views(pictures, path)
        else:
            with atomic_path(path) as temporary, open(temporary, "wb") as file:
                np.save(file, raw)
    return _print_verdict(views)


def _print_verdict(views):
    """Print the cells' errors, and return the exit status that `gpusim plan` has for them."""
    worst = views.account.total.rms
    print(f"  predicted error of a view: {worst:.2g} rms at most")
    verdicts = [made.verdict for made in views.plans.values() if made.verdict is not None]
    states = [verdict.state for verdict in verdicts]
    for state in ("not met", "not judged"):
        if state in states:
            print(
                f"  tolerance: {verdicts[states.index(state)].shown} in {states.count(state)} views"
            )
            return STATUS[state]
    return 0


def _check_decodable(camera):
    """Raise BadData for sensors whose raw frames behind lenslets are not decoded."""
    sensor = camera.sensor
    wrong = "stacked" if sensor.stacked else "binning" if sensor.binning != (1, 1) else ""
    if wrong:
        raise BadData(
            f"sensor.{wrong}: raw frames of such pixels behind lenslets are not decoded to views; write {RAW} only"
        )


def _check(request):
    """Raise for outputs and options that views do not have."""
    for path in request.out:
        if Path(path).suffix not in (VIEWS, RAW):
            raise BadFile(
                path,
                f"views are written as {VIEWS} (for gpusim refocus), raw frames behind lenslets as {RAW}",
            )
    if not request.out:
        raise BadData(f"--views: no file is written; add -o OUT{VIEWS}")
    for name in ("frames", "capture", "verify", "bits", "quality", "report", "verbose"):
        request.refuse(name, "--views makes no pictures with a report")
    request.refuse_picture("--views does not develop")


def _decode(
    simulator: "Simulator",
    scene: "Scene",
    exposure: "LensletExposure",
    raw: np.ndarray,
    views: tuple[int, int],
) -> "ViewImages":
    """Return a raw frame behind lenslets as views, by the grid that a white frame of the camera shows."""
    from gpusim.captures.decoding import calibrate_lenslets, decode_lenslets
    from gpusim.captures.lenslet_frames import expose_lenslets
    from gpusim.captures.views import show_views
    from gpusim.data.charts import chart

    sensor = exposure.camera.sensor
    flat = chart("flat", size=scene.shape[::-1])
    white = np.asarray(expose_lenslets(simulator, flat, views, exposure.exposure_time))
    grid = calibrate_lenslets(white, sensor.cfa_indices.shape)
    light = (raw - float(sensor.dark_level)) / sensor.gain_dn_per_electron
    values = decode_lenslets(light, grid, white, views, sensor.cfa_indices)
    if grid.layout == "hexagonal":
        spacing = grid.pitch * 3**0.5 / 2
    else:
        spacing = grid.pitch
    plan, areas = next(iter(exposure.views.plans.values())), exposure.views.areas
    neutral = np.ones(len(sensor.channels)) if plan.white_rate is None else plan.white_rate
    return show_views(values * neutral, simulator.camera, plan, areas, pitch=spacing)
