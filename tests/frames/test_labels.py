"""Labels go where the light goes: ids, depth, boxes and flow through axis, distortion, view, binning and finer samples.

The forward mapping is written here: it shares nothing with the frame or with `carry_labels`.
"""

from dataclasses import replace

import numpy as np
import pytest
from devices import KINDS
from lights import as_photons
from refusals import refused

import gpusim as gs
from gpusim.domain.errors import BadData

ROWS, COLS = 96, 128
CALIBRATION = gs.Calibration(COLS, ROWS, 110.0, 112.0, 70.0, 44.0, (-0.2, 0.05, 1e-3, -2e-3, 0.0))
FISHEYE = gs.Calibration(COLS, ROWS, 80.0, 80.0, 60.0, 50.0, (0.02, -0.01, 0.0, 0.0), fisheye=True)


def forward(y, x, calibration, view, ratio, start=0.0):
    """Pixel, as an index, at which a point of the scene is seen; y and x are indices of samples.

    The frame is in the middle of the samples.
    """
    rows, cols = ratio * ROWS, ratio * COLS
    y, x = y - (rows - 1) / 2 - ratio * view.shift[0], x - (cols - 1) / 2 - ratio * view.shift[1]
    turn = view.zoom * np.exp(-1j * view.rotation)  # x + i y, turned back and magnified
    at = (x + 1j * y) * turn
    y, x = at.imag / ratio, at.real / ratio  # [pixel] from the middle
    if calibration is not None:
        cx, cy = calibration.cx - (COLS - 1) / 2, calibration.cy - (ROWS - 1) / 2
        u, v = (x - cx) / calibration.fx, (y - cy) / calibration.fy
        q = u * u + v * v
        if calibration.fisheye:
            k1, k2, k3, k4 = calibration.coefficients
            theta = np.arctan(np.sqrt(q))
            t = theta**2
            factor = np.where(
                q > 0,
                theta
                * (1 + t * (k1 + t * (k2 + t * (k3 + t * k4))))
                / np.sqrt(np.maximum(q, 1e-300)),
                1.0,
            )
            u, v = u * factor, v * factor
        else:
            k1, k2, p1, p2, k3 = calibration.coefficients
            factor = 1 + q * (k1 + q * (k2 + q * k3))
            u, v = (
                u * factor + 2 * p1 * u * v + p2 * (q + 2 * u * u),
                v * factor + p1 * (q + 2 * v * v) + 2 * p2 * u * v,
            )
        x, y = u * calibration.fx + cx, v * calibration.fy + cy
    return y + (ROWS - 1) / 2, x + (COLS - 1) / 2


VIEWS = {"plain": gs.View(), "turned": gs.View((3.3, -5.2), 0.3, 1.4)}
LENSES = {"pinhole": None, "Brown-Conrady": CALIBRATION, "fisheye": FISHEYE}
# of ids, in shares of the scene
SQUARES = ((0.30, 0.35), (0.45, 0.70), (0.65, 0.45))
SIDE = 0.12


def scene_of(ratio, view, **more):
    """Squares that shine and have ids 1, 2, 3 on a dark ground of id 0."""
    ids = np.zeros((ratio * ROWS, ratio * COLS), np.int32)
    boxes = []
    for number, (top, left) in enumerate(SQUARES, 1):
        y, x = int(top * len(ids)), int(left * ids.shape[1])
        side = int(SIDE * len(ids))
        ids[y : y + side, x : x + side] = number
        boxes.append((y, x, y + side, x + side))
    light = np.where(ids > 0, 1.0, 1e-3).astype(np.float32)
    return gs.Scene(
        gs.Cube(np.array([500.0, 550.0, 600.0]), np.stack([light] * 3)),
        as_photons("D65"),
        samples_per_pixel=float(ratio),
        view=view,
        labels={"instance": ids, "boxes": np.array(boxes, float)},
        **more,
    )


def camera_of(lens, **changes):
    camera = gs.open_camera("mono")
    optics = replace(
        camera.optics, model="none", relative_illumination="none", distortion=LENSES[lens]
    )
    return replace(camera, optics=optics, sensor=replace(camera.sensor, **changes))


