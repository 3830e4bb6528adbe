"""Functions of the steps from a scene's samples to mean electrons: see `gpusim.pipeline.imaging`."""

from math import prod
from typing import Any

import numpy as np

from gpusim.color.shading import phase_gains, relative_response, shading_gains
from gpusim.domain.scene import View
from gpusim.kernels.optics.distort import distort, shares
from gpusim.kernels.optics.expand import expand
from gpusim.kernels.optics.falloff import falloff
from gpusim.kernels.optics.far import far
from gpusim.kernels.optics.field import field, transfer
from gpusim.kernels.optics.sample import sample
from gpusim.kernels.optics.splat import splat
from gpusim.kernels.sensor.bin import bin as bin_pixels
from gpusim.kernels.spectral.integrate import integrate
from gpusim.optics.coarse import split_tables
from gpusim.optics.expansion import choose_terms
from gpusim.optics.geometry import evening, view_nodes
from gpusim.optics.highlights import (
    PointKernels,
    has_airy_kernels,
    lens_kernels,
    mixed_kernels,
    point_kernels,
)
from gpusim.optics.kernel_space import KernelSpace
from gpusim.optics.lenses import open_lens
from gpusim.optics.placed import Placed
from gpusim.pipeline.reading import WHOLE, planes, store
from gpusim.pipeline.tables import tables_at_distance

PLAIN_MOSAIC = np.zeros((1, 1), np.int32)


def store_content(content, *, window=WHOLE, device) -> tuple:
    """Return a content's samples on the device: entries, and the label of each sample or None."""
    return store(device, content, window)


def make_planes(stored, *, table, device) -> Any:
    """Return planes of stored samples by a table (planes, entries), before the blur; the entries themselves if None."""
    return planes(device, table, stored)


def place_samples(view: View, **constants) -> Any:
    """Return the positions of the samples after the lens and a view, a device array for `place_planes`.

    constants: see `_placing_constants`, and the device.
    """
    device = constants.pop("device")
    return device.array(_place_nodes(view, **constants)[None])


def place_layers(view: View, *, shape, device, **constants) -> tuple:
    """Return the positions of light, and of coverage, which has no flux factor, for `optics.distort`.

    The third result finds the samples that parts of the frame take light from.
    """
    nodes = _place_nodes(view, shape=shape, **constants)
    cover = nodes.copy()
    cover[..., 2] = 1
    placed = Placed(nodes, shape, shape)
    return device.array(nodes[None]), device.array(cover[None]), placed


def _place_nodes(view, *, grid, seen, shape, ratio):
    """Return the grid of places of the samples after the lens and a view, see `optics.distort`."""
    if view.is_plain and grid is not None:
        return grid.nodes
    return view_nodes(view, grid, seen, shape, ratio)


def zoom_of(view: View) -> float:
    """Return the zoom of a view."""
    return view.zoom


def no_zoom(view: View) -> float:
    """Return 1: the positions include the zoom."""
    return 1.0


def mix_lights(*, weights, table, spectra) -> np.ndarray:
    """Return the weight of each plane before the blur in each channel, (C, planes)."""
    light = weights @ spectra.T
    return light if table is None else np.linalg.lstsq(table.T, light.T, rcond=None)[0].T


def even_samples(view: View, *, grid, seen, shape, ratio, device) -> Any:
    """Return the gains (1, rows, cols) that keep flat fields flat after `place_planes` by area."""
    return device.array(evening(view_nodes(view, grid, seen, shape, ratio), seen)[None])


def share_samples(planes_, lights, *, border, device) -> Any:
    """Return the part of each sample that cubics may interpolate. lights: see `mix_lights`, or None for channels."""
    if lights is None:
        return shares(device, planes_, border)
    return shares(device, integrate(planes_, lights.astype(np.float32), device=device), border)


def place_planes(planes_, places, share, zoom, gains=None, *, seen, border, by_area, device) -> Any:
    """Return planes distorted by the lens and the view.

    share: see `share_samples`; not used by area. gains: see `even_samples`.
    """
    if by_area and gains is not None:
        return falloff(
            distort(planes_, places, seen, border, "area", 1.0, device=device), gains, device=device
        )
    if by_area:
        return distort(planes_, places, seen, border, "area", zoom**2, device=device)
    return distort(planes_, places, seen, border, share=share, device=device)


def add_far(rates, planes_, *, model, mix, transfers, cfa, margin, device) -> Any:
    """Add the light from far away to rates. model: see `gpusim.planner.knobs.farfield.FarField`."""
    return far(
        rates,
        planes_,
        model.weights(mix, transfers),
        model.sigmas,
        cfa,
        model.border,
        margin=margin,
        spacings=model.spacings,
        device=device,
    )


def make_field_tables(*, varying, device) -> tuple:
    """Return the inputs of `optics.field` on the device, and its transfer tables."""
    inputs = _field_inputs(varying.stage_inputs, device)
    return inputs, transfer(device, varying.kernels, varying.edges)


def _field_inputs(inputs, device):
    """Return inputs of `optics.field`. Edges and indices are read on the host, the others are on the device."""
    return {
        name: value if name in ("edges", "index") else device.array(value)
        for name, value in inputs.items()
    }


