"""Measured noise of cameras by ISO: darktable's noiseprofiles.json."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.io.databases.json_text import list_of, number_of, numbers_of, read_json, text_of

WHAT = "darktable's noiseprofiles.json"
CHANNELS = "RGB"


@dataclass(frozen=True)
class Setting:
    """Noise at one ISO: the variance of x is a x + b, x from 0 at black to 1 at white.

    Attributes:
        iso: ISO speed.
        a: Slope of red, green and blue.
        b: Variance at black of red, green and blue; negative if the fit gave that.
    """

    iso: float
    a: tuple[float, ...]
    b: tuple[float, ...]


@dataclass(frozen=True)
class CameraNoise:
    """Settings of one camera.

    Attributes:
        maker, model: Its names.
        settings: By rising ISO, one each.
        skipped: Number of entries that the file marks as not usable.
    """

    maker: str
    model: str
    settings: tuple[Setting, ...]
    skipped: int = 0

    def usable(self, channel: str) -> list[Setting]:
        """Return the settings whose slope is positive. Raises UnknownName, BadData."""
        if channel not in CHANNELS or len(channel) != 1:
            raise UnknownName("channel of the noise", channel, CHANNELS)
        at = CHANNELS.index(channel)
        own = [one for one in self.settings if one.a[at] > 0]
        if not own:
            raise BadData(f"{self.maker} {self.model}: no noise setting with a slope above 0")
        return own

    def at(self, iso: float, channel: str = "G") -> tuple[float, float, bool]:
        """Return a, b and whether an entry has them; between entries they are linear in ISO.

        Raises:
            BadData: No entry is usable.
            OutOfRange: The ISO is outside the entries.
            UnknownName: There is no such channel.
        """
        own = self.usable(channel)
        at = CHANNELS.index(channel)
        speeds = [one.iso for one in own]
        if not speeds[0] <= iso <= speeds[-1]:
            allowed = f"{speeds[0]:g} .. {speeds[-1]:g}, the entries of {self.maker} {self.model}"
            raise OutOfRange("iso", f"{iso:g}", allowed)
        a, b = (
            float(np.interp(iso, speeds, [one[at] for one in values]))
            for values in ([one.a for one in own], [one.b for one in own])
        )
        return a, b, iso in speeds


def read_noise_profiles(path: Path) -> list[CameraNoise]:
    """Read the noise profiles of all cameras.

    Args:
        path: noiseprofiles.json.

    Returns:
        The cameras, in the order of the file.

    Raises:
        BadFile: The file is none, or damaged.

    Source:
        J. Hanika, "Profiling sensor and photon noise", darktable.org, 2012: variance a x + b.
    """
    table = read_json(path, WHAT)
    found = []
    for number, maker in enumerate(
        list_of(path, "noiseprofiles", table.get("noiseprofiles"), dict)
    ):
        name = text_of(path, f"maker of entry {number + 1}", maker.get("maker"))
        for model in list_of(path, f"models of {name}", maker.get("models"), dict):
            found.append(_camera(path, name, model))
    return found


def _camera(path, maker, table) -> CameraNoise:
    model = text_of(path, f"model of {maker}", table.get("model"))
    settings: dict[float, Setting] = {}
    skipped = 0
    for one in list_of(path, f"profiles of {maker} {model}", table.get("profiles"), dict):
        if one.get("skip") is True:
            skipped += 1
            continue
        where = f"{maker} {model}: iso"
        iso = number_of(path, where, one.get("iso"), 1, 1e8)
        a, b = (
            tuple(numbers_of(path, f"{maker} {model} iso {iso:g}: {key}", one.get(key), 3, 1.0))
            for key in "ab"
        )
        settings.setdefault(iso, Setting(iso, a, b))
    ordered = tuple(settings[iso] for iso in sorted(settings))
    return CameraNoise(maker, model, ordered, skipped)
