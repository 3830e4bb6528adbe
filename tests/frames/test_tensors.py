"""Batches of tensors: each frame is that of its own picture, whatever else is in its batch, and of its own settings."""

import importlib.util
from dataclasses import replace

import cameras
import numpy as np
import pytest
from cameras import PHONE, camera_with
from devices import ALL_KINDS, KINDS
from PIL import Image

import gpusim as gs
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.memory import to_host

RANDOM = np.random.default_rng(8)
PICTURES = RANDOM.random((4, 3, 40, 48)).astype(np.float32)
needs_torch = pytest.mark.skipif(
    importlib.util.find_spec("torch") is None, reason="torch is not installed"
)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_frame_depends_on_its_picture_and_number_alone(device):
    """Also beside a picture with a highlight, which needs a plan of its own, and after one."""
    compared(device, None)


@pytest.mark.parametrize("device", KINDS[:1])  # every picture is planned
def test_and_so_it_does_by_a_tolerance(device):
    compared(device, "video")


def compared(device, tolerance):
    """Frames of a batch and those of the pictures one by one, in another order."""
    pictures = PICTURES.copy()
    pictures[2, :, 7, 9] = 2e4
    batch = gs.PictureBatch(PHONE, device=device, tolerance=tolerance)
    together = batch(pictures, first=30, seed=2, exposure_time=0.01)
    assert together.shape == (4, 40, 48) and together.dtype == np.uint16
    for item in (2, 0, 3, 1, 2):
        alone = batch(pictures[[item]], first=30 + item, seed=2, exposure_time=0.01)
        np.testing.assert_array_equal(alone[0], together[item])
    assert (batch(pictures, first=31, seed=2, exposure_time=0.01) != together).mean() > 0.5


@pytest.mark.parametrize("tolerance", [None, "video"])
def test_each_picture_has_its_number_and_seed(tolerance):
    batch = gs.PictureBatch(PHONE, device=KINDS[0], tolerance=tolerance)
    numbers, seeds = np.array([7, 3, 3, 2**31]), [1, 1, 2, 0]
    together = batch(PICTURES, first=numbers, seed=seeds, exposure_time=0.01)
    for item, (number, seed) in enumerate(zip(numbers, seeds, strict=True)):
        alone = batch(PICTURES[[item]], first=int(number), seed=seed, exposure_time=0.01)
        np.testing.assert_array_equal(alone[0], together[item])
    with pytest.raises(OutOfRange, match="first"):
        batch(PICTURES, first=[1, 2, 3, 0.5])
    with pytest.raises(BadData, match="3 of first"):
        batch(PICTURES, first=[1, 2, 3])


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize("output", ["raw", "linear", "codes", "mean"])
def test_frames_are_those_of_scenes(device, output):
    """Of linear sRGB as reflectances in D65: that of the scene that `gs.open_scene` makes of a photograph, exact."""
    batch, simulator = (
        gs.PictureBatch(PHONE, device=device, output=output),
        gs.Simulator(PHONE, device=device),
    )
    found = batch(PICTURES, first=5, seed=1, exposure_time=0.02)
    for item, linear in enumerate(PICTURES):
        content = gs.picture(np.zeros((2, 2, 3), np.uint8)).content
        scene = gs.Scene(
            gs.Basis(content.wavelengths, linear, content.basis),
            gs.picture(np.zeros((2, 2, 3), np.uint8)).illuminant,
        )
        loop = simulator.loop(scene, 0.02)
        expected = np.array(simulator.device.numpy(loop.output(output, seed=1, first=5 + item)))
        if output == "codes":  # of which the device has the channels last
            expected = np.moveaxis(expected, -1, 0)
        assert found[item].shape == ((40, 48) if output in ("raw", "mean") else (3, 40, 48))
        np.testing.assert_array_equal(found[item], expected)


