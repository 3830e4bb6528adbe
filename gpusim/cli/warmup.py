"""`gpusim warmup`: the kernels of usual frames, compiled before they are needed."""

from dataclasses import dataclass

from gpusim.cli.options import CAMERA_HELP, DEVICE_HELP, Options, option

TEXTS = {"help": "compile the kernels of usual frames, on all cores, so that no frame waits for it"}


@dataclass(frozen=True, kw_only=True)
class WarmupRequest(Options):
    """Options of `gpusim warmup`."""

    device: str = option(default="auto", help=DEVICE_HELP)
    camera: list[str] | tuple = option(
        default=(),
        action="append",
        help=f"{CAMERA_HELP}; may be repeated (default: phone, machine-vision, figure8, mono)",
    )
    tolerance: list[str] | tuple = option(
        default=(),
        action="append",
        help="preview, video, metrology, a relative RMS error, or exact for none; may be repeated "
        "(default: exact and video)",
    )


def warmup(request: WarmupRequest) -> int:
    """Run `gpusim warmup`.

    Args:
        request: Options of the command.

    Returns:
        The exit status: 1 if a frame failed.

    Raises:
        GpusimError: If there is no such device, camera or tolerance.
    """
    import time

    from gpusim.apps.warmup import CAMERAS, EXACT, SCENES, warm_up
    from gpusim.backends import open_device
    from gpusim.domain.account import Tolerance
    from gpusim.domain.progress import announced
    from gpusim.io.camera.cameras import open_camera

    device = open_device(request.device).name
    cameras = request.camera or CAMERAS
    tolerances = request.tolerance or (EXACT, "video")
    for camera in cameras:
        open_camera(camera)
    for tolerance in tolerances:
        if tolerance != EXACT:
            Tolerance.parse(tolerance)
    count, failures, start = len(cameras) * len(tolerances) * len(SCENES), 0, time.monotonic()
    frames = warm_up(device, cameras, tolerances)
    for number in range(1, count + 1):
        with announced(f"compiling for {device}: frame {number} of {count}"):
            frame = next(frames)
        failures += bool(frame.error)
        print(f"{frame.words}: {frame.error or f'{frame.seconds:.1f} s'}", flush=True)
    print(
        f"{count - failures} of {count} kinds of frames on {device}: {time.monotonic() - start:.0f} s"
    )
    return 1 if failures else 0
