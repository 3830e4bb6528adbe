"""Frames of a shaken camera merged by kernel regression of their raw samples."""

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real

import numpy as np

from gpusim.backends import Device
from gpusim.captures.alignment import align_frames
from gpusim.domain.errors import OutOfRange
from gpusim.kernels.processor.align import TILE, align
from gpusim.kernels.processor.average import average
from gpusim.kernels.processor.levels import MOST_BALANCE
from gpusim.kernels.processor.regress import ENLARGES, regress
from gpusim.kernels.processor.trust import trust
from gpusim.pipeline.frame import Frame

STILL = 0.1  # [pixel] RMS distance to whole periods below which frames are not interpolated
SPARSE = 0.25  # mean squared distance to samples, over that of one frame, up to which they need no demosaicking
LEAST_LIGHT = 0.25  # of the longest exposure's, from which on a frame's samples count for that
PEDESTAL, SPAN, TOP = 3000, 58_000, 65_535  # black, range and full number of demosaicked frames
MIXED = 1  # [pixel] reach of full pixels in demosaicked frames
USUAL = 0.98  # of the full rate, at which searched values are clipped
SEARCHED = 60_000  # largest number that is searched
# stages and their lines in the report
ALIGNED = {
    "processor.align": "tiles of 16 x 16 periods of the mosaic, by a pyramid",
    "processor.refine": "the camera's movement, by gradients, and tiles that depart from it",
    "processor.trust": "blocks that noise does not explain are left out",
}
Develop = Callable[[np.ndarray], np.ndarray]


