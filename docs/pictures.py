"""Makes the pictures of README.md and of the pages in docs/pictures.

    python docs/pictures.py

The commands below make the gallery. README.md has the same commands; a test compares them.
"""

import dataclasses
import os
import runpy
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image
from skimage import data

import gpusim as gs
from gpusim.cli.main import main as gpusim
from gpusim.color.speed import operate_camera
from gpusim.domain.processor import LOOKS
from gpusim.io.frame.images import write_jpeg
from gpusim.judge.truth import mean_and_truth
from gpusim.measure.ideal import ideal
from gpusim.measure.mosaic import color_mosaic

HERE = Path(__file__).parent / "pictures"
SIZE = (480, 320)
GALLERY = {  # photo.png: NASA's portrait of Eileen Collins, of scikit-image. balls.npz: `balls`
    "night": "gpusim simulate photo.png --camera phone --luminance 1 --exposure 1/15 --iso 1600 "
    "--capture burst=8,merged -o night.png",
    "depth": "gpusim simulate balls.npz --camera machine-vision --f-number 2 --focus 0.7 -o depth.png",
    "moving_0000": "gpusim video photo.png --camera phone --exposure 1/30 --frames 1 --pan 0,6 --blur -o moving.png",
    "lamp": "gpusim simulate colorchecker --camera phone --light A --size 480x320 -o lamp.png",
    "dark": "gpusim simulate photo.png --camera phone --luminance 5 --exposure 1/15 --iso 800 -o dark.png",
    "bright": "gpusim simulate photo.png --camera phone --exposure 0.25 -o bright.png",
    "small-aperture": "gpusim simulate deadleaves --camera phone --f-number 16 --size 480x320 -o small-aperture.png",
    "mono": "gpusim simulate photo.png --camera mono --f-number 11 -o mono.png",
    "sweep": "gpusim simulate sweep --camera phone --f-number 1.2 --size 480x320 -o sweep.png",
}

PLOTS = {  # of plots.md
    "look-colors": "gpusim look colorchecker --what colors --camera phone --size 480x320 -o look-colors.png",
    "look-camera": "gpusim look --what camera --camera phone -o look-camera.png",
}


def main():
    """Make all pictures."""
    matplotlib.use("Agg")
    HERE.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        photo = Path(folder) / "photo.png"
        Image.fromarray(data.astronaut()[0:320, 16:496]).save(photo)
        gs.save_scene(balls(), Path(folder) / "balls.npz")
        gallery(Path(folder))
        wide(gs.open_scene(photo, luminance=2))
        looks(photo)
    two_cameras()
    tasks()
    accuracy()
    still_events()


def gallery(folder):
    """Run the commands of the gallery. folder: it contains photo.png and balls.npz."""
    for command in (GALLERY | PLOTS).values():
        *words, out = shlex.split(command)[1:]
        words = [str(folder / word) if (folder / word).is_file() else word for word in words]
        words.append(str(HERE / out))
        if status := gpusim(words):
            raise SystemExit(f"{command}: status {status}")
    for manifest in HERE.glob("*_video.json"):
        manifest.unlink()


# raw developers that render the same DNG, with their defaults. RawTherapee's default corrects lateral colour by what it
# finds in the picture, which puts fringes on this small one: that is off
PEERS = {
    "rawtherapee-cli": "rawtherapee-cli -o {out}.png -n -Y -d -p {profile} -c {raw}",
    "dcraw_emu": "dcraw_emu -w -T -Z {out}.tif {raw}",
}


def looks(photo):
    """Write the looks of the camera phone in good light and at 1 lux, 1 / pi cd/m2, beside raw developers.

    The last look is by the network. Developers that are not installed are left out. photo: its path.
    """
    rows = []
    for luminance, controls in ((300, {}), (1 / np.pi, {"exposure": 1 / 15, "iso": 1600})):
        scene = gs.open_scene(photo, luminance=luminance)
        shown = [{"look": look} for look in LOOKS]
        shown.append({"look": "phone", "demosaic": "network"})
        cameras = (gs.open_camera("phone").with_(**settings) for settings in shown)
        frames = [gs.Simulator(operate_camera(one, **controls))(scene) for one in cameras]
        with tempfile.TemporaryDirectory() as folder:
            pictures = [frame.rgb for frame in frames] + develop_raw(frames[0], Path(folder))
        rows.append(np.concatenate([one[:200, 100:320] for one in pictures], 1))
    write_jpeg(HERE / "looks.jpg", np.concatenate(rows), quality=85)


