"""Transfer functions of strong and fast-turning wavefronts against an integral that shares nothing with the stage.

The pupil integral of the overlap in fixed axes, x along the shift: lines of y, on each the open part of x, both by
composite Gauss rules of 16 nodes on panels whose number doubles until the value stands still.
"""

import importlib
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from devices import ALL_KINDS, DEVICES
from numpy.polynomial.polynomial import polyval2d

from gpusim.domain.errors import OutOfRange
from gpusim.domain.optics import Optics
from gpusim.domain.pupil import Pupil, Wavefront, disc_power, noll
from gpusim.kernels.optics.pupil import polar_table, pupil, radial_table
from gpusim.optics.otf import transfer
from gpusim.optics.rays import CUBIC_ERROR, POLYGON_NODES
from gpusim.optics.tables import transfer_tables

NODES, WEIGHTS = np.polynomial.legendre.leggauss(16)
PLACES = np.array([0.11, 0.37, 0.63, 0.86])  # s
ANGLES = np.array([0.4, 2.0, -1.1, 3.0])


def term(j, waves):
    return (waves * noll(j))[None]


def panels(ends, count):
    """Nodes and weights of `count` panels between each two neighbours of `ends`."""
    edges = np.concatenate(
        [np.linspace(a, b, count + 1)[:-1] for a, b in pairwise(ends)] + [ends[-1:]]
    )
    half = np.diff(edges)[:, None] / 2
    return ((edges[:-1, None] + half) + half * NODES).ravel(), (half * WEIGHTS).ravel()


def own(wave, s, angle, hole=0.0, tolerance=1e-10):
    """O at one frequency, by polar angle t across (y = sin t) and x along the shift, doubled until it stands still."""
    return _own(wave.tobytes(), wave.shape, float(s), float(angle), hole, tolerance)


@lru_cache(maxsize=64)
def _own(wave, shape, s, angle, hole, tolerance):
    wave = np.frombuffer(wave).reshape(shape)
    kinks = [-np.arccos(s), np.arccos(s)]
    if hole:
        heights = [hole]
        heights += [np.sqrt(hole**2 - s**2)] if s < hole else []
        cross = (
            1 - ((4 * s * s + 1 - hole**2) / (4 * s)) ** 2
        )  # the hole of one copy and the rim of the other
        heights += [np.sqrt(cross)] if cross > 0 else []
        kinks += [
            sign * np.arcsin(h) for h in heights for sign in (1, -1) if np.arcsin(h) < np.arccos(s)
        ]
    kinks, before = np.sort(kinks), None
    for count in 2 ** np.arange(1, 11):
        # roots at the kinks: t = middle - half cos(phi) makes them smooth
        total = 0.0
        for a, b in pairwise(kinks):
            phi, weight = panels(np.array([0, np.pi]), count)
            t = (a + b) / 2 - (b - a) / 2 * np.cos(phi)
            weight = weight * (b - a) / 2 * np.sin(phi) * np.cos(t)
            total += sum(
                w * line(wave, s, angle, np.sin(one), hole, count)
                for one, w in zip(t, weight, strict=True)
            )
        total /= np.pi * (1 - hole**2)
        if before is not None and abs(total - before) < tolerance:
            return total
        before = total
    raise AssertionError("the independent integral does not settle")


def line(wave, s, angle, y, hole, count):
    rim = np.sqrt(1 - y * y) - s
    pieces = [(-rim, rim)]
    if hole > abs(y):
        h = np.sqrt(hole * hole - y * y)
        for middle in (-s, s):
            pieces = [
                cut
                for a, b in pieces
                for cut in ((a, min(b, middle - h)), (max(a, middle + h), b))
                if cut[1] > cut[0]
            ]
    total = 0.0
    for a, b in pieces:
        x, weight = panels(np.array([a, b]), count)
        ends = [
            polyval2d(
                np.cos(angle) * at - np.sin(angle) * y, np.sin(angle) * at + np.cos(angle) * y, wave
            )
            for at in (x + s, x - s)
        ]
        total += weight @ np.exp(2j * np.pi * (ends[0] - ends[1]))
    return total


