"""The option --capture: the frames that a camera takes of each scene."""

import argparse
from typing import TYPE_CHECKING, Any

from gpusim.cli.options import option

if TYPE_CHECKING:  # the command line starts without them
    from gpusim.captures.capture import Capture

KINDS = ("burst", "bracket", "reads")
MOVES = (
    "pan",
    "roll",
    "zooming",
    "shake",
    "travel",
    "seed",
    "flicker",
    "pwm",
    "period",
    "instants",
)
FLAGS = "merged", "unaligned"
WANTED = (
    "burst=N, bracket=STOP:STOP:... or reads=TIME:TIME:..., merged, enlarge=FACTOR (of a merged burst), "
    "unaligned (of a merged bracket), and pan=DOWN:RIGHT, roll=DEG_S, "
    "zooming=FACTOR, shake=PIXELS, travel=DOWN:RIGHT:AHEAD (m/s), seed=N, flicker=HZ:DEPTH, pwm=HZ:DUTY, "
    "period=SECONDS, instants=N, each once"
)


def capture_option(more: str = "", moves: bool = True) -> Any:
    """Return the field of the option --capture.

    Args:
        more: End of its help.
        moves: Whether the capture has its own movement.
    """
    motion = "; in motion pan=DOWN:RIGHT,roll=DEG_S,zooming=FACTOR,shake=PIXELS" if moves else ""
    return option(
        type=parse_capture if moves else _parse_at_rest,
        metavar="LIST",
        help="frames of each scene: burst=8, bracket=-2:0:2 (stops) or reads=10ms:20ms "
        f"(non-destructive), with ,merged as one, a merged burst with ,enlarge=1.5{motion}{more}",
    )


def parse_capture(text: str) -> "Capture":
    """Return the capture of `bracket=-2:0:2,merged,pan=0:120`. Raises ArgumentTypeError."""
    from gpusim.captures.bracket import Bracket
    from gpusim.captures.burst import Burst
    from gpusim.captures.capture import Capture
    from gpusim.captures.reads import Reads
    from gpusim.domain.errors import GpusimError
    from gpusim.domain.exposure import parse_seconds

    found: dict[str, str] = {}
    for part in text.split(","):
        name, _, value = part.partition("=")
        known = name in (*KINDS, *MOVES, *FLAGS, "enlarge")
        if name in found or not known or (name in FLAGS) == bool(value):
            raise argparse.ArgumentTypeError(f"{part!r}: wanted {WANTED}")
        found[name] = value
    kinds = [name for name in KINDS if name in found]
    try:
        if len(kinds) > 1:
            raise ValueError
        if "enlarge" in found and "burst" not in found:
            raise ValueError
        if "unaligned" in found and not {"bracket", "merged"} <= set(found):
            raise ValueError
        common = _read_motion(found)
        if "burst" in found:
            factor = float(found.get("enlarge", 1))
            return Burst(int(found["burst"]), enlarge=factor, **common)
        if "bracket" in found:
            stops = tuple(map(float, found["bracket"].split(":")))
            return Bracket(stops, align="unaligned" not in found, **common)
        if "reads" in found:
            return Reads(tuple(map(parse_seconds, found["reads"].split(":"))), **common)
        return Capture(**common)
    except GpusimError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: {error}") from None
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: wanted {WANTED}") from None


def _parse_at_rest(text):
    """Return a capture without its own movement."""
    capture = parse_capture(text)
    moves = [part.partition("=")[0] for part in text.split(",")]
    if any(name in MOVES for name in moves):
        raise argparse.ArgumentTypeError(
            f"{text!r}: --pan, --roll, --shake and --flicker move a video"
        )
    return capture


def _read_motion(found):
    """Return the fields that all captures have."""
    from math import radians

    from gpusim.domain.flicker import Flicker
    from gpusim.domain.motion import Motion

    def numbers(name, default, count=1):
        values = [float(part) for part in found[name].split(":")] if name in found else default
        if not 1 <= len(values) <= count:
            raise ValueError
        return values

    if {"flicker", "pwm"} <= set(found):
        raise ValueError
    flicker = None
    if "flicker" in found:
        flicker = Flicker(*numbers("flicker", [], 2))
    elif "pwm" in found:
        frequency, duty = numbers("pwm", [], 2)
        flicker = Flicker(frequency, duty=duty)
    down, right = numbers("pan", [0.0, 0.0], 2)
    motion = Motion(
        (down, right),
        radians(numbers("roll", [0.0])[0]),
        1.0,
        numbers("zooming", [1.0])[0],
        numbers("shake", [0.0])[0],
        int(found.get("seed", 0)),
        tuple(numbers("travel", [0.0, 0.0, 0.0], 3)),
    )
    common: dict[str, Any] = {"motion": motion, "flicker": flicker, "merged": "merged" in found}
    common["period"] = numbers("period", [0.0])[0]
    if "instants" in found:
        common["instants"] = int(found["instants"])
    return common
