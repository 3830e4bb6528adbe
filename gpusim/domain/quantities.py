"""Numbers with units as people write them."""

import re

from gpusim.domain.exposure import LONGEST

TIME = re.compile(r"(\d+\.?\d*(?:e[+-]?\d+)?|\.\d+)(?:/(\d+\.?\d*))? ?(s|ms|us)?", re.ASCII)
PER_SECOND = {None: 1.0, "s": 1.0, "ms": 1e3, "us": 1e6}


def parse_seconds(text: str) -> float:
    """Return the seconds of a time like 1/60, 0.01, 10ms or 500us. Raise ValueError."""
    match = TIME.fullmatch(text)
    time = (
        float(match[1]) / float(match[2] or 1) / PER_SECOND[match[3]]
        if match and float(match[2] or 1)
        else 0.0
    )
    if not 0 < time <= LONGEST:
        raise ValueError(
            f"{text!r}: wanted seconds such as 1/60 or 0.01, 10ms, 500us, above 0 and up to {LONGEST:g} "
            "s, or auto"
        )
    return time
