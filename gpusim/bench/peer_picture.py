"""A mosaic to display codes: gpusim in one pass, and other libraries."""

import os
from functools import partial

import numpy as np

from gpusim.backends import Device
from gpusim.bench import baseline
from gpusim.bench.camera_pipe import MARGIN_COLS, MARGIN_ROWS, camera_pipeline
from gpusim.bench.peer_demosaic import ERROR_SIZE, make_mosaic
from gpusim.bench.peer_task import Task
from gpusim.domain.cores import count_cores
from gpusim.domain.display import DISPLAYS
from gpusim.kernels.display.encode import thresholds
from gpusim.kernels.stage import public_function

WHITE = 1023  # of the mosaic
MATRIX = np.array([[1.9, -0.6, -0.3], [-0.3, 1.6, -0.3], [0.0, -0.5, 1.5]])
SRGB = DISPLAYS["srgb"]
INNER = np.s_[10:-10, 10:-10]  # without the border, which methods treat differently


def make_picture(device: Device, size: tuple[int, int]) -> Task:
    """Return the task: an RGGB mosaic of 10 bit to sRGB codes of 8 bit, with a colour matrix.

    Errors are root mean squares of the codes: against the float64 reference of the same method, if
    there is one, and against the codes of the original picture, both without a border of 10 pixels.
    Halide's pipeline does more, see `camera_pipeline`: it also sharpens, which the second error
    counts as one.

    Args:
        device: The device of gpusim's forms.
        size: Columns and rows [pixel], even.
    """
    task = Task("picture", "NumPy")
    raw, (small, original) = make_mosaic(size, WHITE)[0], make_mosaic(ERROR_SIZE, WHITE)
    truth = np.rint(255 * SRGB.encode(np.clip(original @ MATRIX.T, 0, 1)))
    develop = partial(
        public_function("processor.develop"),
        matrix=MATRIX.astype(np.float32),
        thresholds=thresholds(SRGB.decode),
        phase="RGGB",
        black_level=0.0,
        scale=1 / WHITE,
    )
    reference = develop(small, device="numpy")

    def judge(method, is_bilinear):
        """Return the form and its error as text. method(raw): gives a function that returns codes (rows, cols, 3)."""
        codes = np.asarray(method(small)())
        told = [f"rms {_find_rms(codes, reference):.2g} of the reference; "] if is_bilinear else []
        return method(raw), f"{''.join(told)}rms {_find_rms(codes, truth):.2f} of the picture"

    def ours(raw):
        there = device.array(raw, np.uint16)

        def run():
            codes = develop(there, device=device)
            device.sync()
            return codes if raw is not small else device.numpy(codes)

        return run

    task.add("NumPy", partial(judge, _numpy, True))
    task.add("gpusim, bilinear", partial(judge, ours, True))
    task.add("OpenCV, bilinear", partial(judge, _opencv, True), "cv2")
    task.add("Halide, camera pipe", partial(judge, _halide, False), "halide")
    return task


def _find_rms(codes, wanted):
    difference = np.asarray(codes, np.float64) - wanted
    return np.sqrt(np.mean(difference[INNER] ** 2))


def _curve():
    """Return the code of each camera value."""
    return np.rint(255 * SRGB.encode(np.arange(WHITE + 1) / WHITE)).astype(np.uint8)


def _numpy(raw):
    curve, matrix = _curve(), MATRIX.astype(np.float32)

    def run():
        light = np.tensordot(matrix, baseline.bilinear(raw, 1.0), 1)
        return curve[np.rint(np.clip(light, 0, WHITE)).astype(np.uint16)].transpose(1, 2, 0)

    return run


def _opencv(raw):
    import cv2

    cv2.setNumThreads(count_cores())
    curve = _curve()

    def run():
        planes = cv2.transform(cv2.demosaicing(raw, cv2.COLOR_BayerBG2RGB), MATRIX)  # saturated
        return curve[np.minimum(planes, WHITE, out=planes)]

    return run


def _halide(raw):
    os.environ.setdefault("HL_NUM_THREADS", str(count_cores()))
    import halide as hl

    (rows, cols), curve = raw.shape, _curve()
    picture, given = camera_pipeline(rows, cols, MATRIX, curve)
    # the pipeline's mosaic begins with green: one column is left out
    margin = ((MARGIN_ROWS, MARGIN_ROWS), (MARGIN_COLS - 1, MARGIN_COLS + 1))
    wide = np.pad(raw, margin, mode="reflect")
    given.set(hl.Buffer(wide))
    shown = hl.Buffer(hl.UInt(8), [cols, rows, 3])

    def run(kept=(wide, curve)):  # Halide's buffers do not own their memory
        picture.realize(shown)
        if raw.shape != ERROR_SIZE[::-1]:
            return shown
        return np.roll(np.moveaxis(np.array(shown), 0, 2), 1, axis=1)

    return run
