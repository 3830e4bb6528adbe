"""Training of filters that are chosen on a first picture, on photographs, for any mosaic.

Frames are as in `gpusim.apps.l3.photographs`: encoded pictures without noise, linear light with
noise. Every second picture also counts blurred, every third one in more vivid colours. Channels of
mosaics that have others than red, green and blue are those of the built-in phone in D65: sums of
the photograph's channels, and electrons in these shares. Photographs do not tell the near infrared:
it is another random mean of red, green and blue in each of them. The first
filters are one least squares for each noise level and position; the second ones one for each orbit
of positions and classes, with a ridge towards the filter of all classes (Lansel & Wandell 2011).
Both keep flat fields of any colour.
"""

import datetime
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gpusim import __version__
from gpusim.apps.l3.channels import channel_mix
from gpusim.apps.l3.fit import solve_ridge
from gpusim.apps.l3.photographs import (
    BLURRED,
    READ,
    blur_planes,
    decode_srgb,
    electron_code,
    encode_srgb,
    read_rgb,
    sample_mosaic,
)
from gpusim.data.charts import chart
from gpusim.domain.guided import (
    FINEST,
    FINEST_FIRST,
    GuidedTable,
    MosaicCode,
    Orbits,
    diamond,
    round_filters,
    steps_of,
    tap_colors,
)
from gpusim.domain.mosaics import symmetries
from gpusim.io.camera.guided import write_guided
from gpusim.kernels.processor.guided_ref import (
    WAYS,
    classify,
    codes_of,
    contrast,
    first_picture,
    light_of,
    terms_of,
)
from gpusim.kernels.processor.learned_ref import positions

BLURS = (0.0, 0.8, 2.0)  # standard deviations of copies [pixel]
NOISY_BLUR = 0.8  # the largest of frames with noise
SATURATION = 2.0  # of the colours of further copies
NOISE = (0.0, 0.006, 0.017, 0.045, 0.12)  # of the code, relative to white
BOX = 2  # as in `GuidedTable`
EVERY = 4  # of so many photographs one counts for the bounds
FLOOR = 0.15  # quantile of the contrasts
LEAST_FLOOR = 0.5 / 255  # of white
RIDGE, FIRST_RIDGE = 1e-5, 1e-6  # of the mean variance of a term
SIZE = 352  # rows and columns of a photograph that are used
CHARTS, EDGE = 8, 0.4  # charts, and the standard deviation of their edges [pixel]
BORDER = 12  # pixels that do not count, beside repeated ones
GRID = np.geomspace(1e-5, 2.0, 400)  # contrasts of the histogram, relative to white


@dataclass(frozen=True)
class Choices:
    """Sizes of a table: radii as in `GuidedTable`, bounds of the classes, the step of the filters.

    Attributes: ratios, diagonals, shares: as in `GuidedTable`. quantiles: of the contrasts of all
    photographs, the bounds of the strengths. step: the second filters are multiples of it.
    """

    radii: tuple[int, int, int] = (5, 4, 2)
    ratios: tuple[int, ...] = (10, 16, 32)
    diagonals: tuple[int, ...] = (13,)
    shares: tuple[int, ...] = (3, 7)
    quantiles: tuple[float, ...] = (0.4, 0.7, 0.9)
    step: int = 1


COARSE = Choices(ratios=(12,), shares=(), quantiles=(0.5, 0.8), step=32)
FEW = (0.0, 0.012, 0.04, 0.12)  # noise levels of a small table


def start_table(mosaic, choices, noise) -> GuidedTable:
    """Return the table that training starts with: values of some sample of each channel."""
    radii, quantiles = choices.radii, choices.quantiles
    directions = 2 * len(choices.ratios) + 1, 2 * len(choices.diagonals) + 1
    kinds = *directions, len(choices.shares) + 1, len(quantiles) + 1
    orbits = Orbits(mosaic, kinds, radii[1:])
    taps = list(map(diamond, radii))
    colors = tap_colors(mosaic, taps[0])
    count = colors.shape[-1]
    first = np.zeros((len(noise), len(colors), count, len(taps[0])), int)
    some = np.argmax(colors, axis=1)[None, ..., None]
    np.put_along_axis(first, np.broadcast_to(some, (*first.shape[:3], 1)), FINEST_FIRST, -1)
    second = np.zeros((len(noise), orbits.count, count, len(taps[1]) + count * len(taps[2])), int)
    for c in range(count):
        second[:, :, c, len(taps[1]) + c * len(taps[2])] = FINEST
    strengths = np.tile(np.arange(1.0, 1 + len(quantiles)), (len(noise), 1))
    floor = np.full(len(noise), LEAST_FLOOR)
    return GuidedTable(
        mosaic=tuple(mosaic),
        radii=radii,
        box=BOX,
        ratios=np.array(choices.ratios),
        diagonals=np.array(choices.diagonals),
        shares=np.array(choices.shares),
        noise=np.array(noise),
        floor=floor,
        strengths=strengths,
        first=first,
        second=second,
    )


