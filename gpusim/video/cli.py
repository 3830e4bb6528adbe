"""`gpusim video`: a frame of every scene, as numbered files or an encoded video."""

import argparse
import time
from dataclasses import asdict
from fractions import Fraction
from functools import partial
from math import radians
from pathlib import Path

from gpusim.domain.errors import BadFile, OutOfRange, UnknownName
from gpusim.options import add_asked, operated, scene_of, whole
from gpusim.video.cast import Cast
from gpusim.video.ramps import Ramps
from gpusim.video.segments import LENGTH, Shard, segments_of

MOST_FRAMES = 10**7
FASTEST = 10**5  # [frame/s]
# Beside camera and scenes what frames depend on
OPTIONS = ("transfer", "size", "light", "luminance", "border", "samples_per_pixel", "band", "tolerance", "guaranteed",
           "seed", "segment", "pan", "roll", "zoom", "zooming", "shake", "blur", "flicker", "pwm", "ramp", "lag",
           "actor", "fps")


def add_command(commands):
    """Add `video` to the subparsers of `gpusim`; its default `run` is `video`."""
    parser = commands.add_parser("video", help="a frame of every scene, or of one scene again and again, as numbered "
                                 "files or an encoded video; goes on where it was interrupted")
    add_asked(parser, several=True)
    parser.add_argument("-o", "--out", required=True, metavar="OUT", help=".mp4 or .mkv, or numbered files: .png, "
                        ".exr, .dng, .npz (a.png gives a_0000.png ...); with --lerobot a folder")
    parser.add_argument("--lerobot", metavar="TASK", help="add an episode of this task, such as 'pick up the cube', to "
                        "the LeRobot data set (version 3.0) in the folder -o, or begin one")
    parser.add_argument("--frames", type=whole(1, MOST_FRAMES), metavar="N", help="of one scene, or the first ones of "
                        "a video (default: one for each scene, all of a video)")
    parser.add_argument("--fps", type=_rate, default=Fraction(30), metavar="RATE", help="frames per second, such as "
                        "24, 29.97 or 30000/1001; no exposure is longer than a frame (default: 30)")
    parser.add_argument("--seed", type=whole(0, 2**64 - 1), default=0, help="of the temporal noise (default: 0)")
    parser.add_argument("--pan", type=_pair, default=(0.0, 0.0), metavar="DOWN,RIGHT", help="camera's movement over "
                        "the scene [pixel/s]")
    parser.add_argument("--roll", type=_number, default=0.0, metavar="DEG_S", help="camera's turn about its axis "
                        "[degree/s]")
    parser.add_argument("--zoom", type=_number, default=1.0, metavar="Z", help="magnification at the first frame, "
                        "from 1 on: 1.1 leaves a margin for a camera that moves (default: 1)")
    parser.add_argument("--zooming", type=_number, default=1.0, metavar="FACTOR", help="by which it grows in a second")
    parser.add_argument("--shake", type=_number, default=0.0, metavar="PIXELS", help="root mean square of a hand's "
                        "displacement, from --seed")
    parser.add_argument("--blur", action="store_true", help="of the camera's movement while it exposes, and its "
                        "rolling shutter: many times the work, as many instants a frame as the tolerance takes")
    parser.add_argument("--actor", type=Cast.parse, action="append", metavar="PNG,...", help="a picture with alpha "
                        "that moves before a photograph, the nearest first: car.png,at=40:-200,pan=0:120 (its middle's "
                        "row and column from the scene's, pixels a second), roll=DEG_S, zoom=Z, zooming=FACTOR")
    parser.add_argument("--ramp", type=Ramps.parse, default=Ramps(), metavar="LIST", help="what changes from the first "
                        "frame to the last, such as exposure=1/500..1/30,focus=0.3..5: exposure, iso, f-number, focus, "
                        "and light, a factor")
    parser.add_argument("--lag", type=_lags, metavar="LIST", help="loops of the camera that follow the scene, and "
                        "their time constants [s], such as exposure=0.3,white=1,focus=0.5; a pass over all scenes "
                        "meters them first (default: exposure follows in the next frame, white is each frame's own)")
    parser.add_argument("--flicker", type=_flicker, metavar="HZ[,DEPTH]", help="all light is that of lamps on the "
                        "mains: 100 or 120, and (most - least) / (most + least) (default: 1); rows see its phase")
    parser.add_argument("--pwm", type=_switched, metavar="HZ,DUTY", help="all light is switched so many times a "
                        "second, and on for a part of the time")
    parser.add_argument("--codec", metavar="NAME", help="h264 (8 bit), h265 (10 bit), ffv1-raw (the mosaic, 16 bit, "
                        ".mkv), ffv1-linear (linear RGB, 16 bit, .mkv) (default: h264)")
    parser.add_argument("--quality", type=_quality, metavar="CRF", help="constant rate factor of h264 and h265, "
                        "0 .. 51, lower is better (default: the encoder's)")
    parser.add_argument("--shard", type=Shard.parse, default=Shard(), metavar="I/N", help="make part I of N alone, I "
                        "from 0 on; all parts together are what one run makes")
    parser.add_argument("--segment", type=whole(1, MOST_FRAMES), default=LENGTH, metavar="N", help="frames that are "
                        f"made independently of all others (default: {LENGTH})")
    parser.add_argument("--transfer", metavar="NAME", help="what the codes of a video stand for, in place of its tag: "
                        "bt709, srgb, pq, hlg, linear, gamma2.2, gamma2.8")
    parser.add_argument("--any-order", action="store_true", help="take scene files as they are given, whatever their "
                        "numbers")
    parser.set_defaults(run=video)


