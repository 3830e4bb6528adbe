"""`gpusim simulate`: frames of one scene, in files, and their report."""

import functools
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from gpusim.apps.video.segments import numbered_path
from gpusim.cli.captures import capture_option
from gpusim.cli.options import Request, flag, option, reads, seed_option, whole, write_json
from gpusim.cli.views import simulate_views
from gpusim.domain.errors import BadFile
from gpusim.domain.progress import announce_each

if TYPE_CHECKING:  # the command line starts without them
    from gpusim.captures.capture import Capture

TEXTS = {"help": "a scene through a camera: raw frame, picture and report"}


@reads("ROWSxCOLS of 1 .. 64 cells, such as 9x9")
def _views(text):
    """Return the rows and columns of the text ROWSxCOLS."""
    rows, cols = (int(part) for part in text.split("x"))
    if not 1 <= min(rows, cols) <= max(rows, cols) <= 64:
        raise ValueError
    return rows, cols


@dataclass(frozen=True, kw_only=True)
class SimulateRequest(Request):
    """Options of `gpusim simulate`."""

    seed: int = seed_option("the temporal noise")
    frames: int = option(
        default=1,
        type=whole(1, 10**6),
        metavar="N",
        help="number of noisy frames, written to numbered files (default: 1)",
    )
    frame: int = option(
        default=0,
        type=whole(0, 2**32 - 1),
        metavar="N",
        help="number of the first frame: each has its own noise (default: 0)",
    )
    capture: "Capture | None" = capture_option("; frames that are not merged get numbered files")
    views: tuple[int, int] | None = option(
        type=_views,
        metavar="ROWSxCOLS",
        help="write pictures through as many cells of the pupil, .npz for gpusim refocus; with lenslets the raw frame "
        "behind them, .npy, and the views that it holds",
    )
    out: list[str] | tuple = option(
        "-o",
        "--out",
        metavar="OUT",
        help="file: .png, .jpg, .webp or .tif display, .exr or .npy linear RGB, .dng or .raw.npy raw, .npz "
        "electrons and DN; may be repeated",
        default=(),
        action="append",
    )
    bits: int | None = option(
        type=int,
        choices=(8, 16, 32),
        help="bits per value of .png (8, 16), .tif and .npy (8, 16, or 32 for linear floats) and "
        ".exr (16, 32) (default: 8, 16, 32 and 32)",
    )
    quality: int | None = option(
        type=whole(1, 100), metavar="N", help="quality of .jpg and .webp, 1 .. 100 (default: 95)"
    )
    report: str | None = option(
        metavar="FILE.json", help="file of the report: models, times and errors"
    )
    dual: str | None = option(
        metavar="FILE.npz",
        help="file of the photodiodes of dual pixels: raw values of each, and mean electrons; of several frames "
        "numbered files",
    )
    verify: bool = flag("also compute the float64 reference, and report the true error")
    verbose: bool = option(
        "-v",
        "--verbose",
        default=False,
        in_key=False,
        action="store_true",
        help="print a line for every stage, error and effect left out",
    )

    @property
    def count(self) -> int:
        """Number of frames that are written."""
        if self.capture is None:
            return self.frames
        self.refuse("frames", "--capture has its own frames", "leave one of them out")
        self.refuse("verify", "the reference is of one frame at rest")
        return self.capture.frame_count

    def dual_path(self, number: int) -> Path:
        """Return the file of the photodiodes of a frame. Raises BadFile for another suffix than .npz."""
        path = Path(self.dual or "")
        if path.suffix != ".npz":
            raise BadFile(path, "wanted a .npz file of photodiodes")
        return path if self.count == 1 else numbered_path(path, number, self.count)

    def check_outputs(self) -> list[Callable[[int], Path]]:
        """Return a function from a frame's number to its path for each output.

        Raises:
            BadFile: If a file cannot be written, is given twice, or is the scene or the camera.
            Conflict: If an option has no effect on these outputs.
        """
        from gpusim.io.atomic import check_output
        from gpusim.io.frame.frames import LOSSY, WITHOUT_PICTURE, frame_format

        if self.capture is not None:
            self.refuse("dual", "--capture has its own frames", "leave one of them out")
        outputs = [_number_files(path, self.count) for path in self.out]
        first = [output(0) for output in outputs]
        suffixes = {frame_format(path) for path in first}
        if not self.out:
            self.refuse("bits", "no file is written", "add -o OUT")
        if suffixes.isdisjoint(LOSSY):
            self.refuse("quality", "no .jpg or .webp is written", "add -o OUT.jpg")
        if suffixes <= {*WITHOUT_PICTURE}:
            self.refuse("bits", "these files have one format of numbers")
            self.refuse_picture("no picture is written", "add -o with .png, .tif or .exr", suffixes)
        folder = functools.cache(os.path.realpath)

        def place(path):
            return os.path.normcase(Path(folder(path.parent), path.name))

        report = [Path(self.report)] if self.report is not None else []
        dual = [self.dual_path(number) for number in range(self.count)] if self.dual else []
        for path in (*first, *report, *dual[:1]):
            check_output(path)
        taken = {
            place(Path(name)): "is read" for name in (self.scene, self.camera) if Path(name).suffix
        }
        frames = (output(number) for output in outputs for number in range(self.count))
        for path in (*report, *dual, *frames):
            here = place(path)
            if here in taken:
                why = f"{taken[here]}, and would be overwritten; give each -o and --report its own name"
                raise BadFile(path, why)
            taken[here] = "is given twice"
        return outputs


