"""Filters for Bayer mosaics, trained on photographs: encoded pictures, and linear light with noise.

At noise level 0 a frame is the photograph's own numbers (8 bits, sRGB) seen through the mosaic, and
blurred copies of it; at the others it is its linear light, counted in electrons with shot and read
noise, on variance-stabilised codes. Both are nearly the same code, so filters can be interpolated
between all levels. Filters keep flat fields exactly, red and blue play the same part, and mirror
images count as further photographs.
"""

import datetime
import json
from pathlib import Path

import numpy as np

from gpusim import __version__
from gpusim.apps.l3.fit import NormalEquations
from gpusim.apps.l3.layout import layout
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadFile
from gpusim.domain.learned import Code, FilterTable
from gpusim.io.camera.learned import write_table
from gpusim.io.scene.photo import open_photo

decode_srgb, encode_srgb = DISPLAYS["srgb"].decode, DISPLAYS["srgb"].encode
MOSAIC = ("RG", "GB")
# of the code, relative to white: 15,600 to 12 electrons
SIGMAS = 0.0, 0.004, 0.009, 0.018, 0.035, 0.07, 0.14
READ = 2.0  # [e-]
BLURS = (0.0, 0.5, 0.8, 1.2, 2.0)  # standard deviations [pixel]
NOISY_BLURS = (0.0, 0.8, 2.0)
BLURRED = 0.25  # weight of a blurred frame, against 1 of a sharp one
BORDER = 4  # pixels that do not count, next to mirrored ones


def equations(photographs, seed: int = 1, blurs=BLURS) -> NormalEquations:
    """The normal equations of photographs, an iterable of (rows, cols, 3) numbers 0 .. 255 in sRGB.

    seed: of the noise. blurs: standard deviations of the copies, 0 for the photograph itself
    [pixel].
    """
    found = NormalEquations(layout(MOSAIC, "RGB", noise=SIGMAS))
    random = np.random.default_rng(seed)
    for picture in photographs:
        light = decode_srgb(np.moveaxis(np.asarray(picture, float), 2, 0) / 255)
        for blur in blurs:
            for number, sigma in enumerate(SIGMAS):
                soft = blur_planes(light, blur)
                if sigma == 0:
                    code, wanted = Code("linear", 0.0, 1 / 255), encode_srgb(soft)
                    raw = sample_mosaic(255 * wanted)
                elif blur in NOISY_BLURS:
                    code, wanted = electron_code(sigma), soft
                    raw = random.poisson(sample_mosaic(wanted) / code.scale)
                    raw = raw + random.normal(0, READ, wanted.shape[1:])
                else:
                    continue
                found.add(raw, wanted, code, number, border=BORDER, weight=BLURRED if blur else 1.0)
    return found


def train(folders, path):
    """Write the table trained on all .png files of some folders, half of each with seed 1, half with 2."""
    pictures = [sorted(Path(folder).glob("[!.]*.png")) for folder in folders]
    found = NormalEquations(layout(MOSAIC, "RGB", noise=SIGMAS))
    for half in (0, 1):
        some = (read_rgb(file) for files in pictures for file in files[half::2])
        found.merge(equations(some, seed=1 + half))
    write_table(path, table(found, provenance([file.stem for files in pictures for file in files])))


def read_rgb(file):
    """Return the three channels of a photograph, 0 .. 255. Raises BadFile."""
    photo = open_photo(file)
    samples = photo.samples
    if samples.shape[-1] != 3 or samples.dtype != np.uint8 or not photo.coding.is_srgb:
        raise BadFile(
            file,
            f"{samples.dtype} of {samples.shape[-1]} channels; wanted a photograph of 8 bits in sRGB",
        )
    return samples


def provenance(names) -> str:
    """Return the provenance of a table of these photographs, as JSON."""
    record = {
        "program": f"gpusim {__version__}, gpusim.apps.l3.photographs",
        "date": f"{datetime.date.today()}",
        "photographs": list(names),
        "seeds": [1, 2],
        "noise of code / white": SIGMAS,
        "read noise [e-]": READ,
        "blur [pixel]": BLURS,
        "blur with noise [pixel]": NOISY_BLURS,
        "weight of blurred frames": BLURRED,
        "protocol": "noise 0: 8-bit sRGB as it is; else linear light in electrons, codes sqrt(e + 3/8 + read^2)",
    }
    return json.dumps(record)


def table(found: NormalEquations, text: str) -> FilterTable:
    """Solve for filters that keep flat fields."""
    return found.solve(preserve=True, exchanges=(("R", "B"),), provenance=text)


def electron_code(sigma):
    """The code of electrons, as many at white as make the noise `sigma` of it."""
    offset = Code("root", 0.0, 1.0, (1.0, READ)).offset
    white = (0.5 / sigma + np.sqrt(offset)) ** 2 - offset
    return Code("root", 0.0, 1 / white, (1.0, READ))


def sample_mosaic(planes, mosaic=MOSAIC, channels="RGB"):
    """Planes (C, rows, cols) of `channels` seen through a mosaic, rows of letters, (rows, cols)."""
    raw = np.empty(planes.shape[1:], planes.dtype)
    rows, cols = len(mosaic), len(mosaic[0])
    for row, col in np.ndindex(rows, cols):
        raw[row::rows, col::cols] = planes[channels.index(mosaic[row][col]), row::rows, col::cols]
    return raw


def blur_planes(planes, sigma):
    """Planes convolved with a Gaussian, mirrored at the borders."""
    from scipy.ndimage import gaussian_filter

    reach = int(np.ceil(4 * sigma))
    return gaussian_filter(planes, sigma, radius=reach, axes=(1, 2), mode="mirror")
