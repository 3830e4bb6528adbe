"""What a program gives by name, from the optical image to display codes."""

from gpusim.kernels.processor.color import color
from gpusim.pipeline.cache import One

OUTPUTS = {
    "irradiance": "the optical image at every wavelength of the scene, over each pixel's aperture (L, rows, cols) "
    "[photon s-1 m-2 nm-1]",
    "electrons": "mean electrons that every pixel would collect in every channel (C, rows, cols) [e-]",
    "mean": "mean electrons of every pixel (rows, cols), or of stacked pixels (C, rows, cols) [e-]",
    "chip_mean": "the same of this very chip, binned where charge is [e-]",
    "raw": "digital numbers (rows, cols), layers of stacked pixels one below the other [DN]",
    "camera": "camera values of every pixel, demosaicked (C, rows, cols), white level 1",
    "linear": "linear display RGB before clipping and tone curve (3, rows, cols), display white 1",
    "xyz": "CIE XYZ of that (3, rows, cols), Y of display white 1",
    "codes": "display codes (rows, cols, 3)",
}


def output_of(program, name, seed, frame):
    """An output on the device; see `Program.output`."""
    if name in ("irradiance", "electrons"):
        return _optical(program, name)
    shots = program.shots
    if name in ("mean", "chip_mean"):
        return getattr(shots.exposure, name)
    raw = shots.raw(seed, frame)
    if name == "raw":
        return raw
    if name == "camera":
        return shots.planes(raw)
    if name == "codes":
        return shots.codes(raw)
    linear = shots.linear(raw)[0]
    return linear if name == "linear" else _xyz(program, linear)


def _optical(program, name):
    """Irradiance per wavelength, or electrons per channel: blurred for themselves, not taken from the mosaic."""
    exposure, kept, imaging = program.shots.exposure, program.kept, program.simulator.imaging
    plan, seconds = program.plan, exposure.exposure_time
    made = kept(
        f"plan of {name}",
        One(plan),
        lambda: imaging.spectral(plan) if name == "irradiance" else plan,
    )
    stored, samples = program.stored(made)
    planes = kept(
        f"planes of {name}", (samples, made.table), lambda: imaging.planes(made.table, stored)
    )
    planes = program.placed(made, planes, f"placed planes of {name}")
    channels = kept(
        f"channels of {name}", (kept.one(planes), One(made)), lambda: imaging.channels(made, planes)
    )
    time = 1.0 if name == "irradiance" else seconds
    return kept(
        name, (kept.one(channels), One(made), time), lambda: imaging.collected(made, channels, time)
    )


def _xyz(program, linear):
    display, device = program.simulator.camera.display, program.simulator.device
    return program.kept(
        "xyz",
        (program.kept.one(linear), display),
        lambda: color(linear, device.array(display.xyz_from_rgb), device=device),
    )