@pytest.mark.parametrize("device", KINDS)
def test_spectral_pictures_are_cubes(device):
    scene = cameras.cubes(1, (48, 32))[0]
    values = np.asarray(scene.content.values, np.float32)[None]
    simulator = gs.Simulator(PHONE, device=device)
    for light, lit in (("D65", gs.picture(np.zeros((2, 2), np.uint8)).illuminant), (None, None)):
        batch = gs.PictureBatch(
            PHONE, device=device, output="mean", wavelengths=scene.content.wavelengths, light=light
        )
        if lit is None:
            from gpusim.domain.scene import unit_light

            lit = unit_light(scene.content.wavelengths)
        expected = simulator.loop(
            gs.Scene(gs.Cube(scene.content.wavelengths, values[0]), lit), 0.01
        ).output("mean")
        np.testing.assert_array_equal(
            batch(values, exposure_time=0.01)[0], simulator.device.numpy(expected)
        )


@pytest.mark.parametrize("device", KINDS)
def test_settings_of_each_picture(device):
    cameras = [
        camera_with(noise={"read": 1.0}),
        camera_with(noise={"read": 30.0}),
        camera_with(optics={"f_number": 8.0}),
        camera_with(processor={"white_balance": "none"}),
    ]
    times, gains = [0.01, 0.02, 0.01, 0.005], [1.0, 1.0, 2.0, 1.0]
    batch = gs.PictureBatch(PHONE, device=device, output="codes")
    for turn in range(2):
        found = batch(PICTURES, first=4 * turn, exposure_time=times, gain=gains, camera=cameras)
        for item, camera in enumerate(cameras):
            alone = gs.PictureBatch(camera, device=device, output="codes")(
                PICTURES[[item]], first=4 * turn + item, exposure_time=times[item], gain=gains[item]
            )
            np.testing.assert_array_equal(found[item], alone[0])


def test_grey_halves_and_other_shapes():
    batch = gs.PictureBatch(PHONE, device="numpy", output="mean")
    grey, colour = (
        batch(np.full((1, channels, 20, 24), 0.5, np.float16), exposure_time=0.01)
        for channels in (1, 3)
    )
    np.testing.assert_allclose(
        grey, colour, rtol=2e-3
    )  # the primaries' sum is 1 within 1e-3 at every wavelength
    for shape in [(2, 1, 16, 16 + n) for n in range(6)]:
        assert batch(np.ones(shape, np.float32), exposure_time=0.01).shape == (2, *shape[2:])


@pytest.mark.parametrize(
    "asked, error, words",
    [
        (np.ones((3, 8, 8)), BadData, "wanted (pictures, channels, rows, cols)"),
        (np.ones((1, 4, 8, 8)), BadData, "1 or 3 channels"),
        (np.ones((0, 3, 8, 8)), BadData, "pictures: (0, 3, 8, 8)"),
        (np.ones((1, 3, 8, 8), np.uint8), BadData, "linear light, not codes"),
        ("pictures", BadData, "wanted an array"),
        (-np.ones((1, 3, 8, 8)), BadData, "negative"),
        (np.full((1, 3, 8, 8), np.nan), BadData, "NaN"),
    ],
)
def test_bad_pictures(asked, error, words):
    with pytest.raises(error) as raised:
        gs.PictureBatch(PHONE, device="numpy")(asked, exposure_time=0.01)
    assert words in str(raised.value) and "\n" not in str(raised.value)


def test_bad_settings():
    with pytest.raises(UnknownName, match="output"):
        gs.PictureBatch(PHONE, device="numpy", output="rgb")
    with pytest.raises(OutOfRange, match="light"):
        gs.PictureBatch(PHONE, device="numpy", light=None)
    for tolerance in (None, "video"):
        with pytest.raises(BadData, match="3 of exposure_time"):
            gs.PictureBatch(PHONE, device="numpy", tolerance=tolerance)(
                PICTURES, exposure_time=[0.1] * 3
            )