def mixture(seed):
    """A pupil and up to 1 wave RMS of defocus, Seidel and Zernike terms."""
    random = np.random.default_rng(seed)
    zernike = np.zeros(66)
    chosen = random.choice(np.arange(1, 66), 4, replace=False)
    zernike[chosen] = random.normal(0, 0.15, 4)
    wave = Wavefront(tuple(zernike), seidel=tuple(random.normal(0, 0.2, 5))).polynomial(
        1.0, random.uniform(0, 6)
    )
    wave = wave.copy()
    wave[:3, :3] += random.normal(0, 0.5) * disc_power(1)
    return Pupil(0, random.choice([0.0, 0.0, 0.2, 0.5])), wave[None]


def on_device(outline, waves, device):
    """O at four frequencies by the stage, its aperture's own transfer taken out.

    At q = 2 all frequencies up to the cut-off are below half a cycle per pixel, and no replica is.
    """
    table = np.float64(
        pupil(outline, waves, np.array([2.0], np.float32), 0.1, 40, 40, device=device)[0]
    )
    y, x = np.array([3, 8, 4, 0, 15]), np.array([4, 1, 11, 14, 6])
    fold = table if table.shape == (21, 21) else table.view(complex)
    return (
        fold[y, x] / np.sinc(0.1 * y / 40) / np.sinc(0.1 * x / 40),
        np.hypot(y, x) / 20,
        np.arctan2(y, x),
    )


def check_device(outline, waves, device):
    """1e-5: cubics along and across of 4e-6 each, series and float32 2e-6."""
    found, s, angle = on_device(outline, waves, device)
    for value, one_s, one_angle in zip(found, s, angle, strict=True):
        assert abs(value - own(waves[0], one_s, one_angle, outline.obscuration, 1e-8)) < 1e-5


def check_reference(outline, waves):
    """1e-9: two changes of less than 1e-10 each, of sums that converge, and 1e-10 of the independent integral."""
    found = transfer(outline, waves, PLACES * np.cos(ANGLES), PLACES * np.sin(ANGLES))[0]
    for value, s, angle in zip(found, PLACES, ANGLES, strict=True):
        assert abs(value - own(waves[0], s, angle, outline.obscuration)) < 1e-9


@pytest.mark.parametrize(
    ("j", "waves"), [(7, 0.3), (11, 0.3), (11, 1.0), (16, 0.2), (22, 0.1), (22, 0.3), (36, 0.3)]
)
def test_terms_that_turn_often(j, waves):
    """They once took nodes for their range alone, and erred by 1e-8 to 1.5e-2."""
    check_reference(Pupil(), term(j, waves))


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize(
    ("j", "waves"), [(7, 0.3), (11, 0.3), (11, 1.0), (16, 0.2), (22, 0.1), (22, 0.3)]
)
def test_tables_of_terms_that_turn_often(j, waves, device):
    check_device(Pupil(), term(j, waves), device)


@pytest.mark.parametrize("seed", [0, 2])
def test_mixtures(seed):
    check_reference(*mixture(seed))


