"""Thirty hard cases, each with the figure that it must keep: `gpusim verify --hard`, and the tests.

The truth is float64 NumPy that shares no code with the tested part: sums in real space for blurs,
distributions from probability theory, integrals between the breakpoints of tables. Each file has
the cases of one subject.
"""

from collections.abc import Iterable, Iterator
from importlib import import_module

from gpusim.backends import Device
from gpusim.judge.hard.case import CASES

SUBJECTS = ("highlights", "spectrum", "diffraction", "field", "photons", "sensor", "planner")


def hard(device: Device, numbers: Iterable[int] | None = None) -> Iterator[dict]:
    """Yield one row per case.

    A case that raises an exception on the device gives a row with an infinite figure, and the next
    case follows.

    Args:
        device: The device.
        numbers: Numbers of cases; None for all.

    Yields:
        Rows with number, name, device, asked (the criterion), got (the figure), limit, ok, and why
        (the meaning of the figure, or the reason of the failure).

    Raises:
        KeyError: There is no case of this number.
    """
    for subject in SUBJECTS:
        import_module(f"gpusim.judge.hard.{subject}")
    for number in sorted(CASES) if numbers is None else numbers:
        case = CASES[number]
        try:
            got, limit, why = case.run(device)
        except Exception as error:  # a driver may raise anything; the next cases are still judged
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