class Training:
    """Sums of all photographs: first those of the first filters, then the others.

    Args:
        mosaic: One period, a text per row.
        choices: Sizes of the table.
        noise: Noise levels, as in `GuidedTable`.
        seed: Seed of the noise.
        blurs: Standard deviations of the copies, the first 0 for the photograph itself [pixel].
    """

    def __init__(self, mosaic, choices=Choices(), noise=NOISE, seed=1, blurs=BLURS):
        self.mosaic, self.noise, self.seed, self.blurs = mosaic, noise, seed, blurs
        self.choices = choices
        self.table = blank = start_table(mosaic, choices, noise)
        self.mix, self.response = channel_mix(mosaic)
        levels, taps, channels = len(noise), len(diamond(choices.radii[0])), len(blank.channels)
        self.first = (
            np.zeros((levels, blank.positions, taps, taps)),
            np.zeros((levels, blank.positions, taps, channels)),
        )
        count, terms = blank.orbits.count, blank.second.shape[-1]
        self.second = (
            np.zeros((levels, count, terms, terms)),
            np.zeros((levels, count, terms, channels)),
        )
        self.histogram = np.zeros((levels, len(GRID) + 1))

    def frames(self, photograph, number):
        """Yield the frames of a photograph: raw, wanted (C, rows, cols), code, noise level, weight."""
        random = np.random.default_rng((self.seed, number))
        encoded = np.moveaxis(np.asarray(photograph, float), 2, 0) / 255
        mix = self.mix.copy()
        for at in np.flatnonzero(np.array(self.table.channels) == "N"):
            mix[at] = random.dirichlet((1, 1, 1))
        copies = [(blur, 1.0) for blur in (self.blurs if number % 2 == 0 else self.blurs[:1])]
        if number % 3 == 1:
            copies.append((self.blurs[0], SATURATION))
        for blur, saturation in copies:
            grey = encoded.mean(axis=0)
            vivid = np.clip(grey + saturation * (encoded - grey), 0, 1)
            soft = np.tensordot(mix, blur_planes(decode_srgb(vivid), blur), 1)
            weight = BLURRED if blur else 1.0
            for level, sigma in enumerate(self.noise):
                if sigma == 0:
                    wanted = encode_srgb(soft)
                    raw = self._sample(255 * wanted)
                    code = MosaicCode("linear", 0.0, 1 / 255, mosaic=self.mosaic)
                    yield raw, wanted, code, level, weight
                elif blur <= NOISY_BLUR:
                    code = self._code(sigma)
                    electrons = soft * self.response[:, None, None] / code.scale
                    raw = random.poisson(self._sample(electrons))
                    raw = raw + random.normal(0, READ, raw.shape)
                    own = np.array([code.factors[letter] for letter in self.table.channels])
                    wanted = code.encode(electrons) * own[:, None, None] / code.white
                    yield raw, wanted, code, level, weight

    def _sample(self, planes):
        return sample_mosaic(planes, self.mosaic, self.table.channels)

    def _code(self, sigma):
        """Return the code of electrons of noise `sigma`, balanced."""
        letters = self.table.channels
        balances = dict(zip(letters, (1 / self.response).tolist(), strict=True))
        mean = np.mean([balances[letter] for letter in "".join(self.mosaic)])
        plain = electron_code(sigma / np.sqrt(mean))
        return MosaicCode(
            "root",
            0.0,
            plain.scale,
            plain.noise,
            mosaic=self.mosaic,
            balances=tuple(balances.items()),
        )

    def add_first(self, photograph, number):
        """Count a photograph for the first filters."""
        for raw, wanted, code, level, weight in self.frames(photograph, number):
            whole = codes_of(raw, code, self.table, (0, 0)) / (steps_of(code) * code.white)
            reach, inner = sum(self.table.reach), self.table.radii[0]
            rows, cols = raw.shape
            places, t = self._inside(raw, wanted)
            some = [np.flatnonzero(places == p) for p in range(self.table.positions)]
            order = np.concatenate(some)
            s = [
                whole[dy : dy + rows, dx : dx + cols][BORDER:-BORDER, BORDER:-BORDER].ravel()[order]
                for dy, dx in diamond(inner) + reach
            ]
            s, t, start = np.array(s, np.float32), t[order], 0
            for p, numbers in enumerate(some):
                part = np.s_[start : start + len(numbers)]
                start += len(numbers)
                self.first[0][level, p] += weight * (s[:, part] @ s[:, part].T)
                self.first[1][level, p] += weight * (s[:, part] @ t[part])

    def _inside(self, raw, wanted):
        inside = np.s_[BORDER : raw.shape[0] - BORDER, BORDER : raw.shape[1] - BORDER]
        places = positions(self.table, raw.shape)[inside].ravel()
        return places, wanted[:, *inside].reshape(len(wanted), -1).T.astype(np.float32)

    def solve_first(self):
        """Solve for the first filters."""
        colors = self.table.colors(0)
        out = np.zeros(self.table.first.shape)
        for level, p in np.ndindex(out.shape[:2]):
            a, b = (part[level, p] for part in self.first)
            unit = FIRST_RIDGE * np.trace(a) / len(a)
            out[level, p] = solve_ridge(a, b, unit, None, (colors[p].T, np.eye(colors.shape[-1]))).T
        shared = average_places(out * FINEST_FIRST, self.mosaic)
        self.table = replace(self.table, first=round_filters(shared, colors))

    def _pictures(self, raw, code, level):
        whole = codes_of(raw, code, self.table, (0, 0))
        return whole, first_picture(whole, self.table.first[level], self.table, (0, 0))

    def add_contrasts(self, photograph, number):
        """Count a photograph for the bounds of strengths, one of EVERY."""
        if number % EVERY:
            return
        for raw, _, code, level, weight in self.frames(photograph, number):
            _, pictures = self._pictures(raw, code, level)
            light = light_of(pictures, self.table)
            across, down = (contrast(light, self.table, *way) for way in WAYS[:2])
            unit = 2 * self.table.lights * steps_of(code) * code.white * (2 * BOX + 1) ** 2
            found = np.searchsorted(GRID, (across + down).ravel() / unit)
            self.histogram[level] += weight * np.bincount(found, minlength=len(GRID) + 1)

    def solve_bounds(self):
        """Find the floor and the bounds of strengths of every noise level."""
        parts = np.cumsum(self.histogram, axis=1) / self.histogram.sum(axis=1, keepdims=True)
        bounds = np.array(
            [np.interp((FLOOR, *self.choices.quantiles), part[: len(GRID)], GRID) for part in parts]
        )
        floor = np.maximum(bounds[:, 0], LEAST_FLOOR)
        self.table = replace(self.table, floor=floor, strengths=bounds[:, 1:])

    def add_second(self, photograph, number):
        """Count a photograph for the second filters."""
        orbits = self.table.orbits
        for raw, wanted, code, level, weight in self.frames(photograph, number):
            whole, pictures = self._pictures(raw, code, level)
            found = classify(
                pictures, code, self.table, self.table.floor[level], self.table.strengths[level]
            )
            places, t = self._inside(raw, wanted)
            cells = places * orbits.classes + found[BORDER:-BORDER, BORDER:-BORDER].ravel()
            order = np.argsort(cells, kind="stable")
            edges = np.searchsorted(cells[order], np.arange(len(orbits.of) + 1))
            unit = np.float32(1 / (steps_of(code) * code.white))
            terms = terms_of(whole, pictures, self.table)
            terms = [term[BORDER:-BORDER, BORDER:-BORDER].ravel()[order] for term in terms]
            left, right = np.array(terms, np.float32) * unit, t[order]
            for cell in np.flatnonzero(np.diff(edges)):
                some = np.s_[edges[cell] : edges[cell + 1]]
                at, moved = (level, orbits.of[cell]), orbits.terms[cell]
                a, b = self.second[0][at], self.second[1][at]
                a[np.ix_(moved, moved)] += weight * (left[:, some] @ left[:, some].T)
                b[np.ix_(moved, orbits.channels[cell])] += weight * (left[:, some] @ right[some])

    def solve_second(self, provenance):
        """Return the table."""
        table, orbits = self.table, self.table.orbits
        out = np.zeros(table.second.shape)
        for level in range(len(self.noise)):
            for p in np.unique(orbits.positions):
                limit = table.term_colors[p].T, np.eye(len(table.channels))
                some = np.flatnonzero(orbits.positions == p)
                a, b = (part[level, some].sum(axis=0) for part in self.second)
                unit = RIDGE * np.trace(a) / len(a) / len(some)
                everywhere = solve_ridge(a, b, FIRST_RIDGE * np.trace(a) / len(a), None, limit)
                for at in some:
                    a, b = (part[level, at] for part in self.second)
                    out[level, at] = solve_ridge(a, b, unit, everywhere, limit).T
                if self.noise[level] == 0:
                    o, own = self._own(p)
                    out[level, some, o] = own
        step = self.choices.step
        whole = step * round_filters(out * FINEST / step, table.term_colors[orbits.positions])
        return replace(table, second=whole, provenance=provenance)

    def _own(self, position):
        """Return the number of the position's own channel, and the weights that keep the sample."""
        radius = self.table.radii[1]
        at = np.flatnonzero((diamond(radius) == 0).all(axis=1))[0]
        channel = np.argmax(self.table.term_colors[position, at])
        return channel, np.arange(self.table.second.shape[-1]) == at


