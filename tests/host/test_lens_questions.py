"""Only few files ask which kind a lens is: everything else calls the methods of `gpusim.optics.lens.Lens`."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.mask import Mask
from gpusim.domain.optics import Optics
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Pupil
from gpusim.optics.lenses import lens_of, open_lens

ROOT = Path(__file__).parents[2]
ASKING = {
    "gpusim/domain/dual.py",  # the settings as a photodiode sees them
    "gpusim/domain/optics.py",  # checks the settings
    "gpusim/domain/pupil.py",  # the geometry of pupils
    "gpusim/optics/lens.py",  # the classes
    "gpusim/optics/lenses.py",
    "gpusim/optics/masked_lens.py",
    "gpusim/optics/split_lens.py",
    "gpusim/judge/truth_lens.py",
    "gpusim/judge/truth_mask.py",
    "gpusim/judge/truth_pupil.py",
}
SETTINGS = {"varies", "is_ideal", "is_symmetric", "has_mirror", "blades"}
CLASSES = {"PupilLens", "MaskedLens", "MeasuredLens", "PointLens"}


def asks(node):
    """Whether a node of the syntax tree is a question about a lens's kind."""
    if isinstance(node, ast.Attribute):
        owner = getattr(node.value, "attr", getattr(node.value, "id", ""))
        return node.attr in SETTINGS or (owner == "optics" and node.attr in ("psf", "model"))
    return isinstance(node, ast.Name) and node.id in CLASSES


def test_few_files_ask_about_a_lens():
    files = [*(ROOT / "gpusim").rglob("*.py"), *(ROOT / "kernels").rglob("*.py")]
    found = {
        str(path.relative_to(ROOT))
        for path in files
        if any(asks(node) for node in ast.walk(ast.parse(path.read_text())))
    }
    assert found == ASKING


OPTICS = Optics(2.8, 4e-3, object_distance=1.0)
SPREAD = PointSpread(np.array([400.0, 700.0]), np.ones((2, 5, 5)), 0.25e-6)
LENSES = {
    "clear": OPTICS,
    "hexagon": replace(OPTICS, pupil=Pupil(6)),
    "out of focus": replace(OPTICS, defocus=8e-6),
    "mask": replace(OPTICS, defocus=8e-6, pupil=Pupil(mask=Mask([[1, 0.8], [0.5j, 1]]))),
    "measured": replace(OPTICS, model="measured", psf=SPREAD),
    "no blur": replace(OPTICS, model="none"),
}


@pytest.mark.parametrize("name", LENSES)
def test_every_lens_has_every_method(name):
    """Kernels and transfer function agree: the spectrum of a kernel is the transfer function times the pixel's."""
    pitch, size = 1e-6, 129
    lens = open_lens(LENSES[name], pitch, 1.0, (64, 96))
    kernel = lens.kernels([550.0], (0.0, 0.0), size)[0]
    spectrum = np.fft.fft2(np.fft.ifftshift(kernel))[3, 5] / kernel.sum()
    fy, fx = 3 / size, 5 / size
    own = lens.transfer([550.0], fy / pitch, fx / pitch)[0, 0]
    pixel = 1.0 if lens.is_pointlike else np.sinc(fy) * np.sinc(fx)
    assert abs(spectrum - own * pixel) < 0.01
    assert lens.spread([550.0]) >= 0 and lens.cutoff(550.0) > 0 and lens.words
    assert (lens.tail is None) == (name in ("measured", "no blur"))
    assert lens.tails([450.0, 550.0]).shape == (2, 3)
    energy, step = lens.sampled_spread([550.0], (0.0, 0.0), 5e-6, 65)
    assert energy.sum() == pytest.approx(1, abs=0.1) and step > 0


def test_a_distance_is_a_defocus():
    near = replace(OPTICS, defocus=OPTICS.displacement(OPTICS.diopters(0.8)))
    kernels = [
        open_lens(OPTICS, 1e-6).kernels([550.0], (0.0, 0.0), 31, 0.8),
        open_lens(near, 1e-6).kernels([550.0], (0.0, 0.0), 31),
    ]
    assert np.allclose(*kernels, atol=1e-9)


def test_a_distance_is_a_disc_on_measured_spreads():
    """An even disc passes half at 2 J1(v) / v = 1/2, v = 2.215, and nothing at 1.2197 cycles a diameter."""
    lens = open_lens(LENSES["measured"], 1e-6)
    image = 1 / (1 / OPTICS.focal_length - 1)
    disc = image * OPTICS.focal_length / OPTICS.f_number * (1 / 0.8 - 1) / 1e-6  # [sample]
    f = np.array([2.215 / np.pi, 1.2196699]) / disc / 1e-6
    ratio = lens.transfer([550.0], 0 * f, f, distance=0.8) / lens.transfer([550.0], 0 * f, f)
    np.testing.assert_allclose(np.abs(ratio[0]), [0.5, 0.0], atol=1e-3)
    kernel, sharp = (lens.kernels([550.0], (0.0, 0.0), 63, at)[0] for at in (0.8, None))
    assert kernel.sum() == pytest.approx(1)
    at = np.arange(63) - 31
    widths = [one.sum(axis=0) @ at**2 for one in (kernel, sharp)]
    # a disc has a variance of a sixteenth of its diameter squared along an axis; the ends of the period take part of it
    assert widths[0] - widths[1] == pytest.approx(disc**2 / 16, rel=0.05)


def test_predicates_say_what_the_lens_does():
    assert lens_of(gs.open_camera("phone")).is_adjustable
    measured, none, clear = (
        open_lens(LENSES[key], 1e-6) for key in ("measured", "no blur", "clear")
    )
    assert not measured.is_adjustable and measured.wavelengths == (400, 700)
    assert none.is_pointlike and none.is_uniform and none.fixed_distance == "there is no blur"
    assert clear.is_airy and clear.symmetry.is_round and clear.symmetry.is_mirrored
    assert len(open_lens(LENSES["hexagon"], 1e-6).tail.lines) == 6
