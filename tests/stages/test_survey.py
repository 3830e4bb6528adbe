"""What a device surveys of a content gives the error that the host predicts from all moments."""

from dataclasses import replace

import numpy as np
import pytest
from devices import DEVICES
from test_drift import contents, monochromatic, operators
from test_fusion import made_for

from gpusim.backends.select import open_device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.judge.hard.planner import response_of
from gpusim.judge.hard.scenes import natural
from gpusim.kernels.spectral.survey import survey
from gpusim.optics.fusion import Spectra, Watch


@pytest.fixture(scope="module")
def response():
    return response_of(made_for(natural((32, 24))))


def bound(watch, content, signal, error):
    """How far float32 may take the error, from projections of n terms and means over a row.

    Each term has the roundings of the weight, the difference and the sum. By Cauchy's inequality row b errs by at most
    (n + 3) 2^-24 |b| |d|, and by the triangle inequality the root of a sum of mean squares by at most that of errors.
    """
    unit, weights = 2.0**-24, watch.table.astype(float) ** 2
    terms = (
        len(content.planes) if content.labels is None else 2
    )  # the largest, of neighbours with an entry each
    squares = np.sort(weights, axis=1)[:, -terms:].sum(1)
    values, across, down = survey(
        content.planes, watch.table, watch.first, content.labels, device="numpy"
    ).mean(0)
    signals = len(watch.flat)
    wrong = (terms + 3) * unit * np.sqrt(squares[signals:].sum() * (across + down)[-1] / signal)
    bright = (terms + 3) * unit * np.sqrt(squares[:signals].sum() * values[-1] / signal)
    return wrong + error * (bright + (terms + content.shape[1] + 5) * unit)


@pytest.mark.parametrize("device", DEVICES)
def test_a_device_gives_the_error_of_all_moments(device, response):
    device = open_device(device)
    for table, transfers in operators(response):
        for content in contents():
            watch, own = Watch.of(response, table, transfers, content), Spectra.of(content)
            numbers = survey(
                content.planes, watch.table, watch.first, content.labels, device=device
            )
            signal = response.share @ np.einsum(
                "cl,lm,cm->c", response.flat, own.values, response.flat
            )
            exact = response.error(table, transfers, own)
            left = watch.left * np.asarray(numbers, float).mean(0)[1:, -1].sum() / signal
            seen, allowed = watch.errors(numbers)[0], bound(watch, content, signal, exact)
            assert exact - allowed <= seen <= np.sqrt(exact**2 + left) + allowed
            assert allowed < 1e-6


@pytest.mark.parametrize("exponent", [76, 57, -80])
@pytest.mark.parametrize("device", DEVICES)
def test_the_sun_is_surveyed_as_any_light(device, exponent, response):
    """Powers of two change no bit of an error or a roughness: squares of 1e23, beyond float32, are not needed."""
    device, (table, transfers) = open_device(device), next(operators(response))
    for content in (natural((96, 64)).content, list(contents())[-1]):
        light = replace(
            content, **{content.samples[-1]: content.planes * np.float32(2.0**exponent)}
        )
        watch = Watch.of(response, table, transfers, content)
        unscaled, once, bright = (
            one.errors(
                survey(seen.planes, one.table, one.first, seen.labels, one.scale, device=device)
            )
            for one, seen in (
                (watch, light),
                (watch.with_scale(content), content),
                (watch.with_scale(light), light),
            )
        )
        assert once[:4] == bright[:4] and bright[0] > 0 and (exponent < 76 or np.isnan(unscaled[0]))


@pytest.mark.parametrize("device", DEVICES)
def test_a_survey_is_the_same_every_time(device, response):
    device = open_device(device)
    content = monochromatic((64, 515), np.random.default_rng(7))
    watch = Watch.of(response, *next(operators(response)), content)
    values, table = device.array(content.values), device.array(watch.table)
    once, *others = (
        device.numpy(survey(values, table, watch.first, device=device)).copy() for _ in range(5)
    )
    assert all((other == once).all() for other in others)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (
            {"content": np.ones((3, 4), np.float32)},
            BadData,
            r"content of shape \(3, 4\); wanted \(entries, rows, cols\)",
        ),
        ({"content": np.ones((3, 0, 4), np.float32)}, BadData, "content of shape"),
        ({"ids": np.zeros((4, 5), np.uint16)}, BadData, r"wanted \(rows, cols\)"),
        (
            {"ids": np.zeros((4, 5), np.uint16), "content": np.ones((4, 6), np.float32)},
            BadData,
            "wanted one",
        ),
        ({"table": np.ones((2, 4), np.float32)}, BadData, r"wanted \(projections, 3\)"),
        ({"table": np.ones((17, 3), np.float32)}, OutOfRange, "projections"),
        ({"table": np.ones((0, 3), np.float32)}, OutOfRange, "projections"),
        ({"first": np.zeros((1, 1), np.int32)}, BadData, "first rows"),
    ],
    ids=["flat", "empty", "cube with ids", "ids apart", "table", "many", "none", "first"],
)
@pytest.mark.parametrize("device", ["numpy", *DEVICES])
def test_what_does_not_fit_is_refused(change, error, words, device):
    inputs = {
        "content": np.ones((3, 4, 5), np.float32),
        "table": np.ones((2, 3), np.float32),
        "first": np.zeros(1, np.int32),
        "ids": None,
    }
    with pytest.raises(error, match=words):
        survey(**inputs | change, device=device)
