"""Figure 14 of Farrell & Wandell: RGB, RGBW and RGBN sensors with learned filters.

    python bench/figure14.py --out bench [--json bench/results/figure14.json]    writes figure14.png (learned filters)

f/4, diffraction-limited, 3 mm focal length, 2.2 um pixels, 100 ms, scenes with a mean of 1 and 40
cd/m2 over the frame. For all other values the chapter cites its reference [103]. The script uses
the curves of the MT9V024 (R, G, B and clear) with a phone's infrared cut; N is the clear curve with
a neutral density of 0.5 (transmission 0.3). The pixel follows the authors' software (isetL3,
functions/L3SensorCreate.m): fill factor 0.45; 1.8 V at 0.2 mV/e-, hence 9000 e-; read noise 1.34
mV, hence 6.7 e-; DSNU 1.41 mV, hence 7.05 e-; dark voltage 10 uV/s, hence 0.05 e-/s; PRNU 0.0022 %.
The 12-bit converter with black level 64 is our choice.

The scene is not in the training set: a ColorChecker, shaded balls, print and lines in front of dead
leaves of reflectances (ColorChecker SG) that no training scene uses.
"""

import dataclasses
from pathlib import Path

import numpy as np
from results import Tables, finish, parser, ready, start

from gpusim.apps.l3.train import ideal_colors, train
from gpusim.data.charts import WAVELENGTHS, chart
from gpusim.data.curves import curve
from gpusim.data.reflectances import reflectances
from gpusim.data.srgb import srgb_to_xyz
from gpusim.domain.camera import Camera
from gpusim.domain.content import Materials
from gpusim.domain.noise import Noise
from gpusim.domain.optics import Optics
from gpusim.domain.processor import Processor
from gpusim.domain.scene import Scene
from gpusim.domain.sensor import Sensor
from gpusim.domain.spectrum import Spectrum
from gpusim.io.atomic import check_output
from gpusim.io.scene.scenes import mean_luminance
from gpusim.pipeline.simulator import Simulator

CAMERAS = {"RGB Bayer": ("RG", "GB"), "RGBW": ("RG", "WB"), "RGBN": ("RG", "NB")}
LUMINANCES = (1.0, 40.0)  # [cd m-2], mean over the frame
NEUTRAL = 0.3  # transmission of the filter on N
SIZE, FINE = (256, 192), 2
BORDER = 8  # [pixel] left out of the measures
SHOWN = np.s_[6:160, 52:250]  # part of the frame in the figure
TO_XYZ = srgb_to_xyz()
GREY = 0.2  # reflectance of a card that fills a frame


def camera(name, cfa, **processor):
    """Return a camera of the figure, with the given processor settings."""
    table = curve("mt9v024")
    curves = dict(
        zip("RGBW", table.values * curve("ir-cut-phone").at(table.wavelengths), strict=True)
    )
    curves["N"] = NEUTRAL * curves["W"]
    letters = tuple(letter for letter in "RGBWN" if letter in "".join(cfa))
    nodes = np.concatenate(
        [[40, 399], table.wavelengths, [701, 7000]]
    )  # light outside the table is not counted
    qe = Spectrum(
        nodes,
        np.pad([curves[letter] for letter in letters], ((0, 0), (2, 2))),
        "MT9V024 x infrared cut",
    )
    noise = Noise(read=6.7, dsnu=7.05, dark_current=0.05, prnu=2.2e-5)
    sensor = Sensor(
        2.2e-6,
        qe,
        full_well=9000,
        bits=12,
        channels=letters,
        cfa=cfa,
        fill_factor=0.45,
        exposure_time=0.1,
        black_level=64,
        noise=noise,
    )
    return Camera(name, Optics(4, 3e-3), sensor, Processor(scaling="normalised", **processor))


