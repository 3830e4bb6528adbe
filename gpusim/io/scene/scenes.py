"""Scenes from chart names, files and video frames, and files from scenes."""

import dataclasses
import functools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gpusim.data.charts import CHARTS, chart
from gpusim.data.colorimetry import xyz
from gpusim.data.lights import FILES, illuminant, white_radiance
from gpusim.data.srgb import srgb_primaries
from gpusim.data.weights import xyz_per_content
from gpusim.domain.content import Picture
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData, BadFile, OutOfRange, UnknownName
from gpusim.domain.illuminated import Illuminated
from gpusim.domain.memory import describe_array, type_of
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.spectrum import energy_from_photons
from gpusim.io.scene.depth import check_depth

LIGHT, LUMINANCE = "D65", 100.0  # of reflectances with unknown light


# damaged files; numbers that are not finite are refused
@np.errstate(divide="ignore", over="ignore", invalid="ignore")
def open_scene(
    name_or_path: str | os.PathLike,
    *,
    size: Sequence[int] | None = None,
    light: str | None = None,
    luminance: float | None = None,
    bands: Mapping[str, float] | None = None,
    border: str | None = None,
    fov: float | None = None,
    samples_per_pixel: float | None = None,
    depth: str = "axis",
    wavelengths: ArrayLike | None = None,
    kind: str | None = None,
    scale: float | None = None,
    key: str | None = None,
    projection: str | None = None,
    part: int | str | None = None,
    layer: str | None = None,
    view: str | None = None,
) -> Scene:
    """Open a built-in chart (`CHARTS`) or a scene file.

    Files are .exr, .npz, ENVI's .hdr (next to its raw file), ISETCam's .mat, cubes .mat, .h5, .hdf5,
    .he5 or .nc, photographs .png, .jpg or .tif, planes .tif or .npy, and spectra .csv, which become
    patches; and folders of bands, .png or .tif, with the wavelengths in their names, such as
    scene_450nm.png. Options that do not apply to the chart or kind of file are refused.

    Args:
        name_or_path: name of a chart, or path of a file or a folder of bands.
        size: columns and rows of the frame of a chart or of patches [pixel]; other files have a
            fixed size.
        light: name of an `illuminant`, replaces the scene's light. None keeps the scene's;
            reflectances and photographs without one get D65.
        luminance: luminance of a perfect white diffuser in the light [cd m-2]; if the light is
            unknown, mean luminance of the scene. None keeps the scene's; reflectances and
            photographs without a light get 100.
        bands: {channel: wavelength [nm]} of an .exr with channels not named by wavelength.
        border: border rule, see Scene; replaces the scene's.
        fov: horizontal field of view, see Scene; replaces the scene's [rad].
        samples_per_pixel: see Scene; replaces the scene's. A chart is drawn finer for the same
            frame; the samples of a file make fewer pixels.
        depth: direction of the distances [m] in an .exr channel (Z, Depth.Z, depth.T ...) or a
            .mat's depthMap: the optical "axis", as in Blender's files; each pixel's "ray", as in
            Mitsuba's (from its near_clip on), which needs `fov`; "none" ignores them.
        wavelengths: wavelengths, strictly ascending [nm], of the planes of a .tif (pages, or
            channels of a page) or .npy, (L, rows, cols) or (rows, cols, L), or of the bands of
            an ENVI file, a .mat, an HDF5 file or a folder instead of those in the file or names.
        kind: kind of planes or spectra: "reflectance" or "radiance" [W m-2 sr-1 nm-1]. None is
            reflectance, unless an ENVI header has another.
        scale: number in the file that stands for 1. None is 1 for floats, the largest of uint8 and
            uint16, and the value of an ENVI header.
        key: name of the cube in a .mat or HDF5 file with several, such as "rad" or "/scene/cube"; or
            of ISETCam's struct.
        projection: "plane" or "equirectangular" (a panorama), see Scene; replaces the scene's.
        part: name or number (from 0) of the only part of an .exr to read, None reads all parts that
            have one frame; number of the page of a photograph in a .tif.
        layer: layer of an .exr with the picture, such as "ViewLayer" or "diffuse"; a part's name
            will do.
        view: view of a stereo .exr, such as "right"; None is the file's first.

    Returns:
        The scene.

    Raises:
        BadData: if `name_or_path` is neither a text nor a path.
        BadFile: if the file cannot be used.
        UnknownName: if a name is unknown.
        OutOfRange: if an option is out of range or does not apply.
        DoesNotFit: if the scene does not fit into memory.
    """
    if not isinstance(name_or_path, str | os.PathLike):
        raise BadData(
            f"open_scene: {type(name_or_path).__name__}, wanted a chart's name or a file; use "
            "gpusim.scene_from for an array"
        )
    check_depth(depth, fov)
    given = {
        "size": size,
        "bands": bands or None,
        "wavelengths": wavelengths,
        "kind": kind,
        "scale": scale,
        "key": key,
        "ray": fov if depth == "ray" else None,
        "no_depth": depth == "none" or None,
        "part": part,
        "layer": layer,
        "view": view,
    }
    given = {name: value for name, value in given.items() if value is not None}
    if str(name_or_path) in CHARTS:
        scene = chart(
            str(name_or_path),
            light=light or LIGHT,
            luminance=LUMINANCE if luminance is None else luminance,
            samples_per_pixel=1.0 if samples_per_pixel is None else samples_per_pixel,
            **_chart_options(name_or_path, given),
        )
    else:
        scene = _open_path(name_or_path, given, light, luminance)
    changes: dict[str, Any] = {"border": border, "fov": fov, "samples_per_pixel": samples_per_pixel}
    changes["projection"] = projection
    changes = {key: value for key, value in changes.items() if value is not None}
    return dataclasses.replace(scene, **changes) if changes else scene