def make_depth_tables(
    *, space: KernelSpace, covers: int, margin: int, on_axis: tuple | None = None, device
) -> tuple:
    """Return what a blur by depth takes from frame to frame.

    Returns:
        Kernels and transfer tables for `optics.field`, of the planes and of the coverage in each channel; the gains by
        which coverage of an even surface at the reference's distance remains 1, (C, rows, cols), or None; and transfer
        tables of the coarse grid, of planes and of coverage, or None. With these the last kernel is the near part of
        the kernel on the axis.

    on_axis: arguments of `tables_at_distance` for that kernel, but for the device; None: there is no coarse grid.
    """
    parts: list[dict] = []
    coarse: list | None = None
    if on_axis is not None:
        whole_tables, coarse = tables_at_distance(*(*on_axis, device)), []
    for k, some in enumerate((slice(None, -covers), slice(-covers, None))):
        own = np.ascontiguousarray(space.kernels[:, some], np.float32)
        if on_axis is not None and coarse is not None:
            split = device.numpy(whole_tables[k]), on_axis[1], own.shape[-1]
            near, far_tables = split_tables(*split)
            own = np.concatenate([own, near.reshape(1, *own.shape[1:])])
            coarse.append(device.array(far_tables))
        found = {"kernels": own, "tables": transfer(device, own, space.edges)}
        parts.append(found)
    parts[1]["sources"] = np.zeros(covers, np.int32)
    if not space.is_varying:
        return *parts, None, coarse
    rows, cols = (int(edge[-1]) - space.kernels.shape[-1] // 2 for edge in space.edges)
    circles = np.full((rows, cols), space.nodes[space.reference])
    whole = np.ones((rows, cols), np.float32)
    terms = choose_terms(space, circles, whole)
    even = device.array(np.stack([whole, 0 * whole]))
    maps = expand(even, terms.degrees, terms.spans, space.edges, terms.limits, device=device)
    flat = field(
        np.ones((1, rows, cols), np.float32),
        maps,
        index=terms.index,
        edges=space.edges,
        mix=np.eye(covers, dtype=np.float32),
        border="edge",
        margin=margin,
        device=device,
        **parts[1],
    )
    gains = (1 / (1 + np.asarray(device.numpy(flat), np.float64))).astype(np.float32)
    return *parts, device.array(gains), coarse


def add_field(rates, planes_, tables, *, mix, border, margin, device) -> Any:
    """Add the difference from the on-axis blur to channels blurred as on the axis."""
    inputs, kernels = tables
    return field(
        planes_,
        mix=mix,
        border=border,
        margin=margin,
        base=rates,
        tables=kernels,
        device=device,
        **inputs,
    )


def crop_margin(planes_, *, margin, samples, device) -> Any:
    """Return planes without the margin on each side, if they have it. Weights of 1 change no value."""
    if tuple(planes_.shape[1:]) == tuple(samples):
        return planes_
    starts = [margin + np.arange(size - 2 * margin, dtype=np.int32) for size in planes_.shape[1:]]
    weights = [np.ones((len(start), 1), np.float32) for start in starts]
    return sample(planes_, starts[0], weights[0], starts[1], weights[1], device=device)


def pass_on(planes_, *, device) -> Any:
    """Return the planes unchanged: they are the channels of the pixels."""
    return planes_


def as_one_plane(rates, *, device) -> Any:
    """Return a mosaic (rows, cols) as planes (1, rows, cols)."""
    return device.reshape(rates, (1, *rates.shape))


def make_point_kernels(
    *, optics, pitch, aperture, shape, displacement, q, wavelengths, spots, core, reach
) -> PointKernels:
    """Return the kernels of points behind a lens: see `gpusim.optics.highlights`."""
    lens = open_lens(optics, pitch, aperture, shape, displacement)
    if has_airy_kernels(lens) and not spots.any():
        return point_kernels(q, aperture[0], reach)
    return lens_kernels(lens, wavelengths, spots, core, reach)


def add_highlights(rates, kernels, *, lights, spare, weights, cfa, device) -> Any:
    """Add highlights to the mosaic, or to each channel of the samples. weights: of the wavelengths, (C, L)."""
    index, made = mixed_kernels(kernels, lights, weights)
    places = np.column_stack([lights.places + spare, index, lights.reach]).astype(np.int32)
    by_channel = ("cores", "profiles", "streaks", "corners")
    if cfa is None:
        return device.stack(
            [
                splat(
                    device.part(rates, c),
                    PLAIN_MOSAIC,
                    places,
                    lights.strength,
                    **{
                        name: value[:, [c]] if name in by_channel else value
                        for name, value in made.items()
                    },
                    device=device,
                )
                for c in range(rates.shape[0])
            ]
        )
    made = {
        name: device.array(value) if isinstance(value, np.ndarray) else value
        for name, value in made.items()
    }
    return splat(
        rates,
        device.array(cfa, np.int32),
        device.array(places, np.int32),
        device.array(lights.strength),
        **made,
        device=device,
    )


def dim_planes(planes_, *, gains, device) -> Any:
    """Return planes times a gain of each pixel (rows, cols)."""
    return falloff(planes_, device.array(gains[None]), device=device)


def return_none() -> None:
    """Return None, for a value that this camera does not use."""


def make_shading(
    *, shape, slope, falloff, nodes, margin, field, binning, stride, by_charge, period, device
) -> np.ndarray:
    """Return the gains of the shading correction for each pixel of the mosaic's period, see `processor.shade`."""
    response = relative_response(shape, slope, falloff, nodes, margin, field)
    if binning == (1, 1):
        return shading_gains(response, period[0] * period[1])
    flat = device.array(response)
    charge = bin_pixels(flat, binning=binning, stride=stride, average=False, device=device)
    response = np.array(device.numpy(charge), np.float32)
    if not by_charge:
        response /= np.float32(prod(binning))
    return phase_gains(response, period)[0]
