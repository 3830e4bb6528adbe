"""All forms of one content say the same of it."""

import numpy as np
import pytest

from gpusim.domain.content import Basis, Cube, Materials, Picture
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.illuminated import Illuminated
from gpusim.domain.scene import Scene, unit_light

WAVELENGTHS = np.linspace(400, 700, 7)
RANDOM = np.random.default_rng(3)
SPECTRA = RANDOM.uniform(0.1, 1, (4, 7))
IDS = RANDOM.integers(0, 4, (5, 6)).astype(np.uint8)
SHADING = RANDOM.uniform(0.2, 2, (5, 6)).astype(np.float32)
# every sample is one spectrum times a number
TRUTH = np.moveaxis(SHADING[..., None].astype(float) * SPECTRA[IDS], -1, 0)
ONE_OF_FOUR = np.stack([(IDS == k) * SHADING for k in range(4)]).astype(np.float32)
# every sample's shading has a code of its own
CODES = (IDS[..., None] == np.arange(4)) * (200 * np.arange(1, 31).reshape(5, 6, 1)).astype(
    np.uint16
)
CURVE = np.zeros(2**16, np.float32)
CURVE[200 * np.arange(1, 31)] = SHADING.ravel()
FORMS = {
    "cube": Cube(WAVELENGTHS, TRUTH.astype(np.float32)),
    "basis": Basis(WAVELENGTHS, ONE_OF_FOUR, SPECTRA),
    "materials": Materials(WAVELENGTHS, IDS, SHADING, SPECTRA),
    "picture": Picture(WAVELENGTHS, CODES, SPECTRA, CURVE),
    "illuminated": Illuminated(
        WAVELENGTHS, ONE_OF_FOUR, np.ones((1, 5, 6), np.float32), np.ones((1, 7)), SPECTRA
    ),
}
ROUNDING = 2e-7  # float32 samples, once more in sums that are float32: 2 x 6e-8 and the sum's own


@pytest.fixture(params=FORMS)
def content(request):
    found = FORMS[request.param]
    assert found.form == request.param
    return found


def close(found, truth):
    np.testing.assert_allclose(found, truth, rtol=4 * ROUNDING, atol=ROUNDING)


def test_spectra_and_sums(content):
    weights = RANDOM.uniform(-1, 1, (3, 7))
    assert content.shape == (5, 6) and content.lit.all()
    close(content.bands_at(np.array([1, 4])), TRUTH[:, [1, 4]])
    close(content.mean_spectrum(), TRUTH.mean(axis=(1, 2)))
    window = (slice(1, 4), slice(2, 6))
    close(content.weigh(weights, window), np.tensordot(weights, TRUTH[:, 1:4, 2:6], 1))
    close(content.brightness(weights[0] ** 2), np.tensordot(weights[0] ** 2, TRUTH, 1))
    rates = weights @ content.entry_spectra.T
    close(content.mix(rates, np.array([0, 3])), np.tensordot(weights, TRUTH[:, [0, 3]], 1))
    close(content.used(np.array([0, 3])) @ content.entry_spectra, TRUTH[:, [0, 3]].sum(axis=(1, 2)))


def test_points(content):
    rows, cols = np.array([0, 2, 4]), np.array([5, 5, 1])
    spectra, light, strength = content.points(rows, cols)
    close(strength[:, None] * spectra[light], TRUTH[:, rows, cols].T)


def test_other_samples_and_other_light(content):
    rows, cols = np.array([[0, 2]]), np.array([[5, 1]])
    close(cube(content.take(rows, cols)), TRUTH[:, [0, 2], [5, 1]][:, None])
    close(cube(content.scale(2.5)), 2.5 * TRUTH)
    light = np.linspace(1, 3, 7)
    close(cube(content.divide_by(light)), TRUTH / light[:, None, None])
    mask = RANDOM.random((5, 6)) < 0.5
    front = content.take(*np.meshgrid(np.arange(5)[::-1], np.arange(6), indexing="ij"))
    close(cube(content.behind(front, mask)), np.where(mask, TRUTH[:, ::-1], TRUTH))
    darker = content.with_planes(content.planes * np.float32(0.5))
    close(cube(darker), TRUTH / 2)


def cube(content):
    return content.bands_at(np.arange(content.shape[0]))


