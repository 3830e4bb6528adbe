"""Every reader on damaged files: a result or a GpusimError in one line, in bounded time and memory.

`python tests/fuzz.py --count 1000` prints one JSON row per reader. Input `number` of a reader and a seed is always the
same: `python tests/fuzz.py --reader png --seed 1 --first 517 --count 1 --keep FOLDER` makes it again.
"""

import argparse
import faulthandler
import io
import json
import re
import struct
import subprocess
import sys
import tempfile
import time
import warnings
import zlib
from contextlib import contextmanager, suppress
from pathlib import Path

import calibration_texts
import film_files
import instrument_files
import json_mutations
import mat_mutations
import mutations
import numpy as np
import picture_mutations

from gpusim.apps.l3.layout import layout
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import GpusimError
from gpusim.domain.learned import FilterTable
from gpusim.domain.memory import require_memory
from gpusim.io.camera.calibration import read_calibration
from gpusim.io.camera.cameras import camera_names, open_camera
from gpusim.io.camera.learned import read_table, write_table
from gpusim.io.camera.noise_profile import read_noise_profile
from gpusim.io.camera.psf import read_psf
from gpusim.io.camera.zemax import read_zemax_psf
from gpusim.io.exr import write_rgb_exr, write_spectral_exr
from gpusim.io.frame.icc import icc_profile
from gpusim.io.frame.view_images import open_views
from gpusim.io.scene.light_fields import open_light_field
from gpusim.io.scene.scenes import open_scene

SEEDS = (1, 2, 3)  # of the kept runs
READERS = (
    "camera",
    "curves",
    "psf",
    "table",
    "scene",
    "light_field",
    "views",
    "exr",
    "png",
    "jpg",
    "tiff",
    "planes",
    "calibration",
    "profile",
    "mat",
    "mat73",
    "envi",
    "array",
    "spectra",
    "listing",
    "hdf5",
    "bands",
    "link",
    "fields",
    "manifest",
    "sheet",
    "film",
)
JSON = ("link", "fields", "manifest", "sheet")
WAVES = np.array([400.0, 500.0, 650.0])
SUFFIXES = {
    "camera": ".toml",
    "exr": ".exr",
    "png": ".png",
    "jpg": ".jpg",
    "tiff": ".tif",
    "planes": ".tif",
    "calibration": ".yaml",
    "profile": ".dng",
    "mat": ".mat",
    "mat73": ".mat",
    "hdf5": ".h5",
    "bands": ".png",
    "envi": ".envi",
    "array": ".npy",
    "spectra": ".csv",
    "listing": ".txt",
    "film": ".mkv",
} | dict.fromkeys(JSON, ".json")  # others read .npz
READ = {
    "camera": open_camera,
    "psf": read_psf,
    "table": read_table,
    "light_field": open_light_field,
    "views": open_views,
    "calibration": read_calibration,
    "profile": read_noise_profile,
    "planes": lambda path: open_scene(path, wavelengths=WAVES),
    "array": lambda path: open_scene(path, wavelengths=WAVES),
    "spectra": lambda path: open_scene(path, size=(60, 40)),
    "film": film_files.read_film,
    "link": json_mutations.read_link,
    "fields": json_mutations.read_fields,
    "manifest": json_mutations.read_manifest,
    "sheet": json_mutations.read_sheet,
}  # others open scenes
MUTATE = {
    "curves": mutations.table,
    "calibration": mutations.yaml,
    "png": picture_mutations.png,
    "jpg": picture_mutations.jpeg,
    "exr": picture_mutations.exr,
    "tiff": picture_mutations.tiff,
    "planes": picture_mutations.tiff,
    "profile": picture_mutations.tiff,
    "mat": mat_mutations.version_5,
    "mat73": mat_mutations.version_7_3,
    "hdf5": mat_mutations.hdf5,
    "bands": picture_mutations.png,
    "envi": instrument_files.envi,
    "array": instrument_files.array,
    "spectra": mutations.table,
    "listing": instrument_files.listing,
    "fields": json_mutations.fields,
    "manifest": json_mutations.manifest,
    "link": json_mutations.changed,
    "sheet": json_mutations.changed,
}  # others see Inputs.make
INSTRUMENTS = {
    "envi": instrument_files.envi_files,
    "array": instrument_files.array_files,
    "spectra": lambda: instrument_files.TABLES,
    "listing": instrument_files.listings,
}
PEAK = Path("/proc/self/clear_refs")
LONGEST = 5.0  # [s] for one input
ROOM = 2**30  # [byte] of addresses that the process may have beside those of its modules: RLIMIT_AS
LARGEST = (
    256 * 2**20
)  # [byte] that the whole process may hold: 60 MiB of modules, and inputs of 10 MB as they unfold
UNACCOUNTED = (
    16 * 2**20
)  # [byte] that one input may take beside twice what its reader asked for: what libraries load
PICTURE = 6  # times as long, and 32 times as much beside estimates, for a whole frame
LONGEST_MESSAGE = 500


