"""A raw frame of a camera: pixel values and the settings under which it was taken."""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class RawFrame:
    """Raw values of one exposure. None: the file does not say.

    Serial numbers, owners and positions are never read.

    Args:
        values: Raw values [DN] of the light-sensitive pixels, shape (rows, cols), black level included.
        cfa: Period of the colour filter array as rows of letters, such as ("RG", "GB"); ("Y",) for
            one channel.
        name: Name of the file, without its folder.
        camera: Make and model.
        black_level: Black level [DN] that the file states, shape (1, 1) or one number for each place
            of a period, or None.
        white_level: Largest value [DN] that the file states.
        iso: ISO speed.
        exposure_time: Exposure time [s].
        f_number: F-number of the lens.
        focal_length: Focal length [m].
        temperature: Temperature of the sensor [deg C].
        photons: Photons on a pixel during the exposure, if they were measured [photon].
        noise_profile: Pairs S, O of a DNG's noise profile, shape (1, 2) or (planes, 2), or None.
        notes: Lines about tags of the file that are not used.
    """

    values: np.ndarray
    cfa: tuple[str, ...] = ("Y",)
    name: str = ""
    camera: str | None = None
    black_level: np.ndarray | None = None
    white_level: float | None = None
    iso: float | None = None
    exposure_time: float | None = None
    f_number: float | None = None
    focal_length: float | None = None
    temperature: float | None = None
    photons: float | None = None
    noise_profile: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    __repr__ = short_repr

    @property
    def channels(self) -> tuple[str, ...]:
        """Letters of the mosaic, each once, in their order of appearance."""
        return tuple(dict.fromkeys("".join(self.cfa)))

    @property
    def period(self) -> tuple[int, int]:
        """Rows and columns of one period of the mosaic."""
        return len(self.cfa), len(self.cfa[0])
