"""An RGGB mosaic to RGB, with the methods of gpusim and of other libraries."""

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gpusim.backends import Device
from gpusim.bench import baseline
from gpusim.bench.peer_task import Task
from gpusim.bench.timing import find_rms
from gpusim.data.charts import chart
from gpusim.domain.cores import count_cores
from gpusim.io.frame.dng import write_dng
from gpusim.kernels.stage import public_function

BORDER = 10  # [pixel] that methods treat differently
ERROR_SIZE = (480, 270)  # columns and rows of the mosaic for the errors
WHITE = 65535  # of the mosaic


def make_demosaic(device: Device, size: tuple[int, int]) -> Task:
    """Return the task: an RGGB mosaic of 16 bit to RGB.

    Errors are relative RMS against the float64 reference of the same method, if there is one, and
    CPSNR against the original picture, both without a border of 10 pixels. LibRaw's time has its
    colour steps.

    Args:
        device: The device of gpusim's forms.
        size: Columns and rows [pixel].
    """
    task = Task("demosaic", "NumPy, bilinear")
    raw, (small, truth) = make_mosaic(size)[0], make_mosaic(ERROR_SIZE)
    inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
    options = {"black_level": 0.0, "scale": 1 / WHITE}
    references = {
        name: np.moveaxis(
            public_function(f"processor.{name}")(small, phase="RGGB", **options, device="numpy"),
            0,
            2,
        )
        for name in ("bilinear", "malvar")
    }

    def judge(method, reference=None):
        """Return the form and its error as text.

        method(raw): gives a function that returns RGB (rows, cols, 3), 1 = white.
        """
        shown = np.asarray(method(small)(), np.float64)[inner]
        cpsnr = -10 * np.log10(np.mean((shown - truth[inner]) ** 2))
        same = (
            ""
            if reference is None
            else f"rms {find_rms(shown, references[reference][inner]):.1e}; "
        )
        return method(raw), f"{same}CPSNR {cpsnr:.2f} dB"

    def ours(name):
        def method(mosaic):
            there = device.array(mosaic, np.uint16)

            mosaic_of = {"cfa": ("RG", "GB")} if name == "network" else {"phase": "RGGB"}

            def run():
                demosaic = public_function(f"processor.{name}")
                result = demosaic(there, **mosaic_of, **options, device=device)
                device.sync()
                return np.moveaxis(device.numpy(result), 0, 2) if mosaic is small else None

            return run

        return method

    def numpy(mosaic):
        if mosaic is small:
            return lambda: np.moveaxis(baseline.bilinear(mosaic, 1 / WHITE), 0, 2)
        return partial(baseline.bilinear, mosaic, 1 / WHITE)

    task.add("NumPy, bilinear", partial(judge, numpy, "bilinear"))
    for name in ("bilinear", "malvar", "adaptive", "best", "learned", "network"):
        task.add(
            f"gpusim, {name}", partial(judge, ours(name), name if name in references else None)
        )
    others = (
        ("OpenCV, bilinear", partial(_opencv, "COLOR_BayerBG2RGB"), "bilinear", "cv2"),
        ("OpenCV, edge-aware", partial(_opencv, "COLOR_BayerBG2RGB_EA"), None, "cv2"),
        *(
            (f"colour-demosaicing, {name}", partial(_colour, name), same, "colour_demosaicing")
            for name, same in (
                ("bilinear", "bilinear"),
                ("Malvar2004", "malvar"),
                ("Menon2007", None),
            )
        ),
        *(
            (f"LibRaw, {name}", partial(_libraw, name), None, "rawpy")
            for name in ("LINEAR", "PPG", "AHD")
        ),
        ("kornia", _kornia, "bilinear", "kornia"),
    )
    for name, method, same, module in others:
        task.add(name, partial(judge, method, same), module)
    return task


def make_mosaic(size: tuple[int, int], white: int = WHITE) -> tuple[np.ndarray, np.ndarray]:
    """Return an RGGB mosaic of a blurred chart and the picture.

    Args:
        size: Columns and rows [pixel].
        white: Number of the lightest value.

    Returns:
        The mosaic (rows, cols), uint16, and the picture (rows, cols, 3), 1 = white.
    """
    from scipy.ndimage import gaussian_filter

    content = chart("deadleaves", size=size, wavelengths=[450.0, 540.0, 610.0]).content
    picture = np.moveaxis(content.bands_at(slice(None)), 0, 2)[..., ::-1]
    picture = gaussian_filter(picture / picture.max(), (0.7, 0.7, 0))  # a lens's blur
    raw = np.empty(picture.shape[:2])
    for (dy, dx), channel in np.ndenumerate([[0, 1], [1, 2]]):
        raw[dy::2, dx::2] = picture[dy::2, dx::2, channel]
    return np.rint(white * raw).astype(np.uint16), picture


def _opencv(code, raw):
    import cv2

    cv2.setNumThreads(count_cores())
    return _scale_white(lambda: cv2.demosaicing(raw, getattr(cv2, code)), raw)


def _colour(name, raw):
    import colour_demosaicing

    values = raw / np.float64(WHITE)
    return lambda: getattr(colour_demosaicing, f"demosaicing_CFA_Bayer_{name}")(values, "RGGB")


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
    return _scale_white(develop, raw)


def _kornia(raw):
    import torch
    from kornia.color import CFA, raw_to_rgb

    torch.set_num_threads(count_cores())
    there = torch.from_numpy(raw / np.float32(WHITE))[None, None]
    # named after OpenCV, as BG: red is at the top left
    return lambda: raw_to_rgb(there, CFA.BG)[0].permute(1, 2, 0).numpy()


def _scale_white(run, raw):
    """Return the picture with white 1, on the judge part of the mosaic; scaling is not timed."""
    return (lambda: run() / WHITE) if raw.shape == ERROR_SIZE[::-1] else run
