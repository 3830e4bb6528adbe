"""Panoramas through pinholes and fisheyes to 95 degrees, against formulas of the radiance at every direction."""

from dataclasses import replace

import numpy as np
import pytest
from devices import ALL_KINDS, KINDS
from lights import as_photons
from refusals import refused

import gpusim as gs
from gpusim.domain.errors import BadData, OutOfRange

ROWS, COLS = 60, 80
PANORAMA = (512, 1024)
WAVES = np.array([500.0, 550.0, 600.0])
CORNER = np.hypot(ROWS, COLS) / 2


def radiance(right, down, ahead):
    """Band-limited over the sphere: harmonics up to the third degree."""
    return 1 + 0.3 * ahead - 0.2 * down + 0.25 * right * ahead + 0.3 * right * down * ahead


def directions(shape=PANORAMA):
    """Direction of every sample: the middle of the columns is ahead, the first row above."""
    rows, cols = shape
    latitude = (0.5 - (np.arange(rows) + 0.5) / rows) * np.pi
    longitude = ((np.arange(cols) + 0.5) / cols - 0.5) * 2 * np.pi
    right = np.cos(latitude)[:, None] * np.sin(longitude)
    ahead = np.cos(latitude)[:, None] * np.cos(longitude)
    return right, np.broadcast_to(-np.sin(latitude)[:, None], right.shape), ahead


def panorama(values=None, **more):
    values = radiance(*directions()) if values is None else values
    return gs.Scene(
        gs.Cube(WAVES, np.stack([values] * 3).astype(np.float32)),
        as_photons("D65"),
        projection="equirectangular",
        name="world",
        **more,
    )


# equidistant and bent, to 95 degrees in the corner: r = f theta (1 + k1 theta^2 + k2 theta^4)
FISHEYES = {"equidistant": (0.0, 0.0), "bent": (-0.05, 0.004)}


def fisheye_camera(name, illumination="none", corner=95.0, model="none"):
    k1, k2 = FISHEYES[name]
    theta = np.radians(corner)
    focal = CORNER / (theta * (1 + k1 * theta**2 + k2 * theta**4))
    calibration = gs.Calibration(
        COLS, ROWS, focal, focal, (COLS - 1) / 2, (ROWS - 1) / 2, (k1, k2, 0.0, 0.0), fisheye=True
    )
    return camera_with(calibration, illumination, model), focal


def camera_with(distortion, illumination="none", model="none"):
    camera = gs.open_camera("mono")
    optics = replace(
        camera.optics, model=model, distortion=distortion, relative_illumination=illumination
    )
    return replace(camera, optics=optics)


def light_of(camera, scene, device=KINDS[0]):
    simulator = gs.Simulator(camera, device=device)
    return np.array(simulator.device.numpy(simulator.expose(scene, 1e-2).mean), np.float64)


def unit():
    """Electrons of radiance 1 in a picture without a lens's geometry."""
    flat = gs.Scene(gs.Cube(WAVES, np.ones((3, 4, 4), np.float32)), as_photons("D65"))
    return light_of(camera_with(None), flat).mean()


def angles_of(height, k1, k2):
    """Angles whose images are at heights [focal length], by bisection."""
    low, high = np.zeros_like(height), np.full_like(height, 1.8)
    for _ in range(60):
        middle = (low + high) / 2
        below = middle * (1 + k1 * middle**2 + k2 * middle**4) < height
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return (low + high) / 2


def seen_by_fisheye(name, focal):
    """Direction of every pixel, its angle, and f^2 sin / (r dr/dt)."""
    k1, k2 = FISHEYES[name]
    y, x = (np.indices((ROWS, COLS)).T - (np.array([ROWS, COLS]) - 1) / 2).T / focal
    height = np.hypot(y, x)
    theta = angles_of(height, k1, k2)
    slope = 1 + 3 * k1 * theta**2 + 5 * k2 * theta**4
    ray = np.stack([x * np.sin(theta) / height, y * np.sin(theta) / height, np.cos(theta)])
    return ray, theta, np.sin(theta) / (height * slope)


