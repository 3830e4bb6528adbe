"""Every stage on a device against its float64 reference: `gpusim verify`, and what the tests run."""

from collections.abc import Iterator

from gpusim.backends import Device
from gpusim.kernels.stage import compare, stage_names


def verify(device: Device, stages: list[str] | None = None) -> Iterator[dict]:
    """One row per case: stage, device, case, max_error, tolerance, ok, why (the tolerance's derivation).

    A stage that raises on the device gives a row with an infinite error and the reason in `why`: a device that fails is
    a failure, never a skip.
    """
    for name in stages or stage_names():
        try:
            for case, error in compare(name, device):
                yield {
                    "stage": name,
                    "device": device.name,
                    "case": case.name,
                    "max_error": error,
                    "tolerance": case.tolerance,
                    "ok": bool(error <= case.tolerance),
                    "why": case.why,
                }
        except (
            Exception
        ) as error:  # whatever a driver raises, the row says it and the other stages go on
            yield {
                "stage": name,
                "device": device.name,
                "case": "(failed to run)",
                "max_error": float("inf"),
                "tolerance": 0.0,
                "ok": False,
                "why": f"{type(error).__name__}: {error}".splitlines()[0],
            }
