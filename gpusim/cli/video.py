"""`gpusim video`: a frame of every scene, as numbered files or an encoded video."""

import argparse
import time
from collections import Counter
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusim.apps.video.ramps import Ramps
from gpusim.apps.video.segments import LENGTH, Shard, segments_of
from gpusim.cli.captures import capture_option
from gpusim.cli.moving import MOST_FRAMES, MovingRequest
from gpusim.cli.options import (
    DEVICES_HELP,
    describe_verdicts,
    flag,
    make_folder,
    number,
    option,
    seed_option,
    whole,
)
from gpusim.domain.account import STATUS, worst_state
from gpusim.domain.errors import BadFile, Conflict, OutOfRange, UnknownName

if TYPE_CHECKING:  # the command line starts without them
    from gpusim.apps.video.loops import Lags
    from gpusim.apps.video.scenes import Scenes
    from gpusim.captures.capture import Capture
    from gpusim.domain.flicker import Flicker

ENCODED = (".mp4", ".mkv", ".y4m")
TEXTS = {
    "help": "a frame of every scene, or frames of one scene, as numbered files or an encoded "
    "video; an interrupted run continues"
}


def _read_lags(text):
    """Return the lags of a camera's control loops."""
    from gpusim.apps.video.loops import Lags

    return Lags.parse(text)


def _read_flicker(text):
    """Return the flicker of HZ or HZ,DEPTH."""
    frequency, _, depth = text.partition(",")
    return _make_flicker(text, frequency=frequency, depth=depth or 1)


def _read_pwm(text):
    """Return the flicker of HZ,DUTY."""
    frequency, _, duty = text.partition(",")
    return _make_flicker(text, frequency=frequency, duty=duty)


def _make_flicker(text, **numbers):
    """Return a Flicker. numbers: its fields, as text."""
    from gpusim.domain.flicker import Flicker

    try:
        return Flicker(**{name: float(number) for name, number in numbers.items()})
    except (ValueError, OutOfRange) as error:
        why = "wanted one or two numbers, such as 100,0.5"
        if isinstance(error, OutOfRange):
            why = str(error)
        raise argparse.ArgumentTypeError(f"{text!r}: {why}") from None


def shard_option(part: str) -> Any:
    """Return the field of the option --shard. part: the part that a shard makes, in words."""
    return option(
        default=Shard(),
        in_key=False,
        type=Shard.parse,
        metavar="I/N",
        help=f"make only {part}",
    )


