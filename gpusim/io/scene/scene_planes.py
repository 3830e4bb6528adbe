"""Scenes as planes for other programs: ENVI files and spectral TIFF.

Both hold float32 numbers: reflectances if the light is known, else radiance. The other fields of a
scene, for `open_scene`, are one JSON text: the header's field `gpusim scene`, or the ImageDescription
of the first page of a TIFF.
"""

import json
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.domain.scene import Scene
from gpusim.domain.spectrum import energy_per_photon
from gpusim.io.atomic import atomic_path
from gpusim.io.files import name_in_errors, open_file, reading, silence
from gpusim.io.scene.envi import PER_NM, data_files
from gpusim.io.scene.scene_exr import parts_of_json, scene_planes

PAGE_NAME = 285  # tag of TIFF
FORMAT = "gpusim spectral scene"
LONGEST_TEXT = 2**20  # [byte] of a description
LARGEST_TIFF = 2**32 - 2**24  # [byte] of numbers; more need a BigTIFF
UNIT = "W m-2 sr-1 nm-1"


def write_envi(path, scene: Scene, *, radiance: bool = False):
    """Write an ENVI header, and its numbers next to it as .img.

    Band sequential float32, the least significant byte first: reflectances, or radiance in W m-2 sr-1
    um-1 with `data gain values` of 1. Raises BadFile, DoesNotFit.
    """
    path = Path(path)
    values, parts = _planes(path, scene, radiance)
    data = path.with_suffix(".img")
    others = [file.name for file in data_files(path) if file != data]
    if others:
        names = ", ".join(others)
        raise BadFile(
            path, f"{names} would count as its data as well; remove it, or take another name"
        )
    numbers = ", ".join(map(repr, scene.wavelengths.tolist()))
    if "illuminant" in parts:
        kind = ["reflectance scale factor = 1"]
    else:
        values *= np.float32(PER_NM)
        kind = [f"data gain values = {{{', '.join(['1'] * len(values))}}}"]
        kind += ["z plot titles = {Wavelength [nm], Radiance [W m-2 sr-1 um-1]}"]
    bands, rows, cols = values.shape
    lines = [
        "ENVI",
        "description = {a scene of gpusim}",
        f"samples = {cols}",
        f"lines = {rows}",
        f"bands = {bands}",
        "header offset = 0",
        "file type = ENVI Standard",
        "data type = 4",
        "interleave = bsq",
        "byte order = 0",
        "wavelength units = Nanometers",
        f"wavelength = {{{numbers}}}",
        *kind,
        f"gpusim scene = {json.dumps(parts)}",
    ]
    # the data come first: a header without data is refused
    with atomic_path(path) as header, atomic_path(data) as raw:
        header.write_text("\n".join(lines) + "\n", encoding="ascii")
        with open(raw, "wb") as file:
            values.astype("<f4", copy=False).tofile(file)


def write_tiff(path, scene: Scene, *, radiance: bool = False):
    """Write a TIFF of one page for each band, float32, named by its wavelength, without packing.

    Radiance is in W m-2 sr-1 nm-1. Raises BadFile, DoesNotFit.
    """
    import tifffile

    values, parts = _planes(path, scene, radiance)
    said = {
        "format": FORMAT,
        "quantity": "reflectance" if "illuminant" in parts else "radiance",
        "unit": "1" if "illuminant" in parts else UNIT,
        "wavelengths_nm": scene.wavelengths.tolist(),
        "scene": parts,
    }
    text = json.dumps(said)
    with atomic_path(path) as temporary:
        with tifffile.TiffWriter(temporary, bigtiff=values.nbytes > LARGEST_TIFF) as file:
            for number, (nm, plane) in enumerate(zip(scene.wavelengths, values, strict=True)):
                file.write(
                    plane,
                    photometric="minisblack",
                    description=text if number == 0 else f"{nm:g} nm",
                    metadata=None,
                    software="gpusim",
                    extratags=[(PAGE_NAME, "s", 0, f"{nm:g} nm", True)],
                )


def _planes(path, scene, radiance):
    """Return planes, radiance in W m-2 sr-1 nm-1, and the other fields. Raises BadFile."""
    held = (["depth"] if scene.depth is not None else []) + sorted(scene.labels)
    if held:
        raise BadFile(path, f"{scene.name} has {', '.join(held)}, which only .exr and .npz hold")
    values, parts = scene_planes(path, scene, radiance)
    if "illuminant" not in parts:
        with np.errstate(over="ignore"):
            values *= energy_per_photon(scene.wavelengths)[:, None, None].astype(np.float32)
    if not np.isfinite([values.min(), values.max()]).all():
        raise BadFile(path, "NaN or infinite values, or more than float32 holds")
    return values, parts


def scene_of_header(path, text: str | None) -> dict:
    """Return fields of Scene from an ENVI header's field `gpusim scene`. Raises BadFile."""
    if text is None:
        return {}
    with name_in_errors(path), reading(path, "an ENVI header of a scene"):
        return parts_of_json(json.loads(text))


def scene_of_tiff(path) -> tuple[np.ndarray, str, dict] | None:
    """Return wavelengths [nm], kind and fields of Scene of a TIFF; None if gpusim did not write it.

    Raises BadFile.
    """
    import tifffile

    with silence("tifffile"), open_file(path) as file, reading(path, "a TIFF"):
        tag = tifffile.TiffFile(file, name=str(path)).pages.first.tags.get("ImageDescription")
        text = tag.value if tag is not None and tag.count < LONGEST_TEXT else ""
    if not isinstance(text, str) or not text.startswith(f'{{"format": "{FORMAT}"'):
        return None
    with name_in_errors(path), reading(path, "a spectral TIFF"):
        said = json.loads(text)
        nm = np.asarray(said["wavelengths_nm"], np.float64)
        return nm, str(said["quantity"]), parts_of_json(said["scene"])
