"""Every option of every command changes the result, or is refused in one line.

Each command runs on tiny scenes, without an option and with it, and the outcomes are compared: exit status, printed
text without times, and files without manifests. A row names the arguments before an option and the option's own; no
option of any command is without a row.
"""

import json
import re
import shlex
import shutil
import sys
from dataclasses import fields, replace
from hashlib import sha256
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from bench_results import made_results
from named_databases import profile_bytes, write_databases
from PIL import Image

import gpusim as gs
from gpusim.bench.result import LIMITS
from gpusim.cli.look import PANELS
from gpusim.cli.main import COMMANDS, main
from gpusim.cli.options import DEVELOPING
from gpusim.color.speed import operate_camera
from gpusim.domain.digest import digest
from gpusim.fit import fitting
from gpusim.io.camera.learned import bayer_table

TIMES = re.compile(r"[0-9.e+-]+ (ms|s|pairs/s|frames/s)\b")
ON = "--camera phone --device numpy"
CHART = f"colorchecker {ON} --size 24x16"
PHOTO = f"photo.png {ON}"
SEVERAL = f"in_1.png in_2.png in_3.png {ON}"
PLANES = f"planes.npy {ON} --wavelengths 450,550,650 --exposure .01"
SPACE = f"depth.exr {ON}"
VIEWS = "views.npz --device numpy"
STUDY = """camera = "phone"
sampling = {method = "latin", count = 25}
vary = {"noise.read_e" = {uniform = [1, 5]}}
scenes = {flat = {scene = "flat", size = [8, 8]}}
measures = ["dynamic_range"]
"""
NAMED = "'Acme Z1' --databases databases"
PARTS = f"parts.exr {ON} --exposure 1/60"

# Options of a scene, its camera and the planner: a name, the arguments before it, and its own
SCENE = {
    "camera": (CHART, "--camera mono"),
    "device": (CHART, "--device warp:cpu"),
    "tolerance": (CHART, "--tolerance preview"),
    "guaranteed": (f"{CHART} --tolerance 1e-2", "--guaranteed"),
    "strict": (f"slanted-edge {ON} --size 96x64 --tolerance 1e-7", "--strict"),
    "size": (CHART, "--size 32x24"),
    "samples_per_pixel": (CHART, "--samples-per-pixel 2"),
    "light": (CHART, "--light A"),
    "luminance": (f"{CHART} --exposure 1/60", "--luminance 5"),
    "border": (CHART, "--border zero"),
    "exposure": (CHART, "--exposure 1/500"),
    "iso": (CHART, "--iso 400"),
    "f_number": (CHART, "--f-number 8"),
    "focus": (CHART, "--focus 0.3"),
    "scaling": (f"{CHART} --exposure 1/500", "--scaling normalised"),
    "demosaic": (CHART, "--demosaic bilinear"),
    "denoise": (CHART, "--denoise 2"),
    "white_balance": (f"{CHART} --light A", "--white-balance none"),
    "look": (CHART, "--look phone"),
    "band": (f"named.exr {ON} --band green=540", "--band red=630"),
    "wavelengths": (PLANES, "--wavelengths 460,560,660"),
    "kind": (PLANES, "--kind radiance"),
    "scale": (PLANES, "--scale 2"),
    "key": (f"cubes.h5 {ON} --key dark --exposure .01", "--key bright"),
    "fov": (f"{SPACE} --depth ray --fov 30", "--fov 60"),
    "depth": (f"{SPACE} --focus 0.5", "--depth none"),
    "projection": (CHART, "--projection equirectangular"),
    "part": (PARTS, "--part other"),
    "layer": (PARTS, "--layer other"),
    "view": (PARTS, "--view right"),
}
MOVING = {
    "frames": (PHOTO, "--frames 3"),
    "fps": (f"{PHOTO} --frames 2 --pan 0,20", "--fps 10"),
    "pan": (f"{PHOTO} --frames 2", "--pan 0,90"),
    "roll": (f"{PHOTO} --frames 2", "--roll 90"),
    "zoom": (PHOTO, "--zoom 1.3"),
    "zooming": (f"{PHOTO} --frames 2", "--zooming 4"),
    "shake": (f"{PHOTO} --frames 2", "--shake 3"),
    "travel": (f"{SPACE} --frames 2", "--travel 0,5,0"),
    "actor": (PHOTO, "--actor actor.png"),
    "transfer": (f"film.mkv {ON}", "--transfer srgb"),
    "any_order": (f"in_2.png in_1.png {ON}", "--any-order"),
}


def after(rows, text):
    """The rows with more arguments before the option."""
    return {name: (f"{base} {text}", option) for name, (base, option) in rows.items()}