def simulate(request: SimulateRequest) -> int:
    """Run `gpusim simulate`.

    Args:
        request: Options of the command.

    Returns:
        The exit status: 1 if a frame does not meet the tolerance.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    from gpusim.io.frame.frames import LOSSY, check_format, frame_format
    from gpusim.pipeline.report import Report

    if request.views is not None:
        return simulate_views(request)
    outputs = request.check_outputs()  # before the work
    camera, scene = request.open_camera(), request.open_scene()
    if request.dual is not None:
        from gpusim.pipeline.diodes import divided

        divided(camera)
    simulator = request.open_simulator(camera)
    seen = replace(camera, sensor=simulator.readout.output)
    qualities = [request.quality if frame_format(path) in LOSSY else None for path in request.out]
    for path, quality in zip(request.out, qualities, strict=True):
        check_format(path, seen, request.bits, quality)
    if request.capture is not None:
        first = request.frame * request.capture.count
        frames = iter(request.capture.take(simulator, scene, seed=request.seed, first=first))
    else:
        frames = simulator.frames(
            scene, request.frames, verify=request.verify, seed=request.seed, first=request.frame
        )
    request.refuse_unread("simulate")
    if request.count > 1:
        from tqdm import tqdm

        frames = tqdm(frames, total=request.count, unit="frame", disable=None)
    else:
        frames = announce_each(frames, lambda count: "computing the frame")
    shown = Report.table if request.verbose else str
    reports = []
    for number, frame in enumerate(frames):
        for output, quality in zip(outputs, qualities, strict=True):
            frame.save(output(number), bits=request.bits, quality=quality)
        reports.append(frame.report)
        if request.count == 1:
            print(shown(frame.report))
    if request.count > 1:
        print(shown(reports[0]))
        print(
            f"  {len(reports)} frames; median of those after the first "
            f"{sorted(report.ms for report in reports[1:])[(len(reports) - 1) // 2]:.2f} ms"
        )
    if request.dual is not None:
        _write_diodes(request, simulator.expose(scene))
    plain = [report.as_dict() for report in reports]
    write_json(request.report, plain[0] if request.count == 1 else plain)
    return 1 if any(report.meets_tolerance is False for report in reports) else 0


def _write_diodes(request, exposure):
    """Write raw values and mean electrons of the photodiodes, a file for each frame."""
    import numpy as np

    from gpusim.io.atomic import atomic_path

    device, dual = exposure.device, exposure.simulator.camera.sensor.dual
    means = np.asarray(device.numpy(exposure.diodes))
    for number in range(request.frames):
        raw = exposure.raw_dual(seed=request.seed, first=request.frame + number)
        with atomic_path(request.dual_path(number)) as path:
            np.savez(
                path,
                raw=np.asarray(device.numpy(raw)),
                electrons=means,
                names=np.array(dual.diodes),
            )


def _number_files(path, count):
    """Return a function from a frame's number to its path: `a.png`, or `a_0000.png`, ..."""
    from gpusim.io.frame.frames import frame_format

    frame_format(path)
    return lambda number: Path(path) if count == 1 else numbered_path(Path(path), number, count)