def turned(ray, yaw, pitch):
    """Up by `pitch`, then to the right by `yaw`."""
    right, down, ahead = ray
    down, ahead = (
        down * np.cos(pitch) - ahead * np.sin(pitch),
        down * np.sin(pitch) + ahead * np.cos(pitch),
    )
    return (
        right * np.cos(yaw) + ahead * np.sin(yaw),
        down,
        ahead * np.cos(yaw) - right * np.sin(yaw),
    )


POSES = {"ahead": (0.0, 0.0), "behind, across the seam": (3.0, 0.2), "at the zenith": (0.4, 1.5)}


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("name", FISHEYES)
def test_a_fisheye_sees_the_radiance_of_its_rays(name, pose):
    """To 95 degrees, any pose. 512 rows, linear between: (pi / 512)^2 / 8 x 12 = 6e-5; a pixel's mean differs from its
    middle by its second derivative / 24: (1.66 / 50)^2 x 12 / 24 = 5e-4."""
    camera, focal = fisheye_camera(name)
    yaw, pitch = POSES[pose]
    seen = gs.view_panorama(panorama(), camera, yaw=yaw, pitch=pitch)
    ray, theta, spread = seen_by_fisheye(name, focal)
    assert np.degrees(theta.max()) > 93
    wanted = radiance(*turned(ray, yaw, pitch)) * spread
    found = light_of(camera, seen) / unit()
    assert np.abs(found / wanted - 1).max() < 2e-3 and np.abs(found - wanted).mean() < 5e-4


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_given_curve_is_the_image_of_an_even_panorama(device):
    """To 95 degrees: the curve to float32, and the radiance times the curve.

    Diffraction takes light over the edge of the image, q / (pi^2 r) = 1.5e-3 of it 25 pixels away.
    """
    curve = (np.linspace(0, 1, 20), 1 - 0.6 * np.linspace(0, 1, 20) ** 2)
    camera, focal = fisheye_camera("bent", curve)
    y, x = (np.arange(n) - (n - 1) / 2 for n in (ROWS, COLS))
    wanted = np.interp(np.hypot(y[:, None], x) / CORNER, *curve)
    even = light_of(camera, gs.view_panorama(panorama(np.ones(PANORAMA)), camera), device)
    assert (
        np.abs(even / even.max() - wanted / wanted.max()).max() < 1e-3
    )  # the image circle is dark beyond 95
    sharp, _ = fisheye_camera("bent", curve)
    found = light_of(sharp, gs.view_panorama(panorama(), sharp), device) / unit()
    ray, _, _ = seen_by_fisheye("bent", focal)
    assert np.abs(found / (wanted * radiance(*ray)) - 1).max() < 2e-3


BROWN = gs.Calibration(COLS, ROWS, 70.0, 72.0, 41.0, 28.0, (-0.15, 0.02, 1e-3, -1e-3, 0.0))


@pytest.mark.parametrize("lens", [None, BROWN])
def test_a_panorama_and_a_plane_of_one_world_give_one_frame(lens):
    """With the cos^4 law: the plane's frame, which other tests judge, from other samples of the same radiance."""
    camera = camera_with(lens, "cos4")
    fx, fy, cx, cy = (70.0, 72.0, 41.0, 28.0)
    fov = None if lens else 2 * np.arctan(COLS / 2 / fx)
    if lens is None:
        fy, cx, cy = fx, (COLS - 1) / 2, (ROWS - 1) / 2
    margin = 12
    y, x = np.indices((ROWS + 2 * margin, COLS + 2 * margin)) - margin
    right, down = (x - cx) / fx, (y - cy) / fy
    length = np.sqrt(1 + right**2 + down**2)
    values = radiance(right / length, down / length, 1 / length)
    cube = gs.Cube(WAVES, np.stack([values] * 3).astype(np.float32))
    plane = gs.Scene(cube, as_photons("D65"), border="scene", margin=margin, fov=fov)
    world = gs.view_panorama(panorama(fov=fov), camera, size=(COLS, ROWS))
    found, wanted = light_of(camera, world), light_of(camera, plane)
    assert np.abs(found / wanted - 1).max() < 1e-3


