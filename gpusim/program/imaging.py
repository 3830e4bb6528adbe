"""From a scene's samples to the electrons that its light makes, as a plan says."""

from dataclasses import replace

import numpy as np

from gpusim.backends import Device
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.domain.foreign import type_of
from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.composite import composite
from gpusim.kernels.optics.distort import distort
from gpusim.kernels.optics.falloff import falloff
from gpusim.kernels.optics.field import field, transfer
from gpusim.kernels.optics.mosaic import mosaic
from gpusim.kernels.optics.nearfar import nearfar
from gpusim.kernels.optics.sample import sample
from gpusim.kernels.optics.splat import splat
from gpusim.kernels.sensor.collect import collect
from gpusim.kernels.spectral.integrate import integrate
from gpusim.kernels.spectral.materials import materials
from gpusim.kernels.spectral.widen import widen
from gpusim.planner.highlights import point_kernels
from gpusim.planner.plan import Plan
from gpusim.program.kept import Kept
from gpusim.program.tables import LensTables

WHOLE = (slice(None), slice(None))


class Imaging:
    """The lens and the pixels of a camera on a device."""

    def __init__(self, camera: Camera, device: Device, kept: Kept):
        self.camera, self.device, self._kept = camera, device, kept
        self.tables = LensTables(camera, device, kept)

    def light(self, made: Plan):
        """Planes of the scene's own wavelengths where the lens puts them, before any blur, shape (L, rows, cols)."""
        table = None if made.content.is_spectral else made.content.entry_spectra.T
        return self._distorted(made, self.planes(table, self.stored(made.content)))

    def _distorted(self, made: Plan, planes):
        """Planes as the distortion puts them."""
        if made.distortion is None:
            return planes
        shape = made.scene.samples if made.mix is None else planes.shape[1:]
        border = "edge" if made.scene.border == "scene" else made.scene.border
        return distort(planes, made.distortion.nodes[None].astype(np.float32), shape, border, made.distortion.method,
                       device=self.device)

    def window(self, made: Plan):
        """The scene's samples that are of use, along both axes: all, or the frame's alone."""
        margin = made.scene.margin
        # without blur or distortion nothing outside the frame is needed
        inside = slice(margin, -margin or None) if made.mix is None and made.distortion is None else slice(None)
        return inside, inside

    def stored(self, content, window=WHOLE):
        """A content's samples on the device, in a window if they come from the host: entries, and which each has."""
        device = self.device

        def cut(name):
            array = getattr(content, name)
            array = array[(..., *window)] if isinstance(array, np.ndarray) else array
            return device.samples(array, content.stored_type(name))

        *labels, planes = [cut(name) for name in content.samples]
        return planes, labels[0] if labels else None

    def planes(self, table, stored):
        """Planes of stored samples by a table (planes, entries), before the blur; the entries themselves if None."""
        entries, ids = stored
        if ids is not None:
            return materials(ids, entries, self.device.array(table), device=self.device)
        if table is None:
            return widen(entries, device=self.device) if type_of(entries) == np.float16 else entries
        return integrate(entries, self.device.array(table), device=self.device)

    def rates(self, made: Plan, planes=None):
        """Electrons per second, planes (1 or C, rows, cols), and the mosaic's pattern over these planes.

        planes: of the scene, before the blur, where they are known.
        """
        device, cfa = self.device, self.camera.sensor.cfa_indices
        if made.mix is None or (not made.folded and (made.highlights is None or made.taps is not None)):
            return self.channels(made, planes), cfa
        planes = self._before(made, planes)
        if made.folded:
            rates = mosaic(planes, self.tables.transfer(made), made.mix, cfa, self._border(made), made.period,
                           margin=made.scene.margin, device=device)
        else:
            rates = collect(self._blurred(made, planes), cfa, 1.0, 0.0, device=device)  # the mosaic, for one second
        if made.highlights is not None:
            rates = self._with_highlights(made, rates, cfa)
        return device.reshape(rates, (1, *rates.shape)), np.zeros((1, 1), np.int32)

    def channels(self, made: Plan, planes=None):
        """What every pixel would get in every channel, before any fall-off: electrons per second (C, rows, cols).

        planes: as for `rates`.
        """
        planes, margin = self._before(made, planes), made.scene.margin
        if made.mix is None:
            if margin and made.distortion is None and tuple(planes.shape[1:]) != made.scene.samples:
                planes = self._inside(planes, margin)
            return self.pixels(made, planes)
        channels = self._blurred(made, planes)
        return self.pixels(made, channels if made.highlights is None else self._with_highlights(made, channels, None))

    def spectral(self, made: Plan) -> Plan:
        """The plan whose channels are the wavelengths, each the irradiance [photon s-1 m-2 nm-1].

        Raises BadData for a blur that varies over the field: its kernels are those of the plan's planes.
        """
        if made.varying is not None:
            raise BadData(f"irradiance of {made.scene.name}: the blur of {self.camera.name} varies over the field; "
                          'wanted optics that are the same all over the frame, or the output "electrons"')
        nodes, optics = made.scene.wavelengths, self.camera.optics
        scale = made.scene.illuminant.at(nodes) * optics.transmission_at(nodes) * optics.irradiance_factor
        table = None if made.content.is_spectral else made.content.entry_spectra.T
        if made.mix is None:
            weighted = np.diag(scale) if table is None else scale[:, None] * table
            return replace(made, weights=np.diag(scale), table=weighted)
        return replace(made, weights=np.diag(scale), mix=np.diag(scale / made.flat), table=table, transfers=None,
                       folded=False)

    @staticmethod
    def _border(made):
        return "edge" if made.scene.border == "scene" else made.scene.border

    def _before(self, made, planes):
        """Planes before the blur where the lens puts them."""
        if planes is None:
            planes = self.planes(made.table, self.stored(made.content, self.window(made)))
        return self._distorted(made, planes)

    def _blurred(self, made, planes):
        """The channels at the scene's samples; spare ones around them where pixels are made of several."""
        device, border, margin = self.device, self._border(made), made.scene.margin
        # spare samples around the scene's own: the crop of the blur begins outside of them
        if made.fft_free:
            rates = nearfar(planes, self.tables.levels(made), made.mix, border, device=device)
            if margin:
                rates = self._inside(rates, margin)
        elif made.depth is None:
            rates = blur(planes, self.tables.transfer(made), made.mix, border, made.period,
                         margin=margin - made.spare, device=device)
        else:
            rates = self._by_depth(made, planes, border)
        return rates if made.varying is None else self._with_field(made, planes, rates, border)

    def _inside(self, planes, margin):
        """Planes without `margin` samples on each side: weights of 1 change no value."""
        starts = [margin + np.arange(size - 2 * margin, dtype=np.int32) for size in planes.shape[1:]]
        weights = [np.ones((len(start), 1), np.float32) for start in starts]
        return sample(planes, starts[0], weights[0], starts[1], weights[1], device=self.device)

    def _by_depth(self, made: Plan, planes, border):
        """The channels, each point blurred as its distance demands, nearer layers laid over farther ones.

        A layer's coverage is blurred in each channel by the kernel of white in the scene's light: that is what the
        channel sees of a wavelength's kernel. Things go on outside the frame even where no light comes from there.
        """
        depth, device, margin = made.depth, self.device, made.scene.margin - made.spare
        assert depth is not None
        channels = len(made.weights)
        white = made.weights / np.maximum(made.weights.sum(axis=1, keepdims=True), 1e-300)
        lights, alphas, layers = [], [], []
        for layer in range(depth.layers):
            content, coverage, confusion = depth.sheet(layer, made.content)
            own = planes if content is made.content else self.planes(made.table, self.stored(content))
            for kernel, share in depth.shares(coverage, confusion):
                bands = self.tables.all_bands(made, depth.distances[kernel])
                share = device.array(share[None])
                light = blur(falloff(own, share, device=device), self.tables.combined(made, bands), made.mix, border,
                             made.period, margin=margin, device=device)
                cover = integrate(bands, device.array(white), device=device)
                cover = device.reshape(cover, (channels, 1, *bands.shape[1:]))
                alpha = blur(share, cover, np.ones((channels, 1), np.float32), "edge" if border == "zero" else border,
                             made.period, margin=margin, device=device)
                lights.append(light)
                alphas.append(alpha)
                layers.append(layer)
        return composite(device.stack(lights), device.stack(alphas), layers, device=device)

    def _with_field(self, made: Plan, planes, rates, border):
        """The channels blurred as on the axis, with what the blur is more elsewhere."""
        assert made.varying is not None
        varying = made.varying
        inputs, tables = self._kept("field", (varying.kernels, *varying.edges), lambda: (
            {name: value if name in ("edges", "index") else self.device.array(value)  # those are read on the host
             for name, value in varying.stage_inputs.items()},
            transfer(self.device, varying.kernels, varying.edges)))
        return field(planes, mix=made.mix, border=border, margin=made.scene.margin - made.spare, base=rates,
                     tables=tables, device=self.device, **inputs)

    def pixels(self, made: Plan, rates):
        """Channels at the pixels from channels at the scene's samples."""
        if made.taps is None:
            return rates
        rows, cols = made.taps
        return sample(rates, rows.start, rows.weights, cols.start, cols.weights, device=self.device)

    def _with_highlights(self, made: Plan, rates, cfa):
        """The mosaic, or every channel of the samples, with the plan's highlights added."""
        lights, device = made.highlights, self.device
        assert lights is not None
        reach = int(lights.reach.max())
        aperture, _ = self.tables.grid(made.scene.samples_per_pixel)[1]  # highlights are split off for squares only
        kernels = self._kept("points", (made.q, aperture, reach), lambda: point_kernels(made.q, aperture, reach))
        weights = lights.spectra[:, None] * (made.weights / made.flat)  # (kernels, channels, L)
        cores, profiles = np.tensordot(weights, kernels.cores, 1), np.tensordot(weights, kernels.profiles, 1)
        places = np.column_stack([lights.places + made.spare, lights.light, lights.reach]).astype(np.int32)
        shape = kernels.step, kernels.parts, kernels.spread
        if cfa is None:
            return device.stack([splat(device.part(rates, c), np.zeros((1, 1), np.int32), places, lights.strength,
                                       cores[:, [c]], profiles[:, [c]], *shape, device=device)
                                 for c in range(rates.shape[0])])
        return splat(rates, device.array(cfa, np.int32), device.array(places, np.int32),
                     device.array(lights.strength), device.array(cores), device.array(profiles), *shape, device=device)

    def exposed(self, made: Plan, rates, exposure_time):
        """Mean electrons (rows, cols) or, of stacked pixels, (C, rows, cols)."""
        planes, cfa = rates
        if self.camera.sensor.stacked:
            return self.collected(made, planes, exposure_time)
        return collect(self._dimmed(made, planes), cfa, exposure_time, made.slope, device=self.device)

    def collected(self, made: Plan, channels, exposure_time):
        """Every channel (C, rows, cols) with its fall-off, times the exposure time [s]."""
        channels = self._dimmed(made, channels)
        return self.device.stack([collect(channels, np.full((1, 1), channel, np.int32), exposure_time, made.slope,
                                          device=self.device) for channel in range(channels.shape[0])])

    def _dimmed(self, made, planes):
        """Planes by what the light loses beyond the cos^4 law."""
        if made.falloff is None:
            return planes
        return falloff(planes, self.device.array(made.falloff[None]), device=self.device)