@dataclass
class Views:
    """Frames of one view, displaced against each other.

    Args:
        device: The device.
        layers: Digital numbers of all frames, uint16 (layers, frames, rows, cols): one layer of a
            mosaic, or one per channel of stacked pixels.
        reference: Number of the frame that stays in place.
        cfa: Channel of each pixel in one period of the mosaic; of stacked pixels one pixel.
        table: Numbers of each frame, see `processor.refine`; rates are in e- s-1.
        lines: Share of the variance in the dark that whole rows or columns have in common.
    """

    device: Device
    layers: np.ndarray
    reference: int
    cfa: np.ndarray
    table: np.ndarray
    lines: float = 0.0

    def __post_init__(self):
        """Keep the numbers of a layer that shows most light, on the device, at least one tile large."""
        brightest = int(np.argmax([layer.mean() for layer in self.layers]))
        layer, period = self.layers[brightest], self.cfa.shape
        size = min(layer.shape[-2] // period[0], layer.shape[-1] // period[1])
        self.small = 0 < size < TILE
        self.searched = fill_tile(layer, period) if self.small else layer
        self.stack = self.device.array(np.ascontiguousarray(layer), np.uint16)

    def search(self) -> np.ndarray:
        """Return displacements [period] found by comparing tiles, (frames, tiles_y, tiles_x, 2).

        Frames of different exposure are compared in pairs, as rates up to the lower of both full
        ones.
        """
        options = {"period": self.cfa.shape, "device": self.device}
        dark, scale, _, _, full = self.table
        if np.ptp(scale) <= 1e-6 * scale[0]:
            stack = self.device.array(np.ascontiguousarray(self.searched), np.uint16)
            return np.array(self.device.numpy(align(stack, reference=self.reference, **options)))
        rates = [
            np.maximum(layer - np.float32(d), 0) * np.float32(s)
            for layer, d, s in zip(self.searched, dark, scale, strict=True)
        ]
        limits, found = (full - dark) * scale * USUAL, []
        for i, rate in enumerate(rates):
            limit = min(limits[i], limits[self.reference])
            pair = np.minimum([rates[self.reference], rate], limit) * (SEARCHED / limit)
            pair = self.device.array(np.rint(pair).astype(np.uint16), np.uint16)
            found.append(self.device.numpy(align(pair, **options))[1])
        return np.stack(found)

    def align(self) -> np.ndarray:
        """Return displacements [period] to hundredths of a pixel, (frames, tiles_y, tiles_x, 2).

        Frames smaller than a tile are displaced by whole periods.
        """
        searched = self.search()
        if self.small:
            return np.rint(searched)
        return align_frames(
            self.device,
            self.stack,
            searched,
            reference=self.reference,
            period=self.cfa.shape,
            table=self.table,
            lines=self.lines,
        )

    def trust(self, displacement: np.ndarray, last: int | None = None) -> np.ndarray:
        """Return the trust in each frame at each block: the least of all layers. See `processor.trust`."""
        found = [
            trust(
                self.device.array(np.ascontiguousarray(layer), np.uint16),
                displacement,
                reference=self.reference,
                last=last,
                period=self.cfa.shape,
                table=self.table,
                device=self.device,
            )
            for layer in self.layers
        ]
        return np.min([self.device.numpy(one) for one in found], axis=0)

    def is_whole(self, displacement: np.ndarray) -> bool:
        """Return whether frames are displaced by whole periods of the mosaic, 0 for a camera at rest."""
        off = (displacement - np.rint(displacement)) * np.array(self.cfa.shape)
        return bool(np.sqrt((off**2).sum(axis=-1).mean()) < STILL)

    def has_samples(self, displacement: np.ndarray) -> bool:
        """Return whether samples of all channels fall on so many fractions of a pixel that they need no demosaicking.

        Places must on average be much nearer to a sample of each channel than in one frame. Frames
        that collect less than a quarter of the light of another are not looked at.
        """
        exposure = self.table[3].min() / self.table[3]  # of inverse variances in the dark: squared
        moves = (displacement * np.array(self.cfa.shape))[exposure >= LEAST_LIGHT**2]
        one = _squared_distance(self.cfa, np.zeros((1, 1, 2)))
        return _squared_distance(self.cfa, moves.reshape(len(moves), -1, 2)) <= SPARSE * one

    def move(self, raw: np.ndarray, displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return numbers moved onto the reference by whole periods, and where a frame has no part in them.

        A frame has no part outside its borders, and where it shows something else: its trust is
        below a half.

        Args:
            raw: Digital numbers of all frames, (frames, ..., rows, cols).
            displacement: Displacements [period], of `align`.

        Returns:
            Numbers, like `raw`, and bool (frames, rows, cols).
        """
        (py, px), (rows, cols) = self.cfa.shape, raw.shape[-2:]
        whole = np.rint(displacement)
        missing = self.trust(whole.astype(np.float32)) < 0.5
        missing = missing.repeat(py, axis=1).repeat(px, axis=2)[:, :rows, :cols]
        tile = [
            np.minimum(np.arange(size) // length // TILE, count - 1)
            for size, length, count in zip((rows, cols), (py, px), whole.shape[1:3], strict=True)
        ]
        found = np.empty_like(raw)
        for values, numbers, moves, gone in zip(
            found, raw, whole.astype(int), missing, strict=True
        ):
            by = moves[np.ix_(*tile)]
            y = np.arange(rows)[:, None] + by[..., 0] * py
            x = np.arange(cols) + by[..., 1] * px
            gone |= (y < 0) | (y >= rows) | (x < 0) | (x >= cols)
            values[...] = numbers[..., y.clip(0, rows - 1), x.clip(0, cols - 1)]
        return found, missing

    def average(self, displacement, noise, black_level: float) -> np.ndarray:
        """Return mean numbers [DN] of all layers, float32 (layers, rows, cols), see `processor.average`."""
        means = [
            average(
                self.device.array(np.ascontiguousarray(layer), np.uint16),
                displacement,
                reference=self.reference,
                period=self.cfa.shape,
                noise=noise,
                black_level=black_level,
                device=self.device,
            )
            for layer in self.layers
        ]
        return np.stack([np.array(self.device.numpy(mean)) for mean in means])

    def merge(
        self, displacement, white: np.ndarray, develop: Develop, enlarge: float = 1.0
    ) -> tuple[np.ndarray, str]:
        """Return rates [e- s-1] of all channels, float32 (C, rows, cols), and what was fitted.

        Raw samples are fitted if `has_samples`, else the frames after demosaicking.

        Args:
            displacement: Displacements [period], of `align`.
            white: Rates of white in each channel [e- s-1].
            develop: Function that demosaicks digital numbers (rows, cols) to digital numbers, float
                (C, rows, cols).
            enlarge: Places per pixel along rows and columns.
        """
        dark, scale, *_, full = self.table
        trusted = self.trust(displacement, int(np.argmax((full - dark) * scale)))
        balance = 1 / np.maximum(white, white.max() / MOST_BALANCE)
        options = {"reference": self.reference, "enlarge": enlarge, "device": self.device}
        if len(self.layers) > 1 or self.has_samples(displacement):
            own = balance[:, None] if len(self.layers) > 1 else balance[None]
            planes = [
                regress(
                    self.device.array(np.ascontiguousarray(layer), np.uint16),
                    *(displacement, trusted),
                    **{"cfa": self.cfa, "table": self.table, "balance": factors, **options},
                )
                for layer, factors in zip(self.layers, own, strict=True)
            ]
            return self._join(planes), "raw samples"
        stacks, table = self._develop(develop)
        (py, px), shape = self.cfa.shape, stacks.shape[-2:]
        each = trusted.repeat(py, axis=1).repeat(px, axis=2)[:, : shape[0], : shape[1]]
        moves = _retile(displacement, self.cfa.shape, shape)
        planes = [
            regress(
                self.device.array(stack, np.uint16),
                *(moves, np.ascontiguousarray(each)),
                cfa=np.zeros((1, 1), np.int32),
                table=table,
                balance=factor[None],
                **options,
            )
            for stack, factor in zip(stacks, balance, strict=True)
        ]
        return self._join(planes), "demosaicked frames"

    def _join(self, planes) -> np.ndarray:
        """Return planes of the device as one array of the host."""
        return np.concatenate([np.array(self.device.numpy(plane)) for plane in planes])

    def _develop(self, develop):
        """Return demosaicked numbers uint16 (C, frames, rows, cols) and their table for `regress`."""
        from scipy.ndimage import maximum_filter

        table = self.table.copy()
        dark, scale, _, _, full = self.table
        most, found = self.layers[0].max(axis=(1, 2)) + 1.0, []
        for i, mosaic in enumerate(self.layers[0]):
            parts = (develop(mosaic) - dark[i]) / (most[i] - dark[i])
            numbers = np.rint(np.clip(PEDESTAL + SPAN * parts, 0, TOP - 1)).astype(np.uint16)
            # demosaicking has mixed full pixels into their neighbours
            numbers[:, maximum_filter(mosaic >= full[i], 2 * MIXED + 1)] = TOP
            found.append(numbers)
        table[0], table[4] = PEDESTAL, TOP
        table[1] = (most - dark) * scale / SPAN
        return np.ascontiguousarray(np.stack(found, axis=1)), table


def is_demosaicked(frame: Frame) -> bool:
    """Return whether a frame is developed from camera values of each pixel, and not by filters of a table."""
    return frame.camera.processor.table is None


def check_enlargement(enlarge: float) -> None:
    """Raise OutOfRange unless a picture can have so many pixels per pixel of the camera."""
    low, high = ENLARGES
    if not (isinstance(enlarge, Real) and low <= enlarge <= high):
        raise OutOfRange("enlarge", enlarge, f"{low:g} .. {high:g}")


def fill_tile(layer, period):
    """Return frames (n, rows, cols) in which the outermost periods repeat, up to one tile at least."""
    places = []
    for size, length in zip(layer.shape[-2:], period, strict=True):
        whole = max(size // length, 1)
        at = np.arange(max(size, TILE * length))
        last = np.minimum(at // length, whole - 1) * length + at % length
        places.append(np.where(at < size, at, last))
    rows, cols = places
    return np.ascontiguousarray(layer[:, rows[:, None], cols])


def _squared_distance(cfa, moves):
    """Return the mean squared distance of places to the nearest sample of a channel [pixel^2].

    moves: displacements [pixel] of frames at some tiles, (frames, tiles, 2).
    """
    period = np.array(cfa.shape)
    places = np.stack(np.meshgrid(*map(np.arange, period), indexing="ij"), axis=-1).reshape(-1, 2)
    means = []
    for channel in np.unique(cfa):
        samples = np.argwhere(cfa == channel)
        # places, frames, tiles, samples
        off = places[:, None, None, None] + moves[None, :, :, None] - samples
        off -= np.rint(off / period) * period
        means.append((off**2).sum(axis=-1).min(axis=(1, 3)).mean())
    return float(np.mean(means))


def _retile(displacement, period, shape):
    """Return displacements [pixel] of tiles of 16 x 16 pixels from those [period] of tiles of 16 x 16 periods."""
    found = displacement * np.array(period, np.float32)
    for axis, (size, length) in enumerate(zip(shape, period, strict=True), 1):
        count = found.shape[axis]
        at = (np.arange(max(1, -(-size // TILE))) + 0.5) / length - 0.5
        if count == 1:
            found = found.repeat(len(at), axis=axis)
            continue
        first = np.clip(np.floor(at).astype(int), 0, count - 2)
        part = np.expand_dims(at - first, tuple(range(1, found.ndim - axis)))
        found = found.take(first, axis) * (1 - part) + found.take(first + 1, axis) * part
    return np.ascontiguousarray(found, np.float32)