def good_archives(reader):
    """Arrays of archives that the reader takes."""
    random = np.random.default_rng(7)
    values = random.random((3, 6, 5), np.float32)
    if reader == "psf":
        plain = {"wavelengths_nm": WAVES, "psf": values, "spacing_um": 1.5}
        return [
            plain,
            plain | {"integrated": True},
            plain | {"heights": [0.0, 1.0], "psf": np.stack([values, values])},
            plain
            | {
                "grid_y": [-1.0, 1.0],
                "grid_x": [-1.0, 0.0, 1.0],
                "psf": random.random((2, 3, 3, 4, 4)),
            },
        ]
    if reader == "table":
        made = layout(("RG", "GB"), "RGB", noise=(0.0, 0.1), radius=1)
        found = io.BytesIO()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.npz"
            write_table(
                path,
                FilterTable(
                    made, random.random(made.shape), random.random(made.shape[:-1]), "a test"
                ),
            )
            found = dict(np.load(path))
        return [found, {key: value for key, value in found.items() if key != "offsets"}]
    if reader == "views":
        plain = {"values": values.reshape(1, 3, 6, 5, 1), "slope_px_per_radius_diopter": -2.0}
        plain |= {"object_distance_m": 0.5, "focal_length_m": 4e-3, "f_number": 2.0}
        plain |= {"extent_radii": 1.0}
        return [plain, plain | {"light": np.ones((1, 3)), "name": "a", "object_distance_m": np.inf}]
    if reader == "light_field":
        shared = {"views": [1, 2], "radius_m": 1e-3, "object_distance_m": 0.5}
        shared |= {"wavelengths_nm": WAVES, "light_field_name": "a"}
        views = {f"view_00_0{i}.cube": values for i in range(2)}
        depth = {f"view_00_0{i}.depth_m": 1 + values[0] for i in range(2)}
        layer = {"cube": values, "alpha": values[0], "depth_m": 0.5}
        layer = {f"view_00_01.layer_0.{key}": value for key, value in layer.items()}
        return [shared | views, shared | views | depth | layer]
    return [
        {
            "wavelengths_nm": WAVES,
            "cube": values,
            "depth_m": 1 + values[0],
            "fov_rad": 0.5,
            "name": "a",
        },
        {
            "wavelengths_nm": WAVES,
            "cube": values,
            "kind": "reflectance",
            "border": "scene",
            "margin": 1,
        },
        {
            "wavelengths_nm": WAVES,
            "coefficients": values,
            "basis": np.eye(3),
            "illuminant": np.ones(3),
            "illuminant_wavelengths_nm": WAVES,
            "samples_per_pixel": 1.5,
        },
        {
            "wavelengths_nm": WAVES,
            "ids": np.zeros((6, 5), np.uint8),
            "shading": values[0],
            "spectra": np.ones((2, 3)),
        },
        {"wave": WAVES, "photons": values.T, "illuminant_photons": np.ones(3), "fov_deg": 30.0},
        {"wave": WAVES, "coef": values.T, "basis": np.eye(3)},
    ]


