"""The cheapest of all ways to blur a scene that is predicted to meet a tolerance."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import chain
from math import log2, prod
from operator import attrgetter

from gpusim.domain.account import SAFETY, Bound, Tolerance, total
from gpusim.optics.farfield import multiplications
from gpusim.optics.lengths import Tiling
from gpusim.planner.knobs.border import Surroundings
from gpusim.planner.knobs.farfield import FarField
from gpusim.planner.knobs.spectral import Way
from gpusim.planner.question import Question

# that a device does in the time of a byte: .5 on two cores by PoCL, 1 on an H200
FLOP_PER_BYTE = 0.5
CACHED = (
    2**21
)  # samples of a transform that doubles its cost: on two cores 3.4 ns a sample at 0.9 million, 11 at 3.5
# [flop] of one of a tile's transforms, which stay in a core's cache or a GPU's local memory, and of a multiplication of
# the far field; both measured against transforms of frames on two cores, and on an H200
TILE_COST, GPU_TILE_COST = 0.6, 1.4
FAR_COST, GPU_FAR_COST = 3.5, 21.0
# times the exact way's samples that transforms may have, for a world without end beyond
WIDER = 2.0
HEADROOM = 1.1  # that a choice leaves: sigmas are for an exposure that is not metered yet
NEAR = 1.1  # ways whose errors are within this factor are equivalent, if none is good enough

REMEDIES = {
    "transforms": "float64 would, so use device numpy",
    "rounding": "float64 would, so use device numpy",
    "spectral sampling": "a scene of more wavelengths, where its spectra change, would be met",
    "planes": "a lens that varies less over the field, or a larger tolerance, would be met",
    "view": "a scene drawn finer, by samples_per_pixel, would be met",
    "distortion": "a scene drawn finer, by samples_per_pixel, would be met",
    "depth, light behind the edges of layers": "a larger tolerance would be met",
    "depth": "a scene that gives its layers, or less depth, would be met",
}


@dataclass(frozen=True, eq=False)
class Option:
    """A way to treat wavelengths in as much of the surroundings. fixed: errors of all ways. cost: see `cost_of`."""

    way: Way
    around: Surroundings
    fixed: dict[str, Bound]
    cost: float

    @cached_property
    def bounds(self) -> dict[str, Bound]:
        """Its errors."""
        found = dict(self.fixed)
        if "transforms" in found:  # ends that go on are transformed, too
            found["transforms"] = found["transforms"].times(self.around.brighter)
        return found | {"planes": self.way.bound, "border": self.around.bound}

    @cached_property
    def total(self) -> Bound:
        """All of its errors together."""
        return total(self.bounds.values())


def cost_of(question: Question, count: int, around: Surroundings, folded: bool) -> float:
    """Return the arithmetic of a frame's planes and transforms, with the bytes moved counted as arithmetic [flop].

    It depends on no device's speed: plans are the same on all CPUs and on all GPUs. count: planes
    that are transformed.
    """
    tile, multiplied = (GPU_TILE_COST, GPU_FAR_COST) if question.on_gpu else (TILE_COST, FAR_COST)
    content, channels = question.content, len(question.weights)
    samples, area = prod(content.shape), float(prod(around.period))
    if around.tiling is None:
        transform = (2.5 * area * log2(area) + FLOP_PER_BYTE * 16 * area) * (1 + area / CACHED)
    else:
        tiled = around.tiling.samples(question.scene.samples)
        transform = tile * 2.5 * tiled * log2(area)
        area = float(tiled)
    read = content.nbytes + (0 if count == len(content.wavelengths) else 4 * count * samples)
    back = 1 if folded else channels
    # of complex numbers, and their sums, at the frequencies of a half spectrum
    products = 8 * count * back * area / 2
    far = 0.0
    if around.far is not None:
        far = multiplied * multiplications(
            question.size, count, channels, tuple(around.far.sigmas), around.far.spacings
        )
    return (count + back) * transform + products + far + FLOP_PER_BYTE * read


def options(
    question: Question,
    ways: list[Way],
    arounds: Iterable[list[Surroundings]],
    fixed: dict[str, Bound],
    folds,
) -> list[Option]:
    """Ways in more and more surroundings, none dearer than the exact one in the first, or in a world without end.

    The cheapest is first. The errors of those beyond one that meets the tolerance are not computed here.
    fixed: errors of all. folds: function from surroundings to whether the mosaic folds into the transforms.
    """
    found: list[Option] = []
    most, first = 0.0, None
    for together in arounds:
        affordable = []
        for around in together:
            first = first or around
            folded = folds(around)
            if around is first or (
                around.far is not None and prod(around.period) <= WIDER * prod(first.period)
            ):  # the exact way, and with a world without end
                most = max(most, cost_of(question, ways[-1].count, around, folded))
            for way in ways:
                cost = cost_of(question, way.count, around, folded)
                if cost <= most:
                    affordable.append(Option(way, around, fixed, cost))
        affordable.sort(key=attrgetter("cost"))
        found += affordable
        tolerance = question.tolerance
        if not affordable or tolerance is None or _first_good(affordable, tolerance):
            break  # more surroundings cost more
    return found


def remedy(
    question: Question,
    found: list[Option],
    arounds: Iterable[list[Surroundings]],
    fixed: dict[str, Bound],
) -> str:
    """Return in words a change that meets the tolerance if no option of `found` does; "" if one does.

    arounds: more surroundings than these options have.
    """
    tolerance = question.tolerance
    if tolerance is None or _first_good(found, tolerance):
        return ""
    best = min(found, key=lambda option: option.total.ratio(tolerance))
    rest = [bound for name, bound in best.bounds.items() if name != "border"]
    known = {name: bound for name, bound in best.bounds.items() if bound.is_known}
    by = max(known, key=lambda name: known[name].ratio(tolerance))
    if SAFETY * total(rest).ratio(tolerance) <= 1:
        for around in chain.from_iterable(arounds):
            if SAFETY * total([*rest, around.bound]).ratio(tolerance) <= 1:
                times = cost_of(question, best.way.count, around, False) / best.cost
                return f"reach = {around.reach} pixels would meet it, at about {times:.3g} times the cost"
        return "no reach that transforms take meets it"
    others = REMEDIES["depth"] if by.startswith("depth") else "a larger tolerance would be met"
    return REMEDIES.get(by, others)


def _first_good(found, tolerance):
    """The first option that is predicted to meet a tolerance, with headroom; or None.

    A border is not computed if the planes already break the tolerance.
    """
    most = 1 / (HEADROOM * SAFETY)
    for option in found:
        if option.way.bound.ratio(tolerance) <= most and option.total.ratio(tolerance) <= most:
            return option
    return None


def choose_option(found: list[Option], tolerance: Tolerance | None) -> Option:
    """The first option that meets the tolerance, or else the cheapest of the most accurate; without one the last.

    found: as `options` gives them.
    """
    if tolerance is None:
        return found[-1]
    good = _first_good(found, tolerance)
    if good is not None:
        return good
    least = NEAR * min(option.total.ratio(tolerance) for option in found)
    near = [option for option in found if option.total.ratio(tolerance) <= least]
    return min(near, key=attrgetter("cost"))


@dataclass(frozen=True)
class Candidate:
    """Summary of an option.

    Attributes:
        words: The way in words.
        planes: Planes that are transformed.
        reach: Surroundings on each side [pixel].
        far: Model of the world beyond; None ignores it.
        tiling: Of the frame into tiles, if it is not one transform.
        period: Of the transforms [sample].
        error: Predicted.
    """

    words: str
    planes: int
    reach: int
    far: FarField | None
    tiling: Tiling | None
    period: tuple[int, int]
    error: Bound

    @property
    def surroundings(self) -> str:
        """Surroundings that take part, in words."""
        tiles = f" of tiles of {self.tiling.side}" if self.tiling else ""
        beyond = ", and the world beyond" if self.far else ""
        return f"{self.reach} pixels of surroundings{tiles}{beyond}"

    def as_dict(self) -> dict:
        """Plain data, for JSON."""
        return {
            "words": self.words,
            "planes": self.planes,
            "reach": self.reach,
            "endless": self.far is not None,
            "tiles": self.tiling is not None,
            "period": self.period,
            "error": asdict(self.error),
        }


def front(found: list[Option], tolerance: Tolerance) -> tuple[Candidate, ...]:
    """Return the options that no cheaper one nearly equals in accuracy, from the cheapest on."""
    best: list[Option] = []
    for option in sorted(found, key=attrgetter("cost")):
        if not best or NEAR * option.total.ratio(tolerance) < best[-1].total.ratio(tolerance):
            best.append(option)
    return tuple(
        Candidate(
            option.way.words,
            option.way.count,
            option.around.reach,
            option.around.far,
            option.around.tiling,
            option.around.period,
            option.total,
        )
        for option in best
    )