def test_what_is_alike(content):
    for other in FORMS.values():
        assert content.is_like(other) is (other is content)
    if content.form in ("picture", "illuminated"):  # its light in other numbers is a basis
        assert content.with_planes(2 * content.planes).is_like(FORMS["basis"])
        assert content.is_like(content.with_samples(np.flip))
    if content.form == "picture":
        assert not content.is_like(Picture(WAVELENGTHS, CODES, SPECTRA, CURVE / 2))
    if content.form in ("cube", "basis", "materials"):
        assert content.is_like(content.with_planes(2 * content.planes))
    assert (content.labels is None) is (content.form != "materials")
    assert content.is_spectral is (content.form == "cube")
    # float32 samples, and ids as the 16 bits that devices take; codes of 16 bits, and what they are decoded to;
    # maps and surfaces, and their products
    assert (
        content.nbytes
        == {
            "cube": 4 * 7 * 30,
            "basis": 4 * 4 * 30,
            "materials": 6 * 30,
            "picture": (2 + 4) * 4 * 30,
            "illuminated": 4 * (4 + 1 + 4) * 30,
        }[content.form]
    )


def test_bad_content(content):
    with pytest.raises(BadData, match="NaN or infinite samples"):
        content.with_planes(content.planes * np.float32(np.nan)).check("s")
    if content.form in ("cube", "materials"):
        with pytest.raises(BadData, match="negative samples"):
            content.with_planes(-content.planes).check("s")
    with pytest.raises(BadData, match=r"zero-size|do not match|must be one"):
        content.with_planes(content.planes[..., :0]).check("s")


def test_what_is_no_content():
    with pytest.raises(
        BadData, match="content ndarray, wanted a Cube, Basis, Materials, Picture or Illuminated"
    ):
        Scene(TRUTH, unit_light(WAVELENGTHS))
    with pytest.raises(OutOfRange, match=r"material id = 9: allowed is 0 \.\. 3"):
        Materials(WAVELENGTHS, np.full((5, 6), 9), SHADING, SPECTRA).check("s")


def test_a_picture_is_read_by_the_host_as_a_basis():
    content, basis = FORMS["picture"], FORMS["basis"]
    for one in (content, Picture(WAVELENGTHS, CODES.astype(">u2"), SPECTRA, CURVE.astype(float))):
        read = one.on_host()
        assert isinstance(read, Basis) and read.coefficients.flags.c_contiguous
        assert read.coefficients.dtype == np.float32 and one.stored_type("codes") == np.uint16
        np.testing.assert_array_equal(read.coefficients, basis.coefficients)
    grey = Picture(WAVELENGTHS, CODES[..., 0], SPECTRA[:1], CURVE)
    assert grey.shape == (5, 6)
    np.testing.assert_array_equal(grey.planes, basis.coefficients[:1])
    assert basis.on_host() is basis


def curve(*first):
    return np.concatenate([first, np.ones(256 - len(first))])


BYTES = CODES.astype(np.uint8)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            (BYTES / 255, SPECTRA, curve()),
            "codes of type float64, wanted uint8 or uint16; give linear light as the planes",
        ),
        ((BYTES.astype(int), SPECTRA, curve()), "codes of type int64"),
        (
            (BYTES[..., :3], SPECTRA, curve()),
            r"codes of shape \(5, 6, 3\), wanted \(rows, cols, 4\), channels last",
        ),
        (
            (BYTES, SPECTRA[:3], curve()),
            r"codes of shape \(5, 6, 4\), .* no alpha: codes\[..., :3\]",
        ),
        ((BYTES[..., 0], SPECTRA, curve()), r"codes of shape \(5, 6\), wanted \(rows, cols, 4\)"),
        ((BYTES[..., None], SPECTRA[:1], curve()), r"codes of shape \(5, 6, 4, 1\)"),
        ((BYTES[0, 0, :1], SPECTRA[:1], curve()), r"codes of shape \(1,\)"),
        ((BYTES, SPECTRA[:, :5], curve()), r"basis \(4, 5\) does not match 7 wavelengths"),
        ((BYTES, SPECTRA, CURVE), r"curve of shape \(65536,\), wanted \(256,\) for uint8"),
        ((CODES, SPECTRA, curve()), r"curve of shape \(256,\), wanted \(65536,\) for uint16"),
        ((BYTES, SPECTRA, curve(-0.5)), "curve from -0.5 to 1, wanted finite light"),
        ((BYTES, SPECTRA, curve(np.nan)), "curve from nan to nan"),
        ((BYTES, SPECTRA, curve(np.inf)), "curve from 1 to inf"),
        ((BYTES, -SPECTRA, curve()), "negative spectra"),
        ((BYTES, SPECTRA * np.nan, curve()), "NaN or infinite spectra"),
        ((BYTES[:0], SPECTRA, curve()), r"zero-size scene \(0, 6, 4\)"),
    ],
)
def test_what_is_no_picture(content, words):
    with pytest.raises(BadData, match=rf"^s: .*{words}") as caught:
        Picture(WAVELENGTHS, *content).check("s")
    assert "\n" not in str(caught.value)
