"""Makes the pictures of README.md and of the pages in docs/pictures.

    python docs/pictures.py

The commands below make the gallery. README.md has the same commands; a test compares them.
"""

import shlex
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image
from skimage import data

import gpusim as gs
from gpusim.cli.main import main as gpusim
from gpusim.judge.truth import mean_and_truth
from gpusim.measure.ideal import ideal
from gpusim.measure.mosaic import color_mosaic

HERE = Path(__file__).parent / "pictures"
SIZE = (480, 320)
GALLERY = {  # photo.png: NASA's portrait of Eileen Collins, of scikit-image
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
        gallery(Path(folder))
        wide(gs.open_scene(photo, luminance=2))
    accuracy()
    still_events()


def gallery(folder):
    """Run the commands of the gallery. folder: it contains photo.png."""
    for name, command in (GALLERY | PLOTS).items():
        words = [
            str(folder / word)
            if word == "photo.png"
            else str(HERE / word)
            if word == f"{name}.png"
            else word
            for word in shlex.split(command)[1:]
        ]
        if status := gpusim(words):
            raise SystemExit(f"{command}: status {status}")


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