def _rate(text):
    try:
        rate = Fraction(text).limit_denominator(1001)
    except (ValueError, ZeroDivisionError):
        rate = Fraction(0)
    if not 0 < rate <= FASTEST:
        raise argparse.ArgumentTypeError(f"{text!r}: wanted frames per second, such as 24, 29.97 or 30000/1001")
    return rate


def _number(text):
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: wanted a number") from None


def _lags(text):
    from gpusim.video.loops import Lags

    return Lags.parse(text)


def _flicker(text):
    """Of HZ or HZ,DEPTH."""
    frequency, _, depth = text.partition(",")
    return _of_light(text, frequency=frequency, depth=depth or 1)


def _switched(text):
    """Of HZ,DUTY."""
    frequency, _, duty = text.partition(",")
    return _of_light(text, frequency=frequency, duty=duty)


def _of_light(text, **numbers):
    from gpusim.domain.flicker import Flicker

    try:
        return Flicker(**{name: float(number) for name, number in numbers.items()})
    except (ValueError, OutOfRange) as error:
        why = str(error) if isinstance(error, OutOfRange) else "wanted one or two numbers, such as 100,0.5"
        raise argparse.ArgumentTypeError(f"{text!r}: {why}") from None


def _pair(text):
    try:
        down, right = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: wanted two numbers, DOWN,RIGHT, such as 0,20") from None
    return down, right


def _quality(text):
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 51:
        raise argparse.ArgumentTypeError(f"{text!r}: wanted a number, 0 .. 51")
    return value


def video(arguments) -> int:
    """Run `gpusim video`; returns the exit status. Raises GpusimError."""
    from gpusim.data.cameras import open_camera
    from gpusim.domain.motion import Motion
    from gpusim.simulator import Simulator
    from gpusim.video.loops import NO_LOOPS, Loops
    from gpusim.video.manifest import kept
    from gpusim.video.scenes import Moving
    from gpusim.video.video import within_period

    path = Path(arguments.out)
    scenes, motion = _scenes(arguments), Motion(arguments.pan, radians(arguments.roll), arguments.zoom,
                                                arguments.zooming, arguments.shake, arguments.seed)
    if arguments.flicker and arguments.pwm:
        raise OutOfRange("--pwm", "given", "without --flicker: all light is one or the other")
    actors = tuple(cast.actor() for cast in arguments.actor or ())
    if motion != Motion(seed=arguments.seed) or arguments.flicker or arguments.pwm or actors:
        scenes = Moving(scenes, motion, arguments.fps, arguments.flicker or arguments.pwm, actors)
        next(scenes.between(0, 1))  # whose actors fit or not
    elif arguments.blur:
        raise OutOfRange("--blur", "given", "with --pan, --roll, --zooming, --shake or --actor: nothing moves")
    camera = within_period(operated(open_camera(arguments.camera), arguments), arguments.fps)
    for part in (0.0, 1.0):
        within_period(arguments.ramp.camera(camera, part), arguments.fps)  # said before the work
    if arguments.lag:
        arguments.lag.check(camera, arguments.ramp)
    simulator = Simulator(camera, device=arguments.device, tolerance=arguments.tolerance,
                          guaranteed=arguments.guaranteed, strict=arguments.strict)
    segments = segments_of(scenes.count, arguments.segment)
    own = arguments.shard.of(segments)
    target, manifest, made = _target(path, arguments, simulator, scenes, segments)
    loops = NO_LOOPS
    if arguments.lag:
        loops = Loops.kept_in(manifest) or _metered(arguments, simulator, scenes)
        made["loops"] = asdict(loops)
    with kept(manifest, made, target.words, target.is_empty):
        return _written(target, simulator, scenes, own, arguments.seed, loops)