@pytest.mark.parametrize("ratio", [1, 2])
@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("lens", LENSES)
def test_ids_and_boxes_land_where_the_light_lands(lens, view, ratio):
    """Centroids of ids against the light's, and against the forward formula; sides of boxes to 1e-3 of a pixel.

    A centroid of whole pixels is off by rounding at its rim: each side moves by up to half a sample; if the
    middle of pixels lies between two samples, all by 1 / 4 of a pixel to the same side. Together below half a pixel.
    """
    scene, camera = scene_of(ratio, VIEWS[view]), camera_of(lens)
    labels = gs.carry_labels(scene, camera)
    ids = labels["instance"]
    assert (
        ids.shape == (ROWS, COLS) and ids.dtype == np.int32 and set(np.unique(ids)) <= {0, 1, 2, 3}
    )
    simulator = gs.Simulator(camera, device=KINDS[0])
    light = np.array(simulator.device.numpy(simulator.expose(scene, 1e-2).mean), np.float64)
    y, x = np.indices(ids.shape)
    seen = 0
    for number, box in enumerate(scene.labels["boxes"], 1):
        share = np.linspace(0, 1, 2001)
        top, left, bottom, right = box - 0.5  # indices of samples
        outline = (
            np.concatenate(
                [top + 0 * share, bottom + 0 * share, *[top + (bottom - top) * share] * 2]
            ),
            np.concatenate(
                [*[left + (right - left) * share] * 2, left + 0 * share, right + 0 * share]
            ),
        )
        rows, cols = forward(*outline, LENSES[lens], VIEWS[view], ratio)
        wanted = np.clip(
            [rows.min() + 0.5, cols.min() + 0.5, rows.max() + 0.5, cols.max() + 0.5],
            0,
            [ROWS, COLS] * 2,
        )
        assert labels["boxes"][number - 1] == pytest.approx(wanted, abs=2e-3)
        inside = np.array([4, 4, ROWS - 4, COLS - 4])
        if (wanted[:2] < inside[:2]).any() or (wanted[2:] > inside[2:]).any():
            continue  # cut by the frame
        own = ids == number
        window = np.s_[
            int(wanted[0]) - 3 : int(wanted[2]) + 4, int(wanted[1]) - 3 : int(wanted[3]) + 4
        ]
        weight = light[window] - light[window].min()
        for places in (y, x):
            by_light = (weight * places[window]).sum() / weight.sum()
            assert places[own].mean() == pytest.approx(by_light, abs=0.5)
        seen += 1
    assert seen >= 2


@pytest.mark.parametrize("lens", LENSES)
def test_every_pixel_has_the_id_of_the_sample_it_looks_at(lens):
    """Ids that are the sample's number: mapped forward, the sample lands within its pixel, half a sample around it.

    Along each axis half a pixel plus half a sample's image, which is at most 1.3 pixels here.
    """
    numbers = np.arange(ROWS * COLS).reshape(ROWS, COLS)
    scene = replace(scene_of(1, VIEWS["plain"]), labels={"number": numbers})
    found = gs.carry_labels(scene, camera_of(lens))["number"]
    rows, cols = np.divmod(found, COLS)
    y, x = forward(rows, cols, LENSES[lens], VIEWS["plain"], 1)
    at = np.indices(found.shape)
    inside = (rows > 0) & (rows < ROWS - 1) & (cols > 0) & (cols < COLS - 1)
    assert inside.mean() > 0.5
    assert np.abs(y - at[0])[inside].max() < 0.7 and np.abs(x - at[1])[inside].max() < 0.7


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("lens", LENSES)
def test_flow_is_the_difference_of_mapped_points(lens, view):
    """A shift that grows over the scene: forward formula of both ends, 1e-3 of a pixel."""
    y, x = np.indices((ROWS, COLS))
    flow = np.stack([0 * y + 1.5, 0 * x - 2.25], -1)
    scene = replace(scene_of(1, VIEWS[view]), labels={"flow": flow.astype(np.float32)})
    found = gs.carry_labels(scene, camera_of(lens))["flow"]
    # of points on a grid: where they are seen now and then
    points = np.meshgrid(np.linspace(30, 66, 7), np.linspace(40, 90, 9), indexing="ij")
    now = np.array(forward(*points, LENSES[lens], VIEWS[view], 1))
    then = np.array(forward(points[0] + 1.5, points[1] - 2.25, LENSES[lens], VIEWS[view], 1))
    inside = (now[0] > 1) & (now[0] < ROWS - 2) & (now[1] > 1) & (now[1] < COLS - 2)
    assert inside.sum() > 20
    first = np.floor(now).astype(int)
    part = now - first
    for axis in (
        0,
        1,
    ):  # the mapping is smooth: linear between pixels errs by its second derivative / 8
        near = [
            [
                found[np.clip(first[0] + i, 0, ROWS - 1), np.clip(first[1] + j, 0, COLS - 1), axis]
                for j in (0, 1)
            ]
            for i in (0, 1)
        ]
        between = (1 - part[0]) * ((1 - part[1]) * near[0][0] + part[1] * near[0][1]) + part[0] * (
            (1 - part[1]) * near[1][0] + part[1] * near[1][1]
        )
        assert np.abs(between - (then - now)[axis])[inside].max() < 1e-3


