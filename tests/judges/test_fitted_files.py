"""Camera files that were fitted to edges, simulated again: MTF50 on the axis of one channel.

Lenses and edges are plain NumPy, see test_optics_of_fits.py; the transfer is a Fourier sum over the simulated edge.
"""

from dataclasses import replace

import edge_targets as edges
import numpy as np
import pytest
from test_optics_of_fits import ACROSS, edge_frames

import gpusim as gs
from gpusim.domain.sensor import FLOAT_BITS

pytestmark = pytest.mark.slow


def slanted_mtf50(values, angle):
    """MTF50 [cycle/pixel] along the normal of one edge through the middle, in bins of 1/8 pixel, without a window.

    angle: of the normal from the columns' axis [rad].
    """
    y, x = (np.indices(values.shape).T - (np.array(values.shape) - 1) / 2).T
    d = x * np.cos(angle) + y * np.sin(angle)
    near = np.abs(d) < 24
    number = np.floor((d[near] + 24) * 8).astype(int)
    counts = np.bincount(number)
    light, at = (np.bincount(number, one[near]) / counts for one in (values, d))
    steps, middles = np.diff(light), (at[1:] + at[:-1]) / 2
    f = np.linspace(0, 1, 2001)
    seen = np.abs(np.exp(-2j * np.pi * np.outer(f, middles)) @ steps) / abs(steps.sum())
    seen /= np.sinc(f / 8) ** 2  # of the bins and of the differences
    k = np.flatnonzero(seen <= 0.5)[0]
    return float(np.interp(0.5, [seen[k], seen[k - 1]], [f[k], f[k - 1]]))


def edge_normal(values):
    """Angle of the normal of an edge [rad], from the mean slopes of the light."""
    down, across = (part.sum() for part in np.gradient(values))
    return np.arctan2(down, across)


def simulated_edges(camera, size, samples):
    """Noiseless raw values of edges of 4 and 86 degrees through the middle, by the simulator."""
    sensor = replace(camera.sensor, bits=FLOAT_BITS, noise=gs.Noise(photon="none"))
    camera = replace(camera, sensor=sensor)
    for angle in (4.0, 86.0):
        scene = gs.chart(
            "slanted-edge",
            size=(size, size),
            samples_per_pixel=samples,
            angle_deg=angle,
        )
        raw = gs.Simulator(camera, device="numpy").expose(scene).raw(seed=1)
        yield angle, np.asarray(raw, float).reshape(size, size)


def fitted_camera(folder, frames, pitch, number, base, own=np.s_[:, :]):
    """Write frames, fit a camera file to them and open it. own: part of the frames."""
    paths = [folder / frame.name.replace("dng", "npz") for frame in frames]
    for path, frame in zip(paths, frames, strict=True):
        np.savez(
            path, dn=frame.values[own].astype(np.uint16), black_level=64.0, cfa=np.array(frame.cfa)
        )
    (folder / "base.toml").write_text(base + f"pixel_pitch_um = {1e6 * pitch:.6f}\n")
    gs.fit(edges=paths, base=folder / "base.toml", options={"f_number": number}).write(
        folder / "mine.toml"
    )
    return gs.open_camera(folder / "mine.toml")


def test_a_camera_file_gives_edges_of_the_same_mtf50(tmp_path):
    frames, otfs, pitch, number = edge_frames(7)
    own = np.s_[edges.TILE : 2 * edges.TILE, edges.TILE : 2 * edges.TILE]
    camera = fitted_camera(tmp_path, frames, pitch, number, 'base = "mono"\n[sensor]\n', own)
    for angle, values in simulated_edges(camera, 96, 8):
        seen = slanted_mtf50(values, edge_normal(values))
        truth = edges.mtf50(otfs["Y"][ACROSS + 1], angle < 45)
        print(f"simulated again at {angle:g} degrees: {seen:.4f}, truth {truth:.4f}")
        assert seen == pytest.approx(truth, rel=0.02)
