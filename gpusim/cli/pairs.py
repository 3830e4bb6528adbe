"""`gpusim pairs`: noisy and clean frames of photographs, in shards for training."""

import time
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from gpusim.apps.pairs.variety import Variety, scene_options
from gpusim.apps.video.segments import Shard, segments_of
from gpusim.cli.captures import capture_option
from gpusim.cli.options import (
    DEVICES_HELP,
    SCENE_HELP,
    Request,
    describe_verdicts,
    flag,
    make_folder,
    option,
    scene_option,
    seed_option,
    whole,
)
from gpusim.cli.video import shard_option
from gpusim.domain.account import STATUS, worst_state
from gpusim.domain.errors import BadFile, Conflict

if TYPE_CHECKING:  # the command line starts without them
    from gpusim.captures.capture import Capture

IN_SHARD = 256  # pairs, by default
WORTH = 128  # pairs for which it is worth to start a process
CONTEXT = 2**29  # [byte] that a driver takes of a GPU's memory for each process
MOST = 10**8
TEXTS = {
    "help": "noisy and clean frames of photographs for training, in tar files for WebDataset",
    "description": "Each sample has KEY.raw.npy (digital numbers, uint16), KEY.clean.npy (the same "
    "without noise, dark current, fixed pattern and clipping, float32) and KEY.json (camera, seed, "
    "exposure, levels, predicted error). A photograph is read as a display shows it: white "
    "reflects all light, and anything brighter is lost.",
}


@dataclass(frozen=True, kw_only=True)
class PairsRequest(Request):
    """Options of `gpusim pairs`."""

    scene: list[str] = scene_option(f"{SCENE_HELP}; several of them, or folders", nargs="+")
    out: str = option(
        "-o",
        "--out",
        in_key=False,
        metavar="FOLDER",
        help="folder of the tar files 000000.tar, ...; it is created if it does not exist",
        required=True,
    )
    vary: Variety = option(
        default=Variety(),
        in_key=False,
        type=Variety.parse,
        metavar="NAME=LOW..HIGH,...",
        help="settings that are drawn for each pair, evenly in the logarithm: "
        "exposure=1/200..1/20, iso=100..1600, luminance=10..1000 [cd/m2]; or from a list: "
        "light=D65|A|FL11",
    )
    each: int = option(
        default=1, type=whole(1, MOST), metavar="N", help="pairs per photograph (default: 1)"
    )
    capture: "Capture | None" = capture_option(
        "; frames that are not merged are on a first axis of the arrays"
    )
    device: str = option(default="auto", in_key=False, help=DEVICES_HELP)
    seed: int = seed_option("the noise and of --vary")
    pictures: bool = flag("also write KEY.rgb.png of every frame")
    in_shard: int = option(
        default=IN_SHARD,
        type=whole(1, MOST),
        metavar="N",
        help=f"pairs per tar file (default: {IN_SHARD})",
    )
    jobs: int | None = option(
        in_key=False,
        type=whole(1, 1024),
        metavar="N",
        help="processes that share the tar files, each with its own memory (default: from the cores, the "
        "number of pairs and the device's memory)",
    )
    shard: Shard = shard_option("part I of N of the tar files, counted from 0")

    def check_settings(self) -> None:
        """Raise Conflict for two options that set the same, or that have no effect together."""
        for name in ("exposure", "iso", "light", "luminance"):
            if name in dict(self.vary.ranges):
                self.refuse(name, f"--vary {name} draws it for each pair", "give only one of them")
        if not self.pictures:
            self.refuse_picture("no picture is made of the raw values", "add --pictures")


