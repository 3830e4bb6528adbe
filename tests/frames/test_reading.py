"""What the host reads of a content that is on a device is what it reads of the same in its own memory."""

from dataclasses import replace

import cameras
import numpy as np
import pytest
from devices import ALL_KINDS, KINDS, apart
from foreign_arrays import Tensor

import gpusim as gs
from gpusim.backends import open_device
from gpusim.backends.tape import Tape, recording
from gpusim.domain.content import Basis, Cube, Materials, Picture
from gpusim.domain.memory import type_of
from gpusim.pipeline import reading
from gpusim.pipeline.light import store_content
from gpusim.pipeline.loop import facts_on_device
from gpusim.pipeline.planning import probe_plan
from gpusim.pipeline.reading import Reading, store
from gpusim.planner.facts import Facts

WAVELENGTHS = np.linspace(400, 700, 31)
SHAPE = (37, 53)
RANDOM = np.random.default_rng(9)
LIGHT = (10.0 ** RANDOM.uniform(-3, 4, SHAPE)).astype(np.float32)
SPECTRA = RANDOM.uniform(0, 1, (300, 31))
FORMS = {
    "cube": Cube(WAVELENGTHS, (RANDOM.random((31, *SHAPE)) * LIGHT).astype(np.float32)),
    "half": Cube(WAVELENGTHS, (RANDOM.random((31, *SHAPE)) * LIGHT).astype(np.float16)),
    "basis": Basis(
        WAVELENGTHS, RANDOM.normal(0, 1, (6, *SHAPE)).astype(np.float32) * LIGHT, SPECTRA[:6]
    ),
    "half basis": Basis(
        WAVELENGTHS, RANDOM.normal(0, 1, (6, *SHAPE)).astype(np.float16), SPECTRA[:6]
    ),
    "materials": Materials(
        WAVELENGTHS, RANDOM.integers(0, 300, SHAPE).astype(np.uint16), LIGHT, SPECTRA
    ),
    "materials of bytes": Materials(
        WAVELENGTHS, RANDOM.integers(0, 256, SHAPE).astype(np.uint8), LIGHT, SPECTRA
    ),
    "picture": Picture(
        WAVELENGTHS,
        RANDOM.integers(0, 256, (*SHAPE, 3), np.uint8),
        SPECTRA[:3],
        np.linspace(0, 1, 256) ** 2.2,
    ),
    "grey": Picture(
        WAVELENGTHS,
        RANDOM.integers(0, 2**16, SHAPE, np.uint16),
        SPECTRA[:1],
        np.linspace(0, 1, 2**16),
    ),
}
ROWS = np.array([[0, 1, 2, 36], [-5, 36, 40, 3], [7, 7, 8, 9], [5, 6, 7, 8]], np.int32)
COLS = np.array([[0, 52, 3], [60, -1, 51], [5, 5, 4], [50, 51, 52]], np.int32)


@pytest.fixture(params=FORMS)
def content(request):
    return FORMS[request.param]


def there(device, content):
    """The content with its samples as the device's arrays."""
    types = iter([content.stored_type(name) for name in content.samples])
    return content.with_samples(lambda array: device.array(array, next(types)))


def readings(name, content):
    """All ways to a content that is on a device."""
    device = open_device(name)
    yield Reading(device, there(device, content))
    yield Reading(device, content.with_samples(Tensor))
    yield Reading(device, content, store(device, content))
    yield Reading(device, content, store_content(content, device=device))


@pytest.mark.parametrize("name", ALL_KINDS)
def test_windows_are_the_samples_themselves(name, content):
    seen = content.on_host()
    rows, cols = np.clip(ROWS, 0, SHAPE[0] - 1), np.clip(COLS, 0, SHAPE[1] - 1)
    of_host = Reading(open_device(name), content).windows(ROWS, COLS)
    for found in (of_host, *(each.windows(ROWS, COLS) for each in readings(name, content))):
        assert type(found) is type(seen) and found.is_like(seen) and found.shape == (4, 3)
        for key in seen.samples:
            values, samples = getattr(found, key), getattr(seen, key)
            assert type(values) is np.ndarray and values.dtype.kind == samples.dtype.kind
            for window in range(4):
                for line, row in enumerate(rows[window]):
                    wanted = samples[..., row, :][..., cols[window]]
                    np.testing.assert_array_equal(values[..., window, line, :], wanted)


@pytest.mark.parametrize("name", ALL_KINDS)
def test_no_windows_are_no_samples(name, content):
    for found in (
        each.windows(ROWS[:0], COLS[:0])
        for each in (Reading(open_device(name), content), *readings(name, content))
    ):
        assert found.planes.shape[-3:] == (0, 4, 3)


