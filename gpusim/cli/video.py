"""`gpusim video`: a frame of every scene, as numbered files or an encoded video."""

import argparse
import time
from collections import Counter
from dataclasses import asdict
from functools import partial
from pathlib import Path

from gpusim.apps.video.ramps import Ramps
from gpusim.apps.video.segments import LENGTH, Shard, segments_of
from gpusim.cli.moving import MOST_FRAMES, add_moving, moving
from gpusim.cli.options import add_asked, describe_options, describe_verdicts, operated, whole
from gpusim.domain.account import STATUS, worst_state
from gpusim.domain.errors import BadFile, OutOfRange, UnknownName


def add_command(commands):
    """Add `video` to the subparsers of `gpusim`; its default `run` is `video`."""
    parser = commands.add_parser(
        "video",
        help="a frame of every scene, or of one scene again and again, as numbered "
        "files or an encoded video; goes on where it was interrupted",
    )
    add_asked(parser, several=True)
    parser.add_argument(
        "-o",
        "--out",
        required=True,
        metavar="OUT",
        help=".mp4 or .mkv, or numbered files: .png, "
        ".tif, .exr, .dng, .npz (a.png gives a_0000.png ...); with --lerobot a folder",
    )
    parser.add_argument(
        "--lerobot",
        metavar="TASK",
        help="add an episode of this task, such as 'pick up the cube', to "
        "the LeRobot data set (version 3.0) in the folder -o, or begin one",
    )
    add_moving(parser)
    parser.add_argument(
        "--seed", type=whole(0, 2**64 - 1), default=0, help="of the temporal noise (default: 0)"
    )
    parser.add_argument(
        "--blur",
        action="store_true",
        help="of the camera's movement while it exposes, and its "
        "rolling shutter: many times the work, as many instants a frame as the tolerance takes",
    )
    parser.add_argument(
        "--ramp",
        type=Ramps.parse,
        default=Ramps(),
        metavar="LIST",
        help="what changes from the first "
        "frame to the last, such as exposure=1/500..1/30,focus=0.3..5: exposure, iso, f-number, focus, "
        "and light, a factor",
    )
    parser.add_argument(
        "--lag",
        type=_lags,
        metavar="LIST",
        help="loops of the camera that follow the scene, and "
        "their time constants [s], such as exposure=0.3,white=1,focus=0.5; a pass over all scenes "
        "meters them first (default: exposure follows in the next frame, white is each frame's own)",
    )
    parser.add_argument(
        "--flicker",
        type=_flicker,
        metavar="HZ[,DEPTH]",
        help="all light is that of lamps on the "
        "mains: 100 or 120, and (most - least) / (most + least) (default: 1); rows see its phase",
    )
    parser.add_argument(
        "--pwm",
        type=_switched,
        metavar="HZ,DUTY",
        help="all light is switched so many times a second, and on for a part of the time",
    )
    parser.add_argument(
        "--codec",
        metavar="NAME",
        help="h264 (8 bit), h265 (10 bit), ffv1-raw (the mosaic, 16 bit, "
        ".mkv), ffv1-linear (linear RGB, 16 bit, .mkv) (default: h264)",
    )
    parser.add_argument(
        "--quality",
        type=_quality,
        metavar="CRF",
        help="constant rate factor of h264 and h265, "
        "0 .. 51, lower is better (default: the encoder's)",
    )
    parser.add_argument(
        "--shard",
        type=Shard.parse,
        default=Shard(),
        metavar="I/N",
        help="make part I of N alone, I from 0 on; all parts together are what one run makes",
    )
    parser.add_argument(
        "--segment",
        type=whole(1, MOST_FRAMES),
        default=LENGTH,
        metavar="N",
        help=f"frames that are made independently of all others (default: {LENGTH})",
    )
    parser.set_defaults(run=video)


def _lags(text):
    from gpusim.apps.video.loops import Lags

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
        why = (
            str(error)
            if isinstance(error, OutOfRange)
            else "wanted one or two numbers, such as 100,0.5"
        )
        raise argparse.ArgumentTypeError(f"{text!r}: {why}") from None


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
    from gpusim.apps.video.loops import NO_LOOPS, Loops
    from gpusim.apps.video.manifest import Plans, kept
    from gpusim.apps.video.video import within_period
    from gpusim.io.camera.cameras import open_camera
    from gpusim.pipeline.simulator import Simulator

    path = Path(arguments.out)
    scenes = moving(arguments)
    camera = within_period(operated(open_camera(arguments.camera), arguments), arguments.fps)
    for part in (0.0, 1.0):
        within_period(arguments.ramp.camera(camera, part), arguments.fps)  # said before the work
    if arguments.lag:
        arguments.lag.check(camera, arguments.ramp)
    simulator = Simulator(
        camera,
        device=arguments.device,
        tolerance=arguments.tolerance,
        guaranteed=arguments.guaranteed,
        strict=arguments.strict,
    )
    segments = segments_of(scenes.count, arguments.segment)
    own = arguments.shard.of(segments)
    target, manifest, made = _target(path, arguments, simulator, scenes, segments)
    loops = NO_LOOPS
    if arguments.lag:
        loops = Loops.kept_in(manifest, arguments.lag, scenes.count) or _metered(
            arguments, simulator, scenes
        )
        made["loops"] = asdict(loops)
    with kept(manifest, made, target.words, target.is_empty):
        return _written(target, simulator, scenes, own, arguments.seed, loops, Plans(manifest))


