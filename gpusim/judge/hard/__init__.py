"""Thirty hard cases, each with the figure that it must keep: `gpusim verify --hard`, and what the tests run.

Truth is float64 NumPy that shares nothing with what it judges: sums in real space for blurs, distributions from
probability theory, integrals between the breakpoints of tables. Each file has the cases of one subject.
"""

from collections.abc import Iterable, Iterator
from importlib import import_module

from gpusim.backends import Device
from gpusim.judge.hard.case import CASES

SUBJECTS = ("highlights", "spectrum", "diffraction", "field", "photons", "sensor", "planner")


def hard(device: Device, numbers: Iterable[int] | None = None) -> Iterator[dict]:
    """One row per case: number, name, device, asked, got, limit, ok, why (what the figure is).

    numbers: of the cases, by default all. A case that raises on the device gives a row with an infinite figure and the
    reason in `why`: a device that fails is a failure, never a skip. Raises KeyError for a number that is none.
    """
    for subject in SUBJECTS:
        import_module(f"gpusim.judge.hard.{subject}")
    for number in sorted(CASES) if numbers is None else numbers:
        case = CASES[number]
        try:
            got, limit, why = case.run(device)
        except (
            Exception
        ) as error:  # whatever a driver raises, the row says it and the other cases go on
            got, limit, why = float("inf"), 0.0, f"{type(error).__name__}: {error}".splitlines()[0]
        got = float(got) if got == got else float("inf")
        yield {
            "number": number,
            "name": case.name,
            "device": device.name,
            "asked": case.asked,
            "got": got,
            "limit": float(limit),
            "ok": bool(got <= limit),
            "why": why,
        }