def develop_raw(frame, folder):
    """Return what the installed PEERS make of a frame's DNG, codes of the frame's size."""
    frame.save(folder / "frame.dng")
    (folder / "own.pp3").write_text("[RAW]\nCA=false\n")
    pictures = []
    for name, command in PEERS.items():
        if shutil.which(name) is None:
            print(f"{name} is not installed: its picture is left out")
            continue
        names = {"raw": folder / "frame.dng", "profile": folder / "own.pp3", "out": folder / name}
        words = shlex.split(command.format(**names))
        subprocess.run(words, check=True, capture_output=True)
        (found,) = folder.glob(f"{name}.*")
        codes = np.array(Image.open(found).convert("RGB"))
        # RawTherapee leaves out a border of equal width on all sides
        border = [(a - b) // 2 for a, b in zip(frame.rgb.shape, codes.shape, strict=True)]
        pictures.append(np.pad(codes, [(n, n) for n in border], mode="edge"))
    return pictures


def balls():
    """Return a scene with depth: three balls on a chequered floor before a wall."""
    color, depth = draw_balls()
    scene = gs.scene_from(color, linear=True, luminance=300)
    return dataclasses.replace(scene, depth=depth.astype(np.float32), fov=2 * np.arctan(0.375))


def draw_balls():
    """Return linear RGB and the depth along the axis [m]: the wall is 4 m away, the floor 0.3 m below the axis."""
    rows, cols = SIZE[::-1]
    y, x = (np.mgrid[:rows, :cols] + 0.5 - np.array([rows, cols])[:, None, None] / 2) / cols * 0.75
    ray = np.stack([x, y, np.ones_like(x)])
    light = np.array([0.3, -0.8, -0.5]) / np.sqrt(0.98)  # direction toward the lamp
    depth = np.full((rows, cols), 4.0)
    color = np.full((rows, cols, 3), (0.30, 0.34, 0.42))
    floor = 0.3 / np.maximum(y, 1e-9)
    seen = floor < depth
    chequer = (np.floor(floor * x / 0.1) + np.floor(floor / 0.1)) % 2
    color[seen] = np.where(chequer[seen, None], 0.62, 0.16)
    depth[seen] = floor[seen]
    for middle, radius, paint in (
        ((-0.10, 0.19, 0.70), 0.11, (0.75, 0.10, 0.08)),
        ((0.22, 0.14, 1.20), 0.16, (0.12, 0.50, 0.15)),
        ((-0.35, 0.02, 2.40), 0.28, (0.10, 0.20, 0.70)),
    ):
        centre, square = np.array(middle), (ray**2).sum(0)
        along = np.tensordot(centre, ray, 1)
        root = along**2 - square * (centre @ centre - radius**2)
        away = (along - np.sqrt(np.maximum(root, 0))) / square
        hit = (root > 0) & (away < depth)
        normal = (away * ray - centre[:, None, None]) / radius
        shade = 0.25 + 0.75 * np.maximum(np.tensordot(light, normal, 1), 0)
        color[hit] = (shade[..., None] * np.array(paint))[hit]
        depth[hit] = away[hit]
    return color, depth


def two_cameras():
    """Draw the MTF of two cameras."""
    from matplotlib import pyplot as plt

    figure, axis = plt.subplots(figsize=(6, 4), layout="constrained")
    for name in ("phone", "machine-vision"):
        gs.plot.mtf(gs.open_camera(name), 550, axis, label=name)
    figure.savefig(HERE / "two-cameras.png", dpi=80)
    plt.close(figure)


def tasks():
    """Run the scripts of docs/tasks and keep what they save. A render of `balls` takes the place of Mitsuba's."""
    home = Path.cwd()
    (HERE / "tasks").mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            Path("photos").mkdir()
            Image.fromarray(data.astronaut()[0:320, 16:496]).save("photos/astronaut.png")
            write_render("render.exr")
            for path in sorted((HERE.parent / "tasks").glob("*.py")):
                runpy.run_path(str(path))
            for path in ("own_camera.png", "pairs/astronaut.png", "focus.png", "pixel_sizes.png"):
                Image.open(path).save(HERE / "tasks" / Path(path).name)
        finally:
            os.chdir(home)


def write_render(path):
    """Write `balls` as Mitsuba does: a channel for each band [W m-2 sr-1 nm-1], and the distance along the ray."""
    import OpenEXR

    color, depth = draw_balls()
    rows, cols = depth.shape
    y, x = np.mgrid[:rows, :cols] + 0.5 - np.array([rows, cols])[:, None, None] / 2
    step = 2 * np.tan(np.radians(20)) / cols
    channels = {}
    for nm in range(400, 701, 50):
        weights = [np.interp(nm, (450, 550, 620), one) for one in np.eye(3)[::-1]]  # of R, G, B
        channels[f"band{nm}"] = np.float32(0.005 * color @ weights)
    away = depth * np.sqrt(1 + (x**2 + y**2) * step**2)
    kind = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(kind, channels | {"depth.T": away.astype(np.float32)}).write(str(path))


def mosaic(frame, zoom):
    """Return digital numbers in their filters' colours, each pixel enlarged `zoom` times."""
    sensor = frame.camera.sensor
    level = np.clip(
        (frame.raw.astype(float) - sensor.black_level) / (sensor.white_level - sensor.black_level),
        0,
        1,
    )
    level = (level / np.quantile(level, 0.995)).clip(0, 1) ** (1 / 2.2)
    return color_mosaic(sensor, (255 * level).astype(np.uint8)).repeat(zoom, 0).repeat(zoom, 1)


def wide(scene):
    """Draw scene, raw and picture side by side, each with an enlarged part."""
    from matplotlib import pyplot as plt

    frame = gs.Simulator(gs.open_camera("phone"), tolerance="video")(scene, seed=1)
    display, raw = gs.open_display("srgb"), mosaic(frame, 1)
    seen = display.encode((ideal(scene) @ display.rgb_from_xyz.T).clip(0, 1))
    figure, axes = plt.subplots(1, 3, figsize=(12, 2.95))
    texts = ("scene: light at 31 wavelengths", "raw: electrons, noise, 10 bits", "picture: sRGB")
    part = np.s_[70:102, 200:248]
    for axis, image, text in zip(axes, (seen, raw, frame.rgb), texts, strict=True):
        axis.imshow(image, interpolation="antialiased")
        axis.set_title(text, fontsize=11)
        axis.set_axis_off()
        inset = axis.inset_axes((0.64, 0.02, 0.345, 0.345))
        inset.imshow(image[part], interpolation="nearest")
        inset.set_xticks([])
        inset.set_yticks([])
        inset.spines[:].set_color("white")
    figure.subplots_adjust(0.005, 0.01, 0.995, 0.9, 0.02)
    figure.savefig(HERE / "wide.png", dpi=110)
    plt.close(figure)


def accuracy():
    """Draw the true error over a pixel's noise at three tolerances, with the prediction."""
    from matplotlib import pyplot as plt

    scene, camera = gs.chart("deadleaves", size=(240, 160)), gs.open_camera("phone")
    figure, axes = plt.subplots(1, 4, figsize=(13, 2.9))
    axes[0].imshow(gs.Simulator(camera)(scene, seed=1).rgb)
    axes[0].set_title("the picture", fontsize=9)
    for axis, asked in zip(axes[1:], ("1e-2", "video", "metrology"), strict=True):
        simulate = gs.Simulator(camera, tolerance=asked)
        frame = simulate(scene, verify=True)
        predicted, true = frame.report.account.total, frame.report.error
        mean, truth = mean_and_truth(simulate, scene, simulate.expose(scene))
        noise = np.sqrt(truth + camera.sensor.read_sigma**2)
        image = axis.imshow(
            np.log10(np.abs(mean - truth) / noise + 1e-9), vmin=-4, vmax=0, cmap="magma"
        )
        axis.set_title(
            f"--tolerance {asked}\nrms: predicted {predicted.rms:.1e}, true {true.rms:.1e}\n"
            f"99.9 %: {predicted.p999_sigma:.2g} sigma, true {true.p999_sigma:.2g}",
            fontsize=8,
        )
    for axis in axes:
        axis.set_axis_off()
    figure.colorbar(image, ax=axes, shrink=0.8, pad=0.01, label="log10 of error over noise")
    figure.savefig(HERE / "accuracy.png", dpi=110, bbox_inches="tight")
    plt.close(figure)


def still_events():
    """Draw the noise events of an event camera against luminance, gpusim and v2e (see video.md)."""
    from matplotlib import pyplot as plt

    camera = gs.open_camera("phone").with_(f_number=2.8, pixel_pitch_um=18.5)
    simulate, sensor = gs.Simulator(camera), gs.EventSensor(mismatch=0.25)
    luminances = np.geomspace(0.03, 300, 13)
    rates = [
        len(
            gs.events_of(
                simulate,
                gs.chart("flat", size=(32, 32), luminance=float(luminance)),
                gs.Motion(),
                3.0,
                sensor,
            )
        )
        / 32**2
        / 3
        for luminance in luminances
    ]
    figure, axis = plt.subplots(figsize=(5, 3))
    axis.loglog(luminances, rates, label="gpusim: cutoff 30 Hz, noise 5 Hz")
    published = [0.1, 1, 10, 100]
    axis.loglog(published, [5.12, 5.08, 4.75, 1.37], "o", label="v2e, noisy preset")
    axis.loglog(published, [6.50] * 4, "s", mfc="none", label="v2e, --photoreceptor_noise")
    axis.set_xlabel("luminance of white [cd/m$^2$]")
    axis.set_ylabel("events per pixel and second")
    axis.set_ylim(0.5, 20)
    axis.legend(fontsize=8)
    figure.savefig(HERE / "still-events.png", dpi=110, bbox_inches="tight")
    plt.close(figure)


if __name__ == "__main__":
    main()