def _metered(arguments, simulator, scenes):
    """Loops of a pass over all scenes."""
    from tqdm import tqdm

    from gpusim.apps.video.loops import metered

    with tqdm(total=scenes.count, desc="metering", unit="frame", disable=None) as bar:
        return metered(
            simulator,
            scenes,
            arguments.lag,
            arguments.ramp,
            float(1 / arguments.fps),
            seed=arguments.seed,
            seen=bar.update,
        )


def _written(target, simulator, scenes, own, seed, loops, plans):
    """Write what is missing, and say what was done; plans: of the manifest. Returns the exit status."""
    from tqdm import tqdm

    from gpusim.apps.video.video import EncodedFile

    begun, worst, count, states = time.perf_counter(), None, 0, Counter()
    total, ends = sum(len(segment) for segment in own), {segment[-1] for segment in own}
    with plans, tqdm(total=total, unit="frame", disable=None) as bar:
        for one in target.write(simulator, scenes, own, seed, loops):
            count += 1
            plans.add(one.plan, one.number, one.number in ends)
            error = one.account.total.rms
            worst = error if worst is None else max(worst, error)
            if simulator.tolerance is not None:
                states[one.account.verdict(simulator.tolerance).state] += 1
            bar.set_postfix_str(f"worst error {worst:.2g}", refresh=False)
            bar.update()
    seconds = time.perf_counter() - begun
    if count:
        print(
            f"{count} frames in {seconds:.1f} s, {count / seconds:.3g} frames/s; worst predicted error {worst:.2g} "
            f"relative rms{describe_verdicts(states)}; {plans}"
        )
    if count < total:
        print(f"{total - count} frames were there already")
    if isinstance(target, EncodedFile):
        print(
            target.told if target.finish() else f"{target.path} is made by the last of the shards"
        )
    return STATUS[worst_state(states)]


def _target(path, arguments, simulator, scenes, segments):
    """What is written, its manifest's file and what that holds. Raises BadFile, UnknownName, OutOfRange."""
    import dataclasses

    from gpusim import __version__
    from gpusim.apps.video.codecs import CODECS, CONTAINERS, Encoder, codec_of
    from gpusim.apps.video.lerobot import Episode
    from gpusim.apps.video.manifest import file_digest
    from gpusim.apps.video.video import EncodedFile, NumberedFiles, blurred_frames, frames
    from gpusim.backends.probe import made_by
    from gpusim.domain.digest import digest
    from gpusim.io.atomic import check_output
    from gpusim.io.frame.frames import FORMATS, check_format

    frames_of = partial(
        blurred_frames if arguments.blur or arguments.flicker or arguments.pwm else frames,
        ramps=arguments.ramp,
    )
    camera, suffix = simulator.camera, path.suffix.lower()
    made = {
        "gpusim": __version__,
        "camera": digest(camera),
        "scenes": scenes.names,
        "actors": [file_digest(cast.path) for cast in arguments.actor or ()],
        "contents of files": [
            file_digest(name)
            for name in (
                scenes.names
                if len(arguments.scene) > 1 or Path(arguments.scene[0]).is_dir()
                else arguments.scene
            )
        ],
        "frames": scenes.count,
        "options": describe_options(arguments, ("lerobot", "any_order", "codec", "quality")),
        "device": made_by(simulator.device),
    }
    is_episode = arguments.lerobot is not None
    if is_episode or suffix in CONTAINERS:
        codec = codec_of(Path("episode.mp4") if is_episode else path, arguments.codec)
        sensor = simulator.readout.output
        if is_episode and codec != CODECS["h264"]:
            raise OutOfRange("--codec of a LeRobot data set", arguments.codec, "h264")
        if is_episode and arguments.shard.count > 1:
            raise OutOfRange(
                "--shard of a LeRobot data set", "given", "none: one run makes an episode"
            )
        if codec.output == "raw" and (sensor.bits > 16 or sensor.stacked):
            raise OutOfRange(
                "raw values of an encoded video",
                "stacked pixels" if sensor.stacked else f"{sensor.bits} bits",
                "one mosaic of up to 16 bits; .npz files hold any",
            )
        shape = simulator.readout.output_shape(next(scenes.between(0, 1)).shape)
        encoder = Encoder(
            codec, shape, arguments.fps, camera.display, camera.processor.tone, arguments.quality
        )
        if is_episode:
            target = Episode(
                path,
                arguments.lerobot,
                camera.name,
                shape,
                arguments.fps,
                arguments.seed,
                codec,
                encoder,
                segments,
                frames_of,
            )
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
        raise OutOfRange(
            "--codec, --quality", f"with {suffix} files", f"for {' and '.join(CONTAINERS)} alone"
        )
    check_format(path, dataclasses.replace(camera, sensor=simulator.readout.output))
    numbered = NumberedFiles(path, scenes.count, frames_of)
    manifest = path.with_name(f"{path.stem}_video.json")
    check_output(manifest)
    there = next((name for name in map(numbered.name, range(scenes.count)) if name.exists()), None)
    if there is not None and not manifest.exists():
        raise BadFile(
            there,
            "is there already, and not of a video that was begun; remove it, or give -o another name",
        )
    return numbered, manifest, made
