"""A frame is a list of steps. Everything else about a frame is a sum or a walk over this list.

A new stage needs the four files of its kernels and one `Step`. The step determines the report's lines and their order,
the memory, the predicted time, the work of an update, and whether the host may read.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

from gpusim.backends import Device
from gpusim.kernels.stage import public_function
from gpusim.pipeline.cache import Cache


class Rate(IntEnum):
    """How often a step runs at most: once for a camera, a scene, an exposure or a frame."""

    CAMERA = 0
    SCENE = 1
    EXPOSURE = 2
    FRAME = 3


@dataclass(frozen=True, eq=False)
class Step:
    """One computation of a frame: `run(*inputs, **constants, **numbers)`.

    The function has no other arguments, no closure and no bound object. So the result depends on inputs, constants and
    numbers only, and they are the cache key.

    Attributes:
        output: Name of the value that it makes.
        stage: Stage in the report, for example "sensor.noise". Several steps may belong to one stage.
        inputs: Names of values. "" stands for None.
        constants: Arguments by name that do not change from frame to frame, the device among them.
        numbers: Names of numbers that change from frame to frame, for example "seed".
        words: The report's line; "" if another step of the stage has it.
        nbytes: Device memory that stays allocated [byte].
        work: Amount of work in the stage's unit, see `gpusim.judge.speeds`; 0 if another step counts it.
        rate: How often it runs at most.
        host: Why the host may read device values or compute in this step; "" if it may not.
        run: The function; by default the stage's public function.
    """

    output: str
    stage: str
    inputs: tuple[str, ...] = ()
    constants: Mapping[str, Any] = field(default_factory=dict)
    numbers: tuple[str, ...] = ()
    words: str = ""
    nbytes: int = 0
    work: float = 0.0
    rate: Rate = Rate.SCENE
    host: str = ""
    run: Callable | None = None

    def __post_init__(self):
        if self.run is None:
            object.__setattr__(self, "run", public_function(self.stage))


class Chain:
    """Builds steps that each take the output of the one before.

    Args:
        first: Name of the first value.
        last: Name of the last value.
        rate: Rate of the steps.
        device: Device of the steps.
    """

    def __init__(self, first: str, last: str, rate: Rate, device: Device):
        self.value = first
        self.steps: list[Step] = []
        self._last, self._rate, self._device = last, rate, device

    def add(self, stage: str, constants: Mapping | None = None, *others: str, **fields) -> None:
        """Add a step whose first input is the last value.

        Args:
            stage: Stage of the step.
            constants: Constants, without the device.
            others: Names of further inputs.
            fields: Other fields of the `Step`.
        """
        constants = {**(constants or {}), "device": self._device}
        step = Step(
            f"{self._last}, step {len(self.steps) + 1}",
            stage,
            (self.value, *others),
            constants,
            **({"rate": self._rate} | fields),
        )
        self.steps.append(step)
        self.value = step.output

    def end(self) -> list[Step]:
        """Return the steps. The last step makes the last value."""
        return [*self.steps[:-1], replace(self.steps[-1], output=self._last)]


class Values:
    """Values of a frame by name. Each is computed when it is needed and something before it has changed.

    Args:
        caches: The cache of each rate's values.
    """

    def __init__(self, caches: Mapping[Rate, Cache]):
        self._caches, self._token = caches, object()
        self._taped = [cache for cache in dict.fromkeys(caches.values()) if cache.is_taped]
        self.steps: dict[str, Step] = {}  # by the value that each makes
        self._given: dict[str, Any] = {}
        self._numbers: dict[str, Any] = {}
        self._known: dict[str, Any] = {}  # values that are up to date
        self._users: dict[str, set[str]] = {}  # outputs that depend directly on a value or number
        self.version = 0  # how often a step may have run

    @classmethod
    def of(cls, steps: Iterable[Step], tables: Cache | None = None) -> "Values":
        """Return values of these steps that are not kept. tables: where the camera's values are kept."""
        own = Cache()
        values = cls(dict.fromkeys(Rate, own) | {Rate.CAMERA: tables or own})
        values.use(steps)
        return values

    def use(self, steps: Iterable[Step]) -> None:
        """Replace all steps by these."""
        before, self.steps, self._users = self.steps, {}, {}
        for step in steps:
            self.steps[step.output] = step
            for name in (*step.inputs, *step.numbers):
                self._users.setdefault(name, set()).add(step.output)
        for name in before.keys() | self.steps.keys():
            if before.get(name) is not self.steps.get(name):
                self.forget(name)

    def give(self, **values) -> None:
        """Set values. They take precedence over the results of steps."""
        for name, value in values.items():
            if name not in self._given or self._given[name] is not value:
                self._given[name] = value
                self.forget(name)

    def withdraw(self, name: str) -> None:
        """Remove a given value. Its step then makes it again."""
        if self._given.pop(name, None) is not None:
            self.forget(name)

    def set_numbers(self, **numbers) -> None:
        """Set the numbers of steps by name."""
        for name, value in numbers.items():
            if name not in self._numbers or self._numbers[name] != value:
                self._numbers[name] = value
                self.forget(name)

    def forget(self, name: str) -> None:
        """Mark a value and all that depend on it as out of date."""
        self._known.pop(name, None)
        for user in self._users.get(name, ()):
            if user in self._known:
                self.forget(user)

    def dependents(self, *names: str) -> set[str]:
        """Return the outputs of steps that depend on a value or number."""
        found: set[str] = set()
        new = {*names}
        while new:
            new = {user for name in new for user in self._users.get(name, ())} - found
            found |= new
        return found

    def given(self, name: str) -> Any:
        """Return a value that was set, or None."""
        return self._given.get(name)

    def known(self, name: str) -> Any:
        """Return a value that was computed, or None if it is out of date."""
        return self._known.get(name)

    def cache_of(self, step: Step) -> Cache:
        """Return the cache of a step's results."""
        return self._caches[step.rate]

    def owns(self, cache: Cache) -> bool:
        """Return True if no other values have rewritten the cache's arrays since the last computation."""
        return not cache.is_taped or cache.user is self._token

    def forget_all(self) -> None:
        """Mark all values as out of date."""
        self._known.clear()

    def __getitem__(self, name: str) -> Any:
        for cache in self._taped:
            # other values may have rewritten the cache's arrays
            if cache.user is not self._token:
                self._known.clear()
                cache.user = self._token
        return self._value(name)

    def unexpected_host_accesses(self) -> list[tuple[str, str]]:
        """Return (value, stage) of steps that read device values or computed on the host without `Step.host`."""
        found = []
        for cache in dict.fromkeys(self._caches.values()):
            for name, reads, work in cache.host_accesses():
                step = self.steps.get(name)
                if step is not None and not step.host:
                    found += [(name, stage) for stage in sorted({*reads, *work})]
        return found

    def __contains__(self, name: str) -> bool:
        return name in self._given or name in self.steps

    def _value(self, name):
        if name in self._known:
            return self._known[name]
        if name in self._given or not name:
            return self._given[name] if name else None
        step = self.steps[name]
        self.version += 1
        value = self._caches[step.rate].run(
            name,
            step.run,
            tuple(map(self._value, step.inputs)),
            step.constants,
            {number: self._numbers[number] for number in step.numbers},
        )
        self._known[name] = value
        return value


def steps_needed(steps: Iterable[Step], names: Iterable[str]) -> list[Step]:
    """Return the steps that these values depend on, in the order of the list."""
    by_output = {step.output: step for step in steps}
    wanted, found = [*names], set()
    while wanted:
        name = wanted.pop()
        if name in by_output and name not in found:
            found.add(name)
            wanted += by_output[name].inputs
    return [step for name, step in by_output.items() if name in found]
