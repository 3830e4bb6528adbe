"""The question to the planner, as numbers (`Question`), and the notes of its plan (`Notes`)."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from math import ceil

import numpy as np

from gpusim.data.weights import check_light, electrons_per_content
from gpusim.domain.account import SAFETY, Bound, Tolerance
from gpusim.domain.calibration import Framed
from gpusim.domain.camera import Camera
from gpusim.domain.content import Content
from gpusim.domain.distortion import Model, fit_to_frame
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.optics import Optics
from gpusim.domain.scene import IMAGE, Scene
from gpusim.domain.sensor import Sensor
from gpusim.optics.geometry import rim_of
from gpusim.optics.lens import Lens
from gpusim.optics.lenses import moved_apertures, open_lens
from gpusim.optics.panorama import lens_key
from gpusim.optics.tables import Caching, Tables
from gpusim.planner.facts import Facts
from gpusim.planner.probes import Probes

MOST_LIMIT = 1e3  # relative RMS error beyond which a limit is none
DECLARED = Bound()  # camera or scene declare the absence: leaving it out is no error


@dataclass(frozen=True, eq=False)
class Question:
    """A scene in front of a camera, checked.

    Attributes:
        scene: The scene.
        camera: The camera.
        facts: Of the content that goes through the blur: of the scene, or of the scene without its highlights.
        tolerance: See `gpusim.planner.plan.plan`. So are guaranteed, reach, period and cache.
        weights: Electrons per second in each channel for content 1 at each wavelength, shape (C, L).
        on_gpu: Whether a GPU computes the frame. Relative costs of its steps differ from a CPU's.
        least: Planes that a blur has at least; 0: the blur may be left out.
        limit: Relative RMS error allowed for what is not decided yet; None without a tolerance.
        optics: The camera's lens settings.
        sensor: The camera's sensor.
        content: The content that goes through the blur.
        ratio: Scene samples per pixel.
        pitch: Distance of the samples [m].
        rim: Samples around these that the lens displaces too, because a blur brings them in.
        size: Rows and columns of the blur's samples: the scene's, its margin, and the rim.
        corner: Distance of the frame's corner from the axis [sample].
        aperture: Height and width of a pixel's aperture [pixel].
        cell: Height and width over which blurred samples are integrated [sample].
        more: Samples beyond the frame that are seen because the pixels are displaced.
        light: Electrons per second in all channels together for content 1 at each wavelength, shape (L,).
        share: Part of the pixels that has each channel, shape (C,).
        q: Wavelength times working f-number over the distance of samples, shape (L,).
        distortion: The lens's, for this frame; None: it shows what a pinhole does.
        axis: Where the optical axis meets the sensor, from the frame's middle, (rows, cols) [pixel].
        lens: The lens in front of the scene's samples.
        is_blurred: Whether the lens blurs at all.
        moved: Displacement of the apertures from the samples [pixel] that the blur makes; else the taps do.
        tables: Transfer tables of the lens.
    """

    scene: Scene
    camera: Camera
    facts: Facts
    tolerance: Tolerance | None
    guaranteed: bool
    reach: int | None
    period: tuple[int, int] | None
    cache: Caching
    weights: np.ndarray
    on_gpu: bool = False
    least: int = 0
    limit: float | None = None
    optics: Optics = field(init=False)
    sensor: Sensor = field(init=False)
    content: Content = field(init=False)
    ratio: float = field(init=False)
    pitch: float = field(init=False)
    rim: int = field(init=False)
    size: tuple[int, int] = field(init=False)
    corner: float = field(init=False)
    aperture: tuple[float, float] = field(init=False)
    cell: tuple[float, float] = field(init=False)
    more: int = field(init=False)
    light: np.ndarray = field(init=False)
    share: np.ndarray = field(init=False)
    q: np.ndarray = field(init=False)
    distortion: Model | None = field(init=False)
    axis: tuple[float, float] = field(init=False)
    lens: Lens = field(init=False)
    is_blurred: bool = field(init=False)
    moved: tuple[float, float] = field(init=False)
    tables: Tables = field(init=False)

    def __post_init__(self):
        scene, optics, sensor = self.scene, self.camera.optics, self.camera.sensor
        (rows, cols), (height, width) = scene.samples, sensor.aperture
        ratio, channels = float(scene.samples_per_pixel), len(self.weights)
        pitch = sensor.pixel_pitch / ratio
        aperture = height / sensor.pixel_pitch, width / sensor.pixel_pitch
        if sensor.stacked:
            share = np.full(channels, 1 / channels)
        else:
            cfa = sensor.cfa_indices
            share = np.bincount(cfa.ravel(), minlength=channels) / cfa.size
        cell = aperture if ratio == 1 else (1.0, 1.0)
        distortion, axis = find_axis(optics, scene.shape, sensor.pixel_pitch)
        if scene.projection == IMAGE:  # its samples are displaced already
            distortion = None
        lens = open_lens(
            optics,
            pitch,
            cell,
            scene.samples,
            moved_apertures(optics, sensor.displacement, ratio),
            (ratio * axis[0], ratio * axis[1]),
        )
        rim = 0
        if (
            distortion is not None
            and not lens.is_pointlike
            and lens.is_uniform
            and scene.depth is None
        ):
            rim = rim_of(distortion, scene.content.shape, pitch)
        more = 2 * (scene.margin + rim)
        for name, value in {
            "optics": optics,
            "sensor": sensor,
            "content": self.facts.content,
            "ratio": ratio,
            "pitch": pitch,
            "rim": rim,
            "size": (rows + more, cols + more),
            "corner": float(np.hypot(rows, cols)) / 2,
            "aperture": aperture,
            "cell": cell,
            "more": ceil(ratio * max(map(abs, sensor.displacement))),
            "light": self.weights.sum(axis=0),
            "share": share,
            "q": scene.wavelengths * 1e-9 * optics.working_f_number / pitch,
            "distortion": distortion,
            "axis": axis,
            "lens": lens,
            "is_blurred": not lens.is_pointlike,
            "moved": lens.displacement,
            "tables": Tables(optics, sensor.pixel_pitch, self.cache),
        }.items():
            object.__setattr__(self, name, value)

    @classmethod
    def of(
        cls, scene: Scene, camera: Camera, facts: Facts, tolerance: Tolerance | None, **asked
    ) -> "Question":
        """Return the question that `plan` is called with.

        Raises:
            BadData, OutOfRange: The light does not fit the camera, no stage honours the
                displacement of the apertures.
        """
        weights = electrons_per_content(scene, camera, asked["cache"])
        check_light(scene, facts.samples.whole, camera)
        down, across = camera.sensor.displacement
        shown = f"{down:.6g}, {across:.6g} pixels"
        if abs(down) > max(1, scene.shape[0] / 4) or abs(across) > max(1, scene.shape[1] / 4):
            raise OutOfRange(
                "sensor.offset + sensor.centre",
                shown,
                "up to a quarter of the frame; or move the scene",
            )
        made = cls(scene, camera, facts, tolerance, **asked, weights=weights)
        if scene.projection == IMAGE and scene.image_of != lens_key(camera):
            raise BadData(
                f"{scene.name} is the image of another lens than {camera.name}'s: gs.view_panorama(panorama, camera)"
            )
        off_grid = max(abs(down - round(down)), abs(across - round(across)))
        if not made.is_blurred and made.ratio == 1 and off_grid > 1e-9:
            raise OutOfRange(
                "sensor.offset + sensor.centre",
                f"{shown}, with one scene sample per pixel and no blur",
                "whole pixels; or raise samples_per_pixel, or blur",
            )
        return made

    def without_blur(self) -> "Question":
        """Return the same question for a lens that does not blur."""
        return replace(self, camera=replace(self.camera, optics=self.optics.without_blur()))

    def with_limit(self, probes: Probes) -> "Question":
        """The same with the relative RMS error at which an error at edges breaks the tolerance."""
        assert self.tolerance is not None
        ratio = SAFETY * probes.local(1.0).ratio(self.tolerance)
        return replace(self, limit=1 / max(ratio, 1 / MOST_LIMIT))  # in the dark no error breaks it

    @cached_property
    def edges(self) -> np.ndarray:
        """Part that each wavelength has of the light of edges in each channel, shape (C, L)."""
        values, steps = self.facts.squares
        if self.scene.border == "zero":  # all around the frame is an edge to the dark
            steps = steps + values * sum(2 / n for n in self.size)
        light = self.weights * np.sqrt(np.maximum(steps, 0))
        return light / np.maximum(light.sum(axis=1, keepdims=True), 1e-300)

    @cached_property
    def mean_q(self) -> float:
        """Mean of q, as the sensor sees the wavelengths."""
        return float(np.average(self.q, weights=self.light))

    @cached_property
    def deviation(self) -> float:
        """Standard deviation of a Gaussian that is about as the lens and the pixel spread a point [sample].

        0.42 q: of that which is as the middle of an Airy pattern. For a disc, half the radius of rays, which keeps the
        root mean square, or in a frame that is smaller, 0.7 of it, which keeps the middle's density.
        """
        if not self.is_blurred:
            return 0.0
        share = 2 if 2 * self.spread > min(self.scene.samples) else 4
        return float(
            np.sqrt((0.42 * self.mean_q) ** 2 + self.spread**2 / share + (self.ratio**2 - 1) / 12)
        )

    @cached_property
    def spread(self) -> float:
        """Radius within which the rays of a point meet the image [sample], see `Lens.spread`."""
        return self.cache("spread", type(self.lens).spread, self.lens, self.scene.wavelengths)


def find_axis(
    optics: Optics, shape: tuple[int, int], pixel_pitch: float
) -> tuple[Model | None, tuple[float, float]]:
    """Return the lens's distortion for a frame, and where its axis meets it from the middle, (rows, cols) [pixel].

    shape: Rows and columns of the frame. pixel_pitch: [m].
    """
    if optics.distortion is None:
        return None, (0.0, 0.0)
    distortion = fit_to_frame(optics.distortion, shape, pixel_pitch)
    if not isinstance(distortion, Framed):
        return distortion, (0.0, 0.0)
    x, y = (distortion.radius / pixel_pitch * at for at in distortion.middle)
    return distortion, (y, x)


def displacement_suffix(displacement) -> str:
    """Return a suffix such as ", displaced by 0.5, 0 pixels", or "" without a displacement."""
    if not any(displacement):
        return ""
    return f", displaced by {displacement[0]:.4g}, {displacement[1]:.4g} pixels"


@dataclass
class Notes:
    """Notes of a plan about itself, in order.

    Attributes:
        models: Stage -> its model in words.
        left_out: Effects that are not modelled, in words.
        bounds: Named errors of the account.
        beside: Named errors that are reported but not in the account.
    """

    models: dict[str, str] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    bounds: dict[str, Bound] = field(default_factory=dict)
    beside: dict[str, float] = field(default_factory=dict)

    def leave_out(self, words: str, bound: Bound, name: str = "", *, of_scene: bool = False):
        """Leave an effect out, with a bound of its error.

        There is no other way to leave something out.

        Args:
            words: The effect.
            bound: DECLARED if camera or scene declare its absence; UNKNOWN if the error is not
                known: no tolerance is called met then.
            name: Of the error in the account; "": the words.
            of_scene: The scene does not hold it. The account is of the scene as it is given, so
                this error is reported next to the account.
        """
        size = "its error is not known"
        if bound.is_known:
            size = f"relative rms {bound.rms:.2g}, predicted"
        self.left_out.append(words if bound is DECLARED else f"{words}: {size}")
        if of_scene:
            self.beside[name or words] = bound.rms
        elif bound is not DECLARED:
            self.bounds[name or words] = bound