@pytest.mark.parametrize("lens", LENSES)
def test_depth_of_a_slanted_plane_is_linear_in_its_inverse(lens):
    """1 / depth of a plane is affine over a pinhole's picture: exact. At an edge no depths are mixed."""
    y, x = np.indices((ROWS, COLS))
    inverse = 0.5 + 1e-3 * y - 5e-4 * x
    wall = (x > 80) & (y > 50)
    depth = np.where(wall, 0.8, 1 / inverse).astype(np.float32)
    scene = replace(scene_of(1, VIEWS["plain"]), labels={}, depth=depth)
    found = gs.carry_labels(scene, camera_of(lens))["depth"]
    assert found.dtype == np.float32
    values = np.unique(found[(found < 1.2)])
    assert values == pytest.approx(0.8)  # nothing between the wall and the plane
    # forward: samples land at places; the depth there
    at_y, at_x = forward(y, x, LENSES[lens], VIEWS["plain"], 1)
    rows, cols = np.rint(at_y).astype(int), np.rint(at_x).astype(int)
    inside = (rows > 3) & (rows < ROWS - 4) & (cols > 3) & (cols < COLS - 4) & ~wall
    inside &= ~((x > 76) & (y > 46))
    near = 1 / found[rows[inside], cols[inside]].astype(float)
    # at the pixel's middle, up to half a pixel from where the sample lands: 0.5 x 1.3 x 1.1e-3
    assert np.abs(near - inverse[inside]).max() < 1.5e-3


