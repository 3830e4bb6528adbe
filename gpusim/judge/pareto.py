"""Time against true error of a scene for a range of plans: `gpusim bench pareto`.

The time is for the mean electrons, from scene samples on the device, after the first frame. For
comparison there are the implementations that a user of SciPy would write, in float32 with one
worker per core: each band with its own transfer function, and each channel with its mean one. The
float64 truth judges all of them.
"""

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import prod

import numpy as np
import scipy.fft

from gpusim.backends import Device
from gpusim.domain.account import Tolerance
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.domain.scene import Scene
from gpusim.judge.speeds import Speeds, frame_ms
from gpusim.judge.truth import require_truth, true_mean
from gpusim.judge.truth_light import MODES, centre_pads
from gpusim.optics.depth import DepthPlan
from gpusim.optics.geometry import DistortionGrid
from gpusim.optics.lenses import lens_of
from gpusim.pipeline.report import Error
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.choices import Blur, Falloff, Sampling

TOLERANCES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, None)
# stages that are not part of the mean electrons
LATER = "spectral.survey", "sensor.meter", "sensor.pattern", "sensor.chip"
REPEATS, SECONDS = 5, 2.0  # frames per point, at least, and time for more [s]


def pareto(camera: Camera, scene: Scene, device: Device) -> Iterator[dict]:
    """Yield one row per point.

    Args:
        camera: A camera whose blur is the same all over the field.
        scene: The scene.
        device: The device to time.

    Yields:
        Rows with point (its name), kind ("plan", "exact", "scipy" or "truth"), tolerance, ms,
        predicted_ms (of the whole frame; only for plans), the true errors rms, p999_sigma and
        max_sigma, predicted (the predicted rms), met, and words.

    Raises:
        BadData: The blur varies over the field.
        OutOfRange: The truth does not support this camera and scene.
        DoesNotFit: The truth needs more memory than there is.
    """
    require_truth(camera, scene)
    if not lens_of(camera).is_uniform:
        raise BadData(
            "bench --pareto: a blur that varies over the field; wanted one that is the same everywhere"
        )
    exact = Simulator(camera, device=device)
    seconds = exact.expose(scene).exposure_time
    start = time.perf_counter()
    truth = true_mean(Simulator, camera, scene, exact.plan(scene), seconds)
    spent = 1e3 * (time.perf_counter() - start)

    def row(point, kind, ms, mean, **more):
        error = Error.between(mean, truth, camera.sensor.read_sigma)
        return {
            "point": point,
            "kind": kind,
            "tolerance": None,
            "ms": ms,
            "predicted_ms": None,
            "rms": error.rms,
            "p999_sigma": error.p999_sigma,
            "max_sigma": error.max_sigma,
            "predicted": None,
            "met": None,
            "words": "",
        } | more

    speeds, seen = Speeds(device), set()
    for tolerance in TOLERANCES:
        wanted = None if tolerance is None else Tolerance(rms=tolerance)
        simulator = Simulator(camera, device=device, tolerance=wanted)
        ms, mean, plan = _frames(simulator, scene, seconds)
        words = "; ".join(
            text for stage, text in plan.models.items() if stage in ("optics.mosaic", "optics.blur")
        )
        words = f"{words or 'no blur'}, {plan.period[1]} x {plan.period[0]}"
        if words in seen:
            continue
        seen.add(words)
        name, kind = ("exact", "exact") if tolerance is None else (f"{tolerance:g}", "plan")
        yield row(
            name,
            kind,
            ms,
            mean,
            tolerance=tolerance,
            words=words,
            predicted=plan.account.total.rms,
            met=plan.verdict and plan.verdict.is_met,
            predicted_ms=sum(frame_ms(simulator, plan, speeds).values()),
        )
    for name, made in _naive(camera, scene, seconds).items():
        times: list[float] = []
        while len(times) < 3:
            start = time.perf_counter()
            mean = made()
            times.append(1e3 * (time.perf_counter() - start))
        yield row(name, "scipy", float(np.median(times)), mean, words="SciPy, float32")
    yield row("float64, each band", "truth", spent, truth, words="what all are judged by")


def _frames(simulator: Simulator, scene, seconds):
    """Return the median time [ms] for copies of a scene, the mean electrons, and the plan."""
    loop = simulator.loop(scene, seconds)
    times: list[float] = []
    stop = time.perf_counter() + SECONDS
    while len(times) < REPEATS + 1 or (time.perf_counter() < stop and len(times) < 50):
        copied = scene.content.with_samples(lambda array: np.array(array))
        loop.update(scene=replace(scene, content=copied))
        exposure = loop.exposure
        times.append(sum(ms for stage, ms in exposure.ms.items() if stage not in LATER))
    mean = np.array(simulator.device.numpy(exposure.mean))
    return float(np.median(times[1:])), mean, loop.plan


