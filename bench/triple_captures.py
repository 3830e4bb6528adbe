"""Mean electrons of captures for `bench/triples.py --kinds features`, from the product and from own sums.

`exposures` asks the product for the frames of a question. `answers` integrates the rates of
`triple_outside.py` over the time that each row is open: rates at a few instants are cubic splines in
time, and flicker is integrated on a fine grid.
"""

from dataclasses import dataclass, replace
from math import ceil

import numpy as np
import triple_outside as outside
from scipy.interpolate import CubicSpline
from triple_lens import Lens

import gpusim as gs
from gpusim.apps.preview.producer import Producer
from gpusim.apps.routes import Held
from gpusim.apps.video.scenes import Moving, Still
from gpusim.apps.video.video import captured_frames, frames
from gpusim.captures.bracket import Bracket
from gpusim.captures.burst import Burst
from gpusim.captures.capture import Capture, Light
from gpusim.captures.reads import Reads
from gpusim.domain.errors import OutOfRange

PLAIN = gs.View()
PERIOD = 1 / 30  # [s] of a video
STEP = 0.3  # [sample] between instants
LEAST, MOST = 5, 41  # instants
FINE = 4000  # parts of the time that a row is open
MARGIN = 4000  # [sample] that a shifted scene goes on for


@dataclass(frozen=True, eq=False)
class Asked:
    """An exposure that the product made.

    mean: electrons. account, verdict: of the product. seconds: exposure time. view: of the scene,
    None if it moves from `start` on. base: view of the scene that moves.
    """

    mean: np.ndarray
    account: object
    seconds: float
    view: gs.View | None
    start: float = 0.0
    left_out: tuple = ()
    base: gs.View = PLAIN


def exposures(question, simulator) -> list[Asked]:
    """Return the exposures of a question; all frames and reads are made, to find crashes."""
    names, scene = question.captures, question.scene
    still = "motion" not in names or not any(question.motion.pan)
    moves = not still or "rolling shutter" in names  # flicker, too
    views = [made_scene(scene, view) for view in question.views]
    found: list[Asked] = []
    if names & {"video", "preview", "batch"}:
        _use_outputs(question, simulator, views)
    if "video" in names and not moves:
        for number in range(2):
            start = number * PERIOD
            view = question.motion.at(start)
            made = simulator.expose(made_scene(scene, view))
            found.append(_asked(simulator, made, view, start))
        return found
    for number, one in enumerate(views):
        # rows of a video open while the camera moves
        for capture in captures(question, is_moving="video" in names):
            light = Light(capture, simulator, one, number * capture.count)
            shots = capture.shots(light, 1, number * capture.count)
            for shot in shots:
                shot.frame().rgb  # noqa: B018  to find crashes
            after = 0.0
            for shot in shots[:2]:
                exposure = shot.exposure
                start = number * PERIOD + after
                view = None if moves else one.view
                found.append(replace(_asked(simulator, exposure, view, start), base=one.view))
                after += 0.0 if "reads" in names else exposure.exposure_time + light.readout_time
    return found


def captures(question, merged=False, is_moving=False) -> list[Capture]:
    """Return the captures of a question. is_moving: during each, if the question says so or not."""
    names, seconds = question.captures, question.camera.sensor.exposure_time
    more = {"period": PERIOD, "flicker": question.flicker, "merged": merged}
    if "motion" in names or is_moving:
        more["motion"] = question.motion
    if "reads" in names:
        stops = question.stops
        return [Reads(times=(0.5 * seconds * 2**k, seconds * 2**k), **more) for k in stops]
    if "bracket" in names:
        return [Bracket(stops=question.stops, **more)]
    if "burst" in names:
        return [Burst(size=2, **more)]
    return [Capture(**more | {"merged": False})]


def made_scene(scene, view):
    """Return a scene seen from a view."""
    return scene if view.is_plain else scene.viewed(view)


def _asked(simulator, made, view, start=0.0):
    mean = np.array(simulator.device.numpy(made.mean), np.float64)
    account = made.plan.account.at(made.exposure_time)
    return Asked(mean, account, made.exposure_time, view, start, tuple(made.plan.left_out))


def _use_outputs(question, simulator, views):
    """Make frames by the outputs of a question, to find crashes."""
    names, moves = question.captures, question.motion.pan
    many = bool(names & {"reads", "burst", "bracket"})
    capture = captures(question, merged=many)[0]
    if "video" in names:
        still = Still(question.scene, 2)
        scenes = Moving(still, gs.Motion(pan=moves), 30, question.flicker)
        blur = bool(names & {"motion", "rolling shutter"})
        if many or blur:
            list(captured_frames(simulator, scenes, [[0, 0, 1]], capture=capture, blur=blur))
        else:
            list(frames(simulator, scenes, [[0, 0, 1]]))
    if "preview" in names:
        state = Held("", tolerance="1e-3", seed=1, held=simulator.camera)
        for one in views:
            Producer(Still(one, 1), simulator.device, capture=capture).picture(state, 0)
    if "batch" in names:
        scenes = views if len(views) > 1 else views * 2
        simulator.batch(len(scenes), "raw", capture=captures(question)[0])(scenes)


