"""What the objects of the package are at a prompt."""

import dataclasses
import inspect

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.calibration import BrownConrady
from gpusim.domain.distortion import RadialTable
from gpusim.measure import sfr

LONGEST = 200  # letters of a repr
NODES = np.linspace(400, 700, 31)
PHONE = gs.open_camera("phone")
SIMULATE = gs.Simulator(PHONE, device="numpy", tolerance="preview")
LENSLETS = PHONE.with_(f_number=4.0, lenslets={"pitch_um": 4.2, "focal_length_um": 16.8})
CHECKER = gs.chart("colorchecker", size=(48, 32))
CUBE = gs.scene_from(np.random.default_rng(1).random((31, 6, 8)), NODES, light="D65")
ALPHA = np.full((6, 8), 0.5, np.float32)


def objects():
    """Of every public class one, and of those that public functions give, with fields of all kinds."""
    frame, exposure = SIMULATE(CHECKER, seed=1), SIMULATE.expose(CHECKER)
    picture = gs.picture(np.zeros((6, 8, 3), np.uint8))
    spread = gs.PointSpread(NODES, np.ones((31, 9, 9)), 1e-6)
    lit = gs.illuminate(gs.chart("flat", size=(8, 6)), {"A": 30.0, "D65": 70.0})
    layers = (gs.Layer(CUBE.content, ALPHA, 0.5),)
    deep = dataclasses.replace(CUBE, depth=np.ones((6, 8)), layers=layers, name=300 * "n")
    edge = SIMULATE(gs.chart("slanted-edge", size=(100, 60))).raw[::2, ::2].astype(float)
    return [
        PHONE,
        PHONE.with_(psf=spread),
        PHONE.optics,
        PHONE.sensor,
        PHONE.processor,
        PHONE.display,
        PHONE.sensor.noise,
        PHONE.sensor.qe,
        gs.Optics(2.0, 0.004, model="measured", psf=spread),
        spread,
        CHECKER,
        CUBE,
        deep,
        deep.layers[0],
        gs.LightField(((deep, deep),), 1e-3),
        gs.ViewImages(np.ones((2, 3, 4, 5, 1)), -2.0, 0.5, 4e-3, 2.0, name=300 * "n"),
        gs.ViewDepth(*np.ones((5, 4, 5))),
        gs.Estimate(1.0, 0.9, 1.1, "e-", 300 * ("a.dng",)),
        gs.Fit((), "phone", 300 * "n"),
        gs.Comparison(300 * "n", ()),
        picture,
        lit,
        *(one.content for one in (CHECKER, CUBE, picture, lit)),
        gs.scene_from(np.zeros((6, 8, 3))).content,
        frame,
        frame.complete(),
        frame.report,
        exposure,
        exposure.plan,
        exposure.rendering,
        exposure.plan.account,
        gs.Capture(),
        gs.Burst(2),
        gs.Bracket(),
        gs.Reads(),
        SIMULATE,
        SIMULATE.device,
        SIMULATE.readout,
        SIMULATE.tolerance,
        SIMULATE.loop(CHECKER),
        SIMULATE.batch(2),
        gs.PictureBatch(PHONE, device="numpy"),
        gs.View(),
        gs.CodedDepth(np.ones((6, 8)), np.zeros((6, 8), int), np.ones((2, 6, 8))),
        gs.Mask(np.ones((64, 64))),
        gs.Motion(),
        gs.Flicker(100.0),
        gs.EventSensor(),
        gs.AutoExposure(),
        gs.Actor(CUBE.content, ALPHA),
        gs.Animation(CUBE, (gs.Actor(CUBE.content, ALPHA),)),
        gs.GpusimError("no"),
        gs.Display(),
        gs.Calibration(640, 480, 500.0, 501.0, 320.0, 240.0, (0.1, -0.2, 0.01, 0.02)),
        BrownConrady(0.1, -0.2, 0.0, 0.0, 0.0, 2.5),
        RadialTable(np.linspace(0, 1, 50), np.linspace(0, 1.1, 50)),
        gs.open_camera("mono"),
        gs.Lenslets(14e-6, 40e-6),
        gs.DualPixels(),
        views := gs.ViewCapture(SIMULATE, gs.chart("flat", size=(12, 8)), (1, 2)),
        views(),
        behind := gs.LensletCapture(
            gs.Simulator(LENSLETS, device="numpy"), gs.chart("flat", size=(12, 8)), (1, 2)
        ),
        behind(None, 0.01),
        gs.LensletGrid(10.0, 0.0, (20.0, 20.0)),
        gs.LensletSamples((50, 60), 14e-6, (0.0, 0.0), (500, 600)),
        sfr(edge),
        gs.study(
            {
                "camera": "phone",
                "sampling": {"method": "grid"},
                "vary": {"read_e": {"grid": [1]}},
                "scenes": {"flat": {"scene": "flat", "size": [8, 8]}},
                "measures": ["dynamic_range"],
            },
            device="numpy",
        ),
    ]


@pytest.fixture(scope="module")
def made():
    return objects()


def test_reprs_are_a_line_that_tells(made):
    for one in made:
        text = repr(one)
        assert text.startswith(type(one).__name__ + "(") and text.endswith(")"), text
        assert len(text) <= LONGEST and "\n" not in text, (len(text), text)


def test_every_public_class_is_among_them(made):
    classes = {name for name in gs.__all__ if inspect.isclass(getattr(gs, name))}
    assert classes - {type(one).__name__ for one in made} == set()
