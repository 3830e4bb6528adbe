"""What a command line says of scenes that move, or of several: its options, and the scenes."""

import argparse
from fractions import Fraction
from math import radians
from pathlib import Path

from gpusim.apps.video.actors import Cast
from gpusim.cli.options import scene_of, whole
from gpusim.domain.errors import BadFile, OutOfRange

MOST_FRAMES = 10**7
FASTEST = 10**5  # [frame/s]


def add_moving(parser):
    """Add the options of scenes, and of a camera that moves before them."""
    parser.add_argument(
        "--frames",
        type=whole(1, MOST_FRAMES),
        metavar="N",
        help="of one scene, or the first ones of "
        "a video (default: one for each scene, all of a video)",
    )
    parser.add_argument(
        "--fps",
        type=_rate,
        default=Fraction(30),
        metavar="RATE",
        help="frames per second, such as "
        "24, 29.97 or 30000/1001; no exposure is longer than a frame (default: 30)",
    )
    parser.add_argument(
        "--pan",
        type=_pair,
        default=(0.0, 0.0),
        metavar="DOWN,RIGHT",
        help="camera's movement over the scene [pixel/s]",
    )
    parser.add_argument(
        "--roll",
        type=_number,
        default=0.0,
        metavar="DEG_S",
        help="camera's turn about its axis [degree/s]",
    )
    parser.add_argument(
        "--zoom",
        type=_number,
        default=1.0,
        metavar="Z",
        help="magnification at the first frame, "
        "from 1 on: 1.1 leaves a margin for a camera that moves (default: 1)",
    )
    parser.add_argument(
        "--zooming",
        type=_number,
        default=1.0,
        metavar="FACTOR",
        help="by which it grows in a second",
    )
    parser.add_argument(
        "--shake",
        type=_number,
        default=0.0,
        metavar="PIXELS",
        help="root mean square of a hand's displacement, from --seed",
    )
    parser.add_argument(
        "--actor",
        type=Cast.parse,
        action="append",
        metavar="PNG,...",
        help="a picture with alpha "
        "that moves before a photograph, the nearest first: car.png,at=40:-200,pan=0:120 (its middle's "
        "row and column from the scene's, pixels a second), roll=DEG_S, zoom=Z, zooming=FACTOR",
    )
    parser.add_argument(
        "--transfer",
        metavar="NAME",
        help="what the codes of a video stand for, in place of its tag: "
        "bt709, srgb, pq, hlg, linear, gamma2.2, gamma2.8",
    )
    parser.add_argument(
        "--any-order",
        action="store_true",
        help="take scene files as they are given, whatever their numbers",
    )


def moving(arguments):
    """The `Scenes` of all frames. Raises BadFile, BadData and what `open_scene` does."""
    from gpusim.apps.video.scenes import Moving
    from gpusim.domain.motion import Motion

    scenes, motion = (
        _scenes(arguments),
        Motion(
            arguments.pan,
            radians(arguments.roll),
            arguments.zoom,
            arguments.zooming,
            arguments.shake,
            arguments.seed,
        ),
    )
    if arguments.flicker and arguments.pwm:
        raise OutOfRange("--pwm", "given", "without --flicker: all light is one or the other")
    actors = tuple(cast.actor() for cast in arguments.actor or ())
    if motion != Motion(seed=arguments.seed) or arguments.flicker or arguments.pwm or actors:
        scenes = Moving(scenes, motion, arguments.fps, arguments.flicker or arguments.pwm, actors)
        next(scenes.between(0, 1))  # whose actors fit or not
    elif arguments.blur:
        raise OutOfRange(
            "--blur", "given", "with --pan, --roll, --zooming, --shake or --actor: nothing moves"
        )
    return scenes


def _scenes(arguments):
    """What the frames show. Raises BadFile, BadData and what `open_scene` does."""
    from gpusim.apps.video.scenes import Files, First, Still, check_numbers, numbered_files
    from gpusim.apps.video.video_frames import SUFFIXES, Film

    names, films = (
        arguments.scene,
        [name for name in arguments.scene if Path(name).suffix.lower() in SUFFIXES],
    )
    if films and len(names) > 1:
        raise BadFile(films[0], "a video among several scenes; give it alone")
    if arguments.transfer is not None and not films:
        raise OutOfRange(
            "--transfer", arguments.transfer, f"for videos alone ({', '.join(SUFFIXES)})"
        )
    if films:
        if any(
            (
                arguments.size,
                arguments.band,
                arguments.fov,
                arguments.depth != "axis",
                arguments.wavelengths,
            )
        ):
            raise OutOfRange(
                "--size, --band, --wavelengths, --fov, --depth",
                "given",
                "none for a video, which has its own size and colours, and no depth",
            )
        options = {
            name: getattr(arguments, name)
            for name in ("light", "luminance", "border", "samples_per_pixel")
        }
        film = Film(
            Path(names[0]),
            arguments.transfer,
            **{name: value for name, value in options.items() if value is not None},
        )
        return film if arguments.frames is None else First(film, arguments.frames)
    if len(names) == 1 and Path(names[0]).is_dir():
        paths = numbered_files(Path(names[0]))
    elif len(names) == 1:
        return Still(scene_of(arguments, names[0]), arguments.frames or 1)
    else:
        paths = [Path(name) for name in names]
    if arguments.frames is not None:
        raise OutOfRange(
            "--frames", arguments.frames, f"for one scene; {len(paths)} scenes make as many frames"
        )
    if not arguments.any_order:
        check_numbers(paths)
    return Files(paths, lambda path: scene_of(arguments, str(path)))


def _rate(text):
    try:
        rate = Fraction(text).limit_denominator(1001)
    except (ValueError, ZeroDivisionError):
        rate = Fraction(0)
    if not 0 < rate <= FASTEST:
        raise argparse.ArgumentTypeError(
            f"{text!r}: wanted frames per second, such as 24, 29.97 or 30000/1001"
        )
    return rate


def _number(text):
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: wanted a number") from None


def _pair(text):
    try:
        down, right = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r}: wanted two numbers, DOWN,RIGHT, such as 0,20"
        ) from None
    return down, right
