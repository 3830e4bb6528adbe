"""Light fields: parallax by geometry, hidden surfaces, checks, and files."""

from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.content import Basis, Cube
from gpusim.domain.errors import BadData, BadFile, Conflict, DoesNotFit, GpusimError, OutOfRange
from gpusim.domain.memory import limit_memory
from gpusim.domain.scene import Layer, Scene, unit_light

SIZE = 96
WAVES = np.array([500.0, 600.0])
LIGHT = gs.chart("flat").illuminant
BASE = gs.open_camera("phone")
CAMERA = replace(BASE, optics=replace(BASE.optics, object_distance=0.5))
EDGE = 14  # [sample] parallax below, and the border's continuation


def texture(y, x):
    """A pattern of three waves at least 10 samples long."""
    waves = np.sin(0.55 * x + 1) + np.cos(0.6 * y) + np.sin(0.35 * x + 0.4 * y)
    return 0.5 + 0.12 * waves


GRID = np.indices((SIZE, SIZE)) - (SIZE - 1) / 2


def wall(distance, values=None, **changes):
    """A textured wall at one distance."""
    values = texture(*GRID) if values is None else values
    content = Cube(WAVES, np.stack([values, 0.5 * values]).astype(np.float32))
    fields = {"depth": np.full((SIZE, SIZE), float(distance)), "name": "wall"} | changes
    return Scene(content, LIGHT, **fields)


def parallax(distance, j, i, shape):
    """Displacement (down, right) [sample] by a thin lens of the text-books, without `Optics`' methods.

    The image of a thing at D is at v_D = 1 / (1 / f - 1 / D). The ray through the pupil's point p
    meets the sensor, at v, at p (v_D - v) / v_D from the image of the pupil's centre, and the lens's
    own sensor is taken in paraxial optics, to first order: (v_D - v) / v_D = v (1 / v - 1 / v_D) =
    v (1 / D - 1 / s). The picture and the pupil have the same axes, so that the sign stays.
    """
    f, s = CAMERA.optics.focal_length, CAMERA.optics.object_distance
    v = 1 / (1 / f - 1 / s)
    cells = np.array([-1 + (2 * j + 1) / shape[0], -1 + (2 * i + 1) / shape[1]])
    point = f / (2 * CAMERA.optics.f_number) * cells
    return point * v * (1 / distance - 1 / s) / CAMERA.sensor.pixel_pitch


@pytest.mark.parametrize("distance", [0.3, 0.5, 1.2, np.inf])
@pytest.mark.parametrize("slanted", [False, True])
def test_things_move_as_a_thin_lens_says(distance, slanted):
    """Cubic splines of a wave of w rad per sample err by less than w^4 / 384 < 4e-4 each (de Boor).

    A wall whose distance differs by a millionth is interpolated at places, not by one shift.
    """
    scene = wall(distance)
    if slanted and np.isfinite(distance):
        scene = replace(scene, depth=scene.depth * (1 + 1e-6 * np.arange(SIZE) / SIZE))
    shape = (3, 5)
    field = gs.light_field(scene, CAMERA, shape)
    assert field.shape == shape and field.object_distance == 0.5
    for j, i in ((0, 0), (1, 2), (2, 3)):
        down, right = parallax(distance, j, i, shape)
        wanted = texture(GRID[0] - down, GRID[1] - right)
        found = field.view(j, i).content.values
        error = np.abs(found[0] - wanted)[EDGE:-EDGE, EDGE:-EDGE].max()
        assert error < 4e-4
        assert not field.view(j, i).layers


def test_the_displacement_is_that_of_the_blur():
    """The design's -d / (2 N_w) (x, y), with d by `Optics.displacement`: the same as by geometry."""
    optics = CAMERA.optics
    for distance in (0.3, 3.0):
        d = optics.displacement(optics.diopters(distance))
        place = np.array([-1 + 1 / 3, -1 + 3 / 5])
        wanted = -d / (2 * optics.working_f_number) * place / CAMERA.sensor.pixel_pitch
        assert parallax(distance, 0, 1, (3, 5)) == pytest.approx(wanted, rel=1e-9)


def two_walls(near, far, layered):
    """A square of 0.9 at `near` before a textured wall at `far`."""
    inside = (np.abs(GRID) < 16).all(axis=0)
    if layered:
        front = Layer(Cube(WAVES, np.full((2, SIZE, SIZE), 0.9, np.float32)), inside * 1.0, near)
        return wall(far, layers=(front,))
    depth = np.where(inside, near, far)
    return replace(wall(far, np.where(inside, 0.9, texture(*GRID))), depth=depth)


def compose(scene):
    """Light of the first plane of a view with its layers, the nearest last."""
    light = np.asarray(scene.content.planes[0], np.float64)
    for layer in reversed(scene.layers):
        light = layer.alpha * layer.content.planes[0] + (1 - layer.alpha) * light
    return light


