"""The named errors of a report in words: what each means, and what makes it smaller."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Cause:
    """A named error in words.

    Attributes:
        meaning: What causes the error.
        remedy: What makes it smaller; "" if nothing that a user can set does.
    """

    meaning: str
    remedy: str = ""

    def __str__(self):
        return f"{self.meaning}; {self.remedy}" if self.remedy else self.meaning


MORE_SAMPLES = "use a scene with more samples per pixel (--samples-per-pixel 2)"
TIGHTER = "a smaller tolerance computes more of it"
FLOAT64 = "the device numpy computes in float64"
LAYERS = "give the scene as layers"

# The errors that a frame's account adds up
CAUSES = {
    "rounding": Cause("sums are computed in 32-bit floating point", FLOAT64),
    "transforms": Cause("Fourier transforms are computed in 32-bit floating point", FLOAT64),
    "transfer tables": Cause("transfer functions of the lens are interpolated from tables"),
    "planes": Cause(
        "a few spectral planes and kernels stand for all wavelengths",
        "a smaller tolerance takes more",
    ),
    "border": Cause(
        "light from far outside the frame is approximated",
        "set a tolerance, or a smaller one",
    ),
    "blur left out": Cause("the blur of the lens is not computed", TIGHTER),
    "highlights": Cause("light far from very bright points is approximated"),
    "highlights behind edges": Cause(
        "edges of objects cut the rays of bright points behind them, without diffraction",
        "--verify computes it",
    ),
    "spectral sampling": Cause(
        "spectra between the wavelengths of the scene are interpolated",
        "use a scene with more wavelengths",
    ),
    "view": Cause("a moved or zoomed view is interpolated between samples", MORE_SAMPLES),
    "distortion": Cause("a distorted picture is interpolated between samples", MORE_SAMPLES),
    "distortion grid": Cause("the displacement by the lens is interpolated on a grid"),
    "distortion left out": Cause("a small distortion is not computed", TIGHTER),
    "distorted border": Cause(
        "distorted light from outside the frame is known only near the frame",
        "use a scene with a margin",
    ),
    "field of view": Cause(
        "the fields of view of the scene and of the calibration differ", "make both equal"
    ),
    "fall-off left out": Cause("a small fall-off toward the corners is not computed", TIGHTER),
    "flat field of the blur": Cause(
        "the brightness of a uniform scene behind this lens is interpolated over the field"
    ),
    "ripples of flat fields": Cause(
        "pixels are so coarse that uniform light has ripples; the given relative illumination has none",
        'use relative_illumination = "cos4" or "none"',
    ),
    "blur by depth within the cells of a light field": Cause(
        "views of a light field are blurred as if all things were in focus",
        "simulate the scene with its depth (gpusim.expose_views)",
    ),
    "depth left out": Cause("the blur is the same at all distances", TIGHTER),
    "distance of measured spreads": Cause(
        "the point spreads were measured at one distance only",
        "give point spreads at several distances (distances_m)",
    ),
    "depth, kernels between those computed": Cause(
        "kernels are interpolated between a few distances", "a smaller tolerance takes more"
    ),
    "depth, point spreads between the distances that were measured": Cause(
        "point spreads are interpolated between the measured distances",
        "measure at more distances",
    ),
    "depth, distances between displaced samples": Cause(
        "depth is interpolated where distortion or a view displaces samples", MORE_SAMPLES
    ),
    "depth, slopes of surfaces": Cause(
        "the blur changes along a slanted surface within one kernel"
    ),
    "depth, edges inside layers": Cause("steps of depth inside one layer hide nothing", LAYERS),
    "depth, occlusion left out": Cause("near objects do not hide light behind them", TIGHTER),
    "depth, in layers (hidden parts are continued)": Cause(
        "surfaces hidden by nearer objects are guessed from the picture next to them", LAYERS
    ),
    "depth, samples that may show one surface or two": Cause(
        "samples at the edges of objects may show one surface or a mix of two", MORE_SAMPLES
    ),
    "depth, light behind the edges of layers": Cause(
        "light that passes the edges of blurred objects is approximated"
    ),
    "shutter": Cause(
        "a few instants stand for the movement during the exposure",
        "a smaller tolerance takes more",
    ),
    "surfaces that were hidden": Cause(
        "the moving camera sees surfaces that the scene does not show; they are guessed", LAYERS
    ),
    "light below 0 between reads": Cause(
        "between two reads, ripples next to moving stars below 0 count as 0", MORE_SAMPLES
    ),
}

# Errors that are reported next to the account
BESIDE = {
    "scene sampling": Cause(
        "the scene has no structure finer than its samples; a real scene has", MORE_SAMPLES
    ),
    "light outside the wavelengths": Cause(
        "the sensor would see light outside the wavelengths of the scene",
        "use a scene with more wavelengths, or an infrared cut",
    ),
    "spectral sampling (spline against lines)": Cause(
        "two ways to interpolate the spectra of the scene differ by this much",
        "use a scene with more wavelengths",
    ),
    "local error next to highlights": Cause(
        "largest error next to a very bright point, relative to the light there", FLOAT64
    ),
    "local error next to further highlights": Cause(
        "largest error next to the bright points that are not added exactly, relative to the light there",
        FLOAT64,
    ),
    "kernel energy beyond the surroundings": Cause(
        "part of a point's light that falls farther than the transforms reach",
        "set a tolerance, or a smaller one",
    ),
    "depth, diffraction at edges": Cause(
        "edges of objects out of focus cut rays, without diffraction"
    ),
    "depth, if without layers": Cause("error of the alternative without layers"),
    "depth, if in layers": Cause("error of the alternative in layers"),
}
