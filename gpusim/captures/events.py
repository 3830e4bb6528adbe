"""Event cameras: pixels report when the logarithm of their light changes by a threshold."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, inf
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from gpusim.captures.moving import STEP, largest_step, parallax_step
from gpusim.captures.parallax import see_from
from gpusim.captures.photoreceptor import RATES, Photoreceptor
from gpusim.domain.errors import BadData, OutOfRange, checked_count, format_value
from gpusim.domain.motion import Motion
from gpusim.domain.scene import Scene, checked_scene
from gpusim.pipeline.simulator import Simulator

EVENT = np.dtype([("t", np.float64), ("x", np.uint16), ("y", np.uint16), ("p", np.int8)])
MOST = 100_000  # most instants
# [Hz] instants per second; the hand of a `Motion` turns at most eight times a second
COARSEST = 100.0
LEAST_THRESHOLD = 0.01  # least threshold of a pixel after mismatch


@dataclass(frozen=True)
class EventSensor:
    """Parameters of an event camera's pixels.

    The defaults are the noisy preset of v2e (shot noise 5 Hz, cutoff 30 Hz, leak 0.1 Hz), except
    for its mismatch of 0.25.

    Source: Lichtsteiner, Posch and Delbruck, IEEE J. Solid-State Circuits 43 (2008), 566.

    Attributes:
        on: increase of the natural logarithm of the light that makes an ON event.
        off: decrease of the natural logarithm of the light that makes an OFF event.
        mismatch: relative standard deviation of both thresholds over the pixels.
        refractory: time after an event during which the pixel does not respond [s]. Afterwards it
            compares with its light at the end of that time.
        leak: ON events per second of a pixel in steady light [Hz].
        dark: dark current [e- s-1].
        window: None, or averaging time of an ideal pixel without a photoreceptor [s]: its output is
            the light averaged over this time, with Poisson noise. 0 is without noise.
        seed: seed of mismatch and noise.
        cutoff: frequency at which a bright pixel's response has lost 3 dB [Hz]; in dim light it is
            slower.
        noise: ON and OFF events per second from the amplifier's noise in dim light, mean over the
            pixels [Hz]. In bright light there are about half as many. Photon noise adds to it.
        charge: electrons that change the photoreceptor's output by one e-fold [e-]. Its cutoff is
            the electrons per second over 2 pi charge [Hz].

    Raises:
        OutOfRange: if a value is out of range.
    """

    on: float = 0.2
    off: float = 0.2
    mismatch: float = 0.02
    refractory: float = 0.0
    leak: float = 0.1
    dark: float = 10.0
    window: float | None = None
    seed: int = 0
    cutoff: float = 30.0
    noise: float = 5.0
    charge: float = 500.0

    def __post_init__(self):
        not_negative = ("mismatch", "refractory", "leak", "dark", "window", "cutoff", "noise")
        least: dict = dict.fromkeys(("on", "off"), LEAST_THRESHOLD) | dict.fromkeys(not_negative, 0)
        for name, low in (least | {"charge": 1}).items():
            value = getattr(self, name)
            if not (name == "window" and value is None) and not (
                isinstance(value, Real) and low <= value < inf
            ):
                raise OutOfRange(f"events.{name}", format_value(value), f"{low:g} or more")
        if not self.dark > 0:
            raise OutOfRange(
                "events.dark", self.dark, "above 0, because the logarithm of 0 is undefined"
            )
        if not self.cutoff > 0:
            raise OutOfRange(
                "events.cutoff", self.cutoff, "above 0 Hz; use window = 0 for an ideal pixel"
            )
        if self.noise > RATES[0] * self.cutoff:
            raise OutOfRange(
                "events.noise",
                self.noise,
                f"up to {RATES[0]:.3g} times the cutoff of {self.cutoff:g} Hz",
            )
        checked_count("events.seed", self.seed, 0, 2**64 - 1)

    def events(self, times: ArrayLike, rates: Iterable[np.ndarray]) -> np.ndarray:
        """Return the events of a sequence of images.

        Between two instants the logarithm of the light changes linearly. The photoreceptor advances
        in its own time steps, so its noise does not depend on the instants. With a `window` each
        instant gets independent photon noise: instants one window apart have the noise of real
        pixels, a coarser spacing has less.

        Args:
            times: two or more instants [s], rising.
            rates: electrons per second at each instant, each of shape (rows, cols) [e- s-1].

        Returns:
            Array of EVENT sorted by time: t [s], column x, row y, polarity p (1 or -1).

        Raises:
            BadData: if the times do not rise, or a rate is missing, negative, not finite or of
                another shape.
        """
        times, found, state = np.asarray(times, np.float64), [], None
        is_series = times.ndim == 1 and len(times) > 1 and np.isfinite(times).all()
        if not is_series or (np.diff(times) <= 0).any():
            raise BadData(
                f"times of events: shape {times.shape}; wanted two or more finite instants [s], rising"
            )
        random = np.random.Generator(np.random.Philox(self.seed))
        images = iter(rates)
        for number, time in enumerate(times):
            if (rate := next(images, None)) is None:
                raise BadData(
                    f"rates of events: {number} for {len(times)} instants; wanted one per instant"
                )
            light = np.asarray(rate, np.float64)
            if light.ndim != 2 or not np.isfinite(light).all() or (light < 0).any():
                raise BadData(
                    f"rates of events at {time:g} s: shape {light.shape}; wanted finite light (rows, cols)"
                )
            if state is None:
                state = _Pixels(self, light.shape, random)
                front = Photoreceptor(self, random) if self.window is None else None
            elif light.shape != state.shape:
                raise BadData(
                    f"rates of events at {time:g} s: {light.shape}, wanted {state.shape} as before"
                )
            if self.window:
                light = random.poisson(light * self.window) / self.window
            logarithm = np.log(light + self.dark).ravel()
            if not number:
                state.begin(time, front.begin(logarithm) if front else logarithm)
            elif front:
                before = times[number - 1]
                for part, output in front.advance(logarithm, time - before):
                    found += state.advance(before + part * (time - before), output)
            else:
                found += state.advance(time, logarithm)
        together = np.concatenate([np.empty(0, EVENT), *found])
        return together[np.argsort(together["t"], kind="stable")]


class _Pixels:
    """Reference levels of the pixels and the end of their refractory times."""

    def __init__(self, sensor, shape, random):
        self._sensor, self.shape = sensor, shape
        scatter = 1 + sensor.mismatch * random.standard_normal((2, *shape))
        thresholds = [[[sensor.on]], [[sensor.off]]] * scatter
        self._on, self._off = np.maximum(thresholds, LEAST_THRESHOLD).reshape(2, -1)
        self._time, self._last, self._level = 0.0, np.empty(0), np.empty(0)
        # end of the refractory time; -inf: not refractory
        self._free = np.full(self._on.shape, -inf)

    def begin(self, time, light):
        """Set the reference level at the first instant. light: its logarithm, (pixels,)."""
        self._time, self._last, self._level = time, light, light.copy()

    def advance(self, time, now):
        """Return the events since the last instant as arrays of EVENT; now: log of the light."""
        begin, before = self._time, self._last
        drift = self._sensor.leak * self._on  # per second, by which the level falls
        slope = (now - before) / (time - begin)
        here, since = np.flatnonzero(self._free < time), np.full(now.shape, begin)
        # pixels that respond again from the end of their refractory time
        late = here[self._free[here] > -inf]
        since[late] = np.maximum(self._free[late], begin)
        self._level[late] = before[late] + slope[late] * (since[late] - begin)
        self._free[late] = -inf
        found = []
        while len(here):
            rise = slope[here] + drift[here]  # of the light over the level
            above = before[here] + slope[here] * (since[here] - begin) - self._level[here]
            limit = np.where(rise > 0, self._on[here], -self._off[here])
            with np.errstate(divide="ignore", invalid="ignore"):
                wait = np.where(rise == 0, inf, np.maximum((limit - above) / rise, 0))
            crosses = since[here] + wait <= time
            here, wait, limit = here[crosses], wait[crosses], limit[crosses]
            at = since[here] + wait
            events = np.empty(len(here), EVENT)
            events["t"], events["p"] = at, np.sign(limit)
            events["y"], events["x"] = np.divmod(here, self.shape[1])
            found.append(events)
            # the level drifts down meanwhile; an event moves it by the threshold
            self._level[here] += limit - drift[here] * wait
            since[here] = at
            if self._sensor.refractory:
                self._free[here] = since[here] = at + self._sensor.refractory
                here = here[since[here] < time]
                self._level[here] = before[here] + slope[here] * (since[here] - begin)
                self._free[here] = -inf
        known = self._free == -inf
        self._level[known] -= (drift * (time - since))[known]
        self._time, self._last = time, now
        return found


def events_of(
    simulator: Simulator,
    scene: Scene,
    motion: Motion,
    duration: float,
    sensor: EventSensor | None = None,
    start: float = 0.0,
    instants: int | None = None,
) -> np.ndarray:
    """Return the events of an event camera that moves in front of a scene.

    See `EventSensor.events`. Each pixel sees the light collected by the simulator's camera, through
    its own colour filter.

    Args:
        simulator: simulator whose camera collects the light.
        scene: scene to look at.
        motion: motion of the camera.
        duration: length of the recording [s].
        sensor: event sensor; None takes the defaults.
        start: time at which the recording begins, on the clock of the motion [s].
        instants: number of images of the scene. None: one per `window` of the sensor if it has one,
            and enough that the camera moves at most STEP samples between two.

    Returns:
        Array of EVENT, see `EventSensor.events`.

    Raises:
        OutOfRange: if the duration or the number of instants is out of range.
        GpusimError: as raised by `Simulator.expose`.
    """
    scene, sensor = checked_scene(scene), EventSensor() if sensor is None else sensor
    if not 0 < duration < inf:
        raise OutOfRange("duration of events", duration, "above 0 s")
    if instants is None:
        windows = duration / sensor.window if sensor.window else 1
        instants = 1 + ceil(max(windows, COARSEST * duration))
        times = start + duration * np.linspace(0, 1, min(instants, MOST))
        step = largest_step(scene, motion, times)
        step += parallax_step(scene, simulator.camera, motion, times)
        instants = 1 + ceil((instants - 1) * max(step / STEP, 1))
    if instants > MOST:
        raise OutOfRange(
            "instants of events", instants, f"up to {MOST}: take a shorter time or a slower camera"
        )
    instants = checked_count("instants of events", instants, 2, MOST)
    times = start + duration * np.linspace(0, 1, instants)

    def seen(time):
        moved = scene
        if any(motion.travel):
            moved = see_from(scene, simulator.camera, motion.place(time)).scene
        return moved.viewed(motion.through(moved.view).at(time))

    loop = simulator.loop(seen(start), 1.0)

    def rates():
        for time in times:
            loop.update(scene=seen(time))
            yield np.array(simulator.device.numpy(loop.output("mean", seed=0, first=0)))

    return sensor.events(times, rates())
