"""The stages as subjects of the benchmark, on the inputs that their contracts give for a size."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from gpusim.backends import Device
from gpusim.backends.buffers import allocate_pages
from gpusim.bench.subject import Check, Work, digest_sources, digest_values
from gpusim.domain.progress import announced
from gpusim.kernels.stage import make_resident, public_function, stage_module

# columns and rows. The reference of a full frame takes minutes: errors are measured on the first
# size, and inputs are hashed in the second
ERROR_SIZE = 240, 135
HASH_SIZE = 64, 48


@dataclass(frozen=True)
class Stage:
    """A stage.

    Attributes:
        name: Its name, `area.name`.
    """

    name: str
    kind = "stage"

    @property
    def family(self) -> str:
        """Its area."""
        return self.name.partition(".")[0]

    def start(self, device: Device, size: tuple[int, int]) -> Work:
        """Return the work for a frame, with all arrays on the device.

        Args:
            device: The device.
            size: Columns and rows.
        """
        module, function = stage_module(self.name), public_function(self.name)
        inputs = module.bench(*size[::-1])
        moved = sum(value.nbytes for value in inputs.values() if isinstance(value, np.ndarray))
        counted = getattr(module, "operations", None)
        operations = None if counted is None else int(counted(**inputs))
        resident = make_resident(device, {key: _at_page(each) for key, each in inputs.items()})
        result = function(**resident, device=device)
        size_of_result = int(np.prod(result.shape)) * device.numpy(result).dtype.itemsize

        def run():
            return function(**resident, device=device)

        moved += size_of_result
        # arrays between its kernels take about as much as its inputs and results
        return Work(run, moved, operations, 2 * moved, is_wall=False)

    def digest(self) -> str:
        """Return the SHA-256 of its kernels' sources, of all shared ones, and of its inputs."""
        area, name = self.name.split(".")
        inputs = stage_module(self.name).bench(*HASH_SIZE[::-1])
        return digest_values(digest_sources(area, name), inputs)

    def rms_error(self, device: Device) -> float:
        """Return the RMS difference from the float64 reference over the reference's RMS.

        Args:
            device: The device.
        """
        inputs = stage_module(self.name).bench(*ERROR_SIZE[::-1])
        function = public_function(self.name)
        result = np.asarray(function(**inputs, device=device), np.float64)
        reference = np.asarray(function(**inputs, device="numpy"), np.float64)
        size = np.sqrt(np.mean(reference**2))
        return float(np.sqrt(np.mean((result - reference) ** 2)) / size)


def _at_page(value):
    """Return an array at the begin of a page, which processors use in place; other values as they are.

    NumPy's own arrays begin anywhere, and times depend on the place. A pack's runner does the same.
    """
    if not isinstance(value, np.ndarray):
        return value
    copied = allocate_pages(value.nbytes).view(value.dtype).reshape(value.shape)
    copied[...] = value
    return copied


def check_stages(
    stages: list[str], verify: Callable[[list[str]], Iterable[dict]]
) -> dict[str, list[Check]]:
    """Return the checks of stages by name.

    Args:
        stages: Names of stages.
        verify: Function from names of stages to the rows of `gpusim.judge.verify.verify`.

    Returns:
        Checks by stage. "" has those of no stage: the device failed before, or between two.
    """
    found: dict[str, list[Check]] = {name: [] for name in stages}
    rows = iter(verify(stages))
    while True:
        done = sum(bool(checks) for checks in found.values())
        with announced(f"verifying stages, {done} of {len(stages)}"):
            row = next(rows, None)
        if row is None:
            return found
        # a device may also fail before or between the stages, "(open)": what follows has no checks
        check = Check(row["case"], row["max_error"], row["tolerance"], row["why"])
        found.setdefault(row["stage"] if row["stage"] in found else "", []).append(check)
