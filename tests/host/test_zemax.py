"""Point spreads from Zemax's text listings: units, which way is up, sampling, lateral color, and what is refused."""

import numpy as np
import pytest
from refusals import refused
from scipy.special import j1

import gpusim as gs
from gpusim.domain.errors import BadData, BadFile, OutOfRange

# Headers as OpticStudio of 2020 and ZEMAX of 2005 wrote them.
FFT = """Listing of FFT PSF Data

File : C:\\lenses\\triplet.zmx
Title: A TRIPLET
Date : 6/6/2020


Polychromatic FFT PSF
{um:.4f} to {um:.4f} \u00b5m at {field}.
Data spacing is {spacing:.6f} \u00b5m.
Data area is {area:.3f} \u00b5m wide.
Surface: Image
Reference Coordinates: {x:.8E}, {y:.8E}
Pupil grid size: 64 by 64
Image grid size: {rows} by {cols}
Center point is: row {row}, column {col}
Values are normalized to the peak.

"""
HUYGENS = """Listing of Huygens PSF Data

File : C:\\ZEMAX\\asphere.ZMX
Title: asphere
Date : TUE AUG 30 2005


HUYGENS PSF
{um:.4f} \u00b5m at {field}.
Data spacing is {spacing:.6f} \u00b5m.
Data area is {area:.2f} by {area:.2f} \u00b5m.
Strehl ratio: 0.486
Pupil grid size: 32 by 32
Image grid size: {rows} by {cols}
Center point is: {row}, {col}
Center coordinates: {x:.8E}, {y:.8E}
Values are relative intensity.

"""


