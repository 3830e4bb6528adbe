"""What is made again on a tape is what is made anew, whatever has changed; replayed, it takes new contents."""

import gc
import weakref

import numpy as np
import pytest
from devices import KINDS

from gpusim.backends.select import open_device
from gpusim.backends.tape import SMALL, OwnTape, Tape, recording
from gpusim.domain.errors import OutOfRange
from gpusim.kernels.sensor.bin import bin as binned
from gpusim.kernels.sensor.chip import chip
from gpusim.kernels.sensor.collect import collect
from gpusim.kernels.sensor.noise import noise
from gpusim.kernels.spectral.integrate import integrate
from gpusim.pipeline.cache import Cache

RANDOM = np.random.default_rng(3)
BAYER = np.array([[0, 1], [1, 2]], np.int32)


@pytest.fixture(params=KINDS)
def device(request):
    return open_device(request.param)


def chain(device, content, weights, seconds, cfa=BAYER, twice=False):
    """A few stages: planes by a constant table, the mosaic, another exposure; sometimes a step more."""
    planes = integrate(content, device.array(weights), device=device)
    mean = collect(planes, cfa, seconds, 1e-3, device=device)
    mean = chip(mean, scale=0.5, device=device)
    return chip(mean, scale=2.0, device=device) if twice else mean


def values(device, array):
    return np.array(device.numpy(array))


def cube(device, shape=(5, 34, 46)):
    return device.array(RANDOM.random(shape, np.float32))


def test_made_again_is_made_anew(device):
    """Other numbers, constants, sizes, kernels and numbers of steps, there and back again."""
    tape, first, small = Tape(), cube(device), cube(device, (5, 12, 18))
    tables = [RANDOM.random((3, 5), np.float32) for _ in range(2)]
    mono = np.zeros((1, 1), np.int32)
    for content, table, seconds, cfa, twice in (
        (first, 0, 0.1, BAYER, False),
        (first, 0, 0.1, BAYER, False),
        (first, 0, 0.3, BAYER, False),
        (first, 1, 0.3, BAYER, False),
        (small, 1, 0.3, BAYER, False),
        (first, 1, 0.3, mono, False),
        (first, 1, 0.3, mono, True),
        (first, 0, 0.1, BAYER, False),
        (cube(device), 0, 0.1, BAYER, False),
    ):
        made = content, tables[table], seconds, cfa, twice
        with recording(tape):
            found = values_after(device, lambda made=made: chain(device, *made))
        np.testing.assert_array_equal(found, values(device, chain(device, *made)))


def test_tapes_that_share_an_array_keep_it_apart(device):
    """One of them goes on to another array; the other, and a launch on no tape, still read the first."""
    shared, other = cube(device, (1, 12, 18)), cube(device, (1, 12, 18))
    tapes = Tape(), Tape()

    def found(tape, array):
        with recording(tape):
            return values_after(
                device, lambda: collect(array, np.zeros((1, 1), np.int32), 0.5, 0.0, device=device)
            )

    first, _ = (found(tape, shared) for tape in tapes)
    second = found(tapes[0], other)
    assert (first != second).all()
    np.testing.assert_array_equal(found(tapes[1], shared), first)
    tapes[1].replay()
    np.testing.assert_array_equal(found(None, shared), first)
    np.testing.assert_array_equal(values(device, shared)[0] * np.float32(0.5), first)


def values_after(device, make):
    """What a computation gives, read outside of its tape."""
    array = make()
    with recording(None):
        return values(device, array)


def test_replayed_it_takes_the_contents_that_are_there(device):
    tape, table, content = Tape(), RANDOM.random((3, 5), np.float32), cube(device)
    source = cube(device)
    for _ in range(2):
        with recording(tape):
            result = chain(device, content, table, 0.2)
    assert tape.is_replayable
    before = values(device, result)
    overwrite(device, content, source)
    np.testing.assert_array_equal(values(device, result), before)
    tape.replay()
    np.testing.assert_array_equal(
        values(device, result), values(device, chain(device, source, table, 0.2))
    )
    assert (values(device, result) != before).any()