def average_places(first, mosaic) -> np.ndarray:
    """Return first filters (N, P, C, T) with one mean for places that a shift of the mosaic exchanges."""
    same = [
        places
        for places, transpose, signs, _ in symmetries(mosaic)
        if not transpose and (signs == 1).all()
    ]
    return np.mean([first[:, places] for places in same], axis=0)


def train_files(mosaic: Sequence[str], sources: dict[Path, str], path: Path, **options) -> None:
    """Write the table of a mosaic, trained on the middle of photographs and some charts.

    Args:
        mosaic: One period, a text per row.
        sources: Source of each photograph by its file, for the provenance; 8 bits in sRGB.
        path: The table's file.
        options: As for `Training`.

    Raises:
        BadFile: A photograph cannot be read or has another form.
    """
    pictures = [_middle(read_rgb(file)) for file in sources] + list(map(draw_chart, range(CHARTS)))
    names = [*sources.values(), *(f"chart deadleaves, seed {seed}" for seed in range(CHARTS))]
    write_guided(path, train(mosaic, pictures, names, **options))


def draw_chart(seed: int, size: int = SIZE) -> np.ndarray:
    """Return dead leaves in colours of measured surfaces, 0 .. 255 in sRGB, (size, size, 3)."""
    content = chart(
        "deadleaves", size=(size, size), wavelengths=[450.0, 540.0, 610.0], seed=seed
    ).content
    planes = np.asarray(content.bands_at(slice(None)), float)[::-1]
    soft = blur_planes(planes / planes.max(), EDGE)
    return 255 * np.moveaxis(encode_srgb(np.clip(soft, 0, 1)), 0, 2)


