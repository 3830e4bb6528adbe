"""From a chart's name, a file or a frame of a video to a Scene, and back to a file."""

import dataclasses
import functools
import os
from pathlib import Path

import numpy as np

from gpusim.data.charts import CHARTS, chart
from gpusim.data.colorimetry import xyz
from gpusim.data.lights import illuminant, white_radiance
from gpusim.data.srgb import srgb_primaries
from gpusim.domain.content import Picture
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData, BadFile, OutOfRange, UnknownName
from gpusim.domain.foreign import described, type_of
from gpusim.domain.illuminated import Illuminated
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.spectrum import Spectrum, energy_from_photons
from gpusim.io.scene.depth import check_depth
from gpusim.io.scene.npz import write_npz
from gpusim.io.scene.readers import CHARTS_TAKE, SUFFIXES, read_scene, taken
from gpusim.io.scene.scene_exr import write_scene_exr

LIGHT, LUMINANCE = "D65", 100.0  # of reflectances of which the light is not known


@np.errstate(
    divide="ignore", over="ignore", invalid="ignore"
)  # of damaged files; what is then no number is refused
def open_scene(
    name_or_path,
    *,
    size=None,
    light=None,
    luminance=None,
    bands=None,
    border=None,
    fov=None,
    samples_per_pixel=None,
    depth="axis",
    wavelengths=None,
    kind=None,
    scale=None,
) -> Scene:
    """Open a built-in chart (`CHARTS`) or a scene file.

    Files are .exr, .npz, ENVI's .hdr (beside its raw file), ISETCam's .mat, a photograph .png, .jpg or .tif, planes
    .tif or .npy, or spectra .csv, which become patches. Options that a chart, or a kind of files, has no use for are
    refused.

    size: columns and rows of the frame of a chart or of patches [pixel]; other files have their own size.
    light: name for `illuminant`, in exchange for the scene's own light. luminance [cd m-2]: of a perfect white diffuser
        in the light; where the light is not known, the mean over the scene instead. Without them a scene keeps the
        light that it has; reflectances and photographs alone get D65 with white at 100 cd m-2.
    bands: {channel: wavelength [nm]} of an .exr whose channels are not named by wavelength.
    wavelengths: [nm], strictly ascending, of the planes of a .tif (pages, or channels of a page) or .npy, (L, rows,
        cols) or (rows, cols, L), or of an ENVI file's bands, in exchange for its own.
    kind: what planes or spectra hold: "reflectance", as without it unless an ENVI header says else, or "radiance"
        [W m-2 sr-1 nm-1]. scale: the number in the file that stands for 1; by default 1 of floats, the largest of uint8
        and uint16, and what an ENVI header says.
    border, fov [rad]: as in Scene, in exchange for the scene's own.
    samples_per_pixel: as in Scene, in exchange for the scene's own. A chart is drawn finer, its frame keeps its size; a
        file keeps its samples, they make fewer pixels.
    depth: how to take distances [m], a channel of an .exr (Z, Depth.Z, depth.T ...) or a .mat's depthMap: along the
        optical "axis", as Blender writes them; along each pixel's "ray", as Mitsuba does (from its near_clip on), for
        which `fov` is needed; "none": leave a file's depth.
    Raises BadData, BadFile, UnknownName, OutOfRange, DoesNotFit.
    """
    if not isinstance(name_or_path, str | os.PathLike):
        raise BadData(
            f"open_scene: {type(name_or_path).__name__}, wanted a chart's name or a file; gpusim.scene_from "
            "makes a scene of an array"
        )
    path = Path(name_or_path)
    check_depth(depth, fov)
    given = {
        "size": size,
        "bands": bands or None,
        "wavelengths": wavelengths,
        "kind": kind,
        "scale": scale,
        "ray": fov if depth == "ray" else None,
        "no_depth": depth == "none" or None,
    }
    given = {name: value for name, value in given.items() if value is not None}
    if str(name_or_path) in CHARTS:
        scene = chart(
            str(name_or_path),
            light=light or LIGHT,
            luminance=LUMINANCE if luminance is None else luminance,
            samples_per_pixel=1.0 if samples_per_pixel is None else samples_per_pixel,
            **taken(name_or_path, CHARTS_TAKE, given),
        )
    elif path.suffix.lower() in SUFFIXES:
        white = white_radiance(
            illuminant(light or LIGHT), LUMINANCE if luminance is None else luminance
        )
        scene = relit(path, read_scene(path, white, given), light, luminance)
    else:
        for header in (f"{path}.hdr", path.with_suffix(".hdr") if path.suffix else ""):
            if os.path.isfile(header):
                raise BadFile(
                    path, f"the samples of an ENVI file; open its header, {Path(header).name}"
                )
        raise UnknownName(
            "scene", str(name_or_path), [*CHARTS, *(f"<file>{suffix}" for suffix in SUFFIXES)]
        )
    changes = {"border": border, "fov": fov, "samples_per_pixel": samples_per_pixel}
    return dataclasses.replace(
        scene, **{key: value for key, value in changes.items() if value is not None}
    )