def test_a_star_keeps_its_energy_per_solid_angle():
    """One sample of a panorama: radiance x solid angle x f^2, wherever it is; 128 rows, of 1.4 degrees."""
    camera, focal = fisheye_camera("equidistant")
    shape = (128, 256)
    base = light_of(camera, gs.view_panorama(panorama(np.full(shape, 1e-3)), camera))
    for row, col in ((64, 128), (40, 150), (70, 85), (64, 180)):
        values = np.full(shape, 1e-3)
        values[row, col] += 100.0
        light = light_of(camera, gs.view_panorama(panorama(values), camera)) - base
        latitude = (0.5 - (row + 0.5) / shape[0]) * np.pi
        solid = (np.pi / shape[0]) ** 2 * np.cos(latitude)
        assert light.sum() / unit() == pytest.approx(100 * solid * focal**2, rel=5e-3)


def test_fine_panoramas_are_averaged():
    """White noise of 2048 rows in pixels of 27 samples: each shows the mean of its area: 1 +- 0.29 / 27 x a few."""
    noise = np.random.default_rng(0).random((2048, 4096)) + 0.5
    camera, focal = fisheye_camera("equidistant")
    scene = gs.Scene(
        gs.Cube(WAVES[:1], noise[None].astype(np.float32)),
        as_photons("D65"),
        projection="equirectangular",
    )
    values = gs.view_panorama(scene, camera).content.values[0]
    _, _, spread = seen_by_fisheye("equidistant", focal)
    assert np.abs(values / spread - 1).std() < 2.5 * 0.29 / 22


def test_labels_of_a_panorama_are_the_nearest():
    right, down, ahead = directions()
    camera, focal = fisheye_camera("bent")
    sides = (right > 0).astype(np.uint8) + 2 * (down > 0) + 4 * (ahead > 0.5)
    seen = gs.view_panorama(panorama(labels={"side": sides.astype(np.uint8)}), camera)
    found = gs.carry_labels(seen, camera)["side"]
    ray, _, _ = seen_by_fisheye("bent", focal)
    wanted = (ray[0] > 0) + 2 * (ray[1] > 0) + 4 * (ray[2] > 0.5)
    assert (found != wanted).mean() < 0.01  # samples of 0.35 degrees at the edges between the ids
    corrected = camera.with_(lens_corrections=True)
    np.testing.assert_array_equal(gs.carry_labels(seen, corrected)["side"], found)


def test_files_hold_the_projection(tmp_path):
    scene = panorama(fov=1.0)
    for suffix in ("npz", "exr"):
        gs.save_scene(scene, tmp_path / f"a.{suffix}")
        back = gs.open_scene(tmp_path / f"a.{suffix}")
        assert back.projection == "equirectangular" and back.fov == 1.0
    flat = replace(scene, projection="plane")
    gs.save_scene(flat, tmp_path / "b.npz")
    assert (
        gs.open_scene(tmp_path / "b.npz", projection="equirectangular").projection
        == scene.projection
    )


def test_what_a_user_gets_wrong_is_said():
    camera, _ = fisheye_camera("bent", "cos4")
    with refused("cos4", "beyond 85 degrees", error=OutOfRange):
        gs.view_panorama(panorama(), camera)
    with refused("give size, columns and rows", error=BadData):
        gs.view_panorama(panorama(), camera_with(None))
    with refused("world is a panorama", "gs.view_panorama", error=BadData):
        gs.Simulator(camera, device="numpy")(panorama())
    with refused("projection", "'fishy'"):
        replace(panorama(), projection="fishy")
    with refused("depth", error=BadData):
        panorama(depth=np.ones(PANORAMA, np.float32))
    even, _ = fisheye_camera("equidistant")
    seen = gs.view_panorama(panorama(), even)
    with refused("yaw, pitch and roll", error=BadData):
        replace(seen, view=gs.View((1.0, 0.0)))
    assert "a panorama" in repr(panorama()) and "a lens's image" in repr(seen)
    with refused("image of another lens", error=BadData):
        gs.Simulator(camera_with(None), device="numpy")(seen)
    with refused('projection="equirectangular"', error=BadData):
        gs.view_panorama(gs.chart("flat"), camera)
    wide, _ = fisheye_camera("equidistant", corner=110.0)
    assert any("are dark" in note for note in gs.view_panorama(panorama(), wide).notes)
