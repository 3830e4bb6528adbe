"""
Noisy pairs for training
========================

A network that removes noise learns from pairs: what a camera gives, and what it would give without noise. One command
makes them of any photographs, in tar files as WebDataset reads them; here it is run from Python.
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

# %%
# Photographs
# -----------
# Four parts of pictures that scikit-image brings. Thousands are no other command.

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
# Each photograph twice, each time with another exposure, speed and light. Every pair depends on its photograph, its
# number and the seed alone: ``--shard I/N`` on several machines gives the same bytes.

command = (
    "pairs photos --camera phone --vary exposure=1/500..1/30,iso=100..1600,light=D65|A|FL11 --luminance 60 "
    "--each 2 --seed 1 --pictures -o shards"
)
subprocess.run(
    [sys.executable, "-m", "gpusim", *command.split()], cwd=folder, check=True, capture_output=True
)
print("gpusim", command)

# %%
# What is in it
# -------------
# Digital numbers, the same of the light alone, a picture, and what was drawn.

pairs: dict = {}
for shard in sorted((folder / "shards").glob("*.tar")):
    with tarfile.open(shard) as archive:
        for member in archive:
            key, _, suffix = member.name.partition(".")
            pairs.setdefault(key, {})[suffix] = archive.extractfile(member).read()
told = json.loads(pairs["00000000"]["json"])
print(
    ", ".join(
        f"{key}: {told[key]}"
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
    told = json.loads(pair["json"])
    axis.imshow(Image.open(io.BytesIO(pair["rgb.png"])))
    axis.set_title(
        f"1/{1 / told['exposure']:.0f} s, ISO {told['iso']:.0f}, {told['light']}", fontsize=9
    )
    axis.set_axis_off()

# %%
# Is the noise right?
# -------------------
# Photons and read noise make a variance that grows with the light: gain times the signal, and the variance in the dark.
# Each cloud is one pair, binned by its clean values; the lines have no free number, they follow from the file's own.

figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
for pair, color in zip(list(pairs.values())[::2], ("C0", "C1", "C2", "C3"), strict=True):
    told = json.loads(pair["json"])
    raw, clean = (
        np.load(io.BytesIO(pair[f"{name}.npy"])).astype(float) for name in ("raw", "clean")
    )
    light = clean - told["black_level"]
    edges = np.linspace(
        0, 0.6 * (told["white_level"] - told["black_level"]), 26
    )  # brighter ones may be clipped
    edges = edges[edges < np.quantile(light, 0.99)]
    inside = [(light >= low) & (light < high) for low, high in pairwise(edges)]
    noise = [np.var((raw - clean)[one]) for one in inside]
    signal = np.array([light[one].mean() for one in inside])
    gain = told["gain_dn_per_e"]
    axis.loglog(signal, noise, ".", color=color)
    axis.loglog(
        signal,
        gain * signal + (gain * told["read_noise_e"]) ** 2 + 1 / 12,
        color=color,
        label=f"{told['photograph']}, {gain:.2f} DN/e⁻",
    )
axis.set(xlabel="signal [DN]", ylabel="variance [DN²]")
axis.legend(frameon=False)
