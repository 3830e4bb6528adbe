"""The lens and the pixels of a camera: the steps of a plan from a scene's samples to mean electrons."""

from dataclasses import replace
from math import prod
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.domain.camera import Camera
from gpusim.domain.content import Content, Picture
from gpusim.domain.errors import BadData
from gpusim.domain.mosaics import bin_mosaic
from gpusim.kernels.common import fft
from gpusim.kernels.common.fft import pitch_of, room
from gpusim.kernels.optics.blur import BATCH, blur_spectra, transform
from gpusim.optics.coarse import CoarseGrid
from gpusim.optics.depth import DepthPlan
from gpusim.optics.farfield import axes, multiplications
from gpusim.optics.field import FieldBlur
from gpusim.optics.geometry import DistortionGrid
from gpusim.optics.highlights import (
    Highlights,
)
from gpusim.optics.kernel_space import KernelSpace
from gpusim.optics.lengths import Tiling
from gpusim.optics.lenses import lens_of, moved_apertures
from gpusim.pipeline.cache import Cache
from gpusim.pipeline.layers import composite_layers, prepare_layers
from gpusim.pipeline.light import (
    PLAIN_MOSAIC,
    add_far,
    add_field,
    add_highlights,
    as_one_plane,
    crop_margin,
    dim_planes,
    even_samples,
    make_depth_tables,
    make_field_tables,
    make_planes,
    make_point_kernels,
    make_shading,
    mix_lights,
    no_zoom,
    pass_on,
    place_layers,
    place_planes,
    place_samples,
    return_none,
    share_samples,
    store_content,
    zoom_of,
)
from gpusim.pipeline.reading import planes, store
from gpusim.pipeline.step import Chain, Rate, Step, Values
from gpusim.pipeline.tables import LensTables
from gpusim.planner.choices import Blur, Falloff, Fusion, Planes, Sampling, Sketch
from gpusim.planner.knobs.farfield import FarField
from gpusim.planner.plan import Plan

BY_SCIPY = "on a CPU SciPy's transforms are faster than the kernels'"


class Imaging:
    """The lens and the pixels of a camera on a device.

    Args:
        camera: The camera.
        device: Its device.
        cache: Cache of the lens's tables.
    """

    def __init__(self, camera: Camera, device: Device, cache: Cache):
        self.camera, self.device, self._cache = camera, device, cache
        self.tables = LensTables(camera, device, cache)

    def steps(self, plan: Plan) -> list[Step]:
        """Return the steps of a plan from the values "content" and "view" to the mean electrons "mean".

        Other steps make "per second" (mean electrons of one second), "channels" (electrons per second in each channel,
        (C, rows, cols), without fall-off), "electrons" (electrons of the exposure in each channel, with fall-off) and
        "shading".
        """
        build = _Steps(plan, self)
        rates, mosaic_of_planes = build.rates()
        return [
            *build.content(),
            *build.planes(),
            *rates,
            *build.exposure(mosaic_of_planes),
            *build.collect_channels("electrons"),
            *build.shading(),
        ]

    def irradiance_steps(self, plan: Plan) -> list[Step]:
        """Return the steps that make "irradiance" at each wavelength [photon s-1 m-2 nm-1].

        Raises BadData for a blur that varies over the field: its kernels exist for the plan's planes only.
        """
        build = _Steps(_plan_per_wavelength(plan, self.camera), self, "irradiance ")
        return [*build.planes(), *build.collect_channels("irradiance", exposure_time=1.0)]

    def values(self, plan: Plan, content: Content | None = None) -> Values:
        """Return the values of the plan's scene, or of another content of the same form."""
        values = Values({rate: Cache() for rate in Rate})
        values.use(self.steps(plan))
        values.give(content=plan.content if content is None else content, view=plan.scene.view)
        return values

    def light(self, plan: Plan) -> Any:
        """Return planes of the scene's wavelengths after distortion, before any blur, (L, rows, cols)."""
        table = None if plan.content.is_spectral else plan.content.entry_spectra.T
        content = store(self.device, plan.content)
        light = planes(self.device, table, content)
        if not plan.is_placed:
            return light
        view, grid = plan.scene.view, plan.find(DistortionGrid)
        nodes = place_samples(view, **_placing_constants(plan), device=self.device)
        by_area = grid is not None and grid.method == "area"
        gains = None
        if by_area and grid is not None and grid.is_even:
            gains = even_samples(view, **_placing_constants(plan), device=self.device)
        share, border = None, _border(plan)
        if not by_area:
            share = share_samples(light, plan.weights, border=border, device=self.device)
        return place_planes(
            light,
            nodes,
            share,
            view.zoom if by_area else 1.0,
            gains,
            seen=_visible_shape(plan),
            border=border,
            by_area=by_area,
            device=self.device,
        )


