"""Numbers that the planner reads from a scene's pixels, each once."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from gpusim.domain.content import Content
from gpusim.domain.scene import Scene
from gpusim.optics.depth import flatten
from gpusim.optics.fusion import Spectra, row_pairs
from gpusim.optics.sampling import Moments, moments
from gpusim.optics.windows import take_windows
from gpusim.planner.window_light import Taken

# times the mean of all pairs' light from which on a pair of rows is looked at for certain
MUCH = 16
MOST_BRIGHT = 32  # such pairs
PLAIN = (str, bytes, int, float, tuple)


class Samples(Protocol):
    """Reads the samples of a content, which may be on a device: see `gpusim.pipeline.reading.Reading`."""

    def rows(self, chosen) -> Content:
        """Whole rows of the samples, int (n,), in host memory."""

    def windows(self, rows, cols) -> Content:
        """Windows of the samples, rows (n, h) and cols (n, w), int: arrays (..., n, h, w) in host memory, all new."""

    def brightness(self, total) -> np.ndarray:
        """Sums over wavelength by `total` (L,): float32 (rows, cols), a new array."""

    def mix(self, chosen, table) -> np.ndarray | None:
        """Sums of entries by `table` (P, entries) in whole rows, int (n,): float32 (P, n, cols).

        None: the host computes them from the rows.
        """

    def squares(self, upper, level: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Mean squares of each wavelength in rows, int (n,), and of its differences to the neighbours below and right.

        Shape (n, L), or None: the host computes them from the rows. level: about the root of such a square.
        """

    def taken(self, rows, cols) -> Taken | None:
        """The windows of `windows`, SIDE samples a side, on a device; None: the host has them."""

    def whole(self) -> Content:
        """All samples, in host memory; of a picture they may be its codes."""


@dataclass(frozen=True, eq=False)
class OnHost:
    """Reads the samples of a content in host memory."""

    content: Content

    def rows(self, chosen) -> Content:
        """See `Samples`."""
        return self.content.take(chosen)

    def windows(self, rows, cols) -> Content:
        """See `Samples`."""

        def taken(array):
            return np.moveaxis(take_windows(array, rows, cols), 0, -3)

        return self.content.on_host().with_samples(taken)

    def brightness(self, total) -> np.ndarray:
        """See `Samples`."""
        return self.content.brightness(total)

    def mix(self, chosen, table) -> None:
        """See `Samples`."""

    def squares(self, upper, level: float) -> None:
        """See `Samples`."""

    def taken(self, rows, cols) -> None:
        """See `Samples`."""

    def whole(self) -> Content:
        """See `Samples`."""
        return self.content