@pytest.mark.parametrize(
    "optics",
    [
        Optics(2.0, 4e-3, pupil=Pupil(0, 0.4)),
        Optics(2.8, 4e-3, pupil=Pupil(0, 0.2), defocus=8e-6),
        Optics(2.0, 4e-3, wavefront=Wavefront(seidel=(0.8, 0.0, 0.0, 0.0, 0.0))),
        Optics(2.0, 4e-3, wavefront=Wavefront(zernike=(0.0,) * 6 + (0.2,)), diffuser=4e-7),
        Optics(2.0, 4e-3, pupil=Pupil(6, 0.1, 0.2)),
        Optics(4.0, 4e-3, pupil=Pupil(5), defocus=1e-5),
    ],
)
def test_tables_that_planners_look_at(optics):
    """Splines through the devices' nodes against the integral at every frequency that is folded: twice their error."""
    wavelengths, pitch = np.array([430.0, 550.0, 690.0]), 1.4e-6
    q = wavelengths * 1e-9 * optics.working_f_number / pitch
    tables = transfer_tables(optics, pitch, q, 0.9, 6, 7)
    waves, q = optics.waves(wavelengths), np.float32(q)
    even = tables.shape[1] == 4
    y, x = np.arange(4) / 6 if even else np.fft.fftfreq(6), np.arange(4) / 7
    for table, wave, one in zip(
        tables if even else np.ascontiguousarray(tables).view(complex), waves, q, strict=True
    ):
        more = np.arange(-4, 5)
        fy, fx = np.add.outer(more, y).ravel()[:, None], np.add.outer(more, x).ravel()
        seen = transfer(
            optics.pupil, wave[None], *(np.ravel(f) * one for f in np.broadcast_arrays(fx, fy))
        )
        seen = seen.reshape(fy.size, fx.size) * np.sinc(0.9 * fy) * np.sinc(0.9 * fx)
        seen *= np.exp(-2 * (np.pi * optics.diffuser / pitch) ** 2 * (fy**2 + fx**2))
        expected = seen.reshape(9, len(y), 9, 4).sum(axis=(0, 2))
        assert np.abs(table - expected).max() < 2 * (
            POLYGON_NODES if optics.pupil.blades else CUBIC_ERROR
        )


@pytest.mark.parametrize("polygon", [Pupil(6, 0.2, 0.3), Pupil(5, 0, 0.1)])
def test_polygon_with_a_turning_wavefront(polygon):
    """Twice the nodes everywhere, of a rule asked for a hundredth of the error, agree to 1e-9."""
    waves = term(16, 0.2)
    x, y = PLACES * np.cos(ANGLES) * 0.9, PLACES * np.sin(ANGLES) * 0.9
    np.testing.assert_allclose(
        transfer(polygon, waves, x, y), transfer(polygon, waves, x, y, error=1e-12), atol=1e-9
    )


@pytest.fixture
def no_integral(monkeypatch):
    def integrated(*_):
        raise AssertionError("a refused wavefront was integrated")

    with monkeypatch.context() as patched:
        patched.setattr(importlib.import_module("gpusim.optics.otf"), "_integral", integrated)
        yield


def test_what_turns_too_often_is_refused_at_once(no_integral):
    """40 waves of the steepest term: the picture would take hours. Nothing is integrated before the refusal."""
    with pytest.raises(OutOfRange, match="turns so often") as caught:
        polar_table(Pupil(), term(66, 40.0))
    assert "\n" not in str(caught.value)
    with pytest.raises(OutOfRange, match="turns so often"):
        radial_table(Pupil(0, 0.3), term(56, 40.0))
    with pytest.raises(OutOfRange, match="turns so often"):
        polar_table(Pupil(6), term(66, 3.0))


# ---- all terms


def kept(make):
    """`make` of one pupil and wavefront, called once."""
    known = []

    def table(*given):
        known[:] = known or [make(*given)]
        return known[0]

    return table


REFUSED = {
    25,
    26,
    *range(31, 37),
    *range(38, 56),
    *range(57, 67),
}  # of 3 waves RMS: minutes of two cores and more


@pytest.mark.slow
@pytest.mark.parametrize("j", sorted(REFUSED))
def test_every_term_that_is_refused(j, no_integral):
    with pytest.raises(OutOfRange, match=r"turns so often .* points or more: allowed is up to"):
        polar_table(Pupil(), term(j, 3.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("j", "waves"),
    [
        (j, waves)
        for j in range(2, 67)
        for waves in (0.1, 0.3, 1.0, 3.0)
        if waves < 3 or j not in REFUSED
    ],
)
def test_every_term(j, waves, monkeypatch):
    """Every other Noll term: float64 within 1e-9, every device within 1e-5; the table is made once for all of them."""
    check_reference(Pupil(), term(j, waves))
    module = importlib.import_module("gpusim.kernels.optics.pupil")
    for name in ("polar_table", "radial_table"):
        monkeypatch.setattr(module, name, kept(getattr(module, name)))
    for device in DEVICES:
        check_device(Pupil(), term(j, waves), device)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3, 39))
def test_many_mixtures(seed):
    outline, waves = mixture(seed)
    check_reference(outline, waves)
    check_device(outline, waves, "auto")