def _chart_options(name, given):
    """Return the given options that a chart accepts. Raises OutOfRange for others."""
    if given.keys() <= {"size"}:  # without the readers, whose import takes time
        return given
    from gpusim.io.scene.readers import CHARTS_TAKE, select_options

    return select_options(name, CHARTS_TAKE, given)


def _open_path(name, given, light, luminance):
    """Return the scene of a file or a folder, in its light."""
    from gpusim.io.scene.readers import SUFFIXES, read_folder, read_scene

    path = Path(name)
    if path.suffix.lower() in SUFFIXES:
        read = read_scene
    elif os.path.isdir(name):
        read = read_folder
    else:
        for header in (f"{path}.hdr", path.with_suffix(".hdr") if path.suffix else ""):
            if os.path.isfile(header):
                why = f"the samples of an ENVI file; open its header {Path(header).name}"
                raise BadFile(path, why)
        known = [*CHARTS, *(f"<file>{suffix}" for suffix in SUFFIXES)]
        raise UnknownName("scene", str(name), known)
    level = LUMINANCE if luminance is None else luminance
    white = white_radiance(illuminant(light or LIGHT), level)
    return relight(path, read(path, white, given), light, luminance)


def save_scene(
    scene: Scene, path: str | os.PathLike, *, radiance: bool = False, half: bool = False
) -> None:
    """Write a scene to a file for `open_scene`.

    An .npz holds the complete scene. An .exr is a spectral OpenEXR for other programs, with one
    channel per wavelength and the depth as channel Z: reflectances, or radiance if the light is
    unknown. All forms become a cube of float32; negative values of a basis become 0. `open_scene`
    reads the light, border and the rest from an attribute. Layout: see `gpusim.io.exr`. An .hdr is an
    ENVI file with its numbers in an .img, a .tif has one page for each wavelength; they hold the same
    without depth and labels.

    Args:
        scene: scene to write.
        path: file to write, .npz, .exr, .hdr or .tif.
        radiance: write radiance although the light is known, not for .npz. It is sampled at the
            scene's wavelengths: lines between them are lost, and light and surfaces are no longer
            separate.
        half: use 16-bit floats, .exr only.

    Raises:
        BadFile: if the file cannot be written or cannot hold the scene: layers, views, and
            reflectances in light that varies.
        OutOfRange: if `radiance` is set for .npz, or `half` for other files than .exr.
        UnknownName: if the suffix is unknown.
        DoesNotFit: if the cube does not fit into memory.
    """
    from gpusim.io.scene.npz import write_npz
    from gpusim.io.scene.scene_exr import write_scene_exr
    from gpusim.io.scene.scene_planes import write_envi, write_tiff
    from gpusim.io.scene.tiff import SUFFIXES as TIFF

    suffix, scene = Path(path).suffix.lower(), checked_scene(scene, True)
    if suffix == ".exr":
        write_scene_exr(path, scene, radiance=radiance, half=half)
    elif half:
        raise OutOfRange("half", True, "for .exr only: other files have 32 bits or more")
    elif suffix == ".hdr":
        write_envi(path, scene, radiance=radiance)
    elif suffix in TIFF:
        write_tiff(path, scene, radiance=radiance)
    elif suffix != ".npz":
        known = (".exr", ".hdr", ".npz", *TIFF)
        raise UnknownName("format of a scene's file", suffix or str(path), known)
    elif radiance:
        raise OutOfRange("radiance", True, "not for .npz, which holds the complete scene")
    else:
        write_npz(path, scene)