def test_copies_read_what_takes_an_arrays_place(device):
    """A kernel and a copy that read the same array: given another, both read that; made again, each its own."""
    tape, table, first, second = (
        Tape(),
        RANDOM.random((3, 5), np.float32),
        cube(device),
        cube(device),
    )

    def made(content):
        with recording(tape):
            return device.stack(
                [
                    device.part(integrate(content, device.array(table), device=device), 1),
                    device.part(content, 2),
                ]
            )

    for _ in range(2):
        found = made(first)
    assert tape.replace_arrays([(first, second)])
    tape.replay()
    expected = values(
        device,
        device.stack(
            [
                device.part(integrate(second, device.array(table), device=device), 1),
                device.part(second, 2),
            ]
        ),
    )
    np.testing.assert_array_equal(values(device, found), expected)
    again = values(device, made(first))
    np.testing.assert_array_equal(again[1], values(device, first)[2])
    assert (again != expected).any()


def test_no_other_array_takes_the_place_of_one_that_is_read_in_two_forms(device):
    """Kernels of its other form would go on reading what it was: the far field's of planes that tiles read, too."""
    tape, table, first, second = (
        Tape(),
        RANDOM.random((3, 5), np.float32),
        cube(device),
        cube(device),
    )
    planes, rows, cols = first.shape

    def made(content):
        with recording(tape):
            own = integrate(content, device.array(table), device=device)
            turned = integrate(
                device.reshape(content, (planes, cols, rows)), device.array(table), device=device
            )
            return device.stack([device.reshape(own, turned.shape), turned])

    for _ in range(2):
        made(first)
    assert tape.is_replayable and not tape.replace_arrays([(first, second)])
    tape.replay()
    again = made(first)
    np.testing.assert_array_equal(
        values(device, again)[0].ravel(), values(device, again)[1].ravel()
    )


def overwrite(device, target, source):
    """Copy an array's values to another, by the verbs that devices have."""
    size = int(np.prod(target.shape))
    device._start_copy(target, source, size, 0, 0)


def test_nothing_is_allocated_or_built_again(device, monkeypatch):
    tape, content, table = Tape(), cube(device), RANDOM.random((3, 5), np.float32)
    for _ in range(2):
        with recording(tape):
            chain(device, content, table, 0.2)
    for name in ("_empty", "_array", "_command", "_launch"):
        monkeypatch.setattr(device, name, lambda *_, name=name: pytest.fail(f"{name} was called"))
    with recording(tape):
        chain(device, content, table, 0.7)
    tape.replay()


def test_reads_and_work_on_the_host_are_noted(device):
    tape, content = Tape(), cube(device)
    with recording(tape):
        device.numpy(content)
    assert tape.reads == ["between the stages"]
    assert not tape.is_replayable
    with recording(tape), device.host_work():
        device.numpy(content)
    assert tape.reads == []
    assert len(tape.host_work) == 1
    assert not tape.is_replayable
    with recording(tape):
        binned(device.reshape(content, (170, 46)), binning=(2, 2), stride=(1, 1), device=device)
    assert tape.is_replayable


def test_large_arrays_that_are_dropped_are_freed_if_the_host_works(device, monkeypatch):
    """Those from before its work; results keep their memory, and are what is made anew."""
    monkeypatch.setattr("gpusim.backends.tape.LARGE", 1)
    tape, content, kept, dropped = Tape(), cube(device), [], []

    def compute(table, seconds):
        planes = integrate(content, device.array(table), device=device)
        whole = device.reshape(device.stack([planes, planes]), (6, 34, 46))
        dropped.append(weakref.ref(planes))
        with device.host_work():
            scale = float(values(device, whole).mean())
        part = device.part(whole, slice(0, 3))
        mean = collect(part, BAYER, seconds, 1e-3, device=device)
        return chip(chip(mean, scale=scale, device=device), scale=0.5, device=device)

    for seconds in (0.1, 0.2, 0.2, 0.4):
        table = RANDOM.random((3, 5), np.float32)
        with recording(tape):
            made = compute(table, seconds)
        device.sync()
        gc.collect()
        assert not tape.is_replayable
        assert [array() for array in dropped] == [None] * len(dropped)
        kept.append(made)
        np.testing.assert_array_equal(values(device, made), values(device, compute(table, seconds)))
    assert all(array is kept[0] for array in kept)