@pytest.mark.parametrize("name", ALL_KINDS)
def test_rows_are_the_samples_themselves(name, content):
    seen, chosen = content.on_host(), np.array([36, 3, -2, 40, 3])
    for found in (
        each.rows(chosen)
        for each in (Reading(open_device(name), content), *readings(name, content))
    ):
        assert type(found) is type(seen) and found.is_like(seen)
        for key in seen.samples:
            np.testing.assert_array_equal(
                getattr(found, key), getattr(seen, key)[..., [36, 3, 0, 36, 3], :]
            )


@pytest.mark.parametrize("name", ALL_KINDS)
def test_brightness_is_that_of_the_host(name, content):
    """Both sum n products of float32; one product where there is a material.

    Each errs by at most n + 1 units of 2^-24 of the sum of their magnitudes (Higham 2002, 3.1), one of them for the
    table's own rounding; second orders are below 1 %.
    """
    total = np.random.default_rng(4).normal(1, 1, 31)
    wanted, seen = content.brightness(total), content.on_host()
    table = np.abs(seen.entry_spectra @ total)
    terms = 1 if seen.labels is not None else len(table)
    magnitude = (
        table[seen.labels] * seen.planes
        if seen.labels is not None
        else np.tensordot(table, np.abs(seen.planes.astype(float)), 1)
    )
    for each in readings(name, content):
        found = each.brightness(total)
        assert type(found) is np.ndarray and found.dtype == np.float32 and found.shape == SHAPE
        assert (
            np.abs(found.astype(float) - wanted) <= 1.01 * 2 * (terms + 1) * 2.0**-24 * magnitude
        ).all()
    np.testing.assert_array_equal(Reading(open_device(name), content).brightness(total), wanted)


def sums_of(content, table):
    """Sums over the wavelengths of all samples by `table` (P, L), and those of their magnitudes: float64 (P, ...)."""
    spectra = table @ content.entry_spectra.T
    if content.labels is not None:
        each = spectra[:, content.labels] * content.planes
        return each, np.abs(each)
    planes = content.planes.astype(float)
    return np.tensordot(spectra, planes, 1), np.tensordot(np.abs(spectra), np.abs(planes), 1)


@pytest.mark.parametrize("name", KINDS)
def test_sums_of_rows_are_those_of_their_samples(name, content):
    """Rounding as of the brightness."""
    table = np.random.default_rng(5).normal(1, 1, (3, 31))
    seen, chosen = content.on_host(), np.array([36, 3, -2, 40, 3])
    wanted, magnitude = (part[:, [36, 3, 0, 36, 3]] for part in sums_of(seen, table))
    terms = len(seen.entry_spectra) if seen.labels is None else 1
    for each in readings(name, content):
        found = each.mix(chosen, table @ seen.entry_spectra.T)
        assert type(found) is np.ndarray and found.dtype == np.float32
        assert (np.abs(found - wanted) <= 1.01 * (terms + 1) * 2.0**-24 * magnitude).all()
    assert Reading(open_device(name), content).mix(chosen, table) is None


@pytest.mark.parametrize("name", KINDS)
def test_squares_are_those_of_all_pairs_of_neighbours(name, content):
    """To the rounding of `spectral.survey`, see its cases: of n terms each, squared and summed over a row."""
    seen, upper = content.on_host(), np.array([0, 5, 17, 36], np.int32)
    bands, magnitude = sums_of(seen, np.eye(31))
    if (
        seen.labels is None
    ):  # differences of entries are taken first, and those are exact to a rounding
        terms, size = len(seen.entry_spectra), np.abs(seen.entry_spectra.T)
        planes = seen.planes.astype(float)
        changes = [np.diff(planes, axis=2), np.diff(planes, axis=1)]
        across, down = (np.tensordot(size, np.abs(change), 1) for change in changes)
    else:
        terms, across = 2, magnitude[:, :, 1:] + magnitude[:, :, :-1]
        down = magnitude[:, 1:] + magnitude[:, :-1]
    down = np.concatenate([down, 0 * down[:, :1]], axis=1)  # below the last row is none
    below = np.concatenate([np.diff(bands, axis=1), 0 * bands[:, :1]], axis=1)

    def mean(values):
        return np.square(values[:, upper]).mean(axis=2).T

    wanted = mean(bands), mean(np.diff(bands, axis=2)) + mean(below)
    rounding = 2.02 * (terms + SHAPE[1] + 5) * 2.0**-24
    most = rounding * mean(magnitude), rounding * (mean(across) + mean(down))
    for each in readings(name, content):
        found = each.squares(upper, float(np.abs(bands).max()))
        for its, own, limit in zip(found, wanted, most, strict=True):
            assert its.shape == (4, 31) and (np.abs(its - own) <= limit).all()
    assert Reading(open_device(name), content).squares(upper, 1.0) is None