ROWS = {
    "simulate": after(SCENE, "-o out.npz -o out.png --report report.json")
    | {
        "seed": (f"{CHART} -o out.npz", "--seed 5"),
        "frames": (f"{CHART} -o out.npz", "--frames 2"),
        "frame": (f"{CHART} -o out.npz", "--frame 3"),
        "capture": (f"{CHART} -o out.npz", "--capture burst=2"),
        "views": (f"{CHART} -o out.npz", "--views 1x2"),
        "out": (CHART, "-o out.npz"),
        "bits": (f"{CHART} -o out.png", "--bits 16"),
        "quality": (f"{CHART} -o out.jpg", "--quality 20"),
        "dual": (CHART.replace("phone", "dual.toml"), "--dual dual.npz"),
        "report": (CHART, "--report report.json"),
        "verify": (CHART, "--verify"),
        "verbose": (CHART, "--verbose"),
    },
    "plan": SCENE
    | {
        "exposure": (f"{CHART} --tolerance video", "--exposure 1/500"),
        "iso": (f"{CHART} --tolerance video", "--iso 400"),
        "scale": (f"{PLANES} --tolerance video", "--scale 2"),
        "part": (f"{PARTS} --tolerance video", "--part other"),
        "layer": (f"{PARTS} --tolerance video", "--layer other"),
        "view": (f"{PARTS} --tolerance video", "--view right"),
        "key": (f"cubes.h5 {ON} --tolerance video --exposure .01 --key dark", "--key bright"),
        "json": (CHART, "--json plan.json"),
    },
    "video": after(SCENE | MOVING, "-o out.npz")
    | {
        "scaling": (f"{CHART} --exposure 1/500 -o out.png", "--scaling normalised"),
        "demosaic": (f"{CHART} -o out.webp", "--demosaic bilinear"),
        "denoise": (f"{CHART} -o out.png", "--denoise 2"),
        "white_balance": (f"{CHART} --light A -o out.dng", "--white-balance none"),
        "look": (f"{CHART} -o out.png", "--look phone"),
        "out": (f"{CHART} -o out.npz", "-o out.png"),
        "lerobot": (f"{CHART} -o folder.png", "--lerobot look"),
        "seed": (f"{CHART} -o out.npz", "--seed 5"),
        "capture": (f"{CHART} -o out.npz", "--capture bracket=-1:0"),
        "blur": (f"{PHOTO} --frames 2 --pan 0,400 -o out.npz", "--blur"),
        "ramp": (f"{PHOTO} --frames 2 -o out.npz", "--ramp exposure=1/500..1/30"),
        "lag": (f"{SEVERAL} --fps 5 -o out.npz", "--lag exposure=1"),
        "average": (f"{PHOTO} --frames 2 --exposure 1/1000 -o out.npz", "--average 2"),
        "flicker": (f"{PHOTO} --exposure 1/500 -o out.npz", "--flicker 100"),
        "pwm": (f"{PHOTO} --exposure 1/500 -o out.npz", "--pwm 200,.3"),
        "codec": (f"{CHART} -o out.mkv", "--codec ffv1-linear"),
        "quality": (f"{CHART} -o out.mkv", "--quality 40"),
        "shard": (f"{PHOTO} --frames 4 --segment 2 -o out.npz", "--shard 1/2"),
        "segment": (f"{PHOTO} --frames 4 --shard 0/2 --segment 3 -o out.npz", "--segment 1"),
    },
    "pairs": after(SCENE, "-o out")
    | {
        "scaling": (f"{CHART} --exposure 1/500 --pictures -o out", "--scaling normalised"),
        "demosaic": (f"{CHART} --pictures -o out", "--demosaic bilinear"),
        "denoise": (f"{CHART} --pictures -o out", "--denoise 2"),
        "white_balance": (f"{CHART} --light A --pictures -o out", "--white-balance none"),
        "look": (f"{CHART} --pictures -o out", "--look phone"),
        "out": (f"{CHART} -o out", "-o other"),
        "vary": (f"{CHART} -o out", "--vary exposure=1/200..1/20"),
        "each": (f"{CHART} -o out", "--each 2"),
        "capture": (f"{CHART} -o out", "--capture burst=2"),
        "seed": (f"{CHART} -o out", "--seed 5"),
        "pictures": (f"{CHART} -o out", "--pictures"),
        "in_shard": (f"{CHART} --each 3 -o out", "--in-shard 2"),
        "shard": (f"{CHART} --each 3 --in-shard 2 -o out", "--shard 1/2"),
        "jobs": (f"{CHART} --each 3 --in-shard 2 -o out", "--jobs 2"),
    },
    "study": {
        "out": ("study.toml --device numpy -o out", "-o other"),
        "device": ("study.toml --device numpy -o out", "--device warp:cpu"),
        "workers": ("study.toml --device numpy -o out", "--workers 2"),
        "shard": ("study.toml --device numpy -o out", "--shard 1/2"),
        "table": ("study.toml --device numpy -o out", "--table parquet"),
    },
    "preview": SCENE
    | MOVING
    | {
        "frames": (f"{PHOTO} --frames 2 --pan 0,20", "--frames 3"),
        "capture": (CHART, "--capture bracket=-1:0"),
        "port": (CHART, "--port 8089"),
        "host": (CHART, "--host 0.0.0.0"),
    },
    "fit": {
        **{
            kind: ("a.dng -o out.toml", f"--{kind} b.dng c.dng")
            for kind in ("darks", "flats", "pairs", "chart", "edges", "grid", "shading", "ramp")
        },
        "out": ("a.dng -o out.toml", "-o other.toml"),
        "page": ("a.dng -o out.toml", "--page page.html"),
        "maps": ("a.dng -o out.toml", "--maps"),
        "base": ("a.dng -o out.toml", "--base mono"),
        "cfa": ("a.dng -o out.toml", "--cfa bayer-grbg"),
        "light": ("a.dng -o out.toml", "--light D65 A"),
    },
    "refocus": {
        "out": (f"{VIEWS} -o out.npy", "-o out.png"),
        "distance": (f"{VIEWS} -o out.npy", "--distance 0.3"),
        "slope": (f"{VIEWS} -o out.npy", "--slope 1.5"),
        "aperture": (f"{VIEWS} -o out.npy", "--aperture 0.6"),
        "all_in_focus": (f"{VIEWS} -o out.npy", "--all-in-focus"),
        "depth": (f"{VIEWS} -o out.npy", "--depth depth.npz"),
        "page": (f"{VIEWS} -o out.npy", "--page page.html"),
        "range": (f"{VIEWS} --depth depth.npz", "--range 0.4,0.8"),
        "white": (f"{VIEWS} -o out.png", "--white 3"),
        "device": (f"{VIEWS} -o out.npy", "--device warp:cpu"),
    },
    "cameras": {
        "name": ("--databases databases", "'Acme Z1'"),
        "iso": (NAMED, "--iso 100"),
        "lens": (NAMED, "--lens zoom"),
        "focal_length": (f"{NAMED} --lens zoom --iso 100", "--focal-length 30"),
        "f_number": (f"{NAMED} --iso 100", "--f-number 4"),
        "distance": (f"{NAMED} --iso 100", "--distance 3"),
        "columns": (f"{NAMED} --iso 100", "--columns 300"),
        "channel": (f"{NAMED} --iso 100", "--channel R"),
        "full_well": (f"{NAMED} --iso 100", "--full-well 20000"),
        "profile": ("'Acme Z10' --databases databases --iso 100", "--profile own.dcp"),
        "sensitivity": (f"{NAMED} --iso 100", "--sensitivity own.csv"),
        "databases": ("'Acme Z1'", "--databases databases"),
        "out": (NAMED, "-o out.toml"),
    },
    "train-l3": {
        "camera": ("--camera phone -o out.npz", "--camera machine-vision"),
        "out": ("--camera phone -o out.npz", "-o other.npz"),
        "light": ("--camera phone -o out.npz", "--light A"),
        "luminance": ("--camera phone -o out.npz", "--luminance 1..10"),
        "generated": ("--camera phone -o out.npz", "--generated 3"),
        "outputs": ("--camera phone -o out.npz", "--outputs xyz"),
        "seed": ("--camera phone -o out.npz", "--seed 5"),
        "device": ("--camera phone -o out.npz", "--device numpy"),
    },
    "train-network": {
        "camera": ("photo.png -o out.npz", "--camera machine-vision"),
        "out": ("photo.png -o out.npz", "-o other.npz"),
        "minutes": ("photo.png -o out.npz", "--minutes 2"),
        "state": ("photo.png -o out.npz", "--state a.pt"),
        "seed": ("photo.png -o out.npz", "--seed 5"),
        "device": ("photo.png -o out.npz", "--device numpy"),
    },
    "compare": {
        "darks": ("mono held.npz", "--darks more.npz"),
        "flats": ("mono held.npz", "--flats more.npz"),
        "edges": ("mono held.npz", "--edges more.npz"),
        "chart": ("mono held.npz", "--chart more.npz"),
        "shading": ("mono held.npz", "--shading more.npz"),
        "light": ("mono --chart held.npz", "--light A"),
        "base_iso": ("mono held.npz", "--base-iso 200"),
        "cfa": ("mono held.npz", "--cfa mono"),
        "device": ("mono held.npz", "--device numpy"),
        "seed": ("mono held.npz", "--seed 5"),
        "page": ("mono held.npz", "--page page.html"),
        "json": ("mono held.npz", "--json rows.json"),
    },
    "verify": {
        "device": ("--device numpy", "--device warp:cpu"),
        "stage": ("--device numpy", "--stage sensor.noise"),
        "json": ("--device numpy", "--json rows.json"),
        "hard": ("--device numpy", "--hard"),
        "combinations": ("--device numpy", "--combinations"),
        "feature": ("--device numpy --combinations", "--feature depth"),
        "tolerance": ("--device numpy --combinations", "--tolerance 1e-2"),
    },
    "bench run": {
        "device": ("--device numpy", "--device warp:cpu"),
        "quick": ("--device numpy", "--quick"),
        "stage": ("--device numpy", "--stage sensor.noise"),
        "only": ("--device numpy", "--only video"),
        "size": ("--device numpy", "--size 64x48"),
        "rounds": ("--device numpy", "--rounds 4"),
        "json": ("--device numpy", "--json rows.json"),
        "append": ("--device numpy", "--append stored.json"),
    },
    "bench peers": {
        "device": ("--device numpy", "--device warp:cpu"),
        "task": ("--device numpy", "--task noise"),
        "size": ("--device numpy", "--size 64x48"),
        "tolerance": ("--device numpy", "--tolerance 1e-3"),
        "repeat": ("--device numpy", "--repeat 3"),
        "json": ("--device numpy", "--json rows.json"),
    },
    "bench scaling": {
        "device": ("--device numpy", "--device warp:cpu"),
        "threads": ("--device opencl", "--threads"),
        "size": ("--device opencl --threads", "--size 64x48"),
        "only": ("--device numpy", "--only 8K"),
        "camera": ("--device numpy", "--camera mono"),
        "tolerance": ("--device numpy", "--tolerance none"),
        "content": ("--device numpy", "--content materials"),
        "repeat": ("--device numpy", "--repeat 7"),
        "json": ("--device numpy", "--json rows.json"),
    },
    "bench compare": {
        "row": ("first.json second.json", "--row optics"),
        "worst": ("first.json slow.json", "--worst 50%"),
        "other_kernels": ("first.json third.json", "--other-kernels"),
        "history": ("first.json second.json", "--history"),
        "html": ("first.json second.json", "--html page.html"),
        "picture": ("first.json second.json", "--picture picture.png"),
    },
    "bench pack": {
        "stage": ("packed", "--stage sensor.noise"),
        "size": ("packed", "--size 24x16"),
        "cores": ("packed", "--cores 2"),
        "archive": ("packed", "--archive packed.zip"),
    },
    "bench pareto": {
        "device": ("colorchecker --device numpy", "--device warp:cpu"),
        "camera": ("colorchecker --device numpy", "--camera mono"),
        "size": ("colorchecker --device numpy", "--size 24x16"),
        "json": ("colorchecker --device numpy", "--json rows.json"),
        "out": ("colorchecker --device numpy", "-o out.png"),
    },
    "warmup": {
        "device": ("--device numpy", "--device warp:cpu"),
        "camera": ("--device numpy --camera phone", "--camera mono"),
        "tolerance": ("--device numpy", "--tolerance preview"),
    },
    "devices": {"json": ("", "--json")},
}