def test_binned_pixels_have_labels_at_the_middle_of_their_parts():
    """2 x 2 of monochrome pixels: the mean of their places; in a Bayer mosaic the parts are two apart."""
    numbers = np.arange(ROWS * COLS).reshape(ROWS, COLS)
    scene = replace(
        scene_of(1, VIEWS["plain"]), labels={"number": numbers, "boxes": [[8, 16, 24, 40]]}
    )
    found = gs.carry_labels(scene, camera_of("pinhole", binning=(2, 2)))
    assert found["number"].shape == (ROWS // 2, COLS // 2)
    rows, cols = np.divmod(found["number"], COLS)
    assert (rows == 2 * np.arange(ROWS // 2)[:, None] + 1).all() and (cols % 2 == 1).all()
    assert found["boxes"].tolist() == [[4, 8, 12, 20]]
    phone = gs.open_camera("phone")
    bayer = replace(
        phone,
        optics=replace(phone.optics, distortion=None),
        sensor=replace(phone.sensor, binning=(2, 2)),
    )
    rows = gs.carry_labels(scene, bayer)["number"][:, 0] // COLS
    assert rows[:4].tolist() == [1, 2, 5, 6]


def test_borders_and_margins():
    """Beyond the scene: continued, mirrored, or nothing; a margin is part of the labels."""
    numbers = np.arange(1, ROWS * COLS + 1).reshape(ROWS, COLS)
    moved = gs.View((0.0, -10.0))
    plain = replace(scene_of(1, moved), labels={"number": numbers}, depth=None)
    edge = gs.carry_labels(plain, camera_of("pinhole"))["number"]
    assert (edge[:, :11] == numbers[:, :1]).all() and (edge[:, 10:] == numbers[:, :-10]).all()
    mirrored = gs.carry_labels(replace(plain, border="reflect"), camera_of("pinhole"))["number"]
    assert (mirrored[:, 9::-1] == numbers[:, :10]).all()
    nothing = gs.carry_labels(replace(plain, border="zero"), camera_of("pinhole"))["number"]
    assert (nothing[:, :10] == 0).all()
    wide = replace(plain, border="scene", margin=12, view=gs.View())
    cut = gs.carry_labels(wide, camera_of("pinhole"))["number"]
    assert (cut == numbers[12:-12, 12:-12]).all()


def test_frames_files_batches_and_pairs_have_labels(tmp_path):
    """The same arrays by every path; a scene without labels has none."""
    scene = replace(
        scene_of(1, VIEWS["plain"]),
        depth=np.full((ROWS, COLS), 2.0, np.float32),
    )
    camera = camera_of("fisheye")
    wanted = gs.carry_labels(scene, camera)
    assert set(wanted) == {"depth", "instance", "boxes"}
    simulator = gs.Simulator(camera, device=KINDS[0])
    frame = simulator.expose(scene, 1e-2).frame()
    for name, label in wanted.items():
        assert (frame.labels[name] == label).all()
    frame.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as held:
        assert (held["label_instance"] == wanted["instance"]).all()
        assert (held["label_boxes"] == wanted["boxes"]).all()
        assert (held["depth_m"] == wanted["depth"]).all()
    gs.save_scene(scene, tmp_path / "scene.npz")
    back = gs.open_scene(tmp_path / "scene.npz")
    assert all((back.labels[name] == label).all() for name, label in scene.labels.items())
    plain = replace(scene, labels={}, depth=None)
    assert simulator.expose(plain, 1e-2).frame().labels == {}


def test_openexr_holds_ids(tmp_path):
    """gpusim's channels, and Blender's indices of objects and materials as another program writes them."""
    import OpenEXR

    scene = scene_of(1, VIEWS["plain"])
    ids = scene.labels["instance"]
    gs.save_scene(replace(scene, labels={"instance": ids, "wall": ids > 0}), tmp_path / "a.exr")
    back = gs.open_scene(tmp_path / "a.exr").labels
    assert (back["instance"] == ids).all() and (back["wall"] == (ids > 0)).all()
    channels = {name: np.ones((ROWS, COLS), np.float32) for name in "RGB"}
    channels["ViewLayer.IndexOB.X"] = ids.astype(np.float32)
    channels["ViewLayer.IndexMA.X"] = ids.astype(np.uint32) * 2
    OpenEXR.File({}, channels).write(str(tmp_path / "blender.exr"))
    read = gs.open_scene(tmp_path / "blender.exr").labels
    assert (read["instance"] == ids).all() and (read["material"] == 2 * ids).all()
    channels["ViewLayer.IndexOB.X"] = ids.astype(np.float32) + np.float32(0.5)
    OpenEXR.File({}, channels).write(str(tmp_path / "half.exr"))
    with refused("half.exr", "IndexOB", "whole numbers"):
        gs.open_scene(tmp_path / "half.exr")
    with refused("boxes or flow"):
        gs.save_scene(scene, tmp_path / "b.exr")
    with refused("2^24"):
        gs.save_scene(replace(scene, labels={"far": ids + 2**25}), tmp_path / "b.exr")


@pytest.mark.parametrize(
    ("labels", "message"),
    [
        ({"instance": np.zeros((3, 4), int)}, "label instance, int64 (3, 4), wanted whole numbers"),
        ({"instance": np.zeros((ROWS, COLS))}, "float64"),
        ({"flow": np.zeros((ROWS, COLS))}, "shape (96, 128, 2)"),
        ({"flow": np.full((ROWS, COLS, 2), np.nan)}, "label flow is not finite"),
        ({"boxes": [[0, 0, 1]]}, "shape (1, 4)"),
        ({"boxes": [[5, 0, 1, 4]]}, "top <= bottom"),
        ({"depth": np.ones((ROWS, COLS), int)}, "depth is an argument of its own"),
        ({"a b": np.ones((ROWS, COLS), int)}, "letters, digits"),
        ({"instance": [[1, 2], [3]]}, "label instance: wanted an array"),
        ([1], "labels list, wanted a dict"),
    ],
)
def test_labels_that_do_not_fit_are_refused(labels, message):
    with refused(message, error=BadData):
        replace(scene_of(1, VIEWS["plain"]), labels=labels)