def _middle(picture):
    """Return the middle of a picture, at most SIZE pixels each way."""
    top, left = (max(0, n - SIZE) // 2 for n in picture.shape[:2])
    return picture[top : top + SIZE, left : left + SIZE]


def train(
    mosaic: Sequence[str], photographs: Sequence[np.ndarray], names: Iterable[str], **options
) -> GuidedTable:
    """Return a table.

    Args:
        mosaic: One period, a text per row.
        photographs: Sequence of pictures, (rows, cols, 3), 0 .. 255 in sRGB.
        names: Their names, for the provenance.
        options: As for `Training`.
    """
    training = Training(mosaic, **options)
    for step, end in (
        (training.add_first, training.solve_first),
        (training.add_contrasts, training.solve_bounds),
        (training.add_second, None),
    ):
        for number, photograph in enumerate(photographs):
            step(photograph, number)
        if end:
            end()
    responses = zip(training.table.channels, training.response.tolist(), strict=True)
    record = {
        "program": f"gpusim {__version__}, gpusim.apps.l3.guided",
        "date": f"{datetime.date.today()}",
        "photographs": list(names),
        "seed": training.seed,
        "noise of code / white": list(training.noise),
        "read noise [e-]": READ,
        "blur [pixel]": list(training.blurs),
        "saturation of every third": SATURATION,
        "weight of blurred frames": BLURRED,
        "responses to white": dict(responses),
    }
    return training.solve_second(json.dumps(record))