def picture(
    codes: Any,
    *,
    light: str = LIGHT,
    luminance: float = LUMINANCE,
    curve: np.ndarray | None = None,
    name: str = "picture",
    **options: Any,
) -> Scene:
    """Return encoded pixels, for example a video frame, as a scene of reflectances.

    They are converted as `open_scene` converts a photograph. The codes go to the device unchanged
    and are decoded there, with the first frame. One plan serves all pictures of one size, type,
    light and options.

    Args:
        codes: uint8 or uint16, RGB (rows, cols, 3) or grey (rows, cols), in host or device memory
            (see `Picture`).
        light: name of an `illuminant`.
        luminance: luminance of white in that light [cd m-2].
        curve: linear value of each code, white 1: float32 (256,) or (65536,) by the type of the
            codes; None is sRGB (IEC 61966-2-1).
        name: name of the scene.
        options: further fields of Scene, for example border.

    Returns:
        The scene.

    Raises:
        BadData: if the codes have a wrong shape or type.
        OutOfRange: if an option is out of range.
        UnknownName: if the light is unknown.
    """
    codes = describe_array(codes, "picture codes")
    primaries = srgb_primaries()
    if curve is None:
        curve = DISPLAYS["srgb"].table(type_of(codes))
    basis = primaries.values if len(codes.shape) != 2 else np.ones((1, len(primaries.wavelengths)))
    content = Picture(primaries.wavelengths, codes, basis, curve)
    return Scene(content, _white(light, luminance), name=name, **options)


def _white(light, luminance):
    if str(light).lower().endswith(FILES):  # which may change
        return white_radiance(illuminant(light), luminance)
    return _named_white(light, luminance)


@functools.lru_cache(maxsize=16)
def _named_white(light, luminance):
    return white_radiance(illuminant(light), luminance)


def relight(path, scene: Scene, light: str | None, luminance: float | None) -> Scene:
    """Return the scene in another light or at another luminance, see `open_scene`.

    light: name of an `illuminant`, None keeps the scene's. luminance: [cd m-2], None keeps the
    scene's. path: for errors. Raises BadFile, UnknownName, OutOfRange.
    """
    if light is None and luminance is None:
        return scene
    if light and isinstance(scene.content, Illuminated):
        raise BadFile(
            path,
            f"light {light!r}: the file's light varies over the scene; give only luminance, or use "
            "gpusim.illuminated",
        )
    if scene.light_is_known:
        own = energy_from_photons(scene.illuminant)
        radiance = white_radiance(illuminant(light) if light else own, luminance or xyz(own)[1])
        return dataclasses.replace(scene, illuminant=radiance)
    if light:
        why = f"light {light!r}: the file holds radiance, whose light is unknown; leave light out"
        raise BadFile(path, why)
    assert luminance is not None  # no light
    mean = mean_luminance(scene)
    if not mean > 0:
        why = f"mean luminance {mean:.3g} cd m-2: it cannot be scaled to {luminance:g}"
        raise BadFile(path, why)
    return dataclasses.replace(scene, content=scene.content.on_host().scale(luminance / mean))


def open_again(
    path, scene: Scene, *, light: str | None = None, luminance: float | None = None
) -> Scene:
    """Return the scene that `open_scene` would open with a light and a luminance, without reading the file.

    path: of the file, or name of the chart. scene: opened without them; no view of a panorama. light,
    luminance: see `open_scene`. Raises BadFile, UnknownName, OutOfRange.
    """
    level = LUMINANCE if luminance is None else luminance
    if str(path) in CHARTS:
        return dataclasses.replace(
            scene, illuminant=white_radiance(illuminant(light or LIGHT), level)
        )
    own = scene.illuminant.values
    if np.array_equal(own, _named_white(LIGHT, LUMINANCE).values):
        # no light in the file: `open_scene` would take the given one
        white = white_radiance(illuminant(light or LIGHT), level)
        scene = dataclasses.replace(scene, illuminant=white)
    return relight(path, scene, light, luminance)


def mean_luminance(scene: Scene) -> float:
    """Return the mean luminance of a scene's content (with its margin) [cd m-2]."""
    try:
        weights = xyz_per_content(scene.wavelengths, scene.illuminant)[1]
    except BadData:  # no wavelength that an eye sees
        return 0.0
    return float(weights @ scene.content.on_host().mean_spectrum())
