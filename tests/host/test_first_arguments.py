"""What is no input is refused at the call, in one line: every public name, and what goes through a simulator."""

import inspect
import re
from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs
from gpusim.measure import snr_curve

ARRAY = np.ones((6, 8, 3))


@pytest.fixture(scope="module")
def simulate():
    return gs.Simulator(gs.open_camera("phone"), device="numpy")


@pytest.mark.parametrize(
    "call",
    [
        lambda simulate: simulate(ARRAY),
        lambda simulate: simulate([ARRAY]),
        lambda simulate: simulate((ARRAY, ARRAY)),
        lambda simulate: simulate.frames(ARRAY, 2),
        lambda simulate: simulate.expose(ARRAY),
        lambda simulate: simulate.plan(ARRAY),
        lambda simulate: simulate.loop(ARRAY),
        lambda simulate: simulate.batch(1)(ARRAY),
        lambda simulate: simulate.batch(1)([ARRAY]),
    ],
)
def test_an_array_is_no_scene(simulate, call):
    with pytest.raises(gs.GpusimError, match="wanted a Scene"):
        call(simulate)


@pytest.mark.parametrize("wrong", [None, 3, "colorchecker", b"x", {"scene": 1}, ARRAY])
def test_what_is_no_scene_is_refused_at_the_call(simulate, wrong):
    with pytest.raises(gs.GpusimError, match="wanted a Scene"):
        simulate(wrong)
    with pytest.raises(gs.GpusimError, match="wanted"):
        simulate.frames(wrong, 1)


def test_a_stream_of_an_array_is_refused_at_the_call(simulate):
    with pytest.raises(gs.GpusimError, match="scenes of a stream"):
        simulate.stream(ARRAY)


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.float16])
@pytest.mark.parametrize("wrong", [-0.01, np.nan])
def test_batches_refuse_negative_light(kind, wrong):
    batch, pictures = (
        gs.PictureBatch(gs.open_camera("phone"), device="numpy"),
        np.ones((2, 3, 8, 8), kind),
    )
    pictures[1, 2, 3, 4] = wrong
    with pytest.raises(gs.GpusimError, match="0 or more"):
        batch(pictures)


def test_batches_refuse_negative_light_of_torch():
    torch = pytest.importorskip("torch", reason="torch is not installed")
    pictures = torch.ones(1, 3, 8, 8, requires_grad=True)
    with pytest.raises(gs.GpusimError, match="0 or more"):
        gs.PictureBatch(gs.open_camera("phone"), device="numpy")(pictures - 2)


def test_snr_is_held_above_saturation():
    """The highest is sqrt(full well) where photons alone make noise (EMVA 1288), for every channel, and it stays."""
    phone = gs.open_camera("phone").sensor
    bare = replace(phone, full_well=5000.0, bits=32, noise=gs.Noise())
    found = snr_curve(bare)
    assert np.isfinite(found.snr).all()
    past = found.exposure >= found.saturation[:, None]
    assert (
        past.any(axis=1).all() and past.sum() > past.shape[0]
    )  # channels saturate one after another
    np.testing.assert_allclose(found.snr[past], 10 * np.log10(bare.saturation), rtol=1e-12)
    # a shot-noise sensor has SNR = sqrt(electrons), electrons proportional to the exposure below saturation
    green = int(found.saturation.argmin())
    share = found.exposure / found.saturation[green]
    np.testing.assert_allclose(
        found.electrons[green], bare.saturation * np.minimum(share, 1), rtol=1e-12
    )


TABLE = [
    ("wavelength_nm", "R", "G", "B"),
    (400, 0.1, 0.2, 0.3),
    (550, 0.15, 0.5, 0.25),
    (700, 0.3, 0.2, 0.1),
]


@pytest.mark.parametrize(
    ("divider", "decimal", "end"),
    [(";", ",", ""), (";", ".", ";;"), ("\t", ".", ""), (",", ".", ",,")],
)
def test_quantum_efficiency_of_every_spreadsheet(tmp_path, divider, decimal, end):
    lines = [divider.join(str(cell).replace(".", decimal) for cell in line) + end for line in TABLE]
    (tmp_path / "qe.csv").write_text("# of a data sheet\n" + "\n".join(lines))
    (tmp_path / "own.toml").write_text('base = "phone"\n[sensor]\nqe = "qe.csv"\n')
    (tmp_path / "own2.toml").write_text(
        'base = "phone"\n[sensor]\nqe = { wavelengths_nm = [400, 550, 700], R = [0.1, 0.15, 0.3], '
        "G = [0.2, 0.5, 0.2], B = [0.3, 0.25, 0.1] }\n"
    )
    found, same = (gs.open_camera(tmp_path / name).sensor.qe for name in ("own.toml", "own2.toml"))
    np.testing.assert_array_equal(found.wavelengths, same.wavelengths)
    np.testing.assert_array_equal(found.values, same.values)


# ------------------------------------------------------------------------------------------------ every public name

EXCEPTIONS = {
    "GpusimError": "an exception takes any message",
    "plot": "a module",
}


@pytest.mark.parametrize(
    "wrong", [ARRAY, None, "no such thing", 3], ids=["array", "None", "str", "int"]
)
@pytest.mark.parametrize("name", sorted(set(gs.__all__) - set(EXCEPTIONS)))
def test_a_public_name_works_or_says_why_not(name, wrong, tmp_path, monkeypatch):
    """TypeError is for arguments that are missing, or that have to be named, and for nothing else."""
    monkeypatch.chdir(tmp_path)
    try:
        made = getattr(gs, name)(
            wrong, **({"device": "numpy"} if name in ("Simulator", "PictureBatch") else {})
        )
    except gs.GpusimError as error:
        assert str(error) and "\n" not in str(error) and len(str(error)) <= 500
    except TypeError as error:
        assert re.search(r"missing \d+ required|takes \d+ positional argument", str(error)), error
    else:
        assert not inspect.isgenerator(made)
