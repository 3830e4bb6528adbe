"""`gpusim pairs`: noisy and clean frames of photographs, in shards for training."""

import argparse
import json
import time
from collections import Counter
from pathlib import Path

from gpusim.apps.pairs.variety import Variety
from gpusim.apps.video.segments import Shard, segments_of
from gpusim.cli.options import (
    add_asked,
    describe_options,
    describe_verdicts,
    operated,
    scene_of,
    whole,
)
from gpusim.domain.account import STATUS, worst_state
from gpusim.domain.errors import BadFile, OutOfRange

IN_SHARD = 256  # pairs, by default
MOST = 10**8


def add_command(commands):
    """Add `pairs` to the subparsers of `gpusim`; its default `run` is `pairs`."""
    parser = commands.add_parser(
        "pairs",
        help="noisy frames of photographs and the light that they are of, in tar "
        "files as WebDataset reads them",
        description="Each sample has KEY.raw.npy (digital "
        "numbers, uint16), KEY.clean.npy (the same of the light alone: without noise, dark "
        "current, fixed pattern and clipping, float32) and KEY.json (camera, seed, exposure, "
        "levels, predicted error). A photograph is taken as what a display shows: white "
        "reflects all light, and what was brighter is not known.",
    )
    add_asked(parser, several=True)
    parser.add_argument(
        "-o", "--out", required=True, metavar="FOLDER", help="of 000000.tar and so on"
    )
    parser.add_argument(
        "--vary",
        type=Variety.parse,
        default=Variety(),
        metavar="NAME=LOW..HIGH,...",
        help="what is drawn for each pair, evenly in the logarithm: exposure=1/200..1/20, "
        "iso=100..1600, luminance=10..1000 [cd/m2]; light=D65|A|FL11",
    )
    parser.add_argument(
        "--each",
        type=whole(1, MOST),
        default=1,
        metavar="N",
        help="pairs of a photograph (default: 1)",
    )
    parser.add_argument(
        "--seed", type=whole(0, 2**64 - 1), default=0, help="of noise and variety (default: 0)"
    )
    parser.add_argument("--pictures", action="store_true", help="KEY.rgb.png of every frame, too")
    parser.add_argument(
        "--in-shard",
        type=whole(1, MOST),
        default=IN_SHARD,
        metavar="N",
        help=f"pairs in a tar file (default: {IN_SHARD})",
    )
    parser.add_argument(
        "--shard",
        type=Shard.parse,
        default=Shard(),
        metavar="I/N",
        help="make part I of N of the tar files alone, I from 0 on",
    )
    parser.set_defaults(run=pairs)


def pairs(arguments) -> int:
    """Run `gpusim pairs`; returns the exit status. Raises GpusimError."""
    from tqdm import tqdm

    from gpusim import __version__
    from gpusim.apps.pairs.pairs import Pairs, gain_of
    from gpusim.apps.pairs.shards import write_shard
    from gpusim.apps.video.manifest import file_digest, kept
    from gpusim.backends.probe import made_by
    from gpusim.data.lights import illuminant
    from gpusim.domain.digest import digest
    from gpusim.io.camera.cameras import open_camera
    from gpusim.pipeline.simulator import Simulator

    varied = dict(arguments.vary.ranges)
    for name, option in (
        ("exposure", arguments.exposure),
        ("iso", arguments.iso),
        ("light", arguments.light),
        ("luminance", arguments.luminance),
    ):
        if name in varied and option is not None:
            raise OutOfRange(f"--{name} and --vary {name}", "both given", "one of them")
    camera = operated(open_camera(arguments.camera), arguments)
    simulator = Simulator(
        camera,
        device=arguments.device,
        tolerance=arguments.tolerance,
        guaranteed=arguments.guaranteed,
        strict=arguments.strict,
    )
    for speed in varied.get("iso", ()):
        gain_of(camera, speed)  # said before the work
    if "iso" in varied and "exposure" not in varied and camera.sensor.exposure_time is None:
        raise OutOfRange(
            "--vary iso",
            "with automatic exposure, which chooses the gain",
            "with --exposure TIME, or --vary exposure=LOW..HIGH",
        )
    photographs = _photographs(arguments)
    opened = _opener(arguments)
    opened(photographs[0], arguments.vary.drawn(arguments.seed, 0))
    made = Pairs(
        simulator,
        photographs,
        opened,
        arguments.vary,
        arguments.each,
        arguments.seed,
        arguments.pictures,
    )
    for light in varied.get("light", ()):
        illuminant(light)
    folder = Path(arguments.out)
    if any(path.parent.resolve() == folder.resolve() for path in photographs):
        raise BadFile(folder, "the photographs are in it; give -o another folder")
    shards = segments_of(len(made), arguments.in_shard)
    own = arguments.shard.of(shards, "--in-shard")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise BadFile(folder, f"cannot be made: {error.strerror or error}") from error
    told = {
        "gpusim": __version__,
        "camera": digest(camera),
        "photographs": [str(path) for path in photographs],
        "contents of files": [file_digest(path) for path in photographs],
        "vary": {name: list(values) for name, values in varied.items()},
        "options": describe_options(arguments, ("vary",)),
        "device": made_by(simulator.device),
    }
    names = {shard.start: folder / f"{number:06d}.tar" for number, shard in enumerate(shards)}
    missing = [shard for shard in own if not names[shard.start].exists()]
    begun, count = time.perf_counter(), sum(map(len, missing))
    states: Counter[str] = Counter()
    with (
        kept(
            folder / "pairs.json",
            told,
            "the tar files beside it",
            lambda: not any(folder.glob("*.tar")),
        ),
        tqdm(total=count, unit="pair", disable=None) as bar,
    ):
        for shard in missing:
            write_shard(names[shard.start], _counted(made.made(shard), bar, states))
    seconds = time.perf_counter() - begun
    if count:
        print(
            f"{count} pairs in {seconds:.1f} s, {count / seconds:.3g} pairs/s{describe_verdicts(states)}"
        )
    if len(missing) < len(own):
        print(f"{len(own) - len(missing)} tar files were there already")
    return STATUS[worst_state(states)]


def _counted(samples, bar, states):
    """The samples; the states of their verdicts are counted in `states`."""
    for key, parts in samples:
        yield key, parts
        if verdict := json.loads(parts["json"]).get("verdict"):
            states[verdict["state"]] += 1
        bar.update()


def _photographs(arguments):
    """Files that are given, those of folders in the order of their names. Raises BadFile."""
    from gpusim.io.scene.readers import IN_FOLDERS, scene_files

    found = []
    for name in map(Path, arguments.scene):
        inside = [name]
        if name.is_dir():
            inside = scene_files(name)
        if not inside:
            raise BadFile(name, f"no scene files in it; wanted {', '.join(IN_FOLDERS)}")
        found += inside
    return found


def _opener(arguments):
    """Function from a path, and what was drawn for it, to a scene."""

    def opened(path, values):
        drawn = {name: values[name] for name in ("light", "luminance") if name in values}
        return scene_of(argparse.Namespace(**(vars(arguments) | drawn)), str(path))

    return opened
