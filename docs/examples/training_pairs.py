"""
Noisy pairs for training
========================

A network that removes noise learns from pairs: a camera's raw frame, and the same frame without
noise. One command makes pairs from any photographs, in tar files for WebDataset. This example runs
it from Python.
"""

import io
import json
import subprocess
import sys
import tarfile
import tempfile
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image
from skimage import data

import gpusim as gs

# %%
# Photographs
# -----------
# Four crops of pictures from scikit-image. The command is the same for thousands.

folder = Path(tempfile.mkdtemp())
(folder / "photos").mkdir()
parts = {
    "astronaut": data.astronaut()[:192, 100:356],
    "coffee": data.coffee()[100:292, 150:406],
    "chelsea": data.chelsea()[50:242, 100:356],
    "rocket": data.rocket()[150:342, 200:456],
}
for name, part in parts.items():
    Image.fromarray(np.ascontiguousarray(part)).save(folder / "photos" / f"{name}.png")

# %%
# The command
# -----------
# Each photograph twice, each time with a different exposure, speed and light. Every pair depends
# only on its photograph, its number and the seed: ``--shard I/N`` on several machines gives the
# same bytes.

command = (
    "pairs photos --camera phone --vary exposure=1/500..1/30,iso=100..1600,light=D65|A|FL11 --luminance 60 "
    "--each 2 --seed 1 --pictures -o shards"
)
subprocess.run(
    [sys.executable, "-m", "gpusim", *command.split()], cwd=folder, check=True, capture_output=True
)
print("gpusim", command)

# %%
# Contents of a pair
# ------------------
# Digital numbers with and without noise, a picture, and the settings that were drawn.

pairs: dict = {}
for shard in sorted((folder / "shards").glob("*.tar")):
    with tarfile.open(shard) as archive:
        for member in archive:
            key, _, suffix = member.name.partition(".")
            pairs.setdefault(key, {})[suffix] = archive.extractfile(member).read()
settings = json.loads(pairs["00000000"]["json"])
print(
    ", ".join(
        f"{key}: {settings[key]}"
        for key in (
            "photograph",
            "exposure",
            "iso",
            "light",
            "gain_dn_per_e",
            "read_noise_e",
            "black_level",
            "white_level",
        )
    )
)

figure, axes = plt.subplots(2, 4, figsize=(11, 4.8), layout="constrained")
for axis, pair in zip(axes.T.flat, pairs.values(), strict=True):
    settings = json.loads(pair["json"])
    axis.imshow(Image.open(io.BytesIO(pair["rgb.png"])))
    axis.set_title(
        f"1/{1 / settings['exposure']:.0f} s, ISO {settings['iso']:.0f}, {settings['light']}",
        fontsize=9,
    )
    axis.set_axis_off()

# %%
# Check of the noise
# ------------------
# The variance of photon and read noise grows with the light: gain times the signal, plus the
# variance in the dark. Each set of points is one pair, binned by its clean values. The lines are
# not fitted; they follow from the numbers in the file.

figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
for pair, color in zip(list(pairs.values())[::2], ("C0", "C1", "C2", "C3"), strict=True):
    settings = json.loads(pair["json"])
    raw, clean = (
        np.load(io.BytesIO(pair[f"{name}.npy"])).astype(float) for name in ("raw", "clean")
    )
    light = clean - settings["black_level"]
    edges = np.linspace(
        0, 0.6 * (settings["white_level"] - settings["black_level"]), 26
    )  # brighter values may be clipped
    edges = edges[edges < np.quantile(light, 0.99)]
    inside = [(light >= low) & (light < high) for low, high in pairwise(edges)]
    noise = [np.var((raw - clean)[one]) for one in inside]
    signal = np.array([light[one].mean() for one in inside])
    gain = settings["gain_dn_per_e"]
    axis.loglog(signal, noise, ".", color=color)
    axis.loglog(
        signal,
        gain * signal + (gain * settings["read_noise_e"]) ** 2 + 1 / 12,
        color=color,
        label=f"{settings['photograph']}, {gain:.2f} DN/e⁻",
    )
axis.set(xlabel="signal [DN]", ylabel="variance [DN²]")
axis.legend(frameon=False)

# %%
# A script saves its pictures:

gs.plot.save_figures("training_pairs")