class _Steps:
    """Builds the steps of a plan. prefix: begins the names of their outputs."""

    def __init__(self, plan: Plan, imaging: Imaging, prefix: str = ""):
        self.plan, self.imaging, self.prefix = plan, imaging, prefix
        self.device, self.sensor = imaging.device, imaging.camera.sensor
        self.pixels = prod(plan.scene.shape)
        self.samples = prod(_visible_shape(plan) if plan.find(Blur) else plan.content.shape)
        self.seen, self.channels = prod(plan.scene.samples), len(plan.weights)
        self.blur, self.tiling, self.far = plan.find(Blur), plan.find(Tiling), plan.find(FarField)
        self.varying, self.depth = plan.find(FieldBlur), plan.find(DepthPlan)
        self.space = plan.find(KernelSpace)
        self.lights = plan.find(Highlights)
        self.grid, self.taps = plan.find(DistortionGrid), plan.find(Sampling)
        planes, fusion, falloff = plan.find(Planes), plan.find(Fusion), plan.find(Falloff)
        self.table = None if planes is None else planes.table
        self.transfers = None if fusion is None else fusion.transfers
        self.gains = None if falloff is None else falloff.gains
        self.flat_of_blur = None if falloff is None else falloff.field
        # samples around the frame's: the scene's margin, and what the lens displaces beyond
        self.margin = plan.scene.margin + (self.blur.rim if self.blur else 0)
        self.folded = self.blur is not None and self.blur.folded
        self.count = len(plan.content.entry_spectra if self.table is None else self.table)

    def words(self, stage):
        return self.plan.models.get(stage, "")

    def content(self) -> list[Step]:
        """Return the step that brings a content's samples to the device, as "entries"."""
        plan, content = self.plan, self.plan.content
        stage = "spectral.decode" if isinstance(content, Picture) else "spectral.illuminate"
        return [
            Step(
                "entries",
                stage,
                ("content",),
                {"window": _window(plan), "device": self.device},
                words=self.words(stage),
                # a picture's codes too
                nbytes=max(content.nbytes, plan.scene.content.nbytes),
                run=store_content,
            )
        ]

    def planes(self) -> list[Step]:
        """Return the steps from "entries" to "planes", the planes before the blur, and to the blur's tables."""
        plan, prefix = self.plan, self.prefix
        has_table = self.table is not None
        stage = "spectral.integrate" if plan.content.labels is None else "spectral.materials"
        chain = Chain("entries", f"{prefix}planes", Rate.SCENE, self.device)
        chain.add(
            stage,
            {"table": self.table},
            run=make_planes,
            words=self.words(stage),
            nbytes=4 * self.count * prod(plan.content.shape) * has_table,
            work=float(plan.content.nbytes + 4 * self.count * prod(plan.content.shape)) * has_table,
        )
        steps = []
        if plan.is_placed:
            by_area = self.grid is not None and self.grid.method == "area"
            channels = {
                "weights": plan.weights,
                "table": self.table,
                "spectra": plan.content.entry_spectra,
            }
            mixed = self.blur is not None and not by_area
            by_depth = self.depth is not None  # the layers' planes are placed one by one
            steps = [
                Step(
                    f"{prefix}lights",
                    "",
                    (),
                    channels if mixed else {},
                    run=mix_lights if mixed else return_none,
                ),
                Step(
                    f"{prefix}places",
                    "optics.distort" if by_depth else "",
                    ("view",),
                    {**_placing_constants(plan), "device": self.device},
                    words=self.words("optics.distort") if by_depth else "",
                    run=place_layers if by_depth else place_samples,
                ),
                Step(
                    f"{prefix}zoom",
                    "",
                    ("view",),
                    run=zoom_of if by_area else no_zoom,
                ),
            ]
            gains = []
            if by_area and self.grid is not None and self.grid.is_even:
                gains = [f"{prefix}evening"]
                constants = {**_placing_constants(plan), "device": self.device}
                steps.append(Step(gains[0], "", ("view",), constants, run=even_samples))
            # the channels' light, without and with their surroundings
            light = 1 if self.blur is None else 2
            if not by_depth:
                share = f"{prefix}share"
                border = {"border": _border(plan), "device": self.device}
                samples = Step(  # the same for all views of a scene
                    share,
                    "",
                    () if by_area else (chain.value, f"{prefix}lights"),
                    {} if by_area else border,
                    run=return_none if by_area else share_samples,
                )
                steps.append(samples)
                chain.add(
                    "optics.distort",
                    {"seen": _visible_shape(plan), "border": _border(plan), "by_area": by_area},
                    f"{prefix}places",
                    share,
                    f"{prefix}zoom",
                    *gains,
                    run=place_planes,
                    words=self.words("optics.distort"),
                    # and two maps
                    nbytes=4 * (self.count + light * self.channels + 2) * self.samples,
                    work=float((self.count + self.channels) * self.samples),
                )
        steps = [*steps, *chain.end()]
        if self.blur is not None and self.depth is None:
            host = "tables of another plan need a few numbers per wavelength"
            steps.append(
                Step(
                    f"{prefix}transfer",
                    "optics.near" if self.far is not None else "",
                    (),
                    {"plan": plan, "tables": self.imaging.tables},
                    words=self.words("optics.near"),
                    nbytes=self._bytes_of_tables(),
                    rate=Rate.CAMERA,
                    host=host,
                    run=LensTables.transfer_of,
                )
            )
        return steps

    def rates(self) -> tuple[list[Step], np.ndarray]:
        """Return the steps to "rates", electrons per second (1 or C, rows, cols), and the mosaic of these planes."""
        cfa = self.sensor.cfa_indices
        if self.blur is None or (
            not self.folded
            and (self.lights is None or self.taps is not None or self.sensor.stacked)
        ):
            return self.channels_to("rates"), cfa
        chain = Chain("planes", "rates", Rate.SCENE, self.device)
        if self.folded:
            self._add_uniform_blur(chain, cfa, self.margin)
        else:
            self._add_blur(chain)  # the mosaic, for one second
            chain.add(
                "sensor.collect",
                {"cfa": cfa, "exposure_time": 1.0, "slope": 0.0},
                nbytes=4 * self.pixels,
            )
        if self.lights is not None:
            self._add_highlights(chain, cfa)
        chain.add("", {}, run=as_one_plane)
        return chain.end(), PLAIN_MOSAIC

    def channels_to(self, name: str) -> list[Step]:
        """Return the steps from planes to the rates of each pixel in each channel, without fall-off."""
        plan = self.plan
        chain = Chain(f"{self.prefix}planes", name, Rate.SCENE, self.device)
        if self.blur is None:
            if plan.scene.margin and not plan.is_placed:
                chain.add(
                    "",
                    {"margin": plan.scene.margin, "samples": plan.scene.samples},
                    run=crop_margin,
                )
        else:
            self._add_blur(chain)
            if self.lights is not None:
                self._add_highlights(chain, None)
        if self.taps is not None:
            rows, cols = self.taps.rows, self.taps.cols
            chain.add(
                "optics.sample",
                {
                    "start_y": rows.start,
                    "weights_y": rows.weights,
                    "start_x": cols.start,
                    "weights_x": cols.weights,
                },
                words=self.words("optics.sample"),
                nbytes=4 * self.channels * self.pixels,
                work=float(self.samples * self.channels),
            )
        if not chain.steps:
            chain.add("", {}, run=pass_on)
        return chain.end()

    def _add_blur(self, chain):
        """Add the blur to channels at the scene's samples, with spare samples around them if pixels need several."""
        plan = self.plan
        planes_ = chain.value
        if self.depth is not None:
            assert self.space is not None
            # planes and results of each layer; terms, of one layer at a time, and tiles
            nbytes = 4 * self.depth.layers * self.samples * (self.count + 6 * self.channels)
            nbytes += 4 * self.samples * self.space.most_terms
            nbytes += self.space.bytes_of_tiles(2 * self.channels)
            is_even = self.grid is not None and self.grid.method == "area" and self.grid.is_even
            names = ("places", "lights", "zoom", "evening" if is_even else "")
            placed = [name and f"{self.prefix}{name}" for name in names if plan.is_placed]
            work = float(16 * self.depth.layers * (self.count + self.channels) * self.samples)
            if self.depth.occlusion is not None:
                sharp = 1 + (self.depth.occlusion.maps is not None)  # layers, and undisplaced
                nbytes += 4 * sharp * (self.channels + 1) * self.depth.layers * self.samples
                work += self.channels * self.depth.occlusion.work
            tables = f"{self.prefix}depth tables"
            constants = {
                "space": self.space,
                "covers": self.channels,
                "margin": self.plan.scene.margin - self.blur.spare,
                "device": self.device,
            }
            if self.space.coarse is not None:
                grid = CoarseGrid.of(self.plan.content.shape, self.blur.period)
                own = self.plan, self.space.reference, grid.period
                constants["on_axis"] = self.imaging.tables.made_at_distance(*own)
            chain.steps.append(
                Step(
                    tables,
                    "optics.field",
                    (),
                    constants,
                    words=self.words("optics.field"),
                    rate=Rate.CAMERA,
                    run=make_depth_tables,
                )
            )
            layers = f"{self.prefix}layers"
            constants = {"plan": plan, "device": self.device}
            places = placed[0] if placed else ""
            chain.steps.append(Step(layers, "", (places,), constants, run=prepare_layers))
            chain.add(
                "optics.composite",
                {"plan": plan, "tables": self.imaging.tables, "border": _border(plan)},
                layers,
                *(placed or [""] * len(names)),
                tables,
                run=composite_layers,
                words=self.words("optics.composite"),
                nbytes=nbytes + self._bytes_of_blur() + self._bytes_of_tables(),
                work=work,
                host="tables of each layer need a few numbers per wavelength"
                + (f"; {BY_SCIPY}" if self.device.on_host else ""),
            )
        else:
            # spare samples around the scene's own: the crop of the blur begins outside of them
            self._add_uniform_blur(chain, None, self.margin - self.blur.spare)
        if self.varying is not None:
            tables = self._add_field_tables(chain)
            chain.add(
                "optics.field",
                {
                    "mix": self.blur.mix,
                    "border": _border(plan),
                    "margin": self.margin - self.blur.spare,
                },
                planes_,
                tables,
                run=add_field,
                words=self.words("optics.field"),
                # planes times maps, spectra
                nbytes=self._bytes_of_varying(self.varying.bytes_of_tiles(self.channels)),
                work=float(self.count * self.varying.cost),
                host="if the blur varies, highlights are mixed on the host; on CPUs SciPy transforms the tiles",
            )

    def _bytes_of_varying(self, tiles):
        """Return the memory of the difference from the on-axis blur [byte]: maps as float64 and float32, results."""
        return (
            20 * self.samples * self.varying.convolutions + tiles + 4 * self.samples * self.channels
        )

    def _add_field_tables(self, chain):
        """Add the step that makes the tables of the difference from the on-axis blur. Return its name."""
        name = f"{self.prefix}field tables of {chain.value}"
        constants = {"varying": self.varying, "device": self.device}
        step = Step(name, "", (), constants, rate=Rate.CAMERA, run=make_field_tables)
        chain.steps.insert(0, step)
        return name

    def _add_uniform_blur(self, chain, cfa, margin):
        """Add a blur that is the same all over the frame: to the mosaic, or to channels if `cfa` is None."""
        plan, planes_ = self.plan, chain.value
        constants = {"mix": self.blur.mix, "border": _border(plan), "margin": margin}
        if self.tiling is not None:
            stage = "optics.tiles"
            constants |= {"cfa": cfa, "side": self.tiling.side, "overlap": self.tiling.overlap}
        elif cfa is not None:
            stage = "optics.mosaic"
            constants |= {"cfa": cfa, "period": plan.period}
        else:
            stage = "optics.blur"
            constants |= {"period": plan.period}
        inputs, run = [f"{self.prefix}transfer"], None
        if plan.find(Sketch) is not None:  # planes stay while a lens is turned
            around = {"border": constants.pop("border"), "period": plan.period}
            host = BY_SCIPY if self.device.on_host else ""
            chain.add(stage, around, run=transform, host=host)
            inputs, run = [planes_, *inputs], blur_sketch
        chain.add(
            stage,
            constants,
            *inputs,
            run=run,
            words=self.words(stage),
            nbytes=self._bytes_of_blur(),
            work=self._work_of_blur(stage, cfa),
            host=BY_SCIPY if self.device.on_host else "",
        )
        if self.far is not None:
            chain.add(
                "optics.far",
                {
                    "model": self.far,
                    "mix": self.blur.mix,
                    "transfers": self.transfers,
                    "cfa": cfa,
                    "margin": margin,
                },
                planes_,
                run=add_far,
                words=self.words("optics.far"),
                nbytes=self._bytes_of_far(),
                work=multiplications(
                    plan.content.shape,
                    self.count,
                    self.channels,
                    tuple(self.far.sigmas),
                    self.far.spacings,
                ),
            )

    def _add_highlights(self, chain, cfa):
        """Add the plan's highlights to the mosaic, or to each channel of the samples if `cfa` is None."""
        plan = self.plan
        lights = self.lights
        assert lights is not None
        across = np.minimum(2 * lights.reach, max(plan.content.shape))
        ratio, optics = plan.scene.samples_per_pixel, plan.camera.optics
        pitch, aperture = self.imaging.tables.grid(ratio)
        displacement = moved_apertures(optics, self.sensor.displacement, ratio)
        chain.steps.append(
            Step(
                "kernels of points",
                "",
                (),
                {
                    "optics": optics,
                    "pitch": pitch,
                    "aperture": aperture,
                    "shape": plan.scene.samples,
                    "displacement": displacement,
                    "q": plan.q,
                    "wavelengths": plan.scene.wavelengths,
                    "spots": lights.spots,
                    "core": lights.core,
                    "reach": int(lights.reach.max()),
                },
                rate=Rate.CAMERA,
                run=make_point_kernels,
            )
        )
        chain.add(
            "optics.splat",
            {
                "lights": lights,
                "spare": self.blur.spare,
                "weights": plan.weights / plan.flat,
                "cfa": cfa,
            },
            "kernels of points",
            run=add_highlights,
            words=self.words("optics.splat"),
            nbytes=4 * (self.seen if cfa is not None else self.channels * self.seen),
            work=float(np.square(across, dtype=np.float64).sum())
            * (1 if self.folded else self.channels),
        )

    def exposure(self, cfa: np.ndarray) -> list[Step]:
        """Return the steps from "rates" to mean electrons: "mean", and "per second" for automatic exposure."""
        dimming = Chain("rates", "dimmed", Rate.SCENE, self.device)
        self._add_falloff(dimming)
        found = list(dimming.steps)
        for name, seconds in (("per second", 1.0), ("mean", None)):
            chain = Chain(dimming.value, name, Rate.EXPOSURE, self.device)
            self._add_collection(chain, None if self.sensor.stacked else cfa, seconds)
            found += chain.end()
        return found

    def collect_channels(self, name: str, exposure_time: float | None = None) -> list[Step]:
        """Return the steps from planes to electrons in each channel, with fall-off, for an exposure time."""
        channels = f"channels of {name}" if self.prefix else "channels"
        chain = Chain(channels, name, Rate.EXPOSURE, self.device)
        self._add_falloff(chain)
        self._add_collection(chain, None, exposure_time)
        return [*self.channels_to(channels), *chain.end()]

    def _add_collection(self, chain, cfa, exposure_time):
        """Add the collection of electrons in each pixel's channel, or in all channels.

        cfa: None for all channels. exposure_time: None for the exposure's.
        """
        plan = self.plan
        layers = self.channels if cfa is None else 1
        is_folded = self.folded
        constants = {"slope": plan.slope, "cfa": cfa}
        if exposure_time is not None:
            constants["exposure_time"] = exposure_time
        chain.add(
            "sensor.collect",
            constants,
            numbers=("exposure_time",) if exposure_time is None else (),
            words=self.words("sensor.collect"),
            # mean electrons, and the mosaic of rates
            nbytes=4 * self.pixels * layers * (1 if is_folded else 2),
            work=float(self.pixels * layers),
        )

    def _add_falloff(self, chain):
        """Add the fall-off beyond the cos^4 law."""
        if self.gains is not None:
            chain.add(
                "optics.falloff",
                {"gains": self.gains},
                run=dim_planes,
                words=self.words("optics.falloff"),
                nbytes=4 * self.channels * self.pixels,
                work=float(self.pixels * self.channels),
            )

    def shading(self) -> list[Step]:
        """Return the step that makes the gains of the shading correction, for each pixel of the mosaic's period."""
        plan, sensor, imaging = self.plan, self.sensor, self.imaging
        if not imaging.camera.processor.corrects_shading:
            return [Step("shading", "", run=return_none)]
        stride, out = bin_mosaic(sensor.cfa_indices, sensor.binning)
        return [
            Step(
                "shading",
                "",
                (),
                {
                    "shape": plan.scene.shape,
                    "slope": plan.slope,
                    "falloff": self.gains,
                    "nodes": None if self.grid is None else self.grid.nodes,
                    # pixels around the frame that the distortion's nodes cover
                    "margin": self.margin / plan.scene.samples_per_pixel if self.blur else 0.0,
                    "field": self.flat_of_blur,
                    "binning": sensor.binning,
                    "stride": stride,
                    "by_charge": sensor.binning_mode == "charge",
                    "period": out.shape,
                    "device": self.device,
                },
                rate=Rate.CAMERA,
                run=make_shading,
            )
        ]

    def _bytes_of_table(self):
        """Return the memory of a transfer table: a quarter of real values, or half of complex values [byte]."""
        plan = self.plan
        lens = lens_of(self.plan.camera)
        is_real = lens.symmetry.is_round and not any(lens.displacement)
        rows, cols = plan.period
        return 4 * (1 if is_real else 4) * (rows // 2 + 1) * (cols // 2 + 1)

    def _bytes_of_tables(self):
        """Return the memory of the transfer tables of wavelengths and planes [byte]."""
        plan = self.plan
        combined = 0 if self.transfers is None else prod(self.transfers.shape[:2])
        return self._bytes_of_table() * (len(plan.q) + combined)

    def _bytes_of_blur(self):
        """Return the memory of a blur: spectra, their sums and the result [byte]."""
        plan, device, count, channels = self.plan, self.device, self.count, self.channels
        (rows, cols), (high, wide) = plan.content.shape, plan.period
        if self.tiling is not None:
            return self._bytes_of_tiles()
        by_host = device.on_host or room(max(plan.period)) > device.local_bytes
        spectrum = 8 * high * pitch_of(device, wide)
        batches = [min(BATCH, count - first) for first in range(0, count, BATCH)]
        if by_host:  # planes with their borders, and SciPy's spectra of one batch at a time
            forward = 4 * high * wide * sum(batches) + spectrum * batches[0]
        elif self.folded:
            forward = 8 * batches[0] * (high // 2 + 1) * (cols + cols % 2)
        else:
            forward = sum(batches) * (8 * rows * pitch_of(device, wide) + spectrum)
        if not self.folded:
            return forward + channels * (spectrum + 4 * high * wide + 4 * self.seen)
        cfa = self.sensor.cfa_indices
        phases = (
            8
            * cfa.size
            * (high // cfa.shape[0] // (1 if by_host else 2) + 1)
            * (wide // cfa.shape[1] // (2 if by_host else 1) + 1)
        )
        return forward + phases + (4 * high * wide if by_host else 0) + 4 * self.seen

    def _bytes_of_tiles(self):
        """Return the memory of a tiled blur [byte].

        That is the result, a tile's frequencies, and the spectra of all tiles if SciPy transforms them.
        """
        plan, device, count, channels = self.plan, self.device, self.count, self.channels
        side = self.tiling.side
        total = 4 * self.seen * (1 if self.folded else channels)
        if device.on_host and device.kind == "opencl":
            total += 4 * side * (side // 2 + 1) * (count + count % 2) * channels
        elif device.on_host:
            samples, half = self.tiling.samples(plan.scene.samples), side // 2 + 1
            phases = self.sensor.cfa_indices.shape if self.folded else (1, 1)
            high, wide = (side // n for n in phases)
            outputs = prod(phases) if self.folded else channels
            of_tile = count * (4 * side**2 + 8 * side * half) + outputs * high * (
                8 * (wide // 2 + 1) + 4 * wide
            )
            total += samples // side**2 * of_tile
        return total

    def _bytes_of_far(self):
        """Return the memory of the far field: splines, tables without it, and rates with it [byte]."""
        plan, device, count, channels = self.plan, self.device, self.count, self.channels
        shape = plan.content.shape
        down, across = axes(shape, self.far.sigmas, self.far.border, self.far.spacings)
        last, values = down.levels - 1, 0
        for level in range(down.levels):  # splines of the planes and of the channels
            high, wide = (axis.splines(level) for axis in (down, across))
            values += (count + channels) * high * wide
            if device.on_host:  # results between the two axes
                values += 2 * channels * high * wide * len(self.far.sigmas[down.of_level(level)])
            # intermediate results between two levels, both ways
            if device.on_host and level < last:
                values += (count + channels) * high * across.splines(level + 1)
        if device.on_host:
            values += count * down.splines(0) * shape[1]
            values += channels * plan.scene.samples[0] * across.splines(0)
        size = self._bytes_of_table() // 4
        tables = len(plan.q) if self.transfers is None else prod(self.transfers.shape[:2])
        return 4 * (values + tables * size + (1 if self.folded else channels) * self.seen)

    def _work_of_blur(self, stage, cfa):
        """Return the operations of the transforms and of the products of spectra."""
        plan, count, channels = self.plan, self.count, self.channels
        frequencies = plan.period[0] * (plan.period[1] // 2 + 1)
        products = 4 * frequencies * count * channels
        if stage == "optics.tiles":
            side, period = self.tiling.side, self.sensor.cfa_indices.shape
            phases, size = (
                (prod(period), [side // n for n in period])
                if self.folded
                else (channels, (side, side))
            )
            one = count * fft.operations((side, side)) + products
            tiles_ = self.tiling.samples(plan.scene.samples) / side**2
            return tiles_ * (one + phases * fft.operations(size))
        if stage == "optics.mosaic":
            parts = [length // n for length, n in zip(plan.period, cfa.shape, strict=True)]
            return count * fft.operations(plan.period) + products + cfa.size * fft.operations(parts)
        tables = 1 if self.transfers is None else len(self.transfers)
        return (count + channels) * fft.operations(plan.period) + frequencies * count * (
            2 * tables + 4 * channels
        )


def _plan_per_wavelength(plan: Plan, camera: Camera) -> Plan:
    """Return a plan with one channel per wavelength, its irradiance [photon s-1 m-2 nm-1]. Raises BadData."""
    blur = plan.find(Blur)
    if plan.find(FieldBlur):
        raise BadData(
            f"irradiance of {plan.scene.name}: the blur of {camera.name} varies over the field; "
            'use optics with the same blur in the whole frame, or the output "electrons"'
        )
    nodes, optics = plan.scene.wavelengths, camera.optics
    scale = (
        plan.scene.illuminant.at(nodes) * optics.transmission_at(nodes) * optics.irradiance_factor
    )
    table = None if plan.content.is_spectral else plan.content.entry_spectra.T
    if blur is None:
        table = np.diag(scale) if table is None else scale[:, None] * table
        return plan.exchange(Planes(table), weights=np.diag(scale))
    return plan.exchange(
        replace(blur, mix=np.diag(scale / plan.flat), folded=False),
        *(() if table is None else (Planes(table),)),
        without=(Planes, Fusion),
        weights=np.diag(scale),
    )


def blur_sketch(spectra, planes, tables, mix, period, margin, device):
    """Return the channels of a draft from the spectra of its planes."""
    return blur_spectra(spectra, tables, mix, planes.shape[1:], period, margin, device)


def _border(plan):
    return "edge" if plan.scene.border == "scene" else plan.scene.border


def _visible_shape(plan):
    """Return the rows and columns that contribute: the frame, with its margin and the blur's rim if there is one."""
    blur_ = plan.find(Blur)
    if blur_ is None:
        return plan.scene.samples
    rows, cols = plan.content.shape
    return rows + 2 * blur_.rim, cols + 2 * blur_.rim


def _window(plan):
    """Return the slices of the scene's samples that are needed: all, or the frame's only."""
    margin = plan.scene.margin
    # without blur or distortion nothing outside the frame is needed
    inside = (
        slice(margin, -margin)
        if margin and not plan.find(Blur) and not plan.is_placed
        else slice(None)
    )
    return inside, inside


def _placing_constants(plan):
    """Return the constants of `place_samples`."""
    return {
        "grid": plan.find(DistortionGrid),
        "seen": _visible_shape(plan),
        "shape": plan.content.shape,
        "ratio": plan.scene.samples_per_pixel,
    }