def _naive(camera, scene, seconds) -> dict[str, Callable[[], np.ndarray]]:
    """Return the functions that a user of SciPy would write, each for the mean electrons, by name.

    The result is empty for cameras that they cannot simulate: they need a mosaic of whole samples.
    """
    exact = Simulator(camera, device="numpy")
    plan = exact.plan(scene)
    gains = plan.find(Falloff)
    if (
        plan.find(Blur) is None
        or camera.sensor.stacked
        or any(plan.find(kind) for kind in (Sampling, DepthPlan, DistortionGrid))
    ):
        return {}
    cube = np.ascontiguousarray(
        exact.imaging.light(replace(plan, content=scene.content)), np.float32
    )
    bands = exact.imaging.tables.all_bands(plan)
    tables = np.asarray(
        _whole(bands, plan.period), np.complex64 if np.iscomplexobj(bands) else np.float32
    )
    weights = (plan.weights / plan.flat).astype(np.float32)
    mode = MODES[scene.border]
    pads = centre_pads(plan.period, cube.shape[1:])
    workers, margin = os.cpu_count(), scene.margin
    cfa = camera.sensor.cfa_indices

    def mosaic(channels):
        (top, _), (left, _) = pads
        rows, cols = scene.shape
        seen = channels[:, top + margin : top + margin + rows, left + margin : left + margin + cols]
        y, x = np.indices(scene.shape)
        picked = np.take_along_axis(seen, cfa[y % cfa.shape[0], x % cfa.shape[1]][None], 0)[0]
        v, u = ((np.arange(n) - (n - 1) / 2) * plan.slope for n in scene.shape)
        falls = (1 + v[:, None] ** 2 + u**2) ** -2 * (1.0 if gains is None else gains.gains)
        return np.maximum(picked, 0) * falls.astype(np.float32) * np.float32(seconds)

    def each_band():
        channels = np.zeros((len(weights), *plan.period), np.float32)
        for band, table, weight in zip(cube, tables, weights.T, strict=True):
            spectrum = scipy.fft.rfft2(np.pad(band, pads, mode), workers=workers) * table
            blurred = scipy.fft.irfft2(spectrum, plan.period, workers=workers)
            channels += weight[:, None, None] * blurred
        return mosaic(channels)

    def each_channel():
        light = np.abs(plan.weights) * cube.reshape(len(cube), -1).mean(axis=1)
        light /= light.sum(axis=1, keepdims=True)
        mean = np.tensordot(light.astype(np.float32), tables, 1)
        planes = np.tensordot(weights, cube, 1)
        spectra = scipy.fft.rfft2(np.pad(planes, [(0, 0), *pads], mode), workers=workers) * mean
        return mosaic(scipy.fft.irfft2(spectra, plan.period, workers=workers))

    return {"each band": each_band, "one PSF per channel": each_channel}


def _whole(tables, period):
    """Return half spectra (L, rows, cols // 2 + 1) from real quarters or from complex halves."""
    rows, cols = period[0], period[1] // 2 + 1
    if tables.shape[1:] == (rows // 2 + 1, cols):
        return tables[:, np.minimum(np.arange(rows), rows - np.arange(rows))]
    assert prod(tables.shape[1:]) == 2 * rows * cols
    return np.ascontiguousarray(tables).view(np.complex128)


def draw(rows: list[dict], path, title: str):
    """Write a figure of time against true error.

    Args:
        rows: Rows of `pareto`.
        path: File to write.
        title: Title of the figure.

    Raises:
        BadData: Matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError:
        raise BadData('a figure needs matplotlib: pip install "gpusim[bench]"') from None

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 5), layout="constrained")
    for kind, marker in (("plan", "o-"), ("exact", "D"), ("scipy", "s"), ("truth", "*")):
        points = sorted(
            (max(row["rms"], 1e-8), row["ms"], row["point"]) for row in rows if row["kind"] == kind
        )
        axes.plot([x for x, *_ in points], [y for _, y, _ in points], marker, label=kind)
        for number, (x, y, name) in enumerate(points):  # neighbours alternate above and below
            apart = (5, -12 if number % 2 else 5)
            axes.annotate(name, (x, y), xytext=apart, textcoords="offset points", fontsize=8)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="true relative RMS error of the mean electrons",
        ylabel="time [ms]",
        title=title,
    )
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
