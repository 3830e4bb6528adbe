"""Event cameras: pixels that tell when the logarithm of their light has changed by a threshold."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, inf
from numbers import Real

import numpy as np

from gpusim.captures.moving import STEP, farthest
from gpusim.captures.photoreceptor import RATES, Photoreceptor
from gpusim.domain.errors import BadData, OutOfRange, checked_count, shown
from gpusim.domain.motion import Motion
from gpusim.domain.scene import Scene, checked_scene
from gpusim.pipeline.simulator import Simulator

EVENT = np.dtype([("t", np.float64), ("x", np.uint16), ("y", np.uint16), ("p", np.int8)])
MOST = 100_000  # instants
COARSEST = (
    100.0  # of them in a second, in which the hand of a `Motion` turns back eight times at most
)
LEAST_THRESHOLD = 0.01  # of a pixel, whatever its mismatch


@dataclass(frozen=True)
class EventSensor:
    """Read-out of a pixel's light as events.

    on, off: change of the natural logarithm of the light that makes an event. mismatch: standard deviation of both
    from pixel to pixel, over themselves. refractory: time after an event in which a pixel sees nothing; what it
    compares with is its light at the end of it [s]. leak: events on a second that a pixel makes in steady light [Hz].
    dark: electrons that flow in darkness [e- s-1]. seed: of mismatch and noise.
    cutoff, noise, charge: of the photoreceptor and the source follower behind it, see `photoreceptor`. cutoff: where
    a bright pixel's response has lost 3 dB [Hz]; in dim light it is slower. noise: events on and off a second that
    the amplifier's noise makes in dim light, in the mean over the pixels [Hz]; in bright light it makes about half.
    Photons add to it. charge: electrons by which the photoreceptor changes by an e-fold [e-]; the electrons per second
    over 2 pi charge are its own cutoff [Hz].
    window: None, or an ideal pixel without a photoreceptor: its output is the light as it is, averaged over this time
    [s], in which the number of electrons scatters by Poisson; 0: it does not.
    The defaults are the noisy preset of v2e (shot noise 5 Hz, cutoff 30 Hz, leak 0.1 Hz), but for its mismatch of 0.25.
    Source: Lichtsteiner, Posch and Delbruck, IEEE J. Solid-State Circuits 43 (2008), 566. Raises OutOfRange.
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
        for name, low in (
            ("on", LEAST_THRESHOLD),
            ("off", LEAST_THRESHOLD),
            ("mismatch", 0),
            ("refractory", 0),
            ("leak", 0),
            ("dark", 0),
            ("window", 0),
            ("cutoff", 0),
            ("noise", 0),
            ("charge", 1),
        ):
            value = getattr(self, name)
            if not (name == "window" and value is None) and not (
                isinstance(value, Real) and low <= value < inf
            ):
                raise OutOfRange(f"events.{name}", shown(value), f"{low:g} or more")
        if not self.dark > 0:
            raise OutOfRange("events.dark", self.dark, "above 0, or darkness has no logarithm")
        if not self.cutoff > 0:
            raise OutOfRange(
                "events.cutoff", self.cutoff, "above 0 Hz; window = 0 is an ideal pixel"
            )
        if self.noise > RATES[0] * self.cutoff:
            raise OutOfRange(
                "events.noise",
                self.noise,
                f"up to {RATES[0]:.3g} times the cutoff of {self.cutoff:g} Hz",
            )
        checked_count("events.seed", self.seed, 0, 2**64 - 1)

    def events(self, times, rates: Iterable[np.ndarray]) -> np.ndarray:
        """Events of light at rising instants [s]; rates: of electrons there, each (rows, cols) [e- s-1].

        Between two instants the logarithm of the light changes linearly. The photoreceptor goes on in steps of its
        own, so that its noise does not depend on the instants. With a `window` each instant is scattered by itself, so
        that instants a window apart have the noise of such pixels, and fewer have less. Returns an array of EVENT, by
        time: t [s], column x, row y, p 1 or -1. Raises BadData for times and rates that are not so.
        """
        times, found, state = np.asarray(times, np.float64), [], None
        if (
            times.ndim != 1
            or len(times) < 2
            or not np.isfinite(times).all()
            or (np.diff(times) <= 0).any()
        ):
            raise BadData(
                f"times of events: shape {times.shape}; wanted two or more finite instants in seconds, "
                "rising"
            )
        random = np.random.Generator(np.random.Philox(self.seed))
        given = iter(rates)
        for number, time in enumerate(times):
            if (rate := next(given, None)) is None:
                raise BadData(
                    f"rates of events: {number}, wanted one for each of {len(times)} instants"
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
                begun = times[number - 1]
                for part, output in front.seen(logarithm, time - begun):
                    found += state.seen(begun + part * (time - begun), output)
            else:
                found += state.seen(time, logarithm)
        together = np.concatenate([np.empty(0, EVENT), *found])
        return together[np.argsort(together["t"], kind="stable")]


class _Pixels:
    """What pixels compare their light with, and since when they look."""

    def __init__(self, sensor, shape, random):
        self._sensor, self.shape = sensor, shape
        scatter = 1 + sensor.mismatch * random.standard_normal((2, *shape))
        self._on, self._off = np.maximum(
            [[[sensor.on]], [[sensor.off]]] * scatter, LEAST_THRESHOLD
        ).reshape(2, -1)
        self._time, self._last, self._level = 0.0, np.empty(0), np.empty(0)
        self._free = np.full(
            self._on.shape, -inf
        )  # end of the refractory time, -inf where the level is known

    def begin(self, time, light):
        """The first instant: what the light's logarithm (pixels,) is compared with."""
        self._time, self._last, self._level = time, light, light.copy()

    def seen(self, time, now):
        """Events since the instant before, of the light's logarithm (pixels,): arrays of EVENT."""
        begun, before = self._time, self._last
        drift = self._sensor.leak * self._on  # per second, by which the level falls
        slope = (now - before) / (time - begun)
        here, since = np.flatnonzero(self._free < time), np.full(now.shape, begun)
        late = here[
            self._free[here] > -inf
        ]  # they look again from the end of their refractory time on
        since[late] = np.maximum(self._free[late], begun)
        self._level[late] = before[late] + slope[late] * (since[late] - begun)
        self._free[late] = -inf
        found = []
        while len(here):
            rise = slope[here] + drift[here]  # of the light over the level
            above = before[here] + slope[here] * (since[here] - begun) - self._level[here]
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
            # the level falls meanwhile, and is reset by the threshold, or to the light at the end of the time
            self._level[here] += limit - drift[here] * wait
            since[here] = at
            if self._sensor.refractory:
                self._free[here] = since[here] = at + self._sensor.refractory
                here = here[since[here] < time]
                self._level[here] = before[here] + slope[here] * (since[here] - begun)
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
    """Events of a camera that moves before a scene, see `EventSensor.events`.

    Each pixel sees the light that the simulator's camera gathers there, its own colour of a mosaic. duration, start:
    [s]. instants: at which the scene is seen; None: a `window` of the sensor apart, if it has one, or nearer where the
    camera moves more than STEP samples between two. Raises as `Simulator.expose` does, and OutOfRange.
    """
    scene, sensor = checked_scene(scene), EventSensor() if sensor is None else sensor
    if not 0 < duration < inf:
        raise OutOfRange("duration of events", duration, "above 0 s")
    if instants is None:
        instants = 1 + ceil(
            max(duration / sensor.window if sensor.window else 1, COARSEST * duration)
        )
        times = start + duration * np.linspace(0, 1, min(instants, MOST))
        instants = 1 + ceil((instants - 1) * max(farthest(scene, motion, times) / STEP, 1))
    if instants > MOST:
        raise OutOfRange(
            "instants of events", instants, f"up to {MOST}: a shorter time or a slower camera"
        )
    times = start + duration * np.linspace(
        0, 1, checked_count("instants of events", instants, 2, MOST)
    )
    program = simulator.program(scene.viewed(motion.at(start)), 1.0)

    def rates():
        for time in times:
            program.update(scene=scene.viewed(motion.at(time)))
            yield np.array(simulator.device.numpy(program.output("mean", seed=0, frame=0)))

    return sensor.events(times, rates())