@pytest.mark.parametrize("layered", [True, False])
def test_nearer_things_hide_farther_ones(layered):
    """Away from edges, the square is 0.9 and the wall is the texture, each at its own displacement."""
    near, far, shape = 0.35, 1.5, (3, 3)
    field = gs.light_field(two_walls(near, far, layered), CAMERA, shape, spread=1.5)
    for j, i in ((0, 0), (2, 1)):
        front, back = (1.5 * parallax(one, j, i, shape) for one in (near, far))
        light = compose(field.view(j, i))
        places = np.abs(GRID - front[:, None, None]).max(axis=0)
        within, outside = places < 14, places > 18
        outside[:EDGE], outside[-EDGE:], outside[:, :EDGE], outside[:, -EDGE:] = 0, 0, 0, 0
        assert np.abs(light[within] - 0.9).max() < 1e-3
        wanted = texture(GRID[0] - back[0], GRID[1] - back[1])
        was_seen = np.abs(GRID - back[:, None, None]).max(axis=0) > 20
        clear = outside & (was_seen | layered)
        assert clear.sum() > 2000
        assert np.abs(light - wanted)[clear].max() < 1e-3
    notes = field.view(0, 0).notes
    assert any("continued" in note for note in notes) != layered


def test_forms_are_kept_and_materials_become_mixtures():
    """Materials of two halves: away from the edge between them each sample is one unit of one of them."""
    random = np.random.default_rng(3)
    ids = (GRID[1] > 0).astype(np.uint8)
    basis = Basis(WAVES, random.random((2, SIZE, SIZE), np.float32), np.eye(2) + 0.1)
    spectra = np.array([[0.2, 0.3], [0.8, 0.7]])
    halves = gs.Materials(WAVES, ids, np.ones((SIZE, SIZE), np.float32), spectra)
    for content in (basis, halves):
        scene = replace(wall(0.3), content=content)
        seen = gs.light_field(scene, CAMERA, (1, 2)).view(0, 1).content
        assert isinstance(seen, Basis)
        assert np.array_equal(seen.entry_spectra, content.entry_spectra)
    left, right = np.split(seen.planes, [SIZE // 2], axis=2)
    assert np.abs(left[:, :, :20] - [[[1]], [[0]]]).max() < 1e-5
    assert np.abs(right[:, :, -20:] - [[[0]], [[1]]]).max() < 1e-5


def test_missing_and_different_views_are_named():
    one, other = wall(1.0), wall(2.0)
    with pytest.raises(BadData, match=r"light field: of 2 x 2 views \(1, 1\) missing"):
        gs.LightField([[one, other], [one]], 1e-3)
    with pytest.raises(BadData, match=r"\(0, 1\), \(1, 0\) missing"):
        gs.LightField([[one, None], [None, one]], 1e-3)
    small = gs.chart("flat", size=(8, 6))
    cases = {
        "shape": small,
        "other wavelengths": replace(one, content=Cube(WAVES + 1, one.content.values)),
        "another light": one.brighten(2.0),
        "unit": replace(one, illuminant=unit_light(WAVES)),
        "border": replace(one, border="zero"),
        "form": replace(one, content=Basis(WAVES, one.content.values, np.eye(2)), layers=()),
        "wanted a Scene": 3,
    }
    for words, wrong in cases.items():
        with pytest.raises(BadData, match=words) as caught:
            gs.LightField([[one, wrong]], 1e-3)
        assert "(0, 1)" in str(caught.value)
    for radius in (0, -1.0, np.nan, np.inf):
        with pytest.raises(OutOfRange, match="radius"):
            gs.LightField([[one]], radius)
    with pytest.raises(OutOfRange, match=r"rows 0 \.\. 0"):
        gs.LightField([[one]], 1e-3).view(1, 0)


def test_bad_requests_are_one_line():
    with pytest.raises(BadData, match="needs the scene's depth"):
        gs.light_field(gs.chart("flat"), CAMERA)
    for views in (3, (3,), (0, 3), (3, 1000), (2.5, 3)):
        with pytest.raises(GpusimError, match="views"):
            gs.light_field(wall(1.0), CAMERA, views)
    for spread in (0, -1, np.nan, "x"):
        with pytest.raises(OutOfRange, match="spread"):
            gs.light_field(wall(1.0), CAMERA, (1, 1), spread)
    with pytest.raises(OutOfRange, match="smaller spread"):
        gs.light_field(wall(0.01), CAMERA, (3, 3), 10)
    with limit_memory(10**6), pytest.raises(DoesNotFit, match="9 x 9 views"):
        gs.light_field(wall(1.0), CAMERA)


def equal(one, other):
    """Whether two scenes have the same numbers."""
    arrays = [(one.content.planes, other.content.planes), (one.depth, other.depth)]
    for mine, its in zip(one.layers, other.layers, strict=True):
        arrays += [(mine.content.planes, its.content.planes), (mine.alpha, its.alpha)]
        arrays += [(np.broadcast_to(mine.depth, one.depth.shape), its.depth)]
    return all(np.allclose(a, b, rtol=1e-6) for a, b in arrays)


@pytest.mark.parametrize("layered", [True, False])
def test_archives_hold_all(tmp_path, layered):
    field = gs.light_field(two_walls(0.35, 1.5, layered), CAMERA, (2, 2))
    path = tmp_path / "field.npz"
    gs.save_light_field(field, path)
    back = gs.open_light_field(path)
    assert (back.shape, back.radius, back.object_distance) == ((2, 2), field.radius, 0.5)
    assert back.name == field.name and back.view(0, 1).name == "wall"
    for j in range(2):
        for i in range(2):
            assert equal(field.view(j, i), back.view(j, i))
    with pytest.raises(BadFile, match=r"gs\.open_light_field"):
        gs.open_scene(path)
    arrays = dict(np.load(path))
    short = {key: value for key, value in arrays.items() if not key.startswith("view_01_00")}
    np.savez(path, **short)
    with pytest.raises(BadFile, match=r"of 2 x 2 views \(1, 0\) missing"):
        gs.open_light_field(path)
    np.savez(path, **arrays, **{"view_02_00.cube": arrays["view_00_00.cube"]})
    with pytest.raises(BadFile, match="view_02_00 is outside"):
        gs.open_light_field(path)
    with pytest.raises(Conflict, match="radius"):
        gs.open_light_field(path, radius=1e-3)


def test_folders_of_exr_files(tmp_path):
    field = gs.light_field(wall(0.4), CAMERA, (2, 3))
    folder = tmp_path / "views"
    gs.save_light_field(field, folder)
    assert sorted(file.name for file in folder.glob("*.exr"))[-1] == "view_01_02.exr"
    back = gs.open_light_field(folder)
    assert (back.shape, back.radius, back.object_distance) == ((2, 3), field.radius, 0.5)
    for j, i in ((0, 0), (1, 2)):
        assert equal(field.view(j, i), back.view(j, i))
    with pytest.raises(BadFile, match=r"has \.exr files already"):
        gs.save_light_field(field, folder)
    (folder / "light_field.json").unlink()
    with pytest.raises(OutOfRange, match=r"light_field\.json"):
        gs.open_light_field(folder)
    again = gs.open_light_field(folder / "view_*.exr", radius=2e-3, views=(2, 3))
    assert again.radius == 2e-3 and again.object_distance == np.inf
    # numbered from 1, as renderers do
    for j in (1, 0):
        for i in (2, 1, 0):
            (folder / f"view_{j:02d}_{i:02d}.exr").rename(folder / f"cam{j + 1}_{i + 1}.exr")
    assert equal(gs.open_light_field(folder, radius=1e-3).view(1, 2), field.view(1, 2))
    moved = folder / "cam1_2.exr"
    moved.rename(folder / "other.exr")
    with pytest.raises(BadFile, match=r"other\.exr: no view"):
        gs.open_light_field(folder, radius=1e-3)
    (folder / "other.exr").rename(folder / "cam2_02.exr")
    with pytest.raises(BadFile, match="the same view as"):
        gs.open_light_field(folder, radius=1e-3)
    (folder / "cam2_02.exr").unlink()
    with pytest.raises(BadFile, match=r"of 2 x 3 views \(0, 1\) missing"):
        gs.open_light_field(folder, radius=1e-3)
    with pytest.raises(BadFile, match="outside the 1 x 3 views"):
        gs.open_light_field(folder, radius=1e-3, views=(1, 3))


def test_files_with_one_number(tmp_path):
    field = gs.light_field(wall(0.4), CAMERA, (2, 2))
    for number in range(4):
        gs.save_scene(field.view(*divmod(number, 2)), tmp_path / f"render{number + 1}.exr")
    with pytest.raises(BadFile, match=r"give views=\(rows, columns\)"):
        gs.open_light_field(tmp_path, radius=1e-3)
    back = gs.open_light_field(tmp_path, radius=1e-3, views=(2, 2))
    assert equal(back.view(1, 0), field.view(1, 0))
    with pytest.raises(BadFile, match="2 x 3 views"):
        gs.open_light_field(tmp_path, radius=1e-3, views=(2, 3))
    for path in ("absent", tmp_path / "*.tif", tmp_path / "empty"):
        with pytest.raises(BadFile):
            gs.open_light_field(path, radius=1e-3)


def test_layers_need_an_archive(tmp_path):
    field = gs.light_field(two_walls(0.35, 1.5, True), CAMERA, (1, 2))
    with pytest.raises(BadFile, match=r"layers, which an \.exr cannot hold; save an \.npz"):
        gs.save_light_field(field, tmp_path / "views")
    assert not (tmp_path / "views").exists()