def answers(question, asked: Asked):
    """Return the answers of own sums for an exposure. Raises OutOfRange if they do not apply."""
    scene, camera = question.scene, question.camera
    if asked.view is not None:
        seen = made_scene(scene, asked.view)
        return outside.answers(seen, camera, asked.seconds)
    if scene.depth is not None and any(question.motion.pan):
        raise OutOfRange("motion", "of a scene with depth", "a scene without depth")
    return _moving(question, asked)


def _moving(question, asked):
    """Return the answers for a camera that moves straight: see the module."""
    scene, camera = question.scene, question.camera
    outside.require(scene, camera)
    rows, sensor = scene.shape[0], camera.sensor
    whole = asked.seconds + sensor.row_time * (rows - 1)
    path = np.hypot(*question.motion.pan) * whole * scene.samples_per_pixel
    is_common = not (sensor.row_time or question.flicker)  # all rows see the same mean light
    count = int(np.clip(ceil(path / STEP) + 1, LEAST, MOST)) if path else 1
    times, parts = asked.start + whole * np.linspace(0, 1, count), None
    if is_common and path:
        # points of Gauss: waves of half a cycle a sample need a half of the path, and some
        parts, weights = np.polynomial.legendre.leggauss(ceil(path) + 12)
        times = asked.start + whole * (parts + 1) / 2
    scene = made_scene(scene, asked.base)
    lens, rates, worlds = Lens(scene, camera), [], []
    planes = outside.planes_of(scene)
    for time in times if path else times[:1]:
        view = question.motion.through(asked.base).at(float(time) if path else 0.0)
        shift = [scene.samples_per_pixel * one for one in view.shift]
        if view.is_plain or scene.depth is not None:  # the sums displace sheets
            worlds.append(planes)
        elif view.zoom == 1 and not view.rotation:
            worlds.append(shifted(planes, shift, scene.border))
        else:
            worlds.append(outside.seen_by_view(scene.viewed(view), planes))
    if parts is not None:
        worlds = [np.tensordot(weights / 2, worlds, 1)]
    for world in worlds:
        rates.append(outside.rates_of_world(lens, scene, camera, world))
    count_of_answers = {len(one) for one in rates}
    if count_of_answers != {1} and count > 1:
        rates = [one[:1] for one in rates]
    means = []
    for number in range(len(rates[0])):
        own = np.stack([one[number] for one in rates])
        means.append(_integrated(own, times[: len(own)], question, asked, sensor.row_time))
    rim = outside.SAFE if camera.optics.distortion is not None or count > 1 else 0
    mosaic = [outside.exposed(one, scene, camera, 1.0) for one in means]
    return outside.Answers(mosaic, min(rim, (min(scene.shape) - 1) // 3), 1e-4)


def _integrated(rates, times, question, asked, row_time):
    """Return the electrons (C, rows, cols) that rates (K, C, rows, cols) give to each row."""
    out, flicker = np.empty(rates.shape[1:]), question.flicker
    for row in range(rates.shape[2]):
        first = asked.start + row * row_time
        t = first + asked.seconds * (np.arange(FINE) + 0.5) / FINE
        light = np.ones(FINE)
        if flicker is not None:
            turn = 2 * np.pi * (flicker.frequency * t + flicker.phase)
            light = 1 + flicker.depth * np.cos(turn)
        if len(times) == 1:
            out[:, row] = rates[0, :, row] * light.mean() * asked.seconds
            continue
        basis = CubicSpline(times, np.eye(len(times)))(t)
        out[:, row] = np.tensordot(light @ basis / FINE, rates[:, :, row], 1) * asked.seconds
    return out


def shifted(planes, shift, border) -> np.ndarray:
    """Return planes whose sample (y, x) is the band-limited scene at (y, x) + shift."""
    down, right = (_moved(n, one, border) for n, one in zip(planes.shape[1:], shift, strict=True))
    return down @ planes @ right.T


def _moved(n, shift, border):
    """Return the light of n samples at places displaced from them, (n, n), in a world without end."""
    at, own = np.arange(n)[:, None] + shift, np.arange(n)
    if border == "reflect":  # sums of sin(pi u) / (pi u) over all mirror images

        def repeated(away):
            turn = np.pi * (away / (2 * n) - np.rint(away / (2 * n)))
            near = np.abs(turn) < 1e-9
            found = np.sin(2 * n * turn) / (2 * n * np.tan(np.where(near, 1, turn)))
            return np.where(near, 1.0, found)

        return repeated(at - own) + repeated(at + 1 + own)
    found = np.sinc(at - own)
    if border != "zero":  # the outermost samples go on, up to a smooth end far away
        far = np.arange(1, MARGIN + 1)
        fade = 0.5 + 0.5 * np.cos(np.pi * np.clip(2 * far / MARGIN - 1, 0, 1))
        found[:, 0] += np.sinc(at + far) @ fade
        found[:, -1] += np.sinc(at - (n - 1) - far) @ fade
    return found
