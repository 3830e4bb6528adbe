"""Quality of demosaicking on photographs, gpusim and Menon 2007. For times see `gpusim bench peers`.

    python bench/demosaic.py --device opencl:0 --photographs DIR [--json bench/results/demosaic-NAME.json]

Every sub-folder of DIR with PNG pictures is a set. RGGB, 8 bits, interpolated in their encoding
(domain "linear"), CPSNR over the three channels without a border of 10 pixels, mean over the set.
For `best` there are also separate means over the first, third .. picture of each set, on which its
constants were chosen, and over the others. Further tables: a lens that blurs (Gaussian on linear
light, CPSNR after sRGB encoding), and Poisson noise with 2 e- read noise at a mean of 5 .. 1000
electrons; and mosaics that have built-in filters, by weighted means and by these. Channels other than
red, green and blue are sums of these in linear light, as the built-in phone sees them.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from results import Tables, finish, parser, ready, start

from gpusim.apps.l3.channels import channel_mix
from gpusim.apps.l3.photographs import decode_srgb, encode_srgb, sample_mosaic
from gpusim.domain.errors import BadFile
from gpusim.domain.guided import BUILT_IN, channels_of
from gpusim.domain.mosaics import MOSAICS
from gpusim.io.camera.guided import guided_table
from gpusim.kernels.processor.guided import guided
from gpusim.kernels.processor.interpolate import interpolate
from gpusim.kernels.stage import public_function

TESTS = Path(__file__).parents[1] / "tests"  # the protocol is theirs
sys.path[:0] = [str(TESTS), str(TESTS / "stages")]
MODES = ("bilinear", "malvar", "adaptive", "best", "learned")
LINEAR = ("bilinear", "malvar")  # the same in any domain
SEEN = ("bilinear", "adaptive", "best", "learned")


def quality(tables, device, sets):
    """Return the CPSNR of every mode on every set, in the pictures' encoding."""
    from test_best import ENCODED
    from test_demosaic import cpsnr, mosaic

    def ours(name):
        options = {
            key: value for key, value in ENCODED.items() if key != "domain" or name not in LINEAR
        }
        method = public_function(f"processor.{name}")
        return lambda image: cpsnr(
            255 * np.moveaxis(method(mosaic(image), **options, device=device), 0, 2), image
        )

    methods = {name: ours(name) for name in MODES}
    if find_spec("colour_demosaicing"):
        from colour_demosaicing import demosaicing_CFA_Bayer_Menon2007

        methods["Menon 2007"] = lambda image: cpsnr(
            demosaicing_CFA_Bayer_Menon2007(mosaic(image).astype(float)), image
        )
    tables.table(
        "CPSNR [dB], interpolated as encoded",
        "",
        *(f"{name} ({len(images)})" for name, images in sets.items()),
    )
    for name, method in methods.items():
        found = [np.array([method(image) for image in images]) for images in sets.values()]
        tables.row(name, *(f"{values.mean():.2f}" for values in found))
        if name in ("best", "Menon 2007"):
            for half, first in (("chosen on", 0), ("held out", 1)):
                tables.row(
                    f"{name}, {half}", *(f"{values[first::2].mean():.2f}" for values in found)
                )


def other_mosaics(tables, device, sets):
    """Return the CPSNR of mosaics that are not Bayer's, in the pictures' encoding."""
    tables.table(
        "CPSNR [dB] of other mosaics, interpolated as encoded, weighted means / built-in filters",
        "",
        *(f"{name} ({len(images)})" for name, images in sets.items()),
    )
    for name in BUILT_IN:
        cells = []
        for images in sets.values():
            found = np.mean([_of_mosaic(image, name, device) for image in images], axis=0)
            cells.append(" / ".join(f"{value:.2f}" for value in found))
        tables.row(name, *cells)


def _of_mosaic(image, name, device):
    """Return the CPSNR of weighted means and of the built-in filters on a picture."""
    from test_demosaic import cpsnr

    options = {"black_level": 0.0, "scale": 1 / 255, "device": device}
    mosaic, letters = MOSAICS[name], channels_of(MOSAICS[name])
    light = np.tensordot(decode_srgb(image / 255), channel_mix(mosaic)[0], (2, 1))
    wanted = np.rint(255 * encode_srgb(light))
    raw = sample_mosaic(np.moveaxis(wanted, 2, 0), mosaic, letters).astype(np.uint16)
    cfa = np.array([[letters.index(letter) for letter in text] for text in mosaic])
    filters = {"phase": mosaic, "domain": "linear", "table": guided_table(name)}
    planes = interpolate(raw, cfa=cfa, **options), guided(raw, **filters, **options)
    return [cpsnr(255 * np.moveaxis(picture, 0, 2), wanted) for picture in planes]


def seen(tables, device, sets):
    """Return the CPSNR for the pictures as a camera sees them: blurred and noisy."""
    from test_best import captured

    methods = [public_function(f"processor.{name}") for name in SEEN]
    tables.table(f"CPSNR [dB] as a camera sees them, {' / '.join(SEEN)}", "", *sets)
    for electrons, blur in (
        (None, 0.0),
        (None, 0.5),
        (None, 0.8),
        (None, 1.2),
        (None, 2.0),
        (5, 0.0),
        (20, 0.0),
        (100, 0.0),
        (1000, 0.0),
    ):
        shown = {"electrons": electrons, "blur": blur, "methods": methods}
        cells = [
            np.mean(
                [captured(image, seed=number, **shown) for number, image in enumerate(images)],
                axis=0,
            )
            for images in sets.values()
        ]
        tables.row(
            f"{electrons} electrons" if electrons else f"no noise, blur of {blur} pixels",
            *(" / ".join(f"{value:.2f}" for value in cell) for cell in cells),
        )


def main():
    """Print the tables, and write them if requested."""
    made = parser(__doc__)
    made.add_argument(
        "--photographs",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder with a sub-folder of PNG pictures per set",
    )
    arguments = made.parse_args()
    device, old = ready(arguments, "demosaic")
    folder = arguments.photographs
    found = (
        [path for path in sorted(folder.iterdir()) if any(path.glob("*.png"))]
        if folder.is_dir()
        else []
    )
    if not found:
        raise BadFile(
            folder,
            "has no photographs: wanted a folder with a sub-folder of PNG pictures for each set",
        )
    from test_demosaic import photographs

    sets, tables = {path.name: list(photographs(path)) for path in found}, Tables()
    quality(tables, device, sets)
    seen(tables, device, sets)
    other_mosaics(tables, device, sets)
    finish(arguments, "demosaic", device, tables.rows, old, columns=tables.columns)


if __name__ == "__main__":
    start(main)
