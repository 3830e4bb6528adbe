"""Times gpusim and other libraries in turns, with errors against a float64 reference.

    python bench/compare.py --device opencl --json bench/results/compare-NAME.json [--subject frame] [--size 1920x1080]

frame: a cube to mean electrons by a transform per band, in SciPy, ducc0 and PyTorch, and by gpusim
with and without a tolerance; error: relative RMS against float64. demosaic: an RGGB mosaic of 16
bit to RGB; error: relative RMS against the float64 reference of the same method if there is one,
and CPSNR against the original picture, both without a border of 10 pixels. LibRaw's time is for
postprocess() with its colour steps.

Ratios are relative to NumPy and SciPy, bench/baseline.py. The other libraries use one thread per
core, and read and write host memory; gpusim stays on the device. A row says if its library is not
installed.
"""

from functools import partial
from importlib.util import find_spec
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory

import baseline
import numpy as np
from baseline import Baseline
from frames import SECONDS, cube
from results import (
    add_size,
    cores,
    count,
    finish,
    parser,
    peer_rows,
    ready,
    rms,
    rounds,
    show,
    start,
)

from gpusim.data.charts import chart
from gpusim.domain.content import Cube
from gpusim.domain.scene import Scene
from gpusim.io.camera.cameras import open_camera
from gpusim.io.frame.dng import write_dng
from gpusim.kernels.stage import public_function
from gpusim.pipeline.simulator import Simulator

PACKAGES = {
    "cv2": "opencv-python-headless",
    "colour_demosaicing": "colour-demosaicing",
    "rawpy": "rawpy",
    "torch": "torch",
    "ducc0": "ducc0",
}
BORDER = 10  # [pixel] that methods treat differently
ERROR_SIZE = (480, 270)  # of the mosaic for the errors
WHITE = 65535  # of the mosaic


class Subject:
    """Forms of one task: functions, errors, missing libraries. The base is NumPy or SciPy."""

    def __init__(self, name: str, base: str):
        self.name, self.base, self.forms, self.errors, self.missing = name, base, {}, {}, []

    def add(self, name: str, make, package: str | None = None):
        """Add a form.

        make(): returns a function that does the task and waits, and its error as text.
        """
        name = f"{self.name}: {name}"
        if package is not None and find_spec(package) is None:
            self.missing.append(
                {"name": name, "failed": f"not installed: pip install {PACKAGES[package]}"}
            )
        else:
            self.forms[name], self.errors[name] = make()

    def rows(self, repeat) -> list[dict]:
        """Time all forms in turns."""
        base = f"{self.name}: {self.base}"
        times = rounds(self.forms, repeat)
        return (
            peer_rows(times, {name: base for name in times if name != base}, self.errors)
            + self.missing
        )


class WithDucc(Baseline):
    """The baseline with ducc0's transforms."""

    def forward(self, plane):
        """See Baseline."""
        import ducc0

        return ducc0.fft.r2c(plane, axes=(0, 1), nthreads=cores())

    def inverse(self, spectra):
        """See Baseline."""
        import ducc0

        return ducc0.fft.c2r(
            spectra,
            axes=(1, 2),
            lastsize=self.plan.period[1],
            forward=False,
            inorm=2,
            nthreads=cores(),
            allow_overwriting_input=True,
        )