def save_scene(scene: Scene, path, *, radiance: bool = False, half: bool = False) -> None:
    """Write a scene to a file that `open_scene` reads.

    .npz: all of it, as it is. .exr: spectral OpenEXR that other programs read, one channel for each wavelength, and the
    depth as channel Z: reflectances, or radiance where the light is not known; every form becomes a cube of float32,
    and what a basis undershoots below 0 is 0. `open_scene` finds the light, border and the rest in an attribute.
    radiance: write that, although the light is known; it is taken at the scene's wavelengths, so lines between them are
    lost, and so is what tells light from surfaces. half: 16-bit floats. Both are for .exr alone.
    Raises BadFile, also for layers and views, which no file holds, and for reflectances in light that varies;
    BadData, DoesNotFit, OutOfRange, UnknownName. Layout: see `gpusim.io.exr`.
    """
    suffix, scene = Path(path).suffix.lower(), checked_scene(scene)
    if suffix == ".exr":
        write_scene_exr(path, scene, radiance=radiance, half=half)
    elif suffix != ".npz":
        raise UnknownName("format of a scene's file", suffix or str(path), (".exr", ".npz"))
    elif radiance or half:
        raise OutOfRange(
            "radiance, half", "given for .npz", "for .exr alone: an .npz holds a scene as it is"
        )
    else:
        write_npz(path, scene)


def picture(
    codes, *, light=LIGHT, luminance=LUMINANCE, curve=None, name="picture", **options
) -> Scene:
    """Lift encoded pixels, such as a video's frame, to reflectances as `open_scene` does a photograph's.

    codes: uint8 or uint16, RGB (rows, cols, 3) or grey (rows, cols), in host memory or a device's (see `Picture`). They
        go to the device as they are, and are decoded there; neither is done before the first frame.
    light: name for `illuminant`. luminance: of white in it [cd m-2]. curve: what each code stands for, white 1: float32
        (256,) or (65536,) by the type of the codes; by default sRGB's (IEC 61966-2-1).
    options: as in Scene, such as border. One plan serves all pictures of one size, type, light and options.
    Raises BadData, OutOfRange, UnknownName.
    """
    codes = described(codes, "picture codes")
    primaries = srgb_primaries()
    if curve is None:
        curve = DISPLAYS["srgb"].table(type_of(codes))
    basis = primaries.values if len(codes.shape) != 2 else np.ones((1, len(primaries.wavelengths)))
    return Scene(
        Picture(primaries.wavelengths, codes, basis, curve),
        _white(light, luminance),
        name=name,
        **options,
    )


@functools.lru_cache(maxsize=16)
def _white(light, luminance):
    return white_radiance(illuminant(light), luminance)


def relit(path, scene: Scene, light: str | None, luminance: float | None) -> Scene:
    """The scene in another light, a name for `illuminant`, or at another luminance, see `open_scene`; None: its own.

    path: that errors name. Raises BadFile, UnknownName, OutOfRange.
    """
    if light is None and luminance is None:
        return scene
    if light and isinstance(scene.content, Illuminated):
        raise BadFile(
            path,
            f"light {light!r} asked for, but the file's light varies over the scene; wanted luminance "
            "alone, or gpusim.illuminated",
        )
    if scene.light_is_known:
        own = energy_from_photons(scene.illuminant)
        radiance = white_radiance(illuminant(light) if light else own, luminance or xyz(own)[1])
        return dataclasses.replace(scene, illuminant=radiance)
    if light:
        raise BadFile(
            path,
            f"light {light!r} asked for, but the file holds radiance: its own light is not known",
        )
    assert luminance is not None  # no light
    mean = mean_luminance(scene)
    if not mean > 0:
        raise BadFile(
            path, f"mean luminance {mean:.3g} cd m-2: it cannot be scaled to {luminance:g}"
        )
    return dataclasses.replace(scene, content=scene.content.scaled(luminance / mean))


def mean_luminance(scene: Scene) -> float:
    """Return the mean luminance of a scene's content (with its margin) [cd m-2]."""
    mean = Spectrum(scene.wavelengths, scene.content.mean_spectrum())
    return float(xyz(mean, energy_from_photons(scene.illuminant))[1])
