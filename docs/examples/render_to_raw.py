"""
From a Mitsuba render to a raw video
====================================

A renderer computes light; a camera makes pictures of it. Mitsuba 3 renders spectra and distances.
gpusim adds a lens with a focus that moves from near to far, and writes the raw data of the sensor.
"""

import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import OpenEXR

import gpusim as gs

folder = Path(tempfile.mkdtemp())
size, fov = (192, 128), 40  # columns and rows, horizontal field of view [degree]
bands = np.arange(400, 701, 50)  # [nm]
sky = 0.002  # [W m⁻² sr⁻¹ nm⁻¹], some 140 cd/m²
balls = [
    ((-0.12, 0.08, 0.6), 0.08, (620, "red")),
    ((0.2, 0.15, 1.2), 0.15, (540, "green")),
    ((-0.6, 0.3, 2.8), 0.3, (450, "blue")),
]  # centre [m], radius [m], wavelength of the highest reflectance [nm]


def paint(middle):
    """Return the reflectance of a ball at the bands."""
    return 0.06 + 0.7 * np.exp(-(((bands - middle) / 60) ** 2))


# %%
# The render
# ----------
# A film with a triangular band per wavelength gives the mean spectral radiance around it [W m⁻²
# sr⁻¹ nm⁻¹]. A second pass, with one ray per pixel, gives the distance along it. (The integrator
# ``aov`` could do both at once, but Mitsuba 3.9 then mixes up the channels of a spectral film.)


def by_mitsuba():
    """Return radiance at the bands, and distances: three balls on a checkerboard, uniform sky."""
    import mitsuba as mi

    mi.set_variant("scalar_spectral")
    to, nodes = mi.ScalarTransform4f(), ", ".join(map(str, bands))
    triangles = {
        f"band{nm}": {
            "type": "irregular",
            "wavelengths": f"{nm - 50}, {nm}, {nm + 50}",
            "values": "0, 0.02, 0",
        }
        for nm in bands
    }
    objects = {
        name: {
            "type": "sphere",
            "center": list(middle),
            "radius": radius,
            "bsdf": {
                "type": "diffuse",
                "reflectance": {
                    "type": "irregular",
                    "wavelengths": nodes,
                    "values": ", ".join(map(str, paint(nm))),
                },
            },
        }
        for middle, radius, (nm, name) in balls
    }
    squares = {"type": "checkerboard", "to_uv": to.scale(50), "color0": 0.15, "color1": 0.6}
    objects |= {
        "sky": {"type": "constant", "radiance": {"type": "uniform", "value": sky}},
        "floor": {
            "type": "rectangle",
            "to_world": to.rotate([1, 0, 0], -90).scale(10),
            "bsdf": {"type": "diffuse", "reflectance": squares},
        },
    }

    def seen(integrator, film, rays):
        sensor = {
            "type": "perspective",
            "fov": fov,
            "near_clip": 0.001,
            "sampler": {"type": "independent"},
            "to_world": to.look_at([0, 0.25, 0], [0, 0.13, 1], [0, 1, 0]),
            "film": {
                "width": size[0],
                "height": size[1],
                "rfilter": {"type": "box"},
                "component_format": "float32",
            }
            | film,
        }
        scene = mi.load_dict(
            {"type": "scene", "integrator": integrator, "sensor": sensor} | objects
        )
        return np.array(mi.render(scene, spp=rays))

    return (
        seen({"type": "path", "max_depth": 4}, {"type": "specfilm"} | triangles, 64),
        seen({"type": "aov", "aovs": "away:depth"}, {"type": "hdrfilm"}, 1)[..., -1],
    )


# %%
# If Mitsuba is not installed, the same balls are computed here: rays intersect spheres and a floor,
# light comes from above, and there are no shadows.