class WithTorch(Baseline):
    """The baseline in PyTorch, with the cube and the tables on its device."""

    def __init__(self, simulator: Simulator, scene: Scene, place: str):
        import torch

        super().__init__(simulator, scene)
        torch.set_num_threads(cores())
        self.place = place
        self.there = {
            name: torch.from_numpy(np.ascontiguousarray(getattr(self, name))).to(place)
            for name in ("tables", "mix", "falloff")
        }

    def mean(self, cube, seconds):
        """Return the mean electrons of a cube; both are tensors."""
        import torch

        rows, cols = cube.shape[1:]
        (top, left), (high, wide) = self.before, self.plan.period
        pads = (left, wide - cols - left, top, high - rows - top)
        tables, mix = self.there["tables"], self.there["mix"]
        sums = torch.zeros(
            (len(mix), high, wide // 2 + 1), dtype=torch.complex64, device=self.place
        )
        for band, table, weights in zip(cube, tables, mix.T, strict=True):
            padded = torch.nn.functional.pad(band[None, None], pads, mode="replicate")[0, 0]
            sums += weights[:, None, None] * (torch.fft.rfft2(padded) * table)
        channels = torch.fft.irfft2(sums, (high, wide))[:, top : top + rows, left : left + cols]
        mosaic = torch.empty((rows, cols), device=self.place)
        for (dy, dx), channel in np.ndenumerate(self.cfa):
            step_y, step_x = self.cfa.shape
            mosaic[dy::step_y, dx::step_x] = channels[int(channel), dy::step_y, dx::step_x]
        result = mosaic.clamp_(min=0) * (self.there["falloff"] * seconds)
        if self.place != "cpu":
            torch.cuda.synchronize()
        return result


def frame(device, size, tolerance) -> Subject:
    """Compare a cube to mean electrons."""
    picture, camera = chart("deadleaves", size=size), open_camera("phone")
    values = cube(picture)
    cubes = [values, values * np.float32(1.01)]
    scenes = [
        Scene(Cube(picture.wavelengths, part), picture.illuminant, picture.border) for part in cubes
    ]
    truth = Simulator(camera, device="numpy").expose(scenes[0], SECONDS).mean
    exact, subject = Simulator(camera, device=device), Subject("frame", "SciPy")

    def ours(limit):
        there = [
            Scene(Cube(picture.wavelengths, device.array(part)), picture.illuminant, picture.border)
            for part in cubes
        ]
        loop = Simulator(camera, device=device, tolerance=limit).loop(there[0], SECONDS)
        given = cycle(there[::-1])
        error = f"rms {rms(device.numpy(loop.output('mean')), truth):.1e}"

        def run():
            loop.update(scene=next(given)).output("mean")
            device.sync()

        return run, error

    def peer(kind, *where):
        made = kind(exact, scenes[0], *where)
        given = cubes
        if where:
            import torch

            given = [torch.from_numpy(part).to(*where) for part in cubes]
        result = made.mean(given[0], SECONDS)
        error = f"rms {rms(result.cpu() if where else result, truth):.1e}"
        following = cycle(given[::-1])
        return lambda: made.mean(next(following), SECONDS), error

    subject.add("SciPy", partial(peer, Baseline))
    subject.add("ducc0", partial(peer, WithDucc), "ducc0")
    subject.add("PyTorch", partial(peer, WithTorch, "cpu"), "torch")
    if device.is_gpu and find_spec("torch"):
        import torch

        if torch.cuda.is_available():
            subject.add("PyTorch, CUDA", partial(peer, WithTorch, "cuda"))
    subject.add("gpusim, every band", partial(ours, None))
    if tolerance:
        subject.add(f"gpusim, tolerance {tolerance:g}", partial(ours, tolerance))
    return subject


def demosaic(device, size, tolerance) -> Subject:
    """Compare an RGGB mosaic to RGB."""
    subject = Subject("demosaic", "NumPy, bilinear")
    raw, (small, truth) = _mosaic(size)[0], _mosaic(ERROR_SIZE)
    inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    options = {"phase": "RGGB", "black_level": 0.0, "scale": 1 / WHITE}
    references = {
        name: np.moveaxis(
            public_function(f"processor.{name}")(small, **options, device="numpy"), 0, 2
        )
        for name in ("bilinear", "malvar")
    }

    def judged(method, reference=None):
        """Return the form and its error as text.

        method(raw): gives a function that returns RGB (rows, cols, 3), 1 = white.
        """
        shown = np.asarray(method(small)(), np.float64)[inner]
        cpsnr = -10 * np.log10(np.mean((shown - truth[inner]) ** 2))
        same = "" if reference is None else f"rms {rms(shown, references[reference][inner]):.1e}; "
        return method(raw), f"{same}CPSNR {cpsnr:.2f} dB"

    def ours(name):
        def method(mosaic):
            there = device.array(mosaic, np.uint16)

            def run():
                result = public_function(f"processor.{name}")(there, **options, device=device)
                device.sync()
                return np.moveaxis(device.numpy(result), 0, 2) if mosaic is small else None

            return run

        return method

    def numpy(mosaic):
        if mosaic is small:
            return lambda: np.moveaxis(baseline.bilinear(mosaic, 1 / WHITE), 0, 2)
        return partial(baseline.bilinear, mosaic, 1 / WHITE)

    subject.add("NumPy, bilinear", partial(judged, numpy, "bilinear"))
    for name in ("bilinear", "malvar", "adaptive", "best", "learned"):
        subject.add(
            f"gpusim, {name}", partial(judged, ours(name), name if name in references else None)
        )
    for name, reference in (("", "bilinear"), ("_EA", None)):
        subject.add(
            f"OpenCV, {'edge-aware' if name else 'bilinear'}",
            lambda name=name, reference=reference: judged(
                partial(_opencv, f"COLOR_BayerBG2RGB{name}"), reference
            ),
            "cv2",
        )
    for name, reference in (
        ("bilinear", "bilinear"),
        ("Malvar2004", "malvar"),
        ("Menon2007", None),
    ):
        subject.add(
            f"colour-demosaicing, {name}",
            lambda name=name, reference=reference: judged(
                partial(_colour, f"demosaicing_CFA_Bayer_{name}"), reference
            ),
            "colour_demosaicing",
        )
    for name in ("LINEAR", "PPG", "AHD"):
        subject.add(f"LibRaw, {name}", lambda name=name: judged(partial(_libraw, name)), "rawpy")
    return subject


def _mosaic(size):
    """Return a mosaic (rows, cols) uint16 and its original picture (rows, cols, 3), 1 = white."""
    from scipy.ndimage import gaussian_filter

    content = chart("deadleaves", size=size, wavelengths=[450.0, 540.0, 610.0]).content
    picture = np.moveaxis(content.bands_at(slice(None)), 0, 2)[..., ::-1]
    picture = gaussian_filter(picture / picture.max(), (0.7, 0.7, 0))  # a lens's blur
    raw = np.empty(picture.shape[:2])
    for (dy, dx), channel in np.ndenumerate([[0, 1], [1, 2]]):
        raw[dy::2, dx::2] = picture[dy::2, dx::2, channel]
    return np.rint(WHITE * raw).astype(np.uint16), picture


def _opencv(code, raw):
    import cv2

    cv2.setNumThreads(cores())
    return _scaled(lambda: cv2.demosaicing(raw, getattr(cv2, code)), raw)


def _colour(name, raw):
    import colour_demosaicing

    values = raw / np.float64(WHITE)
    return lambda: getattr(colour_demosaicing, name)(values, "RGGB")


def _libraw(name, raw):
    import rawpy

    with TemporaryDirectory() as folder:
        path = Path(folder) / "frame.dng"
        write_dng(path, raw, ("RG", "GB"), 0, WHITE, {"D65": (np.eye(3), None)}, np.ones(3))
        picture = rawpy.imread(str(path))
        picture.unpack()
    develop = partial(
        picture.postprocess,
        demosaic_algorithm=getattr(rawpy.DemosaicAlgorithm, name),
        output_bps=16,
        no_auto_bright=True,
        gamma=(1, 1),
        user_wb=[1, 1, 1, 1],
        output_color=rawpy.ColorSpace.raw,
    )
    return _scaled(develop, raw)


def _scaled(run, raw):
    """Return the picture with white 1, on the judged part of the mosaic; scaling is not timed."""
    return (lambda: run() / WHITE) if raw.shape == ERROR_SIZE[::-1] else run


SUBJECTS = {"frame": frame, "demosaic": demosaic}


def main():
    """Print the rows, and write them if requested."""
    made = parser(__doc__)
    add_size(made)
    made.add_argument(
        "--subject", choices=SUBJECTS, action="append", help="may be repeated (default: all)"
    )
    made.add_argument(
        "--tolerance",
        type=float,
        default=4e-4,
        help="tolerance of the fused frame (default: 4e-4); 0: none",
    )
    made.add_argument("--repeat", type=count, default=9)
    arguments = made.parse_args()
    device, old = ready(arguments, "compare")
    rows = []
    for name in arguments.subject or SUBJECTS:
        found = SUBJECTS[name](device, arguments.size, arguments.tolerance).rows(arguments.repeat)
        show(found)
        rows += found
    finish(
        arguments,
        "compare",
        device,
        rows,
        old,
        size=arguments.size,
        tolerance=arguments.tolerance or None,
        repeat=arguments.repeat,
    )


if __name__ == "__main__":
    start(main)
