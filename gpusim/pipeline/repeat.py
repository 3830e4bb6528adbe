"""An output for another scene: the commands of the last frame start again, without the host code of their steps."""

from collections.abc import Mapping, Sequence
from typing import Any

from gpusim.backends import Device
from gpusim.backends.tape import Tape
from gpusim.pipeline.cache import OTHER, Cache, compare, ones
from gpusim.pipeline.step import Step, Values, steps_needed

SCENE = ("content", "view")  # values that a scene sets
FRAME = ("seed", "frame")  # numbers of a frame
PATIENCE = (
    3  # outputs in a row that differ only in scene and frame, before their commands are collected
)
MOST_PATIENCE = 96


class Repeat:
    """The commands of one output, to make it for scenes of one kind and for other frames.

    The steps' functions would start the same commands with the same numbers, so the bits are the same. The values'
    caches no longer know what their arrays hold: values that are asked for by name are computed again, and this object
    is then out of date.

    Args:
        values: Values of which the output was just computed.
        first: Value that is started by `begin`.
        names: Other values that are started by `finish`; the first is the output.
        output: Name of the output.
        seconds: Exposure time [s].

    Attributes:
        results: The values by name; each is rewritten.
        result: The output.

    Raises:
        NotRepeatable: A step reads on the host, or works there with more than arrays.
    """

    def __init__(
        self, values: Values, first: str, names: Sequence[str], output: str, seconds: float
    ):
        self.output, self.seconds = output, seconds
        self._values, self._version = values, values.version
        self._entries: list[tuple[Cache, str]] = []  # that the commands rewrite
        self._host: list[Step] = []  # without commands: they pass on or upload arrays of the scene
        steps = values.steps.values()
        by_scene, by_frame = values.dependents(*SCENE), values.dependents(*FRAME)
        self._begins: list[Tape] = []
        self._finishes: list[Tape] = []
        self._draws: list[Tape] = []
        self._drawn: list[tuple[Cache, str]] = []  # that the draws rewrite
        in_first = {step.output for step in steps_needed(steps, [first])}
        self._known: dict[str, Any] = {name: values.given(name) for name in SCENE}
        for step in steps_needed(steps, [first, *names]):
            self._known[step.output] = values.known(step.output)
            if step.output not in by_scene | by_frame:
                continue
            cache = values.cache_of(step)
            tape = cache.tape_of(step.output)
            if step.rate.name == "CAMERA" or tape is None or not tape.is_replayable:
                raise NotRepeatable(step.output)
            if not tape.commands:
                if step.output in by_frame:
                    raise NotRepeatable(step.output)
                self._host.append(step)
                continue
            self._entries.append((cache, step.output))
            if step.output in in_first:
                self._begins.append(tape)
            else:
                self._finishes.append(tape)
                if step.output in by_frame:
                    self._draws.append(tape)
                    self._drawn.append(self._entries[-1])
        passed = {
            id(one.value)
            for step in self._host
            for one in ones(values.cache_of(step).with_versions((self._known[step.output],)))
        }
        self._takers = [
            tape for tape in (*self._begins, *self._finishes) if not tape.used.isdisjoint(passed)
        ]
        self.results = {name: self._known[name] for name in (first, *names)}
        self.result = self.results[names[0]]
        self._is_first = True

    @property
    def is_current(self) -> bool:
        """Whether nothing else has used the arrays since."""
        return self._version == self._values.version and self._values.are_own

    def begin(self, device: Device, scene: Mapping[str, Any]) -> bool:
        """Start the commands up to the first value for other values of SCENE; False if they cannot serve them."""
        self._expire(self._entries)
        changed = {name: value for name, value in scene.items() if value is not self._known[name]}
        pairs = []
        for step in self._host:
            if not any(name in changed for name in step.inputs):
                continue
            inputs = [changed.get(name, self._known.get(name)) for name in step.inputs]
            old, new = self._known[step.output], step.run(*inputs, **step.constants)  # type: ignore[misc]
            cache = self._values.cache_of(step)
            keys = cache.with_versions((old,)), cache.with_versions((new,))
            if compare(*keys) == OTHER:
                return False
            changed[step.output] = new
            pairs += [
                (own.value, its.value)
                for own, its in zip(ones(keys[0]), ones(keys[1]), strict=True)
                if own.value is not its.value
            ]
        if not all(tape.exchange(pairs) for tape in self._takers):
            return False
        self._known |= changed
        _start(device, self._begins)
        return True

    def finish(self, device: Device, numbers: Mapping[str, int]) -> None:
        """Start the other commands."""
        self._start(device, self._finishes, numbers)

    def draw(self, device: Device, numbers: Mapping[str, int]) -> None:
        """Start only the commands that depend on the numbers of the frame."""
        self._expire(self._entries if self._is_first else self._drawn)
        self._start(device, self._draws, numbers)

    def _start(self, device, tapes, numbers):
        for tape in self._draws:
            tape.renumber(numbers)
        _start(device, tapes)

    def _expire(self, entries):
        """Let the caches know that something else rewrites their arrays."""
        if self._is_first:
            self._is_first = False
            self._values.forget_all()
        for cache, name in entries:
            cache.expire(name)


class NotRepeatable(Exception):
    """A step that does more than start commands."""


def _start(device, tapes):
    commands = [command for tape in tapes for command in tape.commands]
    if commands:
        device.start(commands)
