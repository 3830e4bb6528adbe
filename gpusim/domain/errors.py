"""What can go wrong for a user, each with the value, the place and what is allowed.

The command line prints `str(error)` on one line and exits with status 2; nothing here is ever a traceback.
"""

import difflib


class GpusimError(Exception):
    """Base of every error that a user's input can cause."""


class OutOfRange(GpusimError):
    """A number outside its allowed range.

    Example: ``sensor.fill_factor = 1.4: allowed is 0 < fill_factor <= 1``.
    """

    def __init__(self, key: str, value, allowed: str):
        super().__init__(f"{key} = {value}: allowed is {allowed}")


class UnknownName(GpusimError):
    """A name that is not in the list of names, with the nearest one suggested."""

    def __init__(self, what: str, name: str, known):
        known = sorted(known)
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        super().__init__(f"unknown {what} {name!r}{hint}; known: {', '.join(known)}" if not near
                         else f"unknown {what} {name!r}{hint}")


class BadFile(GpusimError):
    """A file that is missing, truncated or does not hold what it should: ``path: what is wrong``."""

    def __init__(self, path, problem: str):
        super().__init__(f"{path}: {problem}")


class BadData(GpusimError):
    """An array or a spectrum that cannot be simulated (NaN, negative radiance, unsorted wavelengths ...)."""


class DoesNotFit(GpusimError):
    """The estimated memory exceeds what the device has; raised before anything is allocated."""

    def __init__(self, what: str, needed: int, available: int, where: str):
        super().__init__(f"{what} needs about {needed / 2**30:.2f} GiB, {where} has {available / 2**30:.2f} GiB; "
                         "use a smaller scene or another device")


class DeviceError(GpusimError):
    """A device that is missing, unusable or failed, with the reason the driver gave."""


def check_range(owner: str, part, key: str, allowed: str, good, unit: str = ""):
    """Raise OutOfRange unless `good` holds for the field `key` of `part`, or it is None and that is its default."""
    value = getattr(part, key)
    if value is None and getattr(type(part), key, 0) is None:
        return
    try:
        right = good(value)
    except (TypeError, ValueError):  # not of a kind that can be compared
        right, value = False, repr(value)
    if not right:
        shown = f"{value:.6g}" if isinstance(value, float) else value
        raise OutOfRange(f"{owner}.{key}", f"{shown} {unit}".rstrip(), allowed)