@needs_torch
@pytest.mark.parametrize("device", KINDS)
def test_tensors_give_tensors_without_gradients(device):
    import torch

    from gpusim.apps.tensors.torch import Frames

    expected = gs.PictureBatch(PHONE, device=device)(PICTURES, exposure_time=0.01)
    given = torch.from_numpy(PICTURES).requires_grad_()
    found = Frames(PHONE, device=device)(given, exposure_time=0.01)
    assert isinstance(found, torch.Tensor) and not found.requires_grad
    np.testing.assert_array_equal(to_host(found, "test"), expected)
    again = Frames(PHONE, device=device)(given, exposure_time=0.01, first=4)
    assert (again != found).float().mean() > 0.5  # and what was given before is not written over
    np.testing.assert_array_equal(to_host(found, "test"), expected)


@pytest.mark.parametrize("tolerance", [None, "video"])
def test_settings_as_arrays_and_tensors(tolerance):
    times = np.array([0.01, 0.02, 0.005, 0.01])
    batch = gs.PictureBatch(PHONE, device="numpy", tolerance=tolerance)
    expected = batch(PICTURES, exposure_time=times.tolist(), gain=2.0)
    np.testing.assert_array_equal(
        batch(PICTURES, exposure_time=times, gain=np.array(2.0)), expected
    )
    if importlib.util.find_spec("torch"):
        import torch

        np.testing.assert_array_equal(
            batch(PICTURES, exposure_time=torch.from_numpy(times), gain=2.0), expected
        )


@pytest.mark.parametrize("device", KINDS)
def test_a_batch_that_was_refused_leaves_nothing_for_the_next(device):
    """Also where the device alone sees the pictures: those of the next call are good."""
    batch = gs.PictureBatch(PHONE, device=device)
    expected = batch(PICTURES, exposure_time=0.01)
    there = batch.simulator.device
    bad = PICTURES.copy()
    bad[1:3, :, 3, 3] = np.nan
    with pytest.raises(BadData, match="NaN"):
        batch(there.array(bad), exposure_time=0.01)
    np.testing.assert_array_equal(batch(there.array(PICTURES), exposure_time=0.01), expected)


@needs_torch
@pytest.mark.slow  # every worker starts Python, gpusim and a device
@pytest.mark.parametrize("device", KINDS)
def test_workers_of_a_loader_make_the_same_pairs(device, tmp_path):
    import torch
    from torch.utils.data import DataLoader

    from gpusim.apps.tensors.torch import PairSet, PairStream

    for number in range(3):
        Image.fromarray(np.uint8(255 * RANDOM.random((24, 30, 3)))).save(tmp_path / f"{number}.png")
    pairs = PairSet(
        sorted(tmp_path.iterdir()),
        PHONE,
        vary="exposure=1/200..1/20",
        each=2,
        device=device,
        seed=3,
        pictures=True,
    )
    expected = [pairs[number] for number in range(len(pairs))]
    assert expected[0]["rgb"].shape == (3, 24, 30) and expected[0]["clean"].dtype == torch.float32
    for workers in (1, 2):
        loaded = list(
            DataLoader(pairs, batch_size=None, num_workers=workers, multiprocessing_context="spawn")
        )
        streamed = list(
            DataLoader(
                PairStream(pairs),
                batch_size=None,
                num_workers=workers,
                multiprocessing_context="spawn",
            )
        )
        streamed.sort(key=lambda pair: pair["record"]["frame"])
        for found in (loaded, streamed):
            assert len(found) == len(expected)
            for own, its in zip(found, expected, strict=True):
                assert own["record"] == its["record"]
                assert all(torch.equal(own[name], its[name]) for name in ("raw", "clean", "rgb"))


@needs_torch
def test_pairs_of_nothing_and_of_a_bad_range(tmp_path):
    from gpusim.apps.tensors.torch import PairSet

    with pytest.raises(BadData, match="photographs: none"):
        PairSet([], PHONE)
    with pytest.raises(BadData, match="vary: 'time=3'"):
        PairSet([tmp_path / "a.png"], PHONE, vary="time=3")
    with pytest.raises(IndexError, match="pair 4 of 1"):
        PairSet([tmp_path / "a.png"], replace(PHONE, name="x"))[4]