def by_hand():
    """Return the same scene, without indirect light."""
    y, x = (np.indices(size[::-1]) + 0.5 - np.array(size[::-1])[:, None, None] / 2) * (
        2 * np.tan(np.radians(fov / 2)) / size[0]
    )
    forward, up = (
        np.array([0, -0.12, 1]) / np.hypot(0.12, 1),
        np.array([0, 1, 0.12]) / np.hypot(0.12, 1),
    )
    ray = forward - y[..., None] * up - x[..., None] * np.array([1, 0, 0])
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    eye = np.array([0, 0.25, 0])
    with np.errstate(divide="ignore"):
        away = np.where(ray[..., 1] < 0, -0.25 / ray[..., 1], np.inf)  # the floor
    place = np.nan_to_num(ray * np.minimum(away, 1e3)[..., None])
    squares = np.where((np.floor(place[..., 0] * 5) + np.floor(place[..., 2] * 5)) % 2, 0.6, 0.15)
    reflected = np.where(np.isfinite(away), squares, 1)[..., None] * np.ones(len(bands))
    for middle, radius, (nm, _) in balls:
        along = ray @ (np.array(middle) - eye)
        inside = along**2 - ((np.array(middle) - eye) ** 2).sum() + radius**2
        distance = along - np.sqrt(np.maximum(inside, 0))
        hit = (inside > 0) & (distance < away)
        above = ((eye + distance[..., None] * ray - middle) / radius)[..., 1]
        away = np.where(hit, distance, away)
        reflected = np.where(hit[..., None], (0.6 + 0.4 * above[..., None]) * paint(nm), reflected)
    return sky * reflected, np.where(np.isfinite(away), away, 0)


# %%
# Both write a file with the channel names of Mitsuba's film. Distance 0 means that the ray hits
# nothing.

renderer = by_mitsuba if find_spec("mitsuba") else by_hand
radiance, away = renderer()
channels = {
    f"band{nm}": np.ascontiguousarray(radiance[..., number], np.float32)
    for number, nm in enumerate(bands)
}
OpenEXR.File(
    {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION},
    channels | {"depth.T": away.astype(np.float32)},
).write(str(folder / "render.exr"))
print("rendered", renderer.__name__.replace("_", " "))

# %%
# Through a lens
# --------------
# The channel names do not contain wavelengths, so ``bands`` gives them. Distances are along rays;
# with the field of view they become distances along the axis. Light of every layer is blurred by
# its defocus.

scene = gs.open_scene(
    folder / "render.exr", bands={f"band{nm}": nm for nm in bands}, depth="ray", fov=np.radians(fov)
)
camera = gs.open_camera("phone").with_(exposure_time_ms=20)

figure, axes = plt.subplots(1, 3, figsize=(11, 2.8), layout="constrained")
shown = axes[0].imshow(np.where(scene.depth < 10, scene.depth, np.nan), cmap="viridis", vmax=4)
axes[0].set_title("distance [m]")
figure.colorbar(shown, ax=axes[0], shrink=0.8)
for axis, distance in zip(axes[1:], (0.55, 2.6), strict=True):
    axis.imshow(gs.Simulator(camera.with_(object_distance_m=distance))(scene, seed=0).rgb)
    axis.set_title(f"in focus at {distance} m")
for axis in axes:
    axis.set_axis_off()

# %%
# A raw video
# -----------
# The focus moves from 0.55 m to 2.6 m in four frames. ``ffv1-raw`` stores the mosaic without loss,
# 16 bits, in an ordinary video file. If PyAV is not installed, numbered DNG files have the same
# data.

video = "-o focus.mkv --codec ffv1-raw" if find_spec("av") else "-o focus.dng"
command = (
    f"video render.exr --depth ray --fov {fov} "
    + " ".join(f"--band band{nm}={nm}" for nm in bands)
    + f" --camera phone --exposure 20ms --ramp focus=0.55..2.6 --frames 4 {video}"
)
subprocess.run(
    [sys.executable, "-m", "gpusim", *command.split()], cwd=folder, check=True, capture_output=True
)
print("gpusim", command)

if find_spec("av"):
    import av

    with av.open(folder / "focus.mkv") as container:
        raws = [frame.to_ndarray(format="gray16le") for frame in container.decode(video=0)]
else:
    import tifffile

    raws = [tifffile.imread(path) for path in sorted(folder.glob("focus*.dng"))]

figure, axes = plt.subplots(1, 4, figsize=(11, 2.2), layout="constrained")
for number, (axis, raw) in enumerate(zip(axes.flat, raws, strict=True)):
    axis.imshow(raw, cmap="gray")
    axis.set_title(f"raw frame {number}, {0.55 * (2.6 / 0.55) ** (number / 3):.2f} m", fontsize=9)
    axis.set_axis_off()

# %%
# A script saves its pictures:

gs.plot.save_figures("render_to_raw")