def _metered(arguments, simulator, scenes):
    """Loops of a pass over all scenes."""
    from tqdm import tqdm

    from gpusim.video.loops import metered

    with tqdm(total=scenes.count, desc="metering", unit="frame", disable=None) as bar:
        return metered(simulator, scenes, arguments.lag, arguments.ramp, float(1 / arguments.fps),
                       seed=arguments.seed, seen=bar.update)


def _written(target, simulator, scenes, own, seed, loops):
    """Write what is missing, and say what was done. Returns the exit status."""
    from tqdm import tqdm

    from gpusim.video.video import EncodedFile

    begun, worst, count, is_met = time.perf_counter(), None, 0, True
    total = sum(len(segment) for segment in own)
    with tqdm(total=total, unit="frame", disable=None) as bar:
        for one in target.write(simulator, scenes, own, seed, loops):
            count += 1
            error = one.account.total.rms
            worst = error if worst is None else max(worst, error)
            if simulator.tolerance is not None:
                is_met = is_met and one.account.verdict(simulator.tolerance).met
            bar.set_postfix_str(f"worst error {worst:.2g}", refresh=False)
            bar.update()
    seconds = time.perf_counter() - begun
    if count:
        print(f"{count} frames in {seconds:.1f} s, {count / seconds:.3g} frames/s; worst predicted error {worst:.2g} "
              "relative rms" + ("" if simulator.tolerance is None else
                                f"; tolerance {'met' if is_met else 'NOT met'}"))
    if count < total:
        print(f"{total - count} frames were there already")
    if isinstance(target, EncodedFile):
        print(target.told if target.finish() else f"{target.path} is made by the last of the shards")
    return 0 if is_met else 1


def _scenes(arguments):
    """What the frames show. Raises BadFile, BadData and what `open_scene` does."""
    from gpusim.video.film import SUFFIXES, Film
    from gpusim.video.scenes import Files, First, Still, check_numbers, numbered_files

    names, films = arguments.scene, [name for name in arguments.scene if Path(name).suffix.lower() in SUFFIXES]
    if films and len(names) > 1:
        raise BadFile(films[0], "a video among several scenes; give it alone")
    if arguments.transfer is not None and not films:
        raise OutOfRange("--transfer", arguments.transfer, f"for videos alone ({', '.join(SUFFIXES)})")
    if films:
        if arguments.size or arguments.band:
            raise OutOfRange("--size, --band", "given", "neither for a video, which has its own size and colours")
        options = {name: getattr(arguments, name) for name in ("light", "luminance", "border", "samples_per_pixel")}
        film = Film(Path(names[0]), arguments.transfer,
                    **{name: value for name, value in options.items() if value is not None})
        return film if arguments.frames is None else First(film, arguments.frames)
    if len(names) == 1 and Path(names[0]).is_dir():
        paths = numbered_files(Path(names[0]))
    elif len(names) == 1:
        return Still(scene_of(arguments, names[0]), arguments.frames or 1)
    else:
        paths = [Path(name) for name in names]
    if arguments.frames is not None:
        raise OutOfRange("--frames", arguments.frames, f"for one scene; {len(paths)} scenes make as many frames")
    if not arguments.any_order:
        check_numbers(paths)
    return Files(paths, lambda path: scene_of(arguments, str(path)))