@dataclass(frozen=True, kw_only=True)
class VideoRequest(MovingRequest):
    """Options of `gpusim video`."""

    out: str = option(
        "-o",
        "--out",
        in_key=False,
        metavar="OUT",
        help="encoded video .mp4 or .mkv, uncompressed video .y4m, or numbered files .png, .jpg, "
        ".webp, .tif, .exr, .npy, .dng, .npz (a.png gives a_0000.png, ...); with --lerobot a folder",
        required=True,
    )
    lerobot: str | None = option(
        in_key=False,
        metavar="TASK",
        help="add an episode of this task, such as 'pick up the cube', to the LeRobot data set "
        "(version 3.0) in the folder -o, which is created if it does not exist",
    )
    device: str = option(default="auto", in_key=False, help=DEVICES_HELP)
    seed: int = seed_option("the temporal noise and of --shake")
    capture: "Capture | None" = capture_option("; a video merges them", moves=False)
    blur: bool = flag("simulate motion blur and rolling shutter (slow)")
    ramp: Ramps = option(
        default=Ramps(),
        type=Ramps.parse,
        metavar="LIST",
        help="settings that change from the first frame to the last, such as "
        "exposure=1/500..1/30,focus=0.3..5: exposure, iso, f-number, focus, and light (a factor)",
    )
    lag: "Lags | None" = option(
        type=_read_lags,
        metavar="LIST",
        help="time constants [s] of the camera's control loops, such as "
        "exposure=0.3,white=1,focus=0.5; all scenes are metered first (default: exposure follows "
        "in the next frame, the white balance is each frame's own)",
    )
    flicker: "Flicker | None" = option(
        type=_read_flicker,
        metavar="HZ[,DEPTH]",
        help="all light flickers as lamps on mains power do: at 100 or 120 Hz, with the modulation "
        "depth (max - min) / (max + min) (default: 1); rows see it in turn",
    )
    pwm: "Flicker | None" = option(
        type=_read_pwm,
        metavar="HZ,DUTY",
        help="all light is switched at this frequency and is on for this part of the time",
    )
    average: int | None = option(
        type=whole(2, 16),
        metavar="N",
        help="merge each frame with up to N - 1 frames before it, 2 .. 16, aligned to it, so that noise "
        "falls; what moves has no ghosts; frames of another exposure are left out",
    )
    codec: str | None = option(
        in_key=False,
        metavar="NAME",
        help="h264 (8 bit), h265 (10 bit), h265-12 (12 bit), ffv1-raw (the mosaic, 16 bit, .mkv), ffv1-linear "
        "(linear RGB, 16 bit, .mkv); .y4m holds y4m (4:2:0, 8 bit, uncompressed) (default: h264)",
    )
    quality: float | None = option(
        in_key=False,
        type=number("a number, 0 .. 100", lambda value: 0 <= value <= 100),
        metavar="N",
        help="constant rate factor of h264 and h265, 0 .. 51, lower is better (default: the "
        "encoder's); quality of .jpg and .webp files, 1 .. 100, higher is better (default: 95)",
    )
    shard: Shard = shard_option("part I of N, counted from 0; all parts together equal one run")
    segment: int = option(
        default=LENGTH,
        type=whole(1, MOST_FRAMES),
        metavar="N",
        help=f"frames per segment; segments are independent of each other (default: {LENGTH})",
    )

    @property
    def suffix(self) -> str:
        """Suffix of the output, in lower case."""
        from gpusim.io.frame.frames import suffix_of

        return suffix_of(self.out).lower()

    def check_settings(self) -> None:
        """Raise Conflict for two options that set the same, or that cannot hold together."""
        from gpusim.io.frame.frames import LOSSY, WITHOUT_PICTURE

        ramped = dict(self.ramp.ranges)
        for name in ("exposure", "iso", "f_number", "focus"):
            flag = name.replace("_", "-")
            if flag in ramped:
                self.refuse(name, f"--ramp {flag} sets it in every frame", "give only one of them")
        if self.lag is not None and self.lag.focus is not None:
            self.refuse("focus", "--lag focus sets it in every frame", "give only one of them")
        if self.capture is not None:
            self.refuse("average", "--capture merges frames of its own")
        if self.blur or self.flicker or self.pwm:
            remedy = "leave out --blur, --flicker and --pwm"
            self.refuse("average", "it merges frames without movement in themselves", remedy)
        if self.flicker is not None:
            self.refuse("pwm", "--flicker already sets the light", "give only one of them")
        if self.lerobot is None and self.suffix not in ENCODED:
            self.refuse("codec", f"only {', '.join(ENCODED)} files are encoded")
            if self.suffix not in LOSSY:
                self.refuse("quality", f"only {', '.join((*ENCODED, *LOSSY))} files have one")
        has_picture = self.lerobot is not None or self.suffix not in WITHOUT_PICTURE
        if not has_picture or self.codec == "ffv1-raw":
            words = "the output holds raw values, not a picture"
            self.refuse_picture(words, suffixes=(self.suffix,))

    def check_scenes(self, scenes: "Scenes") -> None:
        """Raise Conflict for options that have no effect on these scenes."""
        if not any(map(self.is_changed, ("pan", "roll", "zooming", "shake", "travel", "actor"))):
            remedy = "add --pan, --roll, --zooming, --shake, --travel or --actor"
            self.refuse("blur", "nothing moves", remedy)
        if not (self.blur or self.flicker or self.pwm):
            self.check_movement(scenes)
        if scenes.count == 1:
            for name in ("ramp", "lag", "average"):
                self.refuse(name, "a single frame does not change", "make more --frames")


