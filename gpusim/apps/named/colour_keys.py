"""Keys of colour: mosaic, responses of the channels, and shading of a tuning file."""

import re
from pathlib import Path

import numpy as np

from gpusim.apps.named.keys import GUESS, Sheet
from gpusim.apps.named.response import NODES, PEAK, Matrix, fit_response, typical_response
from gpusim.apps.named.wish import Wish
from gpusim.domain.errors import BadData
from gpusim.io.camera.cameras import read_curves
from gpusim.io.databases.catalogue import CameraEntry, Catalogue
from gpusim.io.databases.dcp import read_profile

DAYLIGHT = 6500.0  # [K]
_X_TRANS = re.compile(r"x-?(pro|e|h|s|m|t(?!100|200))\d|x-pro|x100(s|t|f|v)|x[237]0\b|xq\d", re.I)
_MONO = re.compile(r"monochrom|\bmono\b", re.I)


class Colour:
    """Responses of the channels, with their source.

    Attributes:
        curves: Wavelengths [nm] and responses of R, G, B; None for one channel or a file.
    """

    def __init__(self, sheet: Sheet, entry: CameraEntry, wish: Wish, catalogue: Catalogue):
        self.sheet, self.entry, self.wish = sheet, entry, wish
        self.places = catalogue.places
        self.is_mono = bool(_MONO.search(entry.name)) or bool(entry.tuning and entry.tuning.is_mono)
        self.matrices, self.source = self._matrices()
        self.curves, self.rms = None, 0.0
        if wish.sensitivity is not None:
            self.curves = NODES, self._read_measured()
        elif self.is_mono:
            pass
        elif self.matrices:
            found = fit_response(self.matrices)
            self.curves, self.rms = (NODES, found.qe), found.error
        else:
            typical = typical_response()
            self.curves = NODES, typical * PEAK / typical.max()

    def _read_measured(self):
        """Return the curves of the file of sensitivities at NODES, for lateral colour."""
        path = Path(self.wish.sensitivity)
        found, letters = read_curves(
            Path("camera.toml"), "sensitivity", str(path.absolute()), False
        )
        if letters != ("R", "G", "B"):
            raise BadData(f"{path}: columns {', '.join(letters)}; wanted R, G, B")
        return found.at(NODES)

    def _matrices(self):
        """Return the matrices that are known, and their source."""
        entry = self.entry
        path = self.wish.profile or entry.profile
        if path is not None:
            profile = read_profile(Path(path))
            lights = ", ".join(light for light, _ in profile.matrices)
            source = f"ColorMatrix in {lights} of {profile.file.name}"
            if not self.wish.profile:
                source += f" ({self.places['dcp'].label})"
            return [Matrix(light, own, light) for light, own in profile.matrices], source
        if entry.constants is not None and entry.constants.matrix is not None:
            source = f"dcraw_matrix in D65 of {self.places['camconst'].label}: {entry.constants.names[0]}"
            return [Matrix("D65", entry.constants.matrix, "D65")], source
        if entry.tuning is not None and (found := entry.tuning.nearest(DAYLIGHT)):
            matrix, kelvin = found
            light = f"daylight-{kelvin:.0f}K" if kelvin >= 4000 else f"blackbody-{kelvin:.0f}K"
            source = f"{self.places['libcamera'].label}: {entry.tuning.name}, rpi.ccm and rpi.awb at {kelvin:g} K"
            return [Matrix(light, matrix, "D65")], source
        return [], ""

    def add(self):
        """Add mosaic, responses and the processor's keys."""
        sheet, entry = self.sheet, self.entry
        if self.is_mono:
            sheet.add("sensor", "one channel, of its name", cfa=["W"])
            sheet.add(
                "sensor", f"{GUESS}a typical sensor without filters", qe="mt9v024", qe_ends="zero"
            )
            sheet.add("processor", "one channel", color="none")
        else:
            is_trans = "fuji" in entry.name.lower() and _X_TRANS.search(entry.name)
            mosaic = "x-trans" if is_trans else ["RG", "GB"]
            sheet.add("sensor", f"{GUESS}the mosaic, of the model's name", cfa=mosaic)
            self._add_curves()
        if entry.tuning is not None and entry.tuning.shading is not None:
            self._add_shading(entry.tuning)

    def _add_curves(self):
        sheet = self.sheet
        if self.wish.sensitivity is not None:
            path = str(Path(self.wish.sensitivity).absolute())
            sheet.add("sensor", "measured sensitivities, given", sensitivity=path)
            sheet.add(
                "sensor", f"{GUESS}efficiency of the highest sensitivity", sensitivity_peak=PEAK
            )
            return
        wavelengths, values = self.curves
        table = {"wavelengths_nm": wavelengths.tolist()}
        table |= {
            letter: np.round(own, 5).tolist() for letter, own in zip("RGB", values, strict=True)
        }
        if self.matrices:
            source = (
                f"fitted to {self.source}, within {100 * self.rms:.2g} % of white rms over surfaces; guess: their "
                f"shape beyond that (typical curves) and the peak of {PEAK:g} e-/photon"
            )
        else:
            source = f"{GUESS}typical curves with a peak of {PEAK:g} e-/photon; no matrix is known"
        sheet.add("sensor", source, qe=table, qe_ends="zero")

    def _add_shading(self, tuning):
        """Add the lens shading of a tuning file, at nodes from edge to edge."""
        source = (
            f"{self.places['libcamera'].label}: {tuning.name}, inverse of rpi.alsc luminance_lut"
        )
        source += "; colour shading is left out"
        self.sheet.add(
            "sensor", source, vignetting=np.round(spread_to_edges(tuning.shading), 5).tolist()
        )
        self.sheet.keys = [key for key in self.sheet.keys if key.name != "relative_illumination"]
        self.sheet.add("optics", "the measured shading has it", relative_illumination="none")


def spread_to_edges(cells: np.ndarray) -> np.ndarray:
    """Return values at as many places from edge to edge of the values in the middle of cells.

    Linear between the middles, and beyond the last ones as between the last two; at most 1.
    """
    for axis in (0, 1):
        count = cells.shape[axis]
        at = np.linspace(-0.5, count - 0.5, count)
        first = np.clip(np.floor(at).astype(int), 0, count - 2)
        part = (at - first).reshape([-1 if axis == one else 1 for one in (0, 1)])
        low, high = cells.take(first, axis), cells.take(first + 1, axis)
        cells = low + part * (high - low)
    return np.clip(cells, 0.0, 1.0)