def _target(path, arguments, simulator, scenes, segments):
    """What is written, its manifest's file and what that holds. Raises BadFile, UnknownName, OutOfRange."""
    import dataclasses

    from gpusim import __version__
    from gpusim.backends.probe import made_by
    from gpusim.io.atomic import check_output
    from gpusim.io.frames import FORMATS, check_format
    from gpusim.video.codecs import CODECS, CONTAINERS, Encoder, codec_of
    from gpusim.video.lerobot import Episode
    from gpusim.video.manifest import digest, file_digest
    from gpusim.video.video import EncodedFile, NumberedFiles, blurred_frames, frames

    frames_of = partial(blurred_frames if arguments.blur or arguments.flicker or arguments.pwm else frames,
                        ramps=arguments.ramp)
    camera, suffix = simulator.camera, path.suffix.lower()
    made = {"gpusim": __version__, "camera": digest(camera), "scenes": scenes.names,
            "actors": [file_digest(cast.path) for cast in arguments.actor or ()],
            "contents of files": [file_digest(name) for name in (scenes.names if len(arguments.scene) > 1 or Path(
                arguments.scene[0]).is_dir() else arguments.scene)], "frames": scenes.count,
            "options": {name: str(getattr(arguments, name)) for name in OPTIONS},
            "device": made_by(simulator.device)}
    is_episode = arguments.lerobot is not None
    if is_episode or suffix in CONTAINERS:
        codec = codec_of(Path("episode.mp4") if is_episode else path, arguments.codec)
        sensor = simulator.readout.output
        if is_episode and codec != CODECS["h264"]:
            raise OutOfRange("--codec of a LeRobot data set", arguments.codec, "h264")
        if is_episode and arguments.shard.count > 1:
            raise OutOfRange("--shard of a LeRobot data set", "given", "none: one run makes an episode")
        if codec.output == "raw" and (sensor.bits > 16 or sensor.stacked):
            raise OutOfRange("raw values of an encoded video", "stacked pixels" if sensor.stacked else
                             f"{sensor.bits} bits", "one mosaic of up to 16 bits; .npz files hold any")
        shape = simulator.readout.output_shape(next(scenes.between(0, 1)).shape)
        encoder = Encoder(codec, shape, arguments.fps, camera.display, camera.processor.tone, arguments.quality)
        if is_episode:
            target = Episode(path, arguments.lerobot, camera.name, shape, arguments.fps, arguments.seed, codec, encoder,
                             segments, frames_of)
            made["task"] = arguments.lerobot
        else:
            check_output(path)
            target = EncodedFile(path, codec, encoder, segments, frames_of)
            if path.exists() and not target.folder.exists():
                raise BadFile(path, "is there already; remove it, or give -o another name")
        try:
            if is_episode:
                path.mkdir(exist_ok=True)
            target.folder.mkdir(exist_ok=True)
        except OSError as error:
            raise BadFile(target.folder, f"cannot be made: {error.strerror or error}") from error
        made |= {"fps": str(arguments.fps), "codec": arguments.codec, "quality": arguments.quality}
        return target, target.folder / "video.json", made
    if suffix not in FORMATS:
        raise UnknownName("output format", suffix or str(path), [*CONTAINERS, *FORMATS])
    if arguments.codec is not None or arguments.quality is not None:
        raise OutOfRange("--codec, --quality", f"with {suffix} files", f"for {' and '.join(CONTAINERS)} alone")
    check_format(path, dataclasses.replace(camera, sensor=simulator.readout.output))
    numbered = NumberedFiles(path, scenes.count, frames_of)
    manifest = path.with_name(f"{path.stem}_video.json")
    check_output(manifest)
    there = next((name for name in map(numbered.name, range(scenes.count)) if name.exists()), None)
    if there is not None and not manifest.exists():
        raise BadFile(there, "is there already, and not of a video that was begun; remove it, or give -o another name")
    return numbered, manifest, made
