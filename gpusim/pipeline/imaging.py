"""From a scene's samples to the electrons that its light makes, as a plan says."""

from dataclasses import replace

import numpy as np

from gpusim.backends import Device
from gpusim.domain.camera import Camera
from gpusim.domain.content import Picture
from gpusim.domain.errors import BadData
from gpusim.domain.view import View
from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.composite import composite
from gpusim.kernels.optics.distort import distort
from gpusim.kernels.optics.falloff import falloff
from gpusim.kernels.optics.far import far
from gpusim.kernels.optics.field import field, transfer
from gpusim.kernels.optics.mosaic import mosaic
from gpusim.kernels.optics.sample import sample
from gpusim.kernels.optics.splat import splat
from gpusim.kernels.optics.tiles import tiles
from gpusim.kernels.sensor.collect import collect
from gpusim.kernels.spectral.integrate import integrate
from gpusim.optics.geometry import view_nodes
from gpusim.optics.highlights import point_kernels
from gpusim.pipeline.cache import Kept
from gpusim.pipeline.reading import WHOLE, planes, store
from gpusim.pipeline.tables import LensTables
from gpusim.planner.plan import Plan


class Imaging:
    """The lens and the pixels of a camera on a device."""

    def __init__(self, camera: Camera, device: Device, kept: Kept):
        self.camera, self.device, self._kept = camera, device, kept
        self.tables = LensTables(camera, device, kept)

    def light(self, plan: Plan):
        """Planes of the scene's own wavelengths where the lens puts them, before any blur, shape (L, rows, cols)."""
        table = None if plan.content.is_spectral else plan.content.entry_spectra.T
        planes = self.planes(table, self.stored(plan.content))
        if not plan.is_placed:
            return planes
        view = plan.scene.view
        return self.placed(plan, planes, self.places(plan, view), plan.weights, view.zoom)

    def lights(self, plan: Plan) -> np.ndarray | None:
        """What every plane before the blur is in the light of each channel, (C, planes); None: planes are channels."""
        if plan.mix is None:
            return None

        def made():
            light = plan.weights @ plan.content.entry_spectra.T
            return (
                light
                if plan.table is None
                else np.linalg.lstsq(plan.table.T, light.T, rcond=None)[0].T
            )

        return self._kept("lights", (plan.weights, plan.table, plan.content.entry_spectra), made)

    def places(self, plan: Plan, view: View):
        """Where the lens and a view put the samples, for `placed`: an array of the device."""
        if view.is_plain and plan.distortion is not None:
            nodes = plan.distortion.nodes
        else:
            nodes = view_nodes(
                view,
                plan.distortion,
                self._seen(plan),
                plan.content.shape,
                plan.scene.samples_per_pixel,
            )
        return self.device.array(nodes[None])

    def placed(self, plan: Plan, planes, places, lights, zoom: float = 1.0):
        """Planes where the lens and the view put them.

        places: see `places`. lights: see `lights`. zoom: of the view.
        """
        device, border = self.device, self._border(plan)
        if plan.distortion is not None and plan.distortion.method == "area":
            return distort(planes, places, self._seen(plan), border, "area", zoom**2, device=device)
        light = (
            planes
            if lights is None
            else integrate(planes, lights.astype(np.float32), device=device)
        )
        return distort(planes, places, self._seen(plan), border, light=light, device=device)

    @staticmethod
    def _seen(plan):
        """Rows and columns that are seen: the frame's, and the margin's where there is blur to need it."""
        return plan.scene.samples if plan.mix is None else plan.content.shape

    def window(self, plan: Plan):
        """The scene's samples that are of use, along both axes: all, or the frame's alone."""
        margin = plan.scene.margin
        # without blur or distortion nothing outside the frame is needed
        inside = (
            slice(margin, -margin)
            if margin and plan.mix is None and not plan.is_placed
            else slice(None)
        )
        return inside, inside

    def stored(self, content, window=WHOLE):
        """A content's samples on the device, in a window if they come from the host: entries, and which each has."""
        curve = None
        if isinstance(content, Picture):
            curve = self._kept("curve", content.curve, lambda: self.device.array(content.curve))
        return store(self.device, content, window, curve)

    def planes(self, table, stored):
        """Planes of stored samples by a table (planes, entries), before the blur; the entries themselves if None."""
        return planes(self.device, table, stored)

    def rates(self, plan: Plan, planes=None):
        """Electrons per second, planes (1 or C, rows, cols), and the mosaic's pattern over these planes.

        planes: before the blur, where the lens and the view put them, if they are known.
        """
        device, cfa = self.device, self.camera.sensor.cfa_indices
        if plan.mix is None or (
            not plan.folded and (plan.highlights is None or plan.taps is not None)
        ):
            return self.channels(plan, planes), cfa
        planes = self._before(plan, planes)
        if plan.folded:
            rates = self._alike(plan, planes, cfa, self._border(plan), plan.scene.margin)
        else:
            rates = collect(
                self._blurred(plan, planes), cfa, 1.0, 0.0, device=device
            )  # the mosaic, for one second
        if plan.highlights is not None:
            rates = self._with_highlights(plan, rates, cfa)
        return device.reshape(rates, (1, *rates.shape)), np.zeros((1, 1), np.int32)

    def channels(self, plan: Plan, planes=None):
        """What every pixel would get in every channel, before any fall-off: electrons per second (C, rows, cols).

        planes: as for `rates`.
        """
        planes, margin = self._before(plan, planes), plan.scene.margin
        if plan.mix is None:
            if margin and not plan.is_placed and tuple(planes.shape[1:]) != plan.scene.samples:
                planes = self._inside(planes, margin)
            return self.pixels(plan, planes)
        channels = self._blurred(plan, planes)
        return self.pixels(
            plan,
            channels if plan.highlights is None else self._with_highlights(plan, channels, None),
        )

    def spectral(self, plan: Plan) -> Plan:
        """The plan whose channels are the wavelengths, each the irradiance [photon s-1 m-2 nm-1].

        Raises BadData for a blur that varies over the field: its kernels are those of the plan's planes.
        """
        if plan.varying is not None:
            raise BadData(
                f"irradiance of {plan.scene.name}: the blur of {self.camera.name} varies over the field; "
                'wanted optics that are the same all over the frame, or the output "electrons"'
            )
        nodes, optics = plan.scene.wavelengths, self.camera.optics
        scale = (
            plan.scene.illuminant.at(nodes)
            * optics.transmission_at(nodes)
            * optics.irradiance_factor
        )
        table = None if plan.content.is_spectral else plan.content.entry_spectra.T
        if plan.mix is None:
            weighted = np.diag(scale) if table is None else scale[:, None] * table
            return replace(plan, weights=np.diag(scale), table=weighted)
        return replace(
            plan,
            weights=np.diag(scale),
            mix=np.diag(scale / plan.flat),
            table=table,
            transfers=None,
            folded=False,
        )

    @staticmethod
    def _border(plan):
        return "edge" if plan.scene.border == "scene" else plan.scene.border

    def _before(self, plan, planes):
        """Planes before the blur where the lens and the view put them."""
        if planes is not None:
            return planes
        planes = self.planes(plan.table, self.stored(plan.content, self.window(plan)))
        if not plan.is_placed:
            return planes
        view = plan.scene.view
        return self.placed(plan, planes, self.places(plan, view), self.lights(plan), view.zoom)

    def _blurred(self, plan, planes):
        """The channels at the scene's samples; spare ones around them where pixels are made of several."""
        border = self._border(plan)
        if plan.depth is not None:
            rates = self._by_depth(plan, planes, border)
        else:
            # spare samples around the scene's own: the crop of the blur begins outside of them
            rates = self._alike(plan, planes, None, border, plan.scene.margin - plan.spare)
        return rates if plan.varying is None else self._with_field(plan, planes, rates, border)

    def _alike(self, plan, planes, cfa, border, margin):
        """The mosaic, or the channels (cfa None), where the blur is the same all over the frame."""
        inputs = planes, self.tables.transfer(plan), plan.mix
        if plan.tiling is not None:
            rates = tiles(
                *inputs,
                cfa,
                border,
                plan.tiling.side,
                plan.tiling.overlap,
                margin=margin,
                device=self.device,
            )
        elif cfa is not None:
            rates = mosaic(*inputs, cfa, border, plan.period, margin=margin, device=self.device)
        else:
            rates = blur(*inputs, border, plan.period, margin=margin, device=self.device)
        if plan.far is None:
            return rates
        return far(
            rates,
            planes,
            plan.far.weights(plan.mix, plan.transfers),
            plan.far.sigmas,
            cfa,
            plan.far.border,
            margin=margin,
            spacings=plan.far.spacings,
            device=self.device,
        )

    def _inside(self, planes, margin):
        """Planes without `margin` samples on each side: weights of 1 change no value."""
        starts = [
            margin + np.arange(size - 2 * margin, dtype=np.int32) for size in planes.shape[1:]
        ]
        weights = [np.ones((len(start), 1), np.float32) for start in starts]
        return sample(planes, starts[0], weights[0], starts[1], weights[1], device=self.device)

    def _by_depth(self, plan: Plan, planes, border):
        """The channels, each point blurred as its distance demands, nearer layers laid over farther ones.

        A layer's coverage is blurred in each channel by the kernel of white in the scene's light: that is what the
        channel sees of a wavelength's kernel. Things go on outside the frame even where no light comes from there.
        """
        depth, device, margin = plan.depth, self.device, plan.scene.margin - plan.spare
        assert depth is not None
        channels = len(plan.weights)
        lights, alphas, layers = [], [], []
        for layer in range(depth.layers):
            content, coverage, confusion = depth.sheet(layer, plan.content)
            own = (
                planes if content is plan.content else self.planes(plan.table, self.stored(content))
            )
            for kernel, share in depth.shares(coverage, confusion):
                tables, cover = self.tables.at_distance(plan, kernel)
                share = device.array(share[None])
                light = blur(
                    falloff(own, share, device=device),
                    tables,
                    plan.mix,
                    border,
                    plan.period,
                    margin=margin,
                    device=device,
                )
                alpha = blur(
                    share,
                    cover,
                    np.ones((channels, 1), np.float32),
                    "edge" if border == "zero" else border,
                    plan.period,
                    margin=margin,
                    device=device,
                )
                lights.append(light)
                alphas.append(alpha)
                layers.append(layer)
        return composite(device.stack(lights), device.stack(alphas), layers, device=device)

    def _with_field(self, plan: Plan, planes, rates, border):
        """The channels blurred as on the axis, with what the blur is more elsewhere."""
        assert plan.varying is not None
        varying = plan.varying
        inputs, tables = self._kept(
            "field",
            (varying.kernels, *varying.edges),
            lambda: (
                {
                    name: value
                    if name in ("edges", "index")
                    else self.device.array(value)  # those are read on the host
                    for name, value in varying.stage_inputs.items()
                },
                transfer(self.device, varying.kernels, varying.edges),
            ),
        )
        return field(
            planes,
            mix=plan.mix,
            border=border,
            margin=plan.scene.margin - plan.spare,
            base=rates,
            tables=tables,
            device=self.device,
            **inputs,
        )

    def pixels(self, plan: Plan, rates):
        """Channels at the pixels from channels at the scene's samples."""
        if plan.taps is None:
            return rates
        rows, cols = plan.taps
        return sample(rates, rows.start, rows.weights, cols.start, cols.weights, device=self.device)

    def _with_highlights(self, plan: Plan, rates, cfa):
        """The mosaic, or every channel of the samples, with the plan's highlights added."""
        lights, device = plan.highlights, self.device
        assert lights is not None
        reach = int(lights.reach.max())
        aperture, _ = self.tables.grid(plan.scene.samples_per_pixel)[
            1
        ]  # highlights are split off for squares only
        kernels = self._kept(
            "points", (plan.q, aperture, reach), lambda: point_kernels(plan.q, aperture, reach)
        )
        weights = lights.spectra[:, None] * (plan.weights / plan.flat)  # (kernels, channels, L)
        cores, profiles = (
            np.tensordot(weights, kernels.cores, 1),
            np.tensordot(weights, kernels.profiles, 1),
        )
        places = np.column_stack([lights.places + plan.spare, lights.light, lights.reach]).astype(
            np.int32
        )
        shape = kernels.step, kernels.parts, kernels.spread
        if cfa is None:
            return device.stack(
                [
                    splat(
                        device.part(rates, c),
                        np.zeros((1, 1), np.int32),
                        places,
                        lights.strength,
                        cores[:, [c]],
                        profiles[:, [c]],
                        *shape,
                        device=device,
                    )
                    for c in range(rates.shape[0])
                ]
            )
        return splat(
            rates,
            device.array(cfa, np.int32),
            device.array(places, np.int32),
            device.array(lights.strength),
            device.array(cores),
            device.array(profiles),
            *shape,
            device=device,
        )

    def exposed(self, plan: Plan, rates, exposure_time):
        """Mean electrons (rows, cols) or, of stacked pixels, (C, rows, cols)."""
        planes, cfa = rates
        if self.camera.sensor.stacked:
            return self.collected(plan, planes, exposure_time)
        return collect(
            self._dimmed(plan, planes), cfa, exposure_time, plan.slope, device=self.device
        )

    def collected(self, plan: Plan, channels, exposure_time):
        """Every channel (C, rows, cols) with its fall-off, times the exposure time [s]."""
        channels = self._dimmed(plan, channels)
        return self.device.stack(
            [
                collect(
                    channels,
                    np.full((1, 1), channel, np.int32),
                    exposure_time,
                    plan.slope,
                    device=self.device,
                )
                for channel in range(channels.shape[0])
            ]
        )

    def _dimmed(self, plan, planes):
        """Planes by what the light loses beyond the cos^4 law."""
        if plan.falloff is None:
            return planes
        return falloff(planes, self.device.array(plan.falloff[None]), device=self.device)