@pytest.mark.parametrize("name", [*KINDS, "apart"])
def test_windows_are_blurred_as_if_they_repeated_themselves(name, content):
    """To the rounding of `optics.blur`, see its cases; of the transform of a table, half as much."""
    device = apart() if name == "apart" else open_device(name)
    random, shape = np.random.default_rng(6), (16, 12)
    rows, cols = (np.arange(n) + random.integers(-4, 40, (5, 1)) for n in shape)
    seen, weights = content.on_host(), random.normal(1, 1, (3, 31))
    y, x = np.clip(rows, 0, SHAPE[0] - 1)[:, :, None], np.clip(cols, 0, SHAPE[1] - 1)[:, None]
    taken = Reading(device, there(device, content)).taken(rows, cols)
    wanted, magnitude = (part[:, y, x].swapaxes(0, 1) for part in sums_of(seen, weights))
    rounding = 1.01 * (len(seen.entry_spectra) + 1) * 2.0**-24
    assert (np.abs(taken.sum(weights) - wanted) <= rounding * magnitude).all()
    bands = sums_of(seen, np.eye(31))[0][:, y, x]
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])
    width = random.uniform(0.5, 2, (31, 1, 1))
    even = np.exp(-2 * (np.pi * width) ** 2 * (fy**2 + fx**2))
    for tables in (even, even * np.exp(-2j * np.pi * (0.3 * width * fy + 0.7 * fx))):
        planes = np.fft.irfft2(np.fft.rfft2(bands) * tables[:, None], shape)
        wanted = np.einsum("cl,lnyx->ncyx", weights, planes)
        # a transform mixes all samples of a window: the rounding of each is that of the largest
        most = np.einsum("cl,ln->nc", np.abs(weights), np.abs(bands).max(axis=(2, 3)))
        error = np.abs(taken.blur(tables, weights) - wanted).max(axis=(2, 3))
        assert (error <= (3e-6 + rounding) * most).all()
    assert Reading(device, content).taken(rows, cols) is None


@pytest.mark.parametrize("name", ALL_KINDS)
@pytest.mark.parametrize(
    "read",
    [
        lambda shown: shown.windows(ROWS[:1], COLS[:1]).values,
        lambda shown: shown.brightness(np.ones(31)),
    ],
    ids=["windows", "brightness"],
)
def test_what_was_read_stays(name, read):
    """It is no view of the device's memory, to which a step that is made again writes."""
    device, cube, tape = open_device(name), FORMS["cube"], Tape()
    brighter = replace(cube, values=2 * cube.values)
    with recording(tape):
        found = read(Reading(device, cube, store(device, cube)))
    before = found.copy()
    with recording(tape):
        again = read(Reading(device, brighter, store(device, brighter)))
    np.testing.assert_array_equal(again, 2 * before)
    np.testing.assert_array_equal(found, before)


@pytest.mark.parametrize("name", KINDS)
def test_the_whole_is_not_read(name, monkeypatch):
    """Of a content on a device the host gets windows or one plane; of one in its own memory the device gets nothing."""
    device, content = open_device(name), FORMS["cube"]
    shown, read = Reading(device, there(device, content)), []
    original = device.numpy
    monkeypatch.setattr(device, "numpy", lambda array: read.append(array.shape) or original(array))
    shown.windows(ROWS, COLS)
    shown.brightness(np.ones(31))
    assert sorted(map(tuple, read)) == [(1, *SHAPE), (4, 31, 4, 3)]
    monkeypatch.setattr(reading, "take", None)
    monkeypatch.setattr(reading, "store", None)
    assert type_of(Reading(device, FORMS["half"]).windows(ROWS, COLS).values) == np.float16


@pytest.mark.parametrize("name", KINDS)
def test_probes_of_samples_on_a_device_find_the_errors_of_the_host(name):
    """Float32 transforms round by 3e-7 of the light, which is 0.3 % of an error of planes of 1e-4."""
    simulator = gs.Simulator(gs.open_camera("phone"), device=name, tolerance=1e-3)
    scene = cameras.cubes(1, (160, 120))[0]
    made = simulator.plan(scene, exposure_time=0.01)
    cube = replace(scene.content, values=np.ascontiguousarray(scene.content.values[:, ::-1]))
    other, device = replace(scene, content=cube), simulator.device
    sampled = facts_on_device(cube, store(device, cube), device)
    found, wanted = (
        probe_plan(simulator, made, other, 0.01, facts) for facts in (sampled, Facts.of(other))
    )
    assert isinstance(sampled.samples.taken(ROWS, COLS), reading.TakenOnDevice)
    assert found.bounds.keys() == wanted.bounds.keys() and wanted.bounds["planes"].rms > 1e-4
    for cause, bound in wanted.bounds.items():
        assert found.bounds[cause].figures == pytest.approx(bound.figures, rel=3e-3), cause
