"""
Your own stage, model and backend
=================================

You can insert models that gpusim does not have between its steps. Here: cross-talk between pixels
as a stage with a reference that judges it, a lens with glare as a model, and a backend that counts
its work.
"""

import dataclasses
from collections import Counter
from contextlib import contextmanager

import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import correlate

import gpusim as gs
from gpusim.backends.device import Device
from gpusim.kernels.stage import Case

# %%
# A stage: cross-talk
# -------------------
# Of the electrons that light frees below a pixel, a fraction moves to each of its four neighbours.
# A stage starts with a float64 reference that reads like the formula. The reference judges the fast
# version, on cases with a tolerance and its reason.


def crosstalk_reference(mean, part):
    """Return the mean after each pixel passes `part` to each neighbour; edges are repeated."""
    wide = np.pad(np.asarray(mean, np.float64), 1, mode="edge")
    neighbours = wide[:-2, 1:-1] + wide[2:, 1:-1] + wide[1:-1, :-2] + wide[1:-1, 2:]
    return (1 - 4 * part) * mean + part * neighbours


def crosstalk(mean, part):
    """Return the same in float32, by one call."""
    weights = np.array([[0, part, 0], [part, 1 - 4 * part, part], [0, part, 0]], np.float32)
    return correlate(np.asarray(mean, np.float32), weights, mode="nearest")


random = np.random.default_rng(1)
for shape in ((1, 1), (3, 5), (64, 96)):
    inputs = {"mean": random.uniform(0, 6000, shape).astype(np.float32), "part": 0.03}
    case = Case(f"{shape}", inputs, 6 * 2.0**-24, "five products and four sums in float32")
    error = case.error(crosstalk(**inputs), crosstalk_reference(**inputs))
    print(
        f"{case.name:10s} error {error:.1e} of {case.tolerance:.1e}: {'ok' if error <= case.tolerance else 'FAIL'}"
    )

# %%
# In the chain
# ------------
# An exposure contains the mean electrons. You can replace them; the new electrons are drawn,
# converted and developed as usual. Colours fade and shift, since red and blue pixels now count
# green light, which the matrix does not know.

simulate = gs.Simulator(gs.open_camera("phone"))
exposure = simulate.expose(gs.chart("colorchecker", size=(240, 160)))


def with_electrons(exposure, mean):
    """Return an exposure with other mean electrons, (rows, cols), by the same chip."""
    mean = simulate.device.array(np.ascontiguousarray(mean, np.float32))
    chip = simulate.readout.chip_mean(mean, exposure.exposure_time)
    return dataclasses.replace(exposure, mean=mean, chip_mean=chip)


electrons = simulate.device.numpy(exposure.mean)
figure, axes = plt.subplots(1, 3, figsize=(11, 2.8), layout="constrained")
for axis, part in zip(axes, (0.0, 0.03, 0.1), strict=True):
    frame = with_electrons(exposure, crosstalk(electrons, part)).frame(seed=1)
    axis.imshow(frame.rgb)
    axis.set_title(f"{100 * part:.0f} % to each neighbour")
    axis.set_axis_off()

# %%
# To make it a stage of the package, add four files with its name to ``kernels/sensor``: the
# contract with its cases, the reference, an OpenCL and a Warp kernel. gpusim finds them by name;
# ``gpusim verify`` and the tests then run it on every device.

# %%
# A model: a lens with glare
# --------------------------
# A point spread function defines a lens. This one scatters 3 % of the light into a wide skirt,
# unlike the diffraction of a perfect lens.

y, x = (np.mgrid[:257, :257] - 128) * 0.3  # [µm]
r2 = x**2 + y**2
core, skirt = np.exp(-r2 / (2 * 0.8**2)), np.exp(-r2 / (2 * 12**2)) / (4**2 + r2)
spot = 0.97 * core / core.sum() + 0.03 * skirt / skirt.sum()
phone = gs.open_camera("phone")
lenses = {"clean": core, "with glare": spot}

lights = gs.chart("points", size=(240, 120), count=12, lowest=1e3, highest=1e6, seed=3)
figure, axes = plt.subplots(1, 2, figsize=(11, 3), layout="constrained")
for axis, (title, values) in zip(axes, lenses.items(), strict=True):
    spread = gs.PointSpread(np.array([360.0, 780.0]), np.stack([values, values]), 0.3e-6)
    lens = dataclasses.replace(phone.optics, model="measured", psf=spread)
    camera = dataclasses.replace(phone, optics=lens).with_(exposure_time_ms=300)
    axis.imshow(gs.Simulator(camera)(lights, seed=1).rgb)
    axis.set_title(title)
    axis.set_axis_off()

# %%
# A backend that counts its work
# ------------------------------
# A backend is a subclass of ``Device``. The base class computes by the references; this one also
# counts the stages. A backend for other hardware also defines how to allocate arrays and start a
# kernel (``launch``).


class Diary(Device):
    """The reference backend, with a count of each stage's runs."""

    name = "diary"

    def __init__(self):
        super().__init__()
        self.ran = Counter()

    @contextmanager
    def charged(self, stage):
        """Count the stage, then run it."""
        self.ran[stage] += 1
        with super().charged(stage):
            yield


small = gs.chart("colorchecker", size=(48, 32))
diary = Diary()
slow, fast = gs.Simulator(phone, device=diary)(small, seed=1), gs.Simulator(phone)(small, seed=1)
print(
    f"mean electrons differ by {np.abs(slow.mean / fast.mean - 1).max():.1e}, the picture in "
    f"{(slow.rgb != fast.rgb).sum()} of {slow.rgb.size} codes"
)
for stage, times in diary.ran.items():
    print(f"{stage:22s} {times}")

# %%
# A script saves its pictures:

gs.plot.save_figures("your_own_parts")