STORED = {
    "bench": "suite",
    "format": 1,
    "device": "numpy",
    "machine": {"device": "", "driver": "", "compiler": "", "warnings": []},
    "commit": None,
    "dirty": None,
    "date": "",
    "hash": "",
    "limits": dict.fromkeys(LIMITS),
    "cold_build_s": None,
    "quick": False,
    "scores": {},
    "rows": [],
}


@pytest.fixture(scope="session")
def inputs(tmp_path_factory):
    """A folder of the scenes that the rows name."""
    import OpenEXR

    folder = tmp_path_factory.mktemp("inputs")
    random = np.random.default_rng(1)
    codes = np.uint8(255 * random.random((6, 9, 3))).repeat(4, 0).repeat(4, 1)
    for name, picture in (
        ("photo", codes),
        ("in_1", codes),
        ("in_2", codes // 3),
        ("in_3", codes // 2),
    ):
        Image.fromarray(picture).save(folder / f"{name}.png")
    (folder / "dual.toml").write_text('[sensor]\ndual = {split = "left-right"}\n')
    (folder / "study.toml").write_text(STUDY)
    write_databases(folder / "databases")
    (folder / "own.dcp").write_bytes(profile_bytes())
    (folder / "own.csv").write_text("wavelength_nm,R,G,B\n400,0,0,1\n550,0,1,0\n700,1,0,0\n")
    (folder / "stored.json").write_text(json.dumps(STORED))
    compared = *made_results(10, 3, sides=3), made_results(10, 3, change={1: 0.1})[1]
    compared[2]["rows"][0]["hash"] = "another"
    for name, result in zip(("first", "second", "third", "slow"), compared, strict=True):
        (folder / f"{name}.json").write_text(json.dumps(result))
    cutout = np.full((8, 8, 4), 255, np.uint8)
    Image.fromarray(cutout).save(folder / "actor.png")
    edge = gs.chart("slanted-edge", size=(64, 48))
    bright = edge.content.bands_at(slice(None)).mean(axis=0)
    edges = np.float32([0.3, 0.5, 0.7])[:, None, None] * (bright / bright.max())
    for name, scene, planes in (
        ("", gs.chart("deadleaves", size=(24, 16)), random.random((3, 16, 24), np.float32)),
        ("edge_", edge, np.float32(edges)),
    ):
        np.save(folder / f"{name}planes.npy", planes)
        with h5py.File(folder / f"{name}cubes.h5", "w") as file:
            file.update({"bright": planes, "dark": planes / 2, "wavelengths": [450, 550, 650]})
        channels = {"green": planes[1].copy(), "red": planes[2].copy()}
        OpenEXR.File(
            {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, channels
        ).write(str(folder / f"{name}named.exr"))
        views = ({c: planes[0] / n for c in "RGB"} for n in (1, 2, 3))
        first, right, other = views
        parts = {"rgba": first | {f"right.{c}": right[c] for c in "RGB"}, "other": other}
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(
            [OpenEXR.Part(dict(header), held, part) for part, held in parts.items()]
        ).write(str(folder / f"{name}parts.exr"))
        depth = np.linspace(0.5, 4, bright.size if name else 384, dtype=np.float32)
        gs.save_scene(
            replace(scene, depth=depth.reshape(planes[0].shape)), folder / f"{name}depth.exr"
        )
    values = random.random((3, 3, 12, 14, 3), np.float32)
    gs.save_views(gs.ViewImages(values, -2.0, 0.5, 4e-3, 2.0), folder / "views.npz")
    film = "-o film.mkv --codec ffv1-linear --frames 2 --pan 0,90".split()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(["video", *shlex.split(PHOTO), *film]) == 0
    return folder


KNOWN: dict = {}  # outcomes, of arguments before an option most of all


@pytest.fixture
def outcome(inputs, tmp_path, monkeypatch, capsys):
    """Function from a command line to what it does: status, text without times, digests of files."""
    record(monkeypatch)

    def run(command, text):
        if (command, text) in KNOWN:
            return KNOWN[command, text]
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        shutil.copytree(inputs, folder)
        monkeypatch.chdir(folder)
        capsys.readouterr()
        try:
            status = main([*command.split(), *shlex.split(text)])
        except SystemExit as stop:
            status = stop.code
        said = capsys.readouterr()
        files = {
            str(path.relative_to(folder)): content(path)
            for path in sorted(folder.rglob("*"))
            if path.is_file() and not (inputs / path.relative_to(folder)).exists()
        }
        errors = "" if status == 0 else said.err
        KNOWN[command, text] = status, TIMES.sub("", said.out), errors, files
        return KNOWN[command, text]

    return run


def content(path):
    """Digest of a file: of the figures of a report without times, of nothing of a manifest."""
    if path.name in ("video.json", "out_video.json", "pairs.json", "study.json"):
        return ""
    if path.name in ("report.json", "plan.json"):
        return json.dumps(untimed(json.loads(path.read_text())))
    if path.suffix == ".npz" and path.stat().st_size:
        with np.load(path, allow_pickle=True) as file:
            return sha256(b"".join(np.asarray(file[name]).tobytes() for name in file)).hexdigest()
    return sha256(path.read_bytes()).hexdigest()


def untimed(data):
    """Plain data without times."""
    if isinstance(data, dict):
        return {name: untimed(one) for name, one in data.items() if "ms" not in name}
    return [untimed(one) for one in data] if isinstance(data, list) else data


def record(monkeypatch):
    """Put functions that print their arguments in place of servers, trainings and long judgements."""
    import nicegui

    import gpusim.apps.l3.train
    import gpusim.apps.network.pictures
    import gpusim.apps.pairs.processes
    import gpusim.apps.preview.mount
    import gpusim.apps.study.run
    import gpusim.apps.warmup
    import gpusim.backends.probe
    import gpusim.bench.cold
    import gpusim.bench.pack
    import gpusim.bench.peers
    import gpusim.bench.scaling
    import gpusim.bench.suite
    import gpusim.fit.compare
    import gpusim.fit.fitting
    import gpusim.fit.verdicts
    import gpusim.io.camera.learned
    import gpusim.io.camera.network
    import gpusim.judge.combinations
    import gpusim.judge.hard
    import gpusim.judge.pareto
    import gpusim.judge.verify

    def said(*values):
        return " ".join(
            one.name if hasattr(one, "name") else str(one) for one in values if not callable(one)
        )

    def trained(camera, scenes, *, progress, **options):
        layout = SimpleNamespace(shape=(0, 1, 2, 3, 4, 5), mosaic=("RG",), outputs=("R",))
        return SimpleNamespace(layout=layout, provenance=said(camera, *scenes, options))

    def verified(device, stages):
        row = {"ok": True, "stage": "all", "max_error": 0.0, "tolerance": 0.0, "skipped": ""}
        yield row | {"device": device.name, "case": said(*stages)}

    def verified_by_name(name, stages):
        yield from verified(SimpleNamespace(name=name), stages)

    def hard(device):
        row = {"ok": True, "number": 1, "name": "hard", "asked": "", "got": 0.0, "limit": 1.0}
        yield row | {"device": device.name, "why": ""}

    def combined(device, make, features):
        asked = f"asked: {features}, {make.keywords['tolerance']}"
        yield gpusim.judge.combinations.Cell(features[0], features[-1], "runs", asked)

    def measured(device, subjects, sizes=(), **settings):
        names = [getattr(one, "name", one) for one in subjects]
        row = {"name": said(device, *names, sizes, settings), "verified": False, "failed": ""}
        return STORED | {"device": device.name, "rows": [row]}

    def timed(*asked):
        return [{"name": said(*asked), "failed": ""}]

    def scaled(cases, **settings):
        yield from timed(cases, settings)

    def packed(folder, stages, size, archive, cores):
        counts = dict.fromkeys(("cases", "programs", "bytes"), 0)
        asked = said(folder, *stages, size, archive, cores)
        return counts | {"stages": len(stages), "left": [(asked, "")]}

    def warmed(device, cameras, tolerances):
        for asked in product(cameras, tolerances, gpusim.apps.warmup.SCENES):
            yield gpusim.apps.warmup.Warmed(said(device, *asked), 0.0, "")

    def traded(camera, scene, device):
        row = dict.fromkeys(
            ("ms", "predicted_ms", "rms", "predicted", "p999_sigma", "max_sigma"), 1
        )
        yield row | {"point": "a", "words": said(camera, scene, scene.shape, device)}

    def fitted(files, *settings):
        def write(path, page, maps):
            for one in (path, page or f"{path}.html"):
                Path(one).write_text(said(maps))
            return [path]

        lines = [said(files, *settings)]
        none = {"estimates": {}, "unexplained": (), "unknown": (), "failed": ()}
        return SimpleNamespace(lines=lines, **none, write=write)

    def compared(camera, *files, **settings):
        finding = gpusim.fit.verdicts.Finding("all", "none", 0.0, 0.0, 0.0, 0.0, 1.0, "agrees")
        return gpusim.fit.compare.Comparison(said(camera, *files, settings), (finding,))

    def network_trained(tiles, *, tell, **options):
        model = SimpleNamespace(export=lambda text: SimpleNamespace(count=0, provenance=text))
        return model, {"steps": f"{tiles} {options}"}

    network = SimpleNamespace(  # in place of a module that needs PyTorch
        Progress=None,
        open_state=lambda path: path,
        save_state=lambda path, _: Path(path).write_text(""),
        provenance=said,
        train=network_trained,
    )
    monkeypatch.setitem(sys.modules, "gpusim.apps.network.train", network)
    probed = gpusim.backends.probe.devices
    for module, name, function in (
        (gpusim.backends.probe, "devices", lambda refresh=False: probed()),  # measured before
        (gpusim.apps.l3.train, "train", trained),
        (gpusim.io.camera.learned, "write_table", lambda path, _: Path(path).write_text("")),
        (
            gpusim.apps.network.pictures,
            "read_tiles",
            lambda *asked: (said(*map(str, asked[:3])), asked[0]),
        ),
        (gpusim.io.camera.network, "write_network", lambda path, _: Path(path).write_text("")),
        (gpusim.judge.verify, "verify", verified),
        (gpusim.judge.verify, "verify_devices", verified_by_name),
        (gpusim.judge.hard, "hard", hard),
        (gpusim.judge.combinations, "combinations", combined),
        (fitting, "fit_camera", fitted),
        (gpusim.bench.suite, "measure", measured),
        (gpusim.bench.suite, "append_round", lambda stored, path, device: measured(device, [path])),
        (gpusim.bench.cold, "measure_cold_build", lambda device, stages: None),
        (gpusim.bench.peers, "time_peers", timed),
        (gpusim.bench.scaling, "measure_scaling", scaled),
        (gpusim.bench.pack, "write_pack", packed),
        (gpusim.apps.warmup, "warm_up", warmed),
        (gpusim.fit.compare, "compare", compared),
        (gpusim.judge.pareto, "pareto", traded),
        (gpusim.judge.pareto, "draw", lambda rows, path, title: path.write_text(title)),
    ):
        monkeypatch.setattr(module, name, function, raising=False)

    def mounted(producer, state, name, shape, title):
        made = producer()
        shown = list(made._scenes.between(0, min(made._scenes.count, 2)))
        print(made.device.name, made.period, vars(state), name, shape, title, made.frames)
        print(made._capture, *(digest(scene) for scene in shown))

    monkeypatch.setattr(gpusim.apps.preview.mount, "mount", mounted)
    share = gpusim.apps.pairs.processes.share_shards

    def shared(starts, missing, jobs, report):  # the files are the same
        print(jobs, "jobs")
        return share(starts, missing, jobs, report)

    monkeypatch.setattr(gpusim.apps.pairs.processes, "share_shards", shared)

    def work(starts, pieces, jobs, report):  # in this process, whose files are the same
        print(jobs, "jobs")
        worker = starts[0](1)
        for piece in pieces:
            worker(piece, report)

    monkeypatch.setattr(gpusim.apps.study.run, "share_work", work)
    monkeypatch.setattr(nicegui.ui, "run", lambda **options: print(options))
    monkeypatch.setattr(nicegui.app, "add_middleware", lambda *_, **options: print(options))


REFUSED = {
    "plan": {
        "scaling": (CHART, "--scaling normalised"),
        "white_balance": (CHART, "--white-balance none"),
    },
    "preview": {
        "iso": (CHART, "--iso 400"),
        "guaranteed": (f"{CHART} --tolerance 1e-2", "--guaranteed"),
        "strict": (f"{CHART} --tolerance 1e-2", "--strict"),
    },
}
CONFLICTS = [  # a command line and the option that has no effect in it
    ("simulate", CHART, "--guaranteed"),
    ("simulate", CHART, "--strict"),
    ("simulate", CHART, "--bits 16"),
    ("simulate", f"{CHART} -o out.npz", "--bits 16"),
    ("simulate", f"{CHART} -o out.dng", "--scaling normalised"),
    ("simulate", CHART, "--scaling normalised"),
    ("simulate", f"{CHART} -o out.dng", "--demosaic best"),
    ("simulate", f"{CHART} -o out.raw.npy", "--white-balance none"),
    ("video", f"{PHOTO} -o out.npz", "--scaling normalised"),
    ("video", f"{PHOTO} -o out.dng", "--denoise 1"),
    ("video", f"{PHOTO} -o out.npz", "--look phone"),
    ("pairs", f"{CHART} -o out", "--white-balance none"),
    ("video", f"{PHOTO} -o out.mkv --codec ffv1-raw", "--scaling normalised"),
    ("video", f"{PHOTO} -o out.png", "--blur"),
    ("video", f"{PHOTO} -o out.png --zoom 2", "--blur"),
    ("video", f"{PHOTO} -o out.png", "--pan 0,20"),
    ("video", f"{PHOTO} -o out.png", "--roll 5"),
    ("video", f"{PHOTO} -o out.png", "--zooming 1.1"),
    ("video", f"{PHOTO} -o out.png", "--ramp light=1..2"),
    ("video", f"{PHOTO} -o out.png", "--lag exposure=1"),
    ("video", f"{PHOTO} -o out.png", "--average 2"),
    ("video", f"{PHOTO} -o out.png --frames 2 --capture burst=2", "--average 2"),
    ("video", f"{PHOTO} -o out.png --frames 2 --flicker 100", "--average 2"),
    ("video", f"{PHOTO} -o out.png", "--any-order"),
    ("video", f"{PHOTO} -o out.png", "--transfer srgb"),
    ("video", f"{PHOTO} -o out.png", "--codec h264"),
    ("video", f"{PHOTO} -o out.png", "--quality 20"),
    ("video", f"{PHOTO} -o out.png --flicker 100", "--pwm 100,.5"),
    ("video", f"{SEVERAL} -o out.png", "--frames 2"),
    ("video", f"{PHOTO} -o out.png --frames 2 --ramp exposure=1/99..1/50", "--exposure 1/60"),
    ("video", f"{PHOTO} -o out.png --frames 2 --ramp iso=100..200 --exposure .01", "--iso 100"),
    ("video", f"{PHOTO} -o out.png --frames 2 --ramp f-number=2..4", "--f-number 2"),
    ("video", f"{PHOTO} -o out.png --frames 2 --ramp focus=1..2", "--focus 1"),
    ("video", f"depth.exr {ON} -o out.png --frames 2 --lag focus=1", "--focus 1"),
    ("video", f"{SEVERAL} -o out.png --exposure .01", "--lag exposure=1"),
    ("video", f"{CHART} -o out.mkv --codec ffv1-raw", "--quality 20"),
    ("video", f"{PHOTO} -o out --lerobot look", "--codec h265"),
    ("video", f"{PHOTO} -o out --lerobot look --frames 2 --segment 1", "--shard 0/2"),
    *(
        ("video", f"film.mkv {ON} -o out.png", option)
        for option in (
            "--size 24x16",
            "--band red=600",
            "--wavelengths 450,550",
            "--kind radiance",
            "--scale 2",
            "--key a",
            "--fov 30",
            "--depth none",
            "--layer left",
        )
    ),
    ("pairs", f"{CHART} -o out", "--scaling normalised"),
    ("pairs", f"{CHART} -o out --vary exposure=1/99..1/50", "--exposure 1/60"),
    ("pairs", f"{CHART} -o out --vary iso=100..200", "--iso 100"),
    ("pairs", f"{CHART} -o out --vary light=A|D65", "--light A"),
    ("pairs", f"{CHART} -o out --vary luminance=1..2", "--luminance 1"),
    ("pairs", f"{CHART} -o out", "--vary iso=100..200"),
    ("preview", PHOTO, "--frames 2"),
    ("preview", PHOTO, "--fps 10"),
    ("preview", PHOTO, "--pan 0,20"),
    ("verify", "--device numpy --hard", "--stage sensor.noise"),
    ("verify", "--device numpy --combinations", "--stage sensor.noise"),
    ("compare", "mono held.npz", "--light A"),
    ("compare", "mono --edges held.npz", "--base-iso 100"),
    ("bench compare", "first.json second.json --history", "--worst 5%"),
    ("bench compare", "first.json second.json --history", "--other-kernels"),
    ("verify", "--device numpy --combinations", "--hard"),
    ("verify", "--device numpy", "--feature depth"),
    ("verify", "--device numpy", "--tolerance 1e-2"),
    *(
        ("bench run", "--device numpy --append stored.json", option)
        for option in (
            "--quick",
            "--stage sensor.noise",
            "--only video",
            "--size 64x48",
            "--rounds 4",
            "--json rows.json",
        )
    ),
]
LONG = {"-o": "--out"}


def test_every_option_has_a_row():
    for command, (options, _, _) in COMMANDS.items():
        positional = {part.name for part in fields(options) if part.metadata["positional"]}
        names = {part.name for part in fields(options)} - positional
        assert command == "look" or names == ROWS[command].keys() - positional, command


# In a manifest separately (camera, device, files, codec, task), or without an effect on any frame
RECORDED = set("scene camera device exposure iso f_number focus scaling out shard strict".split())
RECORDED |= {*DEVELOPING}
RECORDED_BY = {
    "video": {"frames", "any_order", "codec", "quality", "lerobot"},
    "pairs": {"vary", "jobs"},
}


@pytest.mark.parametrize("command", RECORDED_BY)
def test_a_manifest_has_every_option(command):
    """A new option is part of it, unless it is named here."""
    options = COMMANDS[command][0]
    names = {part.name for part in fields(options)}
    request = options(scene=["flat"], camera="phone", out="a.png", light="A")
    assert names - request.for_manifest().keys() == RECORDED | RECORDED_BY[command]
    assert request.for_manifest()["light"] == "A" and request.is_given("light")
    assert not request.is_given("seed")


def is_slow(command, name):
    """Whether a row runs only with the slow tests: options that commands share, and the slowest of `simulate`."""
    shared = command in ("plan", "video", "pairs") and name in SCENE
    return shared or (command, name) == ("simulate", "fov")  # test_exr_dialects has it, too


EFFECTS = [
    pytest.param(command, name, *row, marks=[pytest.mark.slow] * is_slow(command, name))
    for command, rows in ROWS.items()
    for name, row in rows.items()
    if name not in REFUSED.get(command, ())
]


@pytest.mark.parametrize(("command", "name", "base", "option"), EFFECTS)
def test_an_option_has_an_effect(command, name, base, option, outcome):
    assert outcome(command, base) != outcome(command, f"{base} {option}")


@pytest.mark.parametrize(
    ("command", "base", "option"),
    [
        *CONFLICTS,
        *((command, *row) for command, rows in REFUSED.items() for row in rows.values()),
    ],
)
def test_an_option_without_effect_is_refused(command, base, option, outcome):
    status, said, error, files = outcome(command, f"{base} {option}")
    flag = option.split()[0]
    assert (status, said, files) == (2, "", {})
    assert error.startswith(f"gpusim: {LONG.get(flag, flag)}") and error.count("\n") == 1
    assert error.count("; ") == 1


# ---- panels of `look`

OF_LENS = {"f_number", "focus"}
OF_SENSOR = OF_LENS | {"exposure", "iso"}
OF_CONTENT = set(
    "size samples_per_pixel light luminance band wavelengths kind scale part layer view key".split()
)
OF_SCENE = OF_CONTENT | {"border", "fov", "depth", "projection", "camera"}
OF_FRAME = OF_SCENE | OF_SENSOR | {"seed", "device", "tolerance", "guaranteed", "strict"}
USED = {
    "scene": OF_CONTENT,
    "spectra": OF_CONTENT | {"at"},
    "oi": OF_SCENE | OF_LENS | {"device"},
    "psf": OF_LENS | {"of", "camera"},
    "mtf": OF_LENS | {"of", "camera"},
    "camera": OF_LENS | {"iso", "camera"},
    "raw": OF_FRAME,
    "picture": OF_FRAME | {"scaling", *DEVELOPING},
    "noise": OF_FRAME,
    "ptc": {"iso", "seed", "device", "camera"},
    "snr": {"exposure", "iso", "light", "camera"},
    "sfr": OF_FRAME,
    "colors": OF_FRAME - {"band"} | {*DEVELOPING},
    "error": OF_FRAME - {"seed"},
    "plan": OF_FRAME - {"seed"} | {"demosaic", "denoise", "look"},
}
OWN = {
    "seed": (CHART, "--seed 5"),
    "at": (CHART, "--at 3,4"),
    "of": ("--camera phone", "--of 500"),
}
ALWAYS = {"what", "out"}
REASONS = {("colors", "band"): "channels named by it are radiance in an unknown light"}
PLOTS = [
    (panel, part.name)
    for panel in PANELS
    for part in fields(COMMANDS["look"][0])
    if not part.metadata["positional"] and part.name not in ALWAYS
]


def looked(panel, name):
    """Arguments of a panel before an option, and the option's."""
    base, option = ((ROWS["plan"] if panel == "plan" else SCENE) | OWN)[name]
    if not USED[panel] & {"size"}:
        base = re.sub(r"^\w[\w.-]* | --size \S+| --device \S+", "", base)
    if "device" not in USED[panel]:
        base = base.replace(" --device numpy", "")
    if "exposure" not in USED[panel]:
        base = re.sub(r" --exposure \S+", "", base)
    if panel in ("scene", "spectra"):
        base = base.replace(" --camera phone", "")
    if panel == "sfr":
        base = base.replace("colorchecker", "slanted-edge").replace("24x16", "64x48")
        base = re.sub(r"^(\w+\.(exr|npy|h5))", r"edge_\1", base).replace("1e-2", "3e-2")
        if "depth" not in base:  # few wavelengths, which some channels do not see
            base = re.sub(r"^(edge_\S+ --camera) phone", r"\1 mono", base)
    return f"{base} --what {panel} -o look.png", option


# A device changes no pixel of a plot: that it is used is only seen by the options that are refused
SHOWN = [row for row in PLOTS if row[1] in USED[row[0]] and row[1] != "device"]


@pytest.mark.parametrize(("panel", "name"), SHOWN)
@pytest.mark.slow
def test_an_option_of_a_plot_has_an_effect(panel, name, outcome):
    base, option = looked(panel, name)
    shown = outcome("look", base)
    assert shown[0] == 0 and shown != outcome("look", f"{base} {option}")


@pytest.mark.parametrize("panel", PANELS)
def test_an_option_that_a_plot_does_not_use_is_refused(panel, outcome):
    for name in (name for one, name in PLOTS if one == panel and name not in USED[panel]):
        base, option = looked(panel, name)
        status, _, error, files = outcome("look", f"{base} {option}")
        assert (status, files) == (2, {}) and error.count("\n") == 1, name
        words = REASONS.get((panel, name), f"look --what {panel} does not use it; leave it out")
        assert f": {words}" in error, name


# ---- folders


@pytest.mark.parametrize(
    ("command", "made"),
    [
        (f"simulate {CHART} -o DIR/a.npz --report DIR/more/r.json", {"a.npz", "more/r.json"}),
        (f"plan {CHART} --json DIR/a.json", {"a.json"}),
        (f"look {CHART} --what raw -o DIR/a.png", {"a.png"}),
        (f"video {PHOTO} --frames 2 -o DIR/a.png", {"a_0000.png", "a_0001.png", "a_video.json"}),
        (f"video {PHOTO} --frames 2 -o DIR/a.mkv", {"a.mkv"}),
        (f"video {PHOTO} --frames 2 -o DIR/a.y4m", {"a.y4m"}),
        (f"pairs {CHART} -o DIR", {"000000.tar", "pairs.json"}),
    ],
)
def test_commands_make_the_folder_of_their_output(command, made, inputs, tmp_path, monkeypatch):
    monkeypatch.chdir(inputs)
    folder = tmp_path / "new" / "folder"
    assert main(shlex.split(command.replace("DIR", str(folder)))) == 0
    found = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert found >= made


# ---- the processor's controls


def test_controls_of_the_processor_are_settings_of_the_camera(inputs, outcome):
    """The pictures are those of a camera file with these keys, its preset white and table left out."""
    preset = gs.open_camera("phone").with_(
        white_balance="preset", **{"processor.white": [0.5, 1.0, 0.7]}
    )
    learned = preset.with_(demosaic="learned", table=bayer_table())
    assert preset.processor.white and learned.processor.table
    assert operate_camera(learned, demosaic="learned") == learned
    assert operate_camera(learned, demosaic="best").processor == replace(
        preset.processor, demosaic="best"
    )
    changed = operate_camera(preset, white_balance="gray-world", denoise=1.5, demosaic="malvar")
    keys = {"white_balance": "gray-world", "denoise": 1.5, "demosaic": "malvar"}
    assert changed.processor == gs.open_camera("phone").with_(**keys).processor
    lines = ['base = "phone"', "[processor]", *(f"{key} = {keys[key]!r}" for key in keys)]
    (inputs / "own.toml").write_text("\n".join(lines))
    options = "--white-balance gray-world --denoise 1.5 --demosaic malvar -o out.png"
    by_option = outcome("simulate", f"{CHART} {options}")[3]
    by_file = outcome("simulate", f"{CHART.replace('phone', 'own.toml')} -o out.png")[3]
    assert by_option == by_file and by_option


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("--demosaic cubic", "unknown processor.demosaic"),
        ("--white-balance grey", "unknown processor.white_balance"),
        ("--look film", "unknown processor.look"),
        ("--white-balance preset", "processor.white = []: allowed is camera values of white"),
    ],
)
def test_wrong_values_are_refused_as_in_camera_files(option, words, outcome):
    for command in ("simulate", "video", "pairs --pictures"):
        command, *more = command.split()
        status, said, error, files = outcome(
            command, f"{CHART} {' '.join(more)} -o out.png {option}"
        )
        assert (status, said, files) == (2, "", {})
        assert words in error and error.count("\n") == 1
