"""Pictures that the network is trained on: which are used, which are left out, what is refused."""

import numpy as np
import pytest
from PIL import Image

import gpusim as gs
from gpusim.apps.network.layout import TILE
from gpusim.apps.network.pictures import find_pictures, read_tiles
from gpusim.domain.errors import BadData, BadFile, OutOfRange


@pytest.fixture
def folder(tmp_path):
    random = np.random.default_rng(1)
    shapes = {"a.png": (320, 330, 3), "grey.png": (320, 320), "small.png": (100, 400, 3)}
    for name, shape in shapes.items():
        Image.fromarray(random.integers(1, 255, shape, np.uint8)).save(tmp_path / name)
    return tmp_path


def test_pictures_in_colour_of_enough_pixels_are_used(folder):
    """Their own colours come first: roots of linear sRGB, white 65535."""
    tiles, used = read_tiles(find_pictures([folder]), [gs.open_camera("phone")], "opencl")
    assert [path.name for path in used] == ["a.png"]
    codes = np.asarray(Image.open(folder / "a.png"))[:TILE, :TILE] / 255
    linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    wanted = 65535 * np.sqrt(np.moveaxis(linear, 2, 0))
    np.testing.assert_allclose(tiles[0], wanted, atol=1)  # half a number, and float32's roundings
    assert tiles.shape[1:] == (3, TILE, TILE) and tiles.dtype == np.uint16


def test_what_is_refused(folder, tmp_path):
    with pytest.raises(BadData, match="none of 320x320 pixels or more in colour"):
        read_tiles([folder / "grey.png", folder / "small.png"], [], "opencl")
    for camera in (gs.open_camera("mono"), gs.open_camera("phone").with_(cfa=("CY", "YM"))):
        with pytest.raises(OutOfRange, match="red, green and blue filters"):
            read_tiles([folder / "a.png"], [camera], "opencl")
    (empty := tmp_path / "empty").mkdir()
    with pytest.raises(BadFile, match="has no pictures"):
        find_pictures([empty])
    with pytest.raises(BadFile, match="no such file or folder"):
        find_pictures([tmp_path / "nowhere"])