class Facts:
    """Facts of a content and, if it is known, of the distance of its samples [m].

    Args:
        content: The content.
        depth: Distance of every sample [m], or None.
        samples: Reads the content's samples; by default they are in host memory.
    """

    def __init__(
        self, content: Content, depth: np.ndarray | None = None, samples: Samples | None = None
    ):
        self.content, self.depth, self.samples = content, depth, samples or OnHost(content)
        self._brightness: tuple[bytes, np.ndarray] | None = None
        self._channels: tuple[bytes, np.ndarray] | None = None
        self._held: dict[str, tuple[tuple, Any]] = {}

    def hold(self, name: str, key: tuple, make: Callable[[], Any]) -> Any:
        """Return `make()`, which depends only on the content and the key; the last result of a name is kept.

        Arrays and settings in the key are equal only if they are the same object. Threads may share facts.
        """
        found = self._held.get(name)
        if found is None or not all(map(_is_same, found[0], key)):
            found = self._held[name] = key, make()
        return found[1]

    @classmethod
    def of(cls, scene: Scene) -> "Facts":
        """Return the facts of the picture that a scene shows."""
        if not (scene.content.is_seen and all(layer.content.is_seen for layer in scene.layers)):
            layers = tuple(
                replace(layer, content=layer.content.on_host()) for layer in scene.layers
            )
            # which looks at the values
            scene = replace(scene, content=scene.content.on_host(), layers=layers)
        return cls(*flatten(scene))

    @cached_property
    def _rows(self):
        """Upper rows of the pairs, int (n,), and their weights, 1 in the mean."""
        first = row_pairs(*self.content.shape)
        if self._brightness is None:
            return first, np.ones(len(first))
        return with_bright_rows(first, self._brightness[1])

    @property
    def _both_rows(self):
        """Both rows of the pairs, one after the other, int (2 n,)."""
        upper = self._rows[0]
        lower = np.minimum(upper + 1, self.content.shape[0] - 1)
        return np.stack([upper, lower], axis=1).ravel()

    @cached_property
    def pairs(self) -> Content:
        """Pairs of neighbouring rows, one above the other, in host memory.

        Evenly spaced ones, and those few that hold much of the light, if the brightness was looked at before.
        """
        return self.samples.rows(self._both_rows)

    @cached_property
    def spectra(self) -> Spectra:
        """Second moments of the spectra and of their differences between neighbours."""
        return Spectra.of_pairs(self.pairs, self._rows[1])

    @cached_property
    def squares(self) -> tuple[np.ndarray, np.ndarray]:
        """Diagonals of the moments `spectra`: of the values, and of the differences, shape (L,) each.

        A device computes them, if it has the samples, without the moments.
        """
        found = None
        if "spectra" not in self.__dict__ and self._brightness is not None:
            total, light = np.frombuffer(self._brightness[0]), self._brightness[1]
            level = float(light.max(initial=0)) / max(float(np.abs(total).sum()), 1e-300)
            found = self.samples.squares(self._rows[0], level)
        if found is None:
            return np.diag(self.spectra.values), np.diag(self.spectra.differences)
        weight = self._rows[1] / len(self._rows[1])
        return weight @ found[0], weight @ found[1]

    def brightness(self, total) -> np.ndarray:
        """Sums over wavelength by `total` (L,): float32 (rows, cols), not to be written to."""
        key, found = total.tobytes(), self._brightness
        if found is None or found[0] != key:
            found = self._brightness = key, self.samples.brightness(total)
        return found[1]

    def is_read_again(self, samples: Samples) -> bool:
        """Return whether samples give the same brightness and pairs of rows as those of these facts, as far as read."""
        if self._brightness is None:
            return False
        key, known = self._brightness
        if not np.array_equal(samples.brightness(np.frombuffer(key)), known):
            return False
        pairs = samples.rows(self._both_rows)
        return all(
            np.array_equal(getattr(pairs, name), getattr(self.pairs, name))
            for name in pairs.samples
        )

    def channels(self, weights) -> np.ndarray:
        """Return the pairs in channels of `weights` (C, L): float64 (C, rows, cols), good to float32."""
        key, found = weights.tobytes(), self._channels
        if found is None or found[0] != key:
            table = (weights @ self.content.entry_spectra.T).astype(np.float32)
            mixed = None
            if "pairs" not in self.__dict__:
                mixed = self.samples.mix(self._both_rows, table)
            if mixed is None:
                mixed = self.pairs.mix(table)
            found = self._channels = key, mixed.astype(np.float64)
        return found[1]

    def moments(self, weights) -> Moments:
        """Moments of the channels `weights` (C, L)."""
        return self.hold(
            "moments",
            (weights.tobytes(),),
            lambda: moments(self.pairs, self.channels(weights), self._rows[1]),
        )


def _is_same(a, b):
    """Return True if two parts of a key are equal, or the same object if they are no numbers or texts."""
    return a is b or (isinstance(a, PLAIN) and isinstance(b, PLAIN) and bool(a == b))


def with_bright_rows(first, brightness) -> tuple[np.ndarray, np.ndarray]:
    """Upper rows of pairs with those added that hold much of the light, and weights of all, 1 in the mean.

    first: evenly spaced upper rows, int (n,). brightness: (rows, cols). A star in the dark lies between the even rows,
    or counts for several of them. A pair that holds much stands for itself, the others for the rest.
    """
    rows = len(brightness)
    even = np.ones(len(first))
    if len(first) >= rows - 1:
        return first, even
    # float64: no square of float32 overflows
    squares = np.einsum("ij,ij->i", brightness, brightness, dtype=np.float64)
    squares /= max(squares.max(), 1e-300)
    light = squares[:-1] + squares[1:]
    bright = np.argsort(light, kind="stable")[::-1][:MOST_BRIGHT]
    bright = bright[light[bright] > MUCH * light.mean()]
    if not len(bright):
        return first, even
    others = np.setdiff1d(first, bright)
    chosen = np.union1d(first, bright)
    weight = np.where(np.isin(chosen, bright), 1.0, (rows - 1 - len(bright)) / max(len(others), 1))
    return chosen, weight * (len(chosen) / weight.sum())


@dataclass(frozen=True)
class Operation:
    """Operation of a camera.

    Attributes:
        seconds: Exposure time, times the brightness of the scene's light [s].
        size: Root mean square of the mosaic [e- s-1].
        noise: Variance of the read noise [e-2].
    """

    seconds: float
    size: float
    noise: float

    @property
    def level(self) -> float:
        """Electrons of the frame's root mean square."""
        return max(self.seconds * self.size, 1e-30)
