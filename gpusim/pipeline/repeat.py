"""An output for another scene: the commands of the last frame start again, without the host code of their steps."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from gpusim.backends import Device
from gpusim.backends.tape import Tape
from gpusim.pipeline.cache import OTHER, Cache, One, compare, ones, renew, version_of
from gpusim.pipeline.exposure import Exposure
from gpusim.pipeline.step import Rate, Step, Values, steps_needed

SCENE = ("content", "view")  # values that a scene sets
FRAME = ("seed", "frame")  # numbers of a frame
PATIENCE = 3  # outputs in a row with the same settings, before their commands are collected
MOST_PATIENCE = 96


class NotRepeatable(Exception):
    """A step does more than start commands."""


class Repeat:
    """The commands of one output, to make it for other scenes of the same kind and for other frames.

    The steps' functions would start the same commands with the same numbers, so the bits are the same. Their caches
    forget for which scene they were computed: a value that is asked for by name is computed again, and this object is
    then out of date.

    Args:
        values: Values of which the output was just computed.
        first: Value that `begin` makes.
        exposed: Values that `expose` makes.
        last: Value that `draw` makes.
        output: Name of the output.
        exposure: The exposure with these arrays, which are rewritten.

    Attributes:
        results: The values by name; each is rewritten.
        result: The last value.

    Raises:
        NotRepeatable: A step reads on the host, or works there with the numbers of the frame.
    """

    def __init__(
        self,
        values: Values,
        first: str,
        exposed: Sequence[str],
        last: str,
        output: str,
        exposure: Exposure,
    ):
        self.output, self.exposure = output, exposure
        self._values, self._version = values, values.version
        self._users = {name: values.dependents(name) for name in SCENE}
        by_frame = values.dependents(*FRAME)
        steps = values.steps.values()
        needed = steps_needed(steps, [first, *exposed, last])
        self._fixed = _find_fixed(values, needed)
        changing = by_frame.union(*(self._users[name] for name in SCENE if name not in self._fixed))
        before, to_exposure = (
            {step.output for step in steps_needed(steps, names)} for names in ([first], exposed)
        )
        self._known: dict[str, Any] = {name: values.given(name) for name in SCENE}
        self._inputs: list[One] = []  # arrays that stay
        self._rewritten: list[tuple[Cache, str]] = []
        self._host: list[Step] = []  # without commands: they pass on or upload arrays of the scene
        self._tapes: list[tuple[str, Tape]] = []
        for step in needed:
            name = step.output
            self._known[name] = values.known(name)
            cache = values.cache_of(step)
            if name not in changing:
                self._inputs += ones(cache.with_versions((self._known[name],)))
                continue
            tape = cache.tape_of(name)
            if step.rate == Rate.CAMERA or tape is None or not tape.is_replayable:
                raise NotRepeatable(name)
            if tape.commands:
                self._tapes.append((name, tape))
            elif name in by_frame:
                raise NotRepeatable(name)
            else:
                self._host.append(step)
            if tape.commands or name not in self._users["content"]:
                self._rewritten.append((cache, name))
        names = [name for name, _ in self._tapes]
        self._begins = [name for name in names if name in before]
        self._exposes = [name for name in names if name in to_exposure - before]
        self._draws = [name for name in names if name not in before | to_exposure]
        self._by_frame = by_frame
        passed = {
            id(one.value)
            for step in self._host
            for one in ones(values.cache_of(step).with_versions((self._known[step.output],)))
        }
        self._takers = [tape for _, tape in self._tapes if not tape.used.isdisjoint(passed)]
        self._of_frame = [tape for name, tape in self._tapes if name in by_frame]
        self._caches = list(dict.fromkeys(cache for cache, _ in self._rewritten))
        self._commands: dict[tuple, list] = {}  # by the names of their results
        self._to_expose: set[str] = set()  # values of scenes that were begun
        self._to_draw: set[str] = set()
        self._written: list | None = None  # arrays that commands rewrite, with their writers
        self.results = {name: self._known[name] for name in exposed}
        self.result = self._known[last]

    @property
    def is_current(self) -> bool:
        """Whether nothing else has used the arrays since."""
        return self.is_alone and all([one.version == version_of(one.value) for one in self._inputs])

    @property
    def is_alone(self) -> bool:
        """Whether nothing else has used the arrays that commands rewrite."""
        values = self._values
        return self._version == values.version and all(map(values.owns, self._caches))

    def begin(self, device: Device, scene: Mapping[str, Any]) -> bool:
        """Make the first value for other values of SCENE; False if the commands cannot serve them."""
        known = self._known
        changed = {name: value for name, value in scene.items() if value is not known[name]}
        if not self._fixed.isdisjoint(changed):
            return False
        self._expire()
        touched = set().union(*[self._users[name] for name in changed])
        self._to_expose |= touched
        self._to_draw |= touched
        passed = []
        for step in self._host:
            if changed.keys().isdisjoint(step.inputs):
                continue
            inputs = [changed.get(name, known.get(name)) for name in step.inputs]
            old, new = known[step.output], step.run(*inputs, **step.constants)  # type: ignore[misc]
            cache = self._values.cache_of(step)
            keys = cache.with_versions((old,)), cache.with_versions((new,))
            if compare(*keys) == OTHER:
                return False
            pairs = [
                (own.value, its.value)
                for own, its in zip(*map(ones, keys), strict=True)
                if own.value is not its.value
            ]
            if step.output in self._users["content"]:
                changed[step.output] = new
                passed += pairs
            else:  # kernels may use it in another form
                for target, source in pairs:
                    device.copy(target, source)
        if passed and not all(tape.exchange(passed) for tape in self._takers):
            return False
        self._known |= changed
        self._start(device, [name for name in self._begins if name in touched])
        return True

    def expose(self, device: Device) -> None:
        """Make the exposure's values."""
        self._start(device, [name for name in self._exposes if name in self._to_expose])
        self._to_expose = set()

    def draw(self, device: Device, numbers: Mapping[str, int]) -> None:
        """Make the last value for the numbers of a frame."""
        self._expire()
        for tape in self._of_frame:
            tape.renumber(numbers)
        changed = self._to_draw | self._by_frame
        self._start(device, [name for name in self._draws if name in changed])
        self._to_draw = set()

    def _start(self, device, names: Iterable[str]):
        """Start the commands that make values."""
        names = tuple(names)
        if names not in self._commands:
            tapes = dict(self._tapes)
            commands = [each for name in names for each in tapes[name].commands]
            self._commands[names] = device.gather(commands)
        if not self._commands[names]:
            return
        try:
            device.start(self._commands[names])
        except BaseException:
            self._version = -1  # never current again: arrays may be half written
            raise

    def _expire(self):
        """Let the caches know that something else rewrites their arrays."""
        if self._written is not None:
            renew(self._written)
            return
        self._values.forget_all()
        self._written = [one for cache, name in self._rewritten for one in cache.expire(name)]


def _find_fixed(values, steps) -> set[str]:
    """Return the values of SCENE of which commands use more than arrays: they cannot be given another one."""
    return {
        given
        for step in steps
        if (tape := values.cache_of(step).tape_of(step.output)) is not None and tape.commands
        for given in step.inputs
        if given in SCENE
    }