def good_pictures(reader, folder):
    """Bytes of files that the reader takes."""
    from PIL import Image

    random, found = np.random.default_rng(7), []
    rgb = random.integers(0, 256, (7, 9, 3), np.uint8)
    if reader == "exr":
        path = folder / "good.exr"
        for write in (
            lambda: write_spectral_exr(path, WAVES, random.random((3, 7, 9))),
            lambda: write_spectral_exr(
                path, WAVES, random.random((3, 7, 9)), reflectance=True, half=True
            ),
            lambda: write_rgb_exr(path, random.random((7, 9, 3))),
            lambda: write_foreign_exr(path, random),
            lambda: write_layers_exr(path, random),
            lambda: write_chroma_exr(path, random),
            lambda: write_parts_exr(path, random),
        ):
            write()
            found.append(path.read_bytes())
        return found
    if reader in ("tiff", "planes"):
        return good_tiffs(reader, random)

    def saved(image, **options):
        buffer = io.BytesIO()
        image.save(buffer, **options)
        found.append(buffer.getvalue())

    if reader == "jpg":
        exif = Image.Exif()
        exif[274] = 6
        saved(Image.fromarray(rgb), format="JPEG", exif=exif)
        saved(Image.fromarray(rgb), format="JPEG", progressive=True, subsampling=0)
        saved(Image.fromarray(rgb[..., 0]), format="JPEG")
        exif.get_ifd(0x8769)[0xA001] = 65535
        exif.get_ifd(0x8769)[0xA005] = {1: "R03"}
        profile = icc_profile(DISPLAYS["display-p3"])
        saved(Image.fromarray(rgb), format="JPEG", exif=exif.tobytes())
        saved(Image.fromarray(rgb), format="JPEG", icc_profile=profile)
        saved(
            Image.fromarray(rgb), format="MPO", save_all=True, append_images=[Image.fromarray(rgb)]
        )
        return found
    for image in (
        Image.fromarray(rgb),
        Image.fromarray(rgb[..., 0]),
        Image.fromarray(rgb).quantize(8),
        Image.fromarray(rgb[..., 0] > 127),
        Image.fromarray(np.dstack([rgb, rgb[..., :1]])),
    ):
        saved(image, format="PNG")
    saved(Image.fromarray(rgb), format="PNG", transparency=(1, 2, 3))
    for colour, channels in ((0, 1), (2, 3), (6, 4)):
        lines = b"".join(
            b"\1" + line.tobytes() for line in random.integers(0, 256, (7, 18 * channels), np.uint8)
        )
        found.append(
            picture_mutations.png_of(
                [
                    (b"IHDR", struct.pack(">IIBBBBB", 9, 7, 16, colour, 0, 0, 0)),
                    (b"IDAT", zlib.compress(lines)),
                    (b"IEND", b""),
                ]
            )
        )
        for tag in colour_chunks(DISPLAYS["display-p3"])[: 6 if colour == 2 else 4]:
            head, *rest = (
                (b"IHDR", struct.pack(">IIBBBBB", 9, 7, 16, colour, 0, 0, 0)),
                (b"IDAT", zlib.compress(lines)),
                (b"IEND", b""),
            )
            found.append(picture_mutations.png_of([head, tag, *rest]))
    return found


def write_foreign_exr(path, random):
    """A picture of BT.2020 with a depth, a normal and an alpha."""
    import OpenEXR

    names = ("R", "G", "B", "A", "depth.T", "normal.X")
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    }
    OpenEXR.File(header, {name: random.random((7, 9), np.float32) for name in names}).write(
        str(path)
    )


def write_layers_exr(path, random):
    """Two views and passes in a crop, with the attributes that a reader uses."""
    import OpenEXR

    names = [f"{view}{letter}" for view in ("", "right.") for letter in "RGBAZ"]
    names += [f"N.Combined.{letter}" for letter in "RGB"] + ["IndexOB.X", "CryptoObject00.r"]
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "multiView": ["left", "right"],
        "whiteLuminance": 200.0,
        "colorInteropID": "lin_ap1_scene",
        "adoptedNeutral": np.array([0.3, 0.3], np.float32),
        "Orientation": 6,
        "dataWindow": (np.array([2, 1], np.int32), np.array([10, 7], np.int32)),
        "displayWindow": (np.array([0, 0], np.int32), np.array([11, 6], np.int32)),
    }
    planes = {name: random.random((7, 9), np.float32) for name in names}
    OpenEXR.File(header, planes | {"IndexOB.X": np.ones((7, 9), np.float32)}).write(str(path))


def write_chroma_exr(path, random):
    """Luminance and chroma of all pixels, of an environment of longitudes and latitudes."""
    import OpenEXR

    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "envmap": OpenEXR.ENVMAP_LATLONG,
    }
    OpenEXR.File(
        header, {name: random.random((6, 8), np.float32) / 4 for name in ("Y", "RY", "BY")}
    ).write(str(path))


def write_parts_exr(path, random):
    """Four parts: a picture and its distances in two views."""
    import OpenEXR

    parts = []
    for view in ("left", "right"):
        for name, channels in (("rgba", "RGB"), ("depth", "Z")):
            header = {"type": OpenEXR.scanlineimage, "view": view}
            planes = {channel: 1 + random.random((7, 9), np.float32) for channel in channels}
            parts.append(OpenEXR.Part(header, planes, f"{name}.{view}"))
    OpenEXR.File(parts).write(str(path))


