"""Demosaicking: time at 1080p and quality on photographs, against OpenCV, LibRaw's PPG and Menon 2007, in one run.

    python bench/demosaic.py --device opencl:0 --repeat 9 [--size 1920x1080] [--photographs DIR]

Time: rounds alternate between all forms, so that other work on the machine meets each; the table has the median of the
rounds, the smallest and the largest, and the ratio to `best` within a round. Ours read uint16 and write float32
in arrays that stay on the device; OpenCV's bilinear (uint16) reads and writes its own; LibRaw's time is postprocess()
with PPG of a raw file written here, its colour steps included; Menon's is colour-demosaicing's, float64, fewer rounds.

Quality: every sub-folder of DIR with PNG pictures is a set. RGGB, 8 bits, interpolated as encoded (domain "linear"),
CPSNR over the three channels without a border of 10 pixels, mean over the set; of `best` also on the first, third ..
picture of each set, on which its constants were chosen, and on the others. Then through a lens that blurs (Gaussian on
linear light, CPSNR after sRGB encoding), and with Poisson and 2 e- read noise at a mean of 5 .. 1000 electrons.
"""

import argparse
import sys
import time
from functools import partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gpusim.backends import open_device
from gpusim.io.dng import write_dng

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # the protocol is the tests'
MODES = ("bilinear", "malvar", "adaptive", "best", "learned")


def modes():
    """Our stages that are there, by name."""
    found = {}
    for name in MODES:
        try:
            found[name] = getattr(import_module(f"gpusim.kernels.processor.{name}"), name)
        except ModuleNotFoundError:
            print(f"no stage {name}", file=sys.stderr)
    return found


def timed(device, rows, cols):
    """Name -> function that demosaicks one 10-bit frame."""
    raw = np.random.default_rng(0).integers(64, 1024, (rows, cols), np.uint16)
    on_device = device.array(raw, np.uint16)
    options = {"phase": "RGGB", "black_level": 64.0, "scale": 1 / 959, "device": device}

    def ours(method, **more):
        method(on_device, **options, **more)
        device.sync()

    forms = {name: partial(ours, method) for name, method in modes().items()}
    forms["best, noise known"] = partial(ours, modes()["best"], noise=(0.5, 2.0))
    try:
        import cv2

        cv2.setNumThreads(2)
        forms["OpenCV bilinear"] = lambda: cv2.cvtColor(raw, cv2.COLOR_BayerBG2RGB)
    except ModuleNotFoundError:
        pass
    ppg = libraw_ppg(raw)
    if ppg:
        forms["LibRaw PPG"] = ppg
    try:
        from colour_demosaicing import demosaicing_CFA_Bayer_Menon2007

        forms["Menon"] = lambda: demosaicing_CFA_Bayer_Menon2007(raw, "RGGB")
    except ModuleNotFoundError:
        pass
    return forms


def libraw_ppg(raw):
    """LibRaw's PPG on `raw`, or None without rawpy."""
    try:
        import rawpy
    except ModuleNotFoundError:
        return None
    with TemporaryDirectory() as folder:
        write_dng(Path(folder) / "frame.dng", raw, "RGGB", 64, 1023, np.eye(3), np.ones(3))
        picture = rawpy.imread(str(Path(folder) / "frame.dng"))
        picture.unpack()
    return partial(picture.postprocess, demosaic_algorithm=rawpy.DemosaicAlgorithm.PPG, output_bps=16,
                   no_auto_bright=True)


def speed(device, rows, cols, repeat):
    """Print the table of times."""
    forms = timed(device, rows, cols)
    times = {name: [] for name in forms}
    for run in forms.values():
        run()
    for number in range(repeat):
        for name, run in forms.items():
            if name == "Menon" and number >= 3:
                continue
            begin = time.perf_counter()
            run()
            times[name].append(1e3 * (time.perf_counter() - begin))
    print(f"| {cols} x {rows}, {device.name} | ms, median (least .. most) | over best |\n|---|---|---|")
    for name, values in times.items():
        ratio = np.median(np.divide(values, times["best"][: len(values)]))
        print(f"| {name} | {np.median(values):.1f} ({min(values):.1f} .. {max(values):.1f}) | {ratio:.2f} |")


def quality(device, folder):
    """Print the quality of every mode on every set in `folder`."""
    from test_best import ENCODED, captured
    from test_demosaic import cpsnr, mosaic, photographs

    sets = {path.name: list(photographs(path)) for path in sorted(folder.iterdir()) if any(path.glob("*.png"))}
    table = {}
    for name, method in modes().items():
        options = dict(ENCODED)
        if name in ("bilinear", "malvar"):
            del options["domain"]
        table[name] = {title: np.array([cpsnr(255 * np.moveaxis(method(mosaic(image), **options, device=device), 0, 2),
                                              image) for image in images]) for title, images in sets.items()}
    try:
        from colour_demosaicing import demosaicing_CFA_Bayer_Menon2007

        table["Menon"] = {title: np.array([cpsnr(demosaicing_CFA_Bayer_Menon2007(mosaic(image).astype(float)), image)
                                           for image in images]) for title, images in sets.items()}
    except ModuleNotFoundError:
        pass
    print(f"\n| CPSNR [dB] | {' | '.join(f'{title} ({len(images)})' for title, images in sets.items())} |"
          f"\n|---{'|---' * len(sets)}|")
    for name, values in table.items():
        print(f"| {name} | {' | '.join(f'{values[title].mean():.2f}' for title in sets)} |")
        if name in ("best", "Menon"):
            for half, first in (("chosen on", 0), ("held out", 1)):
                print(f"| {name}, {half} | {' | '.join(f'{values[title][first::2].mean():.2f}' for title in sets)} |")

    from gpusim.kernels.processor.adaptive import adaptive
    from gpusim.kernels.processor.best import best
    from gpusim.kernels.processor.bilinear import bilinear
    from gpusim.kernels.processor.learned import learned

    print(f"\n| seen as | {' | '.join(f'{title}: bilinear / adaptive / best / learned' for title in sets)} |"
          f"\n|---{'|---' * len(sets)}|")
    for electrons, blur in ((None, 0.0), (None, 0.5), (None, 0.8), (None, 1.2), (None, 2.0),
                            (5, 0.0), (20, 0.0), (100, 0.0), (1000, 0.0)):
        shown = {"electrons": electrons, "blur": blur, "methods": (bilinear, adaptive, best, learned)}
        cells = [np.mean([captured(image, seed=number, **shown) for number, image in enumerate(images)], axis=0)
                 for images in sets.values()]
        print(f"| {electrons or 'no noise,'}{' e-,' if electrons else ''} blur {blur} | "
              f"{' | '.join(' / '.join(f'{value:.2f}' for value in cell) for cell in cells)} |", flush=True)


def main():
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--repeat", type=int, default=9)
    parser.add_argument("--size", default="1920x1080")
    parser.add_argument("--photographs", type=Path, help="folder with a sub-folder of PNG pictures per set")
    arguments = parser.parse_args()
    cols, rows = map(int, arguments.size.split("x"))
    device = open_device(arguments.device)
    speed(device, rows, cols, arguments.repeat)
    if arguments.photographs:
        quality(device, arguments.photographs)


if __name__ == "__main__":
    main()