def video(request: VideoRequest) -> int:
    """Run `gpusim video`.

    Args:
        request: Options of the command.

    Returns:
        The exit status.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    from gpusim.apps.devices import run_together
    from gpusim.apps.video.averaged import averaged_frames
    from gpusim.apps.video.loops import NO_LOOPS, Loops
    from gpusim.apps.video.manifest import Plans, keep_manifest
    from gpusim.apps.video.pipeline import Clock
    from gpusim.apps.video.video import ONE_FRAME, captured_frames, frames, within_period

    request.check_settings()
    scenes = request.open_scenes(request.seed, request.flicker or request.pwm)
    request.check_scenes(scenes)
    rate = request.frame_rate(scenes)
    camera = within_period(request.open_camera(), rate)
    for part in (0.0, 1.0):  # refuse a ramp before the work
        within_period(request.ramp.camera(camera, part), rate)
    if request.lag:
        request.lag.check(camera, request.ramp)
    simulator = request.open_simulator(camera, several=True)
    segments = segments_of(scenes.count, request.segment)
    own = request.shard.of(segments)
    target, manifest, made = _target(request, simulator, scenes, segments)
    is_blurred = bool(request.blur or request.flicker or request.pwm)
    capture, average = request.capture or ONE_FRAME, request.average
    capture.check_size("frames of a video")
    capture = replace(capture, merged=capture.merged or capture.has_frames)
    request.refuse_unread("video")
    for folder in target.folders:
        make_folder(folder)
    loops = NO_LOOPS
    if request.lag:
        known = Loops.read_manifest(manifest, request.lag, scenes.count)
        loops = known or _meter(request, simulator, scenes)
        made["loops"] = asdict(loops)
    generator: Any = frames
    if is_blurred or request.capture:
        generator = partial(captured_frames, capture=capture, blur=is_blurred)
    elif average:
        generator = partial(averaged_frames, count=average)
    settings = {"seed": request.seed, "ramps": request.ramp, "loops": loops}
    written, simulators, clock = [], simulator.on_devices(), Clock()
    for turn, one in enumerate(simulators):  # each makes whole segments, of scenes of its own
        shown = (
            request.open_scenes(request.seed, request.flicker or request.pwm) if turn else scenes
        )
        make = partial(generator, one, shown, **settings)
        written.append(target.write(make, own[turn :: len(simulators)], clock))
    with keep_manifest(manifest, made, target.words, target.is_empty):
        for note in next(scenes.between(0, 1)).notes:
            print(f"note: {note}")
        return _report(
            target, run_together(written), own, simulator.tolerance, Plans(manifest), clock
        )


def _meter(request, simulator, scenes):
    """Return the loops of a pass over all scenes."""
    from tqdm import tqdm

    from gpusim.apps.video.loops import meter_scenes

    with tqdm(total=scenes.count, desc="metering", unit="frame", disable=None) as bar:
        return meter_scenes(
            simulator,
            scenes,
            request.lag,
            request.ramp,
            float(1 / request.frame_rate(scenes)),
            seed=request.seed,
            seen=bar.update,
        )


def _find_limit(clock, seconds):
    """Return the part of the pipeline that the others wait for, in words. seconds: of the whole."""
    frames, scenes = (min(clock.seconds[name], seconds) for name in ("frames", "scenes"))
    if frames < seconds / 2:
        return "limited by encoding and writing"
    return f"limited by {'reading the scenes' if scenes > frames / 2 else 'computing frames'}"


def _report(target, written, own, tolerance, plans, clock):
    """Write what is missing, and say what was done.

    written: frames of the target, each after it was written. own: segments of this run. plans: of
    the manifest. clock: times of the parts. Returns the exit status.
    """
    from tqdm import tqdm

    from gpusim.apps.video.video import EncodedFile

    begun, worst, count, states = time.perf_counter(), None, 0, Counter()
    total, ends = sum(len(segment) for segment in own), {segment[-1] for segment in own}
    with plans, tqdm(total=total, unit="frame", disable=None) as bar:
        for one in written:
            count += 1
            plans.add(one.plan, one.number, one.number in ends)
            error = one.account.total.rms
            worst = error if worst is None else max(worst, error)
            if tolerance is not None:
                states[one.account.verdict(tolerance).state] += 1
            limit = _find_limit(clock, time.perf_counter() - begun)
            bar.set_postfix_str(f"worst error {worst:.2g}, {limit}", refresh=False)
            bar.update()
    seconds = time.perf_counter() - begun
    if count:
        print(
            f"{count} frames in {seconds:.1f} s, {count / seconds:.3g} frames/s, "
            f"{_find_limit(clock, seconds)}; worst predicted error {worst:.2g} "
            f"relative rms{describe_verdicts(states)}; {plans}"
        )
    if count < total:
        print(f"{total - count} frames were there already")
    if isinstance(target, EncodedFile):
        print(target.result if target.finish() else f"{target.path} will be made by the last shard")
    return STATUS[worst_state(states)]


def _target(request, simulator, scenes, segments):
    """Return the output, the path of its manifest and the manifest's content.

    Raises BadFile, Conflict, OutOfRange, UnknownName.
    """
    from gpusim.apps.video.manifest import describe_run, file_digest
    from gpusim.io.frame.frames import FORMATS

    is_list = len(request.scene) > 1 or Path(request.scene[0]).is_dir()
    shown = scenes.names if is_list else request.scene
    made = describe_run(
        simulator,
        shown,
        request.for_manifest(),
        scenes=scenes.names,
        actors=[file_digest(cast.path) for cast in request.actor],
        frames=scenes.count,
    )
    path = Path(request.out)
    if request.lerobot is not None or request.suffix in ENCODED:
        target, more = _open_encoded(request, path, simulator, scenes, segments)
        return target, target.folder / "video.json", made | more
    if request.suffix not in FORMATS:
        raise UnknownName("output format", request.suffix or request.out, [*ENCODED, *FORMATS])
    if request.is_given("quality"):
        made["quality"] = request.quality
    return *_open_numbered(path, simulator, scenes, request.quality), made


def _open_numbered(path, simulator, scenes, quality):
    """Return numbered files as the output, and the path of their manifest. quality: of LOSSY files, or None.

    Raises BadFile, OutOfRange.
    """
    from gpusim.apps.video.video import NumberedFiles
    from gpusim.io.atomic import check_output
    from gpusim.io.frame.frames import check_format

    check_format(path, replace(simulator.camera, sensor=simulator.readout.output), quality=quality)
    numbered = NumberedFiles(path, scenes.count, None if quality is None else int(quality))
    manifest = path.with_name(f"{path.stem}_video.json")
    check_output(manifest)
    there = next((name for name in map(numbered.name, range(scenes.count)) if name.exists()), None)
    if there is not None and not manifest.exists():
        why = "exists, and no video was begun here; remove it, or give -o another name"
        raise BadFile(there, why)
    return numbered, manifest


def _open_encoded(request, path, simulator, scenes, segments):
    """Return an encoded video or an episode as the output, and its part of the manifest."""
    from gpusim.apps.video.codecs import CODECS, RAW, Encoder, codec_of
    from gpusim.apps.video.lerobot import Episode
    from gpusim.apps.video.video import EncodedFile, RawFile
    from gpusim.io.atomic import check_output

    camera, sensor = simulator.camera, simulator.readout.output
    is_episode = request.lerobot is not None
    codec = codec_of(Path("episode.mp4") if is_episode else path, request.codec)
    if is_episode and codec != CODECS["h264"]:
        remedy = "leave --codec or --lerobot out"
        raise Conflict("--codec", "the videos of a LeRobot data set are h264", remedy)
    if is_episode and request.shard.count > 1:
        raise Conflict("--shard", "one run makes an episode", "leave --shard or --lerobot out")
    if codec.output == "raw" and (sensor.bits > 16 or sensor.stacked):
        raise OutOfRange(
            "raw values of an encoded video",
            "stacked pixels" if sensor.stacked else f"{sensor.bits} bits",
            "one mosaic of up to 16 bits; .npz files hold any",
        )
    shape = simulator.readout.output_shape(next(scenes.between(0, 1)).shape)
    rate = request.frame_rate(scenes)
    encoder = Encoder(
        codec, shape, rate, camera.display, camera.processor.tone_curve, request.quality
    )
    made: dict[str, Any] = {
        "fps": str(rate),
        "codec": request.codec,
        "quality": request.quality,
    }
    if is_episode:
        task = request.lerobot
        episode = Episode(path, task, camera.name, request.seed, encoder, segments)
        return episode, made | {"task": task}
    check_output(path)
    target = (RawFile if path.suffix.lower() == RAW else EncodedFile)(path, encoder, segments)
    if path.exists() and not target.folder.exists():
        raise BadFile(path, "exists; remove it, or give -o another name")
    return target, made
