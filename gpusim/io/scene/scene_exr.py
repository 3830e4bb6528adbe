"""Scenes as spectral OpenEXR, with gpusim's own fields in an attribute.

The channels are reflectances (T) or radiance (S0), `Z` is the depth [m]. The attribute
`gpusimScene`, JSON, has the fields without a place in the layout: the light of reflectances, and
border, margin, fov, name and samples_per_pixel as in Scene.
"""

import json

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.domain.illuminated import Illuminated
from gpusim.domain.memory import require_memory
from gpusim.domain.scene import BOXES, FLOW, Scene
from gpusim.domain.spectrum import Spectrum
from gpusim.io.exr import write_spectral_exr
from gpusim.io.files import name_in_errors, reading
from gpusim.io.scene.npz import check_whole

ATTRIBUTE, DEPTH = "gpusimScene", "Z"
# besides light and depth
PARTS = {
    "border": str,
    "margin": int,
    "fov": float,
    "name": str,
    "samples_per_pixel": float,
    "projection": str,
}
COPIES = 2  # of the cube: samples, and samples in the unit of the file
ROWS = 64  # converted to spectra in float64 at once


def write_scene_exr(path, scene: Scene, *, radiance: bool = False, half: bool = False):
    """Write a scene, see `save_scene`. Raises BadFile, DoesNotFit."""
    values, parts = scene_planes(path, scene, radiance)
    depth = {} if scene.depth is None else {DEPTH: np.asarray(scene.depth)}
    labels = {
        f"label.{name}": label for name, label in scene.labels.items() if name not in (FLOW, BOXES)
    }
    if len(labels) < len(scene.labels):
        raise BadFile(path, f"{scene.name} has boxes or flow, which only an .npz holds")
    for name, label in labels.items():
        if np.abs(label, dtype=np.float64).max() >= 2**24:  # float32's whole numbers
            raise BadFile(path, f"{name}: numbers from 2^24 on, which only an .npz holds")
    write_spectral_exr(
        path,
        scene.wavelengths,
        values,
        reflectance="illuminant" in parts,
        half=half,
        more=depth | labels,
        **{ATTRIBUTE: json.dumps(parts)},
    )


def scene_planes(path, scene: Scene, radiance: bool) -> tuple[np.ndarray, dict]:
    """Return planes float32 (L, rows, cols) of a scene, and its other fields for `parts_of_json`.

    The planes are reflectances if the fields have an "illuminant", else radiance [photon s-1 m-2
    sr-1 nm-1]. radiance: also if the light is known. Raises BadFile, DoesNotFit.
    """
    check_whole(path, scene)
    content, reflectance = scene.content.on_host(), scene.light_is_known and not radiance
    if reflectance and isinstance(content, Illuminated):
        raise BadFile(
            path,
            f"the light of {scene.name} varies over the scene, which reflectances cannot express: use "
            "radiance=True, or an .npz",
        )
    nodes = scene.wavelengths
    light = np.ones(len(nodes)) if reflectance else scene.illuminant.at(nodes)
    values = np.empty((len(light), *content.shape), np.float32)
    what = f"{len(light)} channels of {content.shape[1]} x {content.shape[0]} samples"
    require_memory(f"{path}: {what}", COPIES * values.nbytes)
    for start in range(0, content.shape[0], ROWS):
        rows = slice(start, start + ROWS)
        values[:, rows] = np.maximum(content.bands_at(rows) * light[:, None, None], 0)
    parts = {key: getattr(scene, key) for key in PARTS if getattr(scene, key) is not None}
    if reflectance:
        parts["illuminant"] = {
            "name": scene.illuminant.name,
            "wavelengths_nm": scene.illuminant.wavelengths.tolist(),
            "values": scene.illuminant.values.tolist(),
        }
    return values, parts


def scene_parts(path) -> dict:
    """Return the fields of Scene in a file's attribute, without its depth.

    {} for a file of another program. Raises BadFile.
    """
    import OpenEXR

    with name_in_errors(path), reading(path, "an OpenEXR file with a scene's description"):
        file = OpenEXR.File(str(path), separate_channels=True, header_only=True)
        if ATTRIBUTE not in file.header():
            return {}
        return parts_of_json(json.loads(file.header()[ATTRIBUTE]))


def parts_of_json(stored) -> dict:
    """Return fields of Scene from their description. Raises any error if it is damaged."""
    if not isinstance(stored, dict):
        raise ValueError(f"{ATTRIBUTE} is no JSON object")
    parts = {key: kind(stored[key]) for key, kind in PARTS.items() if key in stored}
    if "illuminant" in stored:
        light = stored["illuminant"]
        wavelengths = np.asarray(light["wavelengths_nm"], np.float64)
        power = np.asarray(light["values"], np.float64)
        parts["illuminant"] = Spectrum(wavelengths, power, str(light["name"]))
    return parts