def pairs(request: PairsRequest) -> int:
    """Run `gpusim pairs`.

    Args:
        request: Options of the command.

    Returns:
        The exit status.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    from tqdm import tqdm

    from gpusim.apps.pairs.processes import share_shards, write_shards
    from gpusim.apps.video.manifest import describe_run, keep_manifest
    from gpusim.color.speed import gain_for_speed
    from gpusim.data.lights import illuminant

    request.check_settings()
    varied = dict(request.vary.ranges)
    simulator = request.open_simulator(several=True)
    camera = simulator.camera
    for speed in varied.get("iso", ()):  # refuse wrong settings before the work
        gain_for_speed(camera.sensor, speed)
    for light in varied.get("light", ()):
        illuminant(light)
    if "iso" in varied and "exposure" not in varied and camera.sensor.exposure_time is None:
        remedy = "add --exposure TIME or --vary exposure=LOW..HIGH"
        raise Conflict("--vary iso", "automatic exposure chooses the gain", remedy)
    photographs, jobs = _photographs(request), request.jobs
    made = _open_pairs(request, simulator, photographs)
    first = made.open(0)
    folder = Path(request.out)
    if any(path.parent.resolve() == folder.resolve() for path in photographs):
        raise BadFile(folder, "the photographs are in it; give -o another folder")
    shards = segments_of(len(made), request.in_shard)
    own = request.shard.of(shards, "--in-shard")
    request.refuse_unread("pairs")
    make_folder(folder)
    content = describe_run(
        simulator,
        photographs,
        request.for_manifest(),
        photographs=[str(path) for path in photographs],
        vary={name: list(values) for name, values in varied.items()},
    )
    names = {shard.start: folder / f"{number:06d}.tar" for number, shard in enumerate(shards)}
    missing = [(names[shard.start], shard) for shard in own if not names[shard.start].exists()]
    begun, count = time.perf_counter(), sum(len(shard) for _, shard in missing)
    jobs = max(jobs or _choose_jobs(simulator, first, count), len(simulator.devices))
    jobs = max(min(jobs, len(missing)), 1)
    states: Counter[str] = Counter()
    limits: Counter[str] = Counter()

    def is_empty():
        return not any(folder.glob("*.tar"))

    with (
        keep_manifest(folder / "pairs.json", content, "its tar files", is_empty),
        tqdm(total=count, unit="pair", disable=None) as bar,
    ):

        def report(progress):
            bar.set_postfix_str(f"limited by {progress.limit}", refresh=False)
            bar.update(progress.count)
            states.update(progress.states)
            limits[progress.limit] += progress.count

        if jobs > 1:
            starts = [
                partial(_open_pairs, request, one, photographs) for one in simulator.on_devices()
            ]
            share_shards(starts, missing, jobs, report)
        else:
            write_shards(made, missing, report)
    seconds = time.perf_counter() - begun
    if count:
        print(
            f"{count} pairs in {seconds:.1f} s, {count / seconds:.3g} pairs/s, limited by "
            f"{max(limits, key=lambda name: limits[name])}{describe_verdicts(states)}"
        )
    if len(missing) < len(own):
        print(f"{len(own) - len(missing)} tar files were there already")
    return STATUS[worst_state(states)]


def _open_pairs(request, simulator, photographs):
    """Return the pairs of the command line."""
    from gpusim.apps.pairs.pairs import Pairs
    from gpusim.domain.scene import PLANE
    from gpusim.io.scene.scenes import open_again

    own_light = {name: getattr(request, name) for name in ("light", "luminance")}
    is_relit = bool(own_light.keys() & dict(request.vary.ranges))

    def open_drawn(path, values):
        return request.open_scene(str(path), **scene_options(values))

    def open_unlit(path, values):
        return request.open_scene(str(path), light=None, luminance=None)

    def relight(path, scene, values):
        if scene.projection != PLANE:  # a view of a panorama
            return open_drawn(path, values)
        return open_again(path, scene, **(own_light | scene_options(values)))

    return Pairs(
        simulator,
        photographs,
        open_unlit if is_relit else open_drawn,
        request.vary,
        request.each,
        request.seed,
        request.pictures,
        capture=request.capture,
        relit=relight if is_relit else None,
    )


def _choose_jobs(simulator, scene, count):
    """Return the number of processes for this many pairs of scenes like this one."""
    from gpusim.domain.cores import count_cores

    device, cores = simulator.device, count_cores()
    if device.kind == "numpy" or count < 2 * WORTH:
        return 1
    jobs = min(7 * cores // 8 if device.is_gpu else cores // 2, count // WORTH)
    if jobs > 1 and device.is_gpu:  # each has memory of its own there
        each = 2 * simulator.plan(scene).bytes_needed + CONTEXT
        jobs = min(jobs, device.memory // each * len(simulator.devices))
    return jobs


def _photographs(request):
    """Return the files of the command line, those of a folder in the order of their names.

    Raises BadFile.
    """
    from gpusim.io.scene.readers import IN_FOLDERS, scene_files

    found = []
    for name in map(Path, request.scene):
        inside = scene_files(name) if name.is_dir() else [name]
        if not inside:
            raise BadFile(name, f"no scene files in it; wanted {', '.join(IN_FOLDERS)}")
        found += inside
    return found