def listing(
    path,
    values,
    *,
    head=HUYGENS,
    nm=550.0,
    spacing=0.5,
    middle=None,
    field="0.00 deg",
    centre=(0.0, 0.0),
    encoding="cp1252",
):
    """Write values, (rows, cols) from the top line on, about `middle`, (row, column) from 0.

    spacing: [um]. centre: [mm].
    """
    rows, cols = values.shape
    row, col = middle or (rows // 2, cols // 2)
    text = head.format(
        um=nm / 1e3,
        field=field,
        spacing=spacing,
        area=spacing * cols,
        x=centre[0],
        y=centre[1],
        rows=rows,
        cols=cols,
        row=row + 1,
        col=col + 1,
    )
    text += "\n".join("\t".join(f"{value:.3E}" for value in line) for line in values) + "\n"
    path.write_bytes(text.replace("\n", "\r\n").encode(encoding))
    return path


def places(rows, cols, middle=None):
    """Distance of each sample along y, up, and along x from the middle [sample]."""
    row, col = middle or (rows // 2, cols // 2)
    return row - np.arange(rows)[:, None], np.arange(cols) - col


def airy(distance, nm, f_number):
    v = np.pi * distance / (nm * 1e-9 * f_number) + 1e-9
    return (2 * j1(v) / v) ** 2


def centroid(values):
    """(row, column) from the middle [sample]."""
    n = values.shape[-1]
    steps = np.arange(n) - (n - 1) / 2
    return np.array([values.sum(-1) @ steps, values.sum(-2) @ steps]) / values.sum()


@pytest.mark.parametrize("head", [FFT, HUYGENS], ids=["FFT", "Huygens"])
@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-8-sig", "utf-16"])
def test_every_encoding_gives_the_values(tmp_path, head, encoding):
    """An even grid, whose middle is a sample: the largest square about it is kept, as it is, three digits of each."""
    values = np.random.default_rng(1).random((32, 32)) + 0.1
    found = gs.read_zemax_psf(
        listing(tmp_path / "a.txt", values, head=head, nm=486.1, spacing=0.4, encoding=encoding)
    )
    wanted = values[1:, 1:][::-1]  # row and column 17 are the middle of 31
    np.testing.assert_allclose(found.values[0], wanted / wanted.sum(), rtol=2e-3)
    assert found.wavelengths == [486.1] and found.spacing == pytest.approx(4e-7, rel=1e-12)
    assert found.heights is None


@pytest.mark.parametrize(("unit", "scale"), [("\u00b5m", 1), ("um", 1), ("nm", 1000), ("mm", 1e-3)])
def test_units(tmp_path, unit, scale):
    path = listing(tmp_path / "a.txt", np.ones((5, 5)), encoding="utf-8")
    text = path.read_text().replace("0.500000 \u00b5m.", f"{0.5 * scale:.9f} {unit}.")
    path.write_text(text, encoding="utf-8")
    assert gs.read_zemax_psf(path).spacing == pytest.approx(5e-7, rel=1e-9)


def test_wavelengths_sampled_apart_are_sampled_alike(tmp_path):
    """FFT listings are lambda N / 4 apart: Airy patterns of three wavelengths, then all at the finest's distance.

    The sampling theorem gives them back; 48 samples of the sinc's lines beyond each end are missing where the pattern
    is 1e-4 of its peak, and three digits are printed: 2e-3 of the peak.
    """
    files = []
    for nm in (650.0, 450.0, 550.0):
        spacing = nm * 1e-9 * 4 / 4
        y, x = places(96, 96)
        files.append(
            listing(
                tmp_path / f"{nm:.0f}.txt",
                airy(np.hypot(y, x) * spacing, nm, 4),
                head=FFT,
                nm=nm,
                spacing=spacing * 1e6,
            )
        )
    found = gs.read_zemax_psf(files)
    assert found.wavelengths.tolist() == [450, 550, 650] and found.spacing == pytest.approx(
        450e-9, rel=1e-6
    )
    n = found.values.shape[-1]
    assert n == 2 * 47 + 1  # of the finest: the others reach further
    y, x = places(n, n)
    for nm, values in zip(found.wavelengths, found.values, strict=True):
        wanted = airy(np.hypot(y, x) * found.spacing, nm, 4)
        assert np.abs(values / values.max() - wanted).max() < 2e-3


def comet(rows, cols, toward, middle=None):
    """A spot with a tail toward (x, y)."""
    y, x = places(rows, cols, middle)
    along = x * toward[0] + y * toward[1]
    across = x * toward[1] - y * toward[0]
    return np.exp(-(across**2) / 8) * np.where(
        along > 0, np.exp(-along / 5), np.exp(-(along**2) / 8)
    )


@pytest.mark.parametrize("toward", [(0, 1), (0, -1), (1, 0), (-1, 0)], ids=["+y", "-y", "+x", "-x"])
@pytest.mark.parametrize("tail", [1, -1], ids=["outward", "inward"])
def test_tails_keep_their_side_of_the_axis(tmp_path, toward, tail):
    """Tails away from the axis, drawn as OpticStudio draws, y up: with the heights' +columns they point to +columns.

    The even grid's middle is (32, 32) of 64; turned, it is the other one of the two middles.
    """
    directions = np.array(toward) * tail
    files = [
        listing(
            tmp_path / "0.txt", comet(64, 64, (0, 1)) + comet(64, 64, (0, -1)), field="0.00 deg"
        ),
        listing(
            tmp_path / "1.txt",
            comet(64, 64, directions),
            field="9.00 deg",
            centre=1.5 * np.array(toward),
        ),
        listing(
            tmp_path / "2.txt",
            comet(64, 64, directions),
            field="18.0 deg",
            centre=3.0 * np.array(toward),
        ),
    ]
    found = gs.read_zemax_psf(files[::-1], corner=3e-3)
    np.testing.assert_allclose(found.heights, [0, 0.5, 1], rtol=1e-7)
    wanted = comet(63, 63, (tail, 0), (31, 31))
    for spread in found.values[1:, 0]:
        np.testing.assert_allclose(spread / spread.max(), wanted / wanted.max(), atol=2e-3)
        assert tail * centroid(spread)[1] > 1
    beyond = found.at(0.6, 0.6)[
        0
    ]  # down and to the right in the picture: the tail turns with the field
    assert (tail * centroid(beyond) > 0.7).all()


def test_lateral_color_stays_in_the_point_spreads(tmp_path):
    """Image points of blue 0.75 um nearer to the axis than green's, of red 0.5 um beyond: 1.5 and 1 samples.

    Gaussians of 3 samples: those of a shift by a sinc are right to 1e-4, and digits to 1e-3, a centroid to a hundredth.
    """
    y, x = places(64, 64)
    spot = np.exp(-(x**2 + y**2) / 18)
    files = [
        listing(
            tmp_path / f"{nm:.0f}-{k}.txt",
            spot,
            nm=nm,
            field=f"{k}",
            centre=(0, -k * (2.0 + move * 1e-3)),
        )
        for nm, move in ((450.0, -0.75), (550.0, 0.0), (650.0, 0.5))
        for k in (0, 1)
    ]
    found = gs.read_zemax_psf(files, corner=1.9e-3)
    for spread, wanted in zip(found.values[1], (-1.5, 0, 1), strict=True):
        assert centroid(spread) == pytest.approx((0, wanted), abs=0.01)
    for spread in found.values[0]:
        assert centroid(spread) == pytest.approx((0, 0), abs=0.01)
    blue = gs.read_zemax_psf(files, corner=1.9e-3, reference=450.0)
    assert centroid(blue.values[1][2])[1] == pytest.approx(2.5, abs=0.01)


def test_listings_become_an_archive_of_a_camera(tmp_path):
    """As the recipe says: read, write, name it in a camera's file."""
    y, x = places(65, 65)
    files = [
        listing(tmp_path / f"{nm}.txt", airy(np.hypot(y, x) * 4e-7, nm, 4), nm=nm, spacing=0.4)
        for nm in (380.0, 550.0, 780.0)
    ]
    gs.write_psf(tmp_path / "lens.npz", gs.read_zemax_psf(files))
    again, direct = gs.read_psf(tmp_path / "lens.npz"), gs.read_zemax_psf(files)
    np.testing.assert_allclose(again.values, direct.values, rtol=1e-15)
    assert again.spacing == pytest.approx(direct.spacing, rel=1e-15) and again.heights is None
    (tmp_path / "own.toml").write_text(
        'base = "none"\n[optics]\nf_number = 4\nfocal_length_mm = 4\npsf = "lens.npz"\n[sensor]\n'
        'pixel_pitch_um = 2\nqe = "mt9v024"\nfull_well_e = 9000\nbits = 10\n'
    )
    assert gs.open_camera(tmp_path / "own.toml").optics.model == "measured"


def test_archives_keep_heights_and_grids(tmp_path):
    values = np.random.default_rng(2).random((2, 3, 1, 5, 5))
    for spread in (
        gs.PointSpread(np.array([550.0]), values[0], 1e-6, heights=np.array([0, 0.5, 1])),
        gs.PointSpread(np.array([550.0]), values, 1e-6, True, grid=([-1, 1], [-1, 0, 1])),
    ):
        gs.write_psf(tmp_path / "a.npz", spread)
        again = gs.read_psf(tmp_path / "a.npz")
        np.testing.assert_allclose(again.values, spread.values, rtol=1e-15)
        assert again.integrated == spread.integrated
        if spread.heights is None:
            assert all(map(np.array_equal, again.grid, spread.grid))
        else:
            assert np.array_equal(again.heights, spread.heights)


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("Listing of Huygens PSF Data", "Listing of MTF", []),
        ("HUYGENS PSF", "HUYGENS", []),
        ("Data spacing is 0.500000 \u00b5m.", "", ["Data spacing"]),
        ("Data spacing is 0.500000 \u00b5m.", "Data spacing is 0.5 ell.", ["unit 'ell'"]),
        ("Data spacing is 0.500000", "Data spacing is 0.000000", ["spacing"]),
        ("Data spacing is 0.500000", "Data spacing is 1e-300", ["spacing", "1e-10"]),
        ("Data spacing is 0.500000", "Data spacing is 5e+300", ["spacing", "0.01 m"]),
        ("0.5500 \u00b5m at", "1E+300 \u00b5m at", ["wavelength", "0.0001 m"]),
        ("Center coordinates: 0.00000000E+00", "Center coordinates: 1E+300", ["coordinates"]),
        ("Center point is: 5, 5", "Center point is: 0, 5", ["row 0"]),
        ("Image grid size: 8 by 8", "Image grid size: 8 by 9", ["64 values instead of 8 x 9"]),
        ("Image grid size: 8 by 8", "Image grid size: 0 by 0", ["0 by 0"]),
        (
            "0.5500 \u00b5m at",
            "0.4500 to 0.6500 \u00b5m at",
            ["0.4500 to 0.6500", "single wavelength"],
        ),
        ("0.5500 \u00b5m at", "at", ["wavelength"]),
        ("Values are", "Numbers are", ["Values are"]),
        ("Center point is: 5, 5", "Center point is: 9, 5", ["row 9"]),
        ("1.000E+00", "1.000E+0x", ["in numbers"]),
        ("1.000E+00", "-1.00E+00", ["negative", "linear"]),
        ("1.000E+00", "nan", ["not finite"]),
    ],
)
def test_what_is_wrong_with_a_listing_is_said(tmp_path, old, new, parts):
    path = listing(tmp_path / "a.txt", np.ones((8, 8)), encoding="utf-8")
    text = path.read_bytes().decode()
    path.write_bytes(text.replace(old, new, 1 if "E+" in old else -1).encode())
    if old in ("Listing of Huygens PSF Data", "HUYGENS PSF"):  # one of both lines is enough
        assert gs.read_zemax_psf(path).values.shape == (1, 7, 7)
        return
    with refused(*parts, error=(BadFile, BadData, OutOfRange)):
        gs.read_zemax_psf(path)