def test_scene() -> Scene:
    """Return the scene, white at 100 cd m-2."""
    cols, rows = (FINE * n for n in SIZE)
    base = chart(
        "deadleaves",
        size=SIZE,
        samples_per_pixel=FINE,
        surfaces="colorchecker-sg",
        smallest=6,
        seed=1407,
    )
    checker = chart("colorchecker", size=(SIZE[0] // 2, SIZE[1] // 2), samples_per_pixel=FINE)
    balls = (("skin", 8), ("objects", 61), ("nature", 20), ("munsell", 12))
    spectra = [
        reflectances("colorchecker-sg").at(WAVELENGTHS, None),
        checker.content.spectra,
        np.ones((1, 31)),
    ]
    spectra += [reflectances(name).at(WAVELENGTHS, None)[[number]] for name, number in balls]
    first = np.cumsum([0, *map(len, spectra)])
    ids, shading = base.content.ids.astype(np.uint16), base.content.shading.copy()
    y, x = np.mgrid[:rows, :cols]
    shading *= 0.45 + 0.4 * x / cols  # light from the right
    grey = first[2]
    table = y > 0.62 * rows
    ids[table], shading[table] = grey, (0.22 + 0.2 * x / cols)[table]
    top, left = int(0.06 * rows), int(0.03 * cols)
    place = np.s_[top : top + rows // 2, left : left + cols // 2]
    ids[place], shading[place] = checker.content.ids + first[1], checker.content.shading
    places = ((0.66, 0.6, 0.13), (0.88, 0.7, 0.12), (0.45, 0.78, 0.09), (0.2, 0.78, 0.1))
    for number, (cx, cy, radius) in enumerate(places):
        dx, dy = (x - cx * cols) / (radius * cols), (y - cy * rows) / (radius * cols)
        inside = dx**2 + dy**2 < 1
        height = np.sqrt(np.maximum(1 - dx**2 - dy**2, 0))
        ids[inside] = first[3] + number
        shading[inside] = (0.06 + 0.94 * np.maximum(0.55 * dx - 0.5 * dy + 0.67 * height, 0))[
            inside
        ]
    page = np.s_[int(0.06 * rows) : int(0.42 * rows), int(0.58 * cols) : int(0.97 * cols)]
    ids[page], shading[page] = grey, 0.9 * (1 - 0.95 * _print(shading[page].shape))
    content = Materials(WAVELENGTHS, ids, shading.astype(np.float32), np.vstack(spectra))
    return dataclasses.replace(base, content=content, name="figure 14")


def _print(shape):
    """Return ink, 0 .. 1: lines of text of decreasing size, and a fan of lines."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.new("L", (shape[1], shape[0]))
    draw = ImageDraw.Draw(image)
    y = 4
    for size, text in ((30, "Local, linear"), (22, "and learned filters"), (16, "RGB, RGBW, RGBN")):
        draw.text((8, y), text, 255, ImageFont.load_default(size))
        y += int(1.2 * size)
    for n in range(17):
        draw.line([(12 + 10 * n, shape[0] - 6), (40 + 6.2 * n, y + 8)], 255, 2)
    return np.asarray(image) / 255


def measures(shown, wanted):
    """Return CPSNR of sRGB codes [dB] and mean CIEDE2000 of linear display RGB."""
    import colour

    def lab(rgb):
        return colour.XYZ_to_Lab(rgb @ TO_XYZ.T, [0.3127, 0.3290])

    shown, wanted = (
        np.clip(image[BORDER:-BORDER, BORDER:-BORDER], 0, 1) for image in (shown, wanted)
    )
    codes = [colour.cctf_encoding(image, function="sRGB") for image in (shown, wanted)]
    return (
        -10 * np.log10(np.mean((codes[0] - codes[1]) ** 2)),
        float(colour.delta_E(lab(shown), lab(wanted), method="CIE 2000").mean()),
    )


def grey_snr(simulator, white, seed):
    """Return mean over standard deviation of a grey card's luminance [dB]. luminance: of white."""
    card = chart("flat", size=SIZE, luminance=white, reflectance=GREY)
    luminance = simulator(card, seed=seed).linear[BORDER:-BORDER, BORDER:-BORDER] @ TO_XYZ[1]
    return 20 * np.log10(luminance.mean() / luminance.std())


def main():
    """Train, take the pictures, print the table, draw the figure."""
    made = parser(__doc__)
    made.add_argument(
        "--out", type=Path, default=Path(__file__).parent, help="folder of figure14.png"
    )
    made.add_argument(
        "--seed", type=int, default=3, help="seed of the frames' noise, not of the training"
    )
    arguments = made.parse_args()
    device, old = ready(arguments, "figure14")
    check_output(arguments.out / "figure14.png")
    scene = test_scene()
    own = mean_luminance(scene)
    print(
        f"mean reflectance {own / 100:.3f}: white at "
        + ", ".join(f"{100 * at / own:.4g}" for at in LUMINANCES)
        + " cd/m2\n"
    )
    pictures, rows = {}, []
    for name, cfa in CAMERAS.items():
        table = train(camera(name, cfa), device=device)
        for label, settings in (
            ("learned", {"demosaic": "learned", "table": table}),
            ("interpolation, matrix", {"demosaic": "bilinear"}),
        ):
            used = camera(name, cfa, **settings)
            simulator = Simulator(used, device=device)
            wanted = np.moveaxis(ideal_colors(scene), 0, -1) @ used.display.rgb_from_xyz.T
            for mean in LUMINANCES:
                light = dataclasses.replace(scene, illuminant=scene.illuminant.scale(mean / own))
                frame = simulator(light, seed=arguments.seed)
                rows.append(
                    (
                        mean,
                        name,
                        label,
                        *measures(frame.linear, wanted),
                        grey_snr(simulator, 100 * mean / own, arguments.seed),
                    )
                )
                if label == "learned":
                    pictures[mean, name] = frame.rgb
    tables = Tables()
    for mean in LUMINANCES:
        tables.table(
            f"{mean:g} cd/m2",
            "mosaic and processor",
            "CPSNR [dB]",
            "mean CIEDE2000",
            "SNR of a grey card [dB]",
        )
        for at, name, label, cpsnr, difference, snr in sorted(
            rows, key=lambda row: row[2] != "learned"
        ):
            if at == mean:
                tables.row(f"{name}, {label}", f"{cpsnr:.2f}", f"{difference:.2f}", f"{snr:.1f}")
    finish(
        arguments, "figure14", device, tables.rows, old, seed=arguments.seed, columns=tables.columns
    )
    draw(pictures, arguments.out / "figure14.png")


def draw(pictures, path):
    """Draw rows of luminances and columns of mosaics, pixel for pixel, a part of the frames."""
    from PIL import Image, ImageDraw, ImageFont

    rows, cols = next(iter(pictures.values()))[SHOWN].shape[:2]
    edge, head = 4, 20
    sheet = Image.new("RGB", (3 * cols + 2 * edge, 2 * (rows + head)), "white")
    draw = ImageDraw.Draw(sheet)
    for line, mean in enumerate(LUMINANCES):
        for column, name in enumerate(CAMERAS):
            place = column * (cols + edge), line * (rows + head)
            draw.text(
                (place[0] + 2, place[1] + 3),
                f"{name}, {mean:g} cd/m2",
                "black",
                ImageFont.load_default(13),
            )
            sheet.paste(Image.fromarray(pictures[mean, name][SHOWN]), (place[0], place[1] + head))
    sheet.save(path, optimize=True)


if __name__ == "__main__":
    start(main)
