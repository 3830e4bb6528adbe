"""Prior of spectral sensitivities: measured detectors, filters and infrared cuts, varied as cameras vary."""

from functools import lru_cache

import numpy as np

from gpusim.data.curves import curve

NODES = np.arange(390.0, 721.0, 10.0)  # [nm]
LEAST = 0.001  # of a peak: added before the logarithm, so that a curve may end
CAMERAS = 800  # that are drawn
EDGE, THICKNESS, BARE = 12.0, 0.5, 0.05  # cuts: shift [nm], log thickness, and share without any
WARP, GAIN, SMOOTH = (
    8.0,
    0.15,
    80.0,
)  # shifts [nm] and factors (log) that vary smoothly over SMOOTH [nm]
LEVEL, CROSSTALK, FLOOR = 0.2, 0.04, 0.005
DEPTH = 0.8, 1.15  # least and largest share of its light that a dye takes away
OWN, LENGTH = 0.06, 25.0  # further deviations (log), and their correlation length [nm]
DYES = {"Y": 2, "C": 0, "M": 1}  # channel whose light a dye takes away: yellow takes blue


@lru_cache(maxsize=16)
def curve_prior(letters: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and covariance of log(curve + LEAST) at NODES, of all channels together; peaks are about 1.

    R, G and B are measured curves of the package behind measured infrared cuts. W is a detector behind a cut, and so
    is a single Y. Y, C and M are that detector behind a dye, which takes away the band of a primary filter: its share
    of the light that passes any primary. Edges and thickness of cuts vary, filters are warped, tilted, scaled and
    mixed. Another letter may be any of these.

    Args:
        letters: Channels, C.

    Returns:
        Mean, shape (C L,), and covariance, shape (C L, C L).

    Source:
        Rasmussen and Williams, Gaussian Processes for Machine Learning (2006); Beer and Lambert's law of thickness.
    """
    random = np.random.default_rng(list(map(ord, "curves" + "".join(letters))))
    table = np.array([_draw_camera(random, letters) for _ in range(CAMERAS)])
    logs = np.log(table / np.median(table.max(axis=(1, 2))) + LEAST).reshape(CAMERAS, -1)
    own = OWN**2 * _alike(LENGTH) + 1e-5 * np.eye(len(NODES))
    return logs.mean(0), np.cov(logs.T) + np.kron(np.eye(len(letters)), own)


def _alike(length):
    """Return correlations of the nodes, shape (L, L)."""
    return np.exp(-((NODES[:, None] - NODES) ** 2) / (2 * length**2))


@lru_cache(maxsize=1)
def _measured():
    """Return sets of R, G and B without cuts, detectors, and cuts, at NODES."""
    tables = {
        name: np.asarray(curve(name).at(NODES, outside=None))
        for name in ("mt9v024", "iset-rgb", "cmos-photodetector", "ir-cut-phone", "ir-cut-schott")
    }
    sets = [tables[name][:3] / tables[name][:3].max() for name in ("mt9v024", "iset-rgb")]
    detectors = [one / one.max() for one in (tables["mt9v024"][3], tables["cmos-photodetector"])]
    cuts = [np.clip(tables[name], 0, 1) for name in ("ir-cut-phone", "ir-cut-schott")]
    return sets, detectors, cuts


def _draw_camera(random, letters):
    """Return curves of a random camera, shape (C, L)."""
    sets, detectors, cuts = _measured()
    primaries = sets[random.integers(len(sets))]
    cut = _vary_cut(random, cuts[random.integers(len(cuts))])
    bare = detectors[random.integers(len(detectors))] * cut
    filters = primaries / primaries.max(axis=1, keepdims=True)
    share = filters / (filters.sum(axis=0) + 1e-3)
    seen = dict(zip("RGB", primaries * cut, strict=True)) | {"W": bare}
    for letter, taken in DYES.items():
        seen[letter] = bare * (1 - np.clip(random.uniform(*DEPTH) * share[taken], 0, 1))
    if tuple(letters) == ("Y",):
        seen["Y"] = bare
    others = list(seen)
    table = np.array([seen[one if one in seen else random.choice(others)] for one in letters])
    count = len(table)
    mixed = table + CROSSTALK * random.exponential(size=(count, count)) @ table
    mixed = mixed + FLOOR * random.exponential() * cut
    shifts = WARP * (_wave(random, count) + 0.5 * _wave(random, 1))
    warped = [np.interp(NODES + own, NODES, row) for own, row in zip(shifts, mixed, strict=True)]
    levels = LEVEL * (random.normal(size=(count, 1)) + random.normal())
    return np.array(warped) * np.exp(GAIN * _wave(random, count) + levels)


def _vary_cut(random, cut):
    """Return a cut with shifted edges and of another thickness; some have no infrared edge."""
    blue, red = (np.interp(NODES - EDGE * random.normal(), NODES, cut) for _ in range(2))
    red = np.ones(len(NODES)) if random.random() < BARE else red
    return np.where(NODES < 520, blue, red) ** np.exp(THICKNESS * random.normal())


@lru_cache(maxsize=1)
def _root():
    return np.linalg.cholesky(_alike(SMOOTH) + 1e-6 * np.eye(len(NODES)))


def _wave(random, count):
    """Return smooth random curves of variance 1, shape (count, L)."""
    return random.normal(size=(count, len(NODES))) @ _root().T