@pytest.mark.parametrize(
    "data", [b"", b"\xff\xfe", b"\x00" * 100, b"Listing of FFT PSF Data\n", b"\xff\xfeL\x00\xd8"]
)
def test_what_is_no_listing(tmp_path, data):
    (tmp_path / "a.txt").write_bytes(data)
    with refused("a.txt", "Zemax", error=BadFile):
        gs.read_zemax_psf(tmp_path / "a.txt")


def test_listings_that_do_not_go_together(tmp_path):
    def at(name, field, centre, nm=550.0):
        return listing(tmp_path / name, np.ones((9, 9)), field=field, centre=centre, nm=nm)

    axis, off = at("0", "0 deg", (0, 0)), at("1", "9 deg", (0, 2))
    for files, options, parts in (
        ([axis, off], {}, ["corner"]),
        ([axis, off], {"corner": 3e-3}, ["up to 2 mm", "3 mm"]),
        ([off, at("2", "12 deg", (0, 3))], {"corner": 3e-3}, ["first field height"]),
        ([axis, at("3", "12 deg", (2, 3))], {"corner": 3e-3}, ["along x"]),
        ([axis, axis], {}, ["once"]),
        ([axis, at("b", "9 deg", (0, 2), 450.0)], {"corner": 2e-3}, ["each wavelength"]),
        ([axis], {"reference": 450.0}, ["reference", "550"]),
        ([], {}, ["0 point spreads"]),
    ):
        with refused(*parts, error=(BadData, OutOfRange)):
            gs.read_zemax_psf(files, **options)