def colour_chunks(display):
    """Chunks of a PNG that say its colours."""
    profile = b"profile\0\0" + zlib.compress(icc_profile(display))
    return [
        (b"cICP", bytes([9, 16, 0, 0])),
        (b"iCCP", profile),
        (b"gAMA", struct.pack(">I", 45455)),
        (b"cHRM", struct.pack(">8I", 31270, 32900, 70800, 29200, 17000, 79700, 13100, 4600)),
        (b"tRNS", bytes(6)),
        (b"pHYs", struct.pack(">IIB", 2, 1, 0)),
    ]


def good_tiffs(reader, random):
    """Bytes of TIFF files of photographs, or of stacks of three planes."""
    import tifffile

    def saved(array, **options):
        buffer = io.BytesIO()
        tifffile.imwrite(buffer, array, metadata=None, **options)
        return buffer.getvalue()

    rgb = random.integers(0, 65536, (40, 30, 3), np.uint16)
    if reader == "planes":
        planes = rgb.transpose(2, 0, 1)
        return [
            saved(planes, photometric="minisblack"),
            saved(planes, photometric="minisblack", compression="zlib"),
            saved(rgb, photometric="minisblack", planarconfig="contig"),
            saved(planes / 65536, photometric="minisblack", planarconfig="separate"),
            saved(
                (planes // 4).astype(np.int16),
                photometric="minisblack",
                extratags=[
                    (42112, "s", 0, '<Item sample="0" role="scale">0.0001</Item>', False),
                    (42113, "s", 0, "-9999", False),
                ],
            ),
        ]
    return [
        saved(
            rgb, photometric="rgb", rowsperstrip=9, compression=packed, predictor=packed is not None
        )
        for packed in (None, "zlib", "lzw", "packbits")
    ] + [
        saved(rgb[..., 0].astype(np.uint8), photometric="miniswhite", tile=(16, 16)),
        saved(rgb.astype(np.float32), photometric="rgb", compression="zlib", predictor=3),
        saved(np.dstack([rgb, rgb[..., :1]]), photometric="rgb", extrasamples=["unassalpha"]),
        saved((rgb // 256).astype(np.uint8), photometric="rgb", compression="jpeg"),
        saved(rgb.astype(np.uint32) * 65536, photometric="rgb", compression="zstd"),
        saved(rgb, photometric="rgb", iccprofile=icc_profile(DISPLAYS["display-p3"])),
    ]


def good_texts(reader):
    """Camera files, or a table of curves; and lines to put into camera files."""
    if reader == "curves":
        return [b"wavelength_nm,R,G,B\n400,0.1,0.2,0.3\n550,0.1,0.5,0.3\n700,0.4,0.2,0.1\n"], []
    if reader == "calibration":
        return CALIBRATIONS + [text.encode() for text in calibration_texts.TEXTS], []
    root = next(folder for folder in Path(__file__).parents if (folder / "README.md").is_file())
    blocks = re.findall(r"```toml\n(.*?)```", (root / "docs" / "cameras.md").read_text(), re.S)
    return (
        [(root / f"gpusim/data/cameras/{name}.toml").read_bytes() for name in camera_names()]
        + [block.encode() for block in blocks],
        "\n".join(blocks).split("\n"),
    )


CALIBRATIONS = [
    text.encode()
    for text in (
        "image_width: 640\nimage_height: 480\ncamera_name: cam\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [500.1, 0, 320.5, 0, 501.2, 240.5, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n"
        "  rows: 1\n  cols: 5\n  data: [-0.2, 0.05, 0.001, 0.002, 0.0]\n",
        "cam0:\n  camera_model: pinhole\n  intrinsics: [461.6, 460.3, 363.0, 248.1]\n  distortion_model: equidistant\n"
        "  distortion_coeffs: [-0.01, 0.02, -0.01, 0.003]\n  resolution: [752, 480]\n",
        "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n"
        "   dt: d\n   data: [ 500., 0., 320., 0., 500., 240., 0., 0., 1. ]\n",
        '<?xml version="1.0"?>\n<opencv_storage>\n<image_width>640</image_width>\n<image_height>480</image_height>\n'
        '<camera_matrix type_id="opencv-matrix">\n<rows>3</rows>\n<cols>3</cols>\n<dt>d</dt>\n'
        "<data>500. 0. 320. 0. 500. 240. 0. 0. 1.</data></camera_matrix>\n</opencv_storage>\n",
        '{"image_width": 640,\n"image_height": 480,\n"camera_matrix": [[500, 0, 320], [0, 500, 240], [0, 0, 1]],\n'
        '"distortion_coefficients": [0.1, 0.2, 0, 0, 0]}',
    )
]


class Inputs:
    """The mutated files of one reader."""

    def __init__(self, reader, folder):
        self.reader, self.lines, self.arrays = reader, [], []
        if reader in ("camera", "curves", "calibration"):
            self.good, self.lines = good_texts(reader)
        elif reader in INSTRUMENTS:
            self.good = INSTRUMENTS[reader]()
        elif reader in JSON:
            self.good = json_mutations.good(reader)
        elif reader == "film":
            self.good = film_files.good_films(np.random.default_rng(7))
        elif reader == "profile":
            self.good = [picture_mutations.good_profile(np.random.default_rng(7))]
        elif reader in ("mat", "mat73"):
            self.good = mat_mutations.good(reader)
        elif reader == "hdf5":
            self.good = mat_mutations.good_hdf5()
        elif reader == "bands":
            self.good = good_pictures("png", folder)[1:2] + good_pictures("png", folder)[6:7]
        elif reader in ("exr", "png", "jpg", "tiff", "planes"):
            self.good = good_pictures(reader, folder)
        else:
            self.arrays, self.good = good_archives(reader), []
            for arrays in self.arrays:
                buffer = io.BytesIO()
                np.savez_compressed(buffer, **arrays)
                self.good.append(buffer.getvalue())

    def make(self, seed, number) -> bytes:
        random = np.random.default_rng((seed, READERS.index(self.reader), number))
        data, other = mutations.pick(random, self.good), mutations.pick(random, self.good)
        if self.reader == "film" or (
            random.random() < 0.3
            and self.reader
            not in (
                "fields",
                "sheet",
            )
        ):  # which nobody reads as bytes
            return mutations.damaged(data, other, random)
        if self.arrays:
            return mutations.archive(mutations.pick(random, self.arrays), random)
        if self.reader == "camera":
            return mutations.toml(data, self.lines, random)
        return MUTATE[self.reader](data, random)


CAMERA = """base = "none"
[optics]
f_number = 2
focal_length_mm = 4
[sensor]
pixel_pitch_um = 2
qe = "curves.csv"
full_well_e = 9000
bits = 10
"""


def reading(reader, folder):
    """Return the path that a reader's inputs are written to, and what reads it."""
    if reader == "curves":
        (folder / "own.toml").write_text(CAMERA)
        return folder / "curves.csv", lambda path: open_camera(folder / "own.toml")
    if reader == "envi":
        return folder / "input.envi", read_envi
    if reader == "bands":
        return folder / "input.png", read_bands
    if reader == "listing":
        for number, text in enumerate(instrument_files.NEIGHBOURS):
            (folder / f"{number}.txt").write_text(text)
        return folder / "input.txt", read_listing
    return folder / f"input{SUFFIXES.get(reader, '.npz')}", READ.get(reader, open_scene)


def read_envi(path):
    """Open a header and its raw file that are one input."""
    head, _, raw = path.read_bytes().partition(instrument_files.MARK)
    (path.parent / "a.hdr").write_bytes(head)
    (path.parent / "a.raw").write_bytes(raw)
    return open_scene(path.parent / "a.hdr")


def read_bands(path):
    """Open a folder whose three bands are one input."""
    folder = path.parent / "bands"
    folder.mkdir(exist_ok=True)
    for nm in (450, 550, 650):
        (folder / f"a_{nm}nm.png").write_bytes(path.read_bytes())
    return open_scene(folder)


def read_listing(path):
    """Read a listing by itself, and with one of another wavelength or another field point where they go together."""
    read_zemax_psf(path)
    for number in range(len(instrument_files.NEIGHBOURS)):
        with suppress(GpusimError):
            read_zemax_psf([path.parent / f"{number}.txt", path], corner=instrument_files.CORNER)


def flaw(error) -> str | None:
    """What is wrong with what a reader raised."""
    text = str(error)
    if not isinstance(error, GpusimError):
        return f"{type(error).__name__}: {text[:120]}"
    if len(text) >= LONGEST_MESSAGE or not text.isprintable():
        return f"{type(error).__name__} of {len(text)} characters, {text.count(chr(10)) + 1} lines: {text[:80]!r}"
    return None


@contextmanager
def estimates():
    """Yield a list to which goes what readers ask `require_memory` for [byte]."""
    asked = []

    def require(what, needed):
        asked.append(needed)
        require_memory(what, needed)

    users = [
        module
        for name, module in sys.modules.items()
        if name.startswith("gpusim") and vars(module).get("require_memory") is require_memory
    ]
    for module in users:
        module.require_memory = require
    try:
        yield asked
    finally:
        for module in users:
            module.require_memory = require_memory


def fuzz(reader, seed, first, count, keep=None) -> dict:
    """Read `count` damaged files; returns a row of counts, with all that is wrong named by its number.

    An input is wrong that ends in no result and no GpusimError, or takes too long, or more than twice the memory that
    its reader estimated.
    """
    row = {
        "reader": reader,
        "seed": seed,
        "mutated": 0,
        "accepted": 0,
        "refused": 0,
        "wrong": 0,
        "examples": [],
        "slowest_s": 0.0,
        "slowest": None,
        "unaccounted_mib": 0.0,
    }
    with tempfile.TemporaryDirectory() as folder, estimates() as asked:
        inputs, (path, read) = Inputs(reader, Path(folder)), reading(reader, Path(folder))
        peak, longest, unaccounted = 0, LONGEST, UNACCOUNTED
        if reader == "fields":
            longest, unaccounted = PICTURE * LONGEST, 32 * UNACCOUNTED
        if reader == "film":  # FFmpeg decodes a frame when it opens a file
            unaccounted = 8 * UNACCOUNTED
        for data in inputs.good:
            path.write_bytes(data)
            try:
                read(path)
            except GpusimError as error:
                if reader != "camera":  # the documentation's second block is no whole file
                    raise AssertionError(
                        f"the unharmed {path.name} was refused: {error}"
                    ) from error
        for number in range(first, first + count):
            data = inputs.make(seed, number)
            path.write_bytes(data)
            if keep:
                (Path(keep) / f"{reader}-{seed}-{number}{path.suffix}").write_bytes(data)
            faulthandler.dump_traceback_later(20 * LONGEST, exit=True)
            asked.clear()
            PEAK.write_text("5")  # counts from here
            held, began, problem = memory("VmRSS"), time.perf_counter(), None
            try:
                read(path)
                row["accepted"] += 1
            except Exception as error:  # the very thing that is looked for
                problem = flaw(error)
                row["refused"] += problem is None
            took = time.perf_counter() - began
            faulthandler.cancel_dump_traceback_later()
            row["mutated"] += 1
            if took > row["slowest_s"]:
                row |= {"slowest_s": round(took, 3), "slowest": number}
            if took > longest:
                problem = problem or f"took {took:.1f} s"
            taken = memory("VmHWM") - held
            peak = max(peak, held + taken)
            row["unaccounted_mib"] = max(
                row["unaccounted_mib"], round((taken - 2 * sum(asked)) / 2**20, 1)
            )
            if taken > 2 * sum(asked) + unaccounted:
                problem = (
                    problem or f"took {taken / 2**20:.0f} MiB, asked for {sum(asked) / 2**20:.1f}"
                )
            if problem:
                row["wrong"] += 1
                row["examples"] = [*row["examples"], f"{number}: {problem}"][:30]
    return row | {"peak_mib": round(peak / 2**20)}


def limit_memory():
    """From now on the process may take ROOM bytes more than it has."""
    import resource

    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + ROOM, resource.getrlimit(resource.RLIMIT_AS)[1]))


def memory(key):
    """VmRSS, the resident size of this process, or VmHWM, its peak since PEAK was written to [byte]."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(status[key].split()[0]) * 1024


def in_a_process(reader, seed, count) -> dict:
    """Row of `fuzz` in a process of its own, whose memory is limited."""
    command = [
        sys.executable,
        __file__,
        "--reader",
        reader,
        "--seed",
        str(seed),
        "--count",
        str(count),
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])  # OpenEXR writes to standard output as well


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--reader", choices=READERS, action="append")
    parser.add_argument("--seed", type=int, default=SEEDS[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=125)
    parser.add_argument("--keep", help="folder in which inputs are kept")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    warnings.simplefilter("error", RuntimeWarning)  # of NumPy: a second line
    for reader in arguments.reader or READERS:
        fuzz(reader, arguments.seed, 0, 0)  # modules are loaded before memory is limited
        limit_memory()
        print(
            json.dumps(
                fuzz(reader, arguments.seed, arguments.first, arguments.count, arguments.keep)
            ),
            flush=True,
        )


if __name__ == "__main__":
    sys.exit(main())