def test_large_constants_are_given_again(device):
    """They may have been written to; small ones are compared."""
    tape = Tape()
    for size in (SMALL // 4, SMALL // 4 + 1):
        constant = np.zeros(size, np.float32)
        for number in range(3):
            constant[-1] = number
            with recording(tape):
                array = device.array(constant)
            assert values(device, array)[-1] == number


def test_another_frame_is_drawn_by_the_launches_of_one(device):
    """Seed, frame and all numbers of an exposure, with and without row noise: bit for bit those of a new draw."""
    expected = device.array(100 * RANDOM.random((34, 46), np.float32))
    traps = device.array(RANDOM.random((34, 46), np.float32))
    for lines in (0.0, 0.7):
        sensor = {
            "row_noise": lines,
            "full_well": 1e4,
            "white_level": 1023,
            "telegraph_switching": 0.3,
            "device": device,
        }
        numbers = {"dark_electrons": 1.0, "read_noise": 2.0, "gain": 0.5, "black_level": 64.0}
        tape = Tape()
        with recording(tape):
            raw = noise(expected, traps, traps, seed=1, frame=0, **numbers, **sensor)
        for seed, frame, other in (
            (1, 1, {}),
            (2**64 - 3, 2**32 - 1, {"dark_electrons": 30.0}),
            (1, 1, {"gain": 2.5}),
            (1, 1, {"read_noise": 7.0, "dark_electrons": 0.0, "black_level": 3.0}),
        ):
            assert tape.renumber({"seed": seed, "frame": frame, **numbers, **other})
            tape.replay()
            fresh = noise(
                expected, traps, traps, seed=seed, frame=frame, **(numbers | other), **sensor
            )
            np.testing.assert_array_equal(values(device, raw), values(device, fresh))
        with pytest.raises(OutOfRange, match="frame"):
            tape.renumber({"frame": 2**32})
        assert not tape.renumber({"frame": 1, "unknown": 2})


def test_another_time_is_set_in_the_launches_of_one(device):
    rates, dark, tapes = (
        cube(device, (3, 34, 46)),
        device.array(RANDOM.random((34, 46), np.float32)),
        (Tape(), Tape()),
    )
    with recording(tapes[0]):
        mean = collect(rates, BAYER, 0.1, 1e-3, device=device)
    with recording(tapes[1]):
        expected = chip(mean, None, dark, dark_time=0.1, device=device)
    assert tapes[0].renumber({"exposure_time": 0.7})
    assert tapes[1].renumber({"dark_time": 2.5})
    for tape in tapes:
        tape.replay()
    fresh = collect(rates, BAYER, 0.7, 1e-3, device=device)
    np.testing.assert_array_equal(values(device, mean), values(device, fresh))
    np.testing.assert_array_equal(
        values(device, expected),
        values(device, chip(fresh, None, dark, dark_time=2.5, device=device)),
    )


def test_results_on_a_tape_of_ones_own_are_kept(device):
    """Each call's array stays as it is, also of two threads' tapes."""
    own, content, table = OwnTape(), cube(device), RANDOM.random((3, 5), np.float32)
    results = []
    for number in range(1, 5):
        with recording(own.tape):
            results.append(chain(device, content, table, 0.1 * number))
    for number, result in enumerate(results, 1):
        np.testing.assert_array_equal(
            values(device, result), values(device, chain(device, content, table, 0.1 * number))
        )


def test_a_computation_that_fails_leaves_no_trace(device):
    tape, content, table = Tape(), cube(device), RANDOM.random((3, 5), np.float32)
    with recording(tape):
        chain(device, content, table, 0.2)
    with pytest.raises(ZeroDivisionError), recording(tape):
        chain(device, content, table, 1 / 0)
    with recording(tape):
        result = chain(device, content, table, 0.4)
    np.testing.assert_array_equal(
        values(device, result), values(device, chain(device, content, table, 0.4))
    )


@pytest.mark.parametrize("device", KINDS)
def test_an_array_is_not_taken_for_one_that_is_gone(device):
    """What a step that failed had given is freed, and Python gives its place, and its `id`, to other arrays."""
    device = open_device(device)
    cache = Cache(device)
    for name in range(20):
        cache(f"first {name}", empty, device, 1)
        with pytest.raises(ZeroDivisionError):
            cache(f"first {name}", empty, device, 0)
    gc.collect()
    for name in range(20):
        made = cache(f"second {name}", empty, device, 1)
        before = cache.with_versions(made)
        assert cache(f"second {name}", empty, device, 2) is made  # written again, as by tapes
        assert cache.with_versions(made).version > before.version


def empty(device, number):
    """An array of the device; fails for 0."""
    return device.empty((2, 3 * number // number))
