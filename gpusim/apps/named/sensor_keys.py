"""Keys of [sensor] and [noise]: levels, gain, full well and read noise."""

import math

from gpusim.apps.named.keys import GUESS, Sheet
from gpusim.apps.named.lens_keys import FrameSize
from gpusim.apps.named.wish import Wish
from gpusim.domain.errors import OutOfRange
from gpusim.io.camera.noise_profile import NoiseProfile
from gpusim.io.databases.catalogue import CameraEntry, Catalogue
from gpusim.io.databases.libcamera import SENSORS

DENSITY = 2300.0  # [e- um-2] full well of a usual pixel; data sheets have 1500 .. 3500
CROWDED = 2.0  # times DENSITY from which a note says that the slope is not a pixel's
BITS = 14
CLEARANCE = 6.0  # standard deviations of the noise at black that a guessed black level leaves
READ = 3.0  # [e-] of a camera whose noise is not known


def add_sensor(
    sheet: Sheet, entry: CameraEntry, wish: Wish, frame: FrameSize, catalogue: Catalogue
) -> None:
    """Add levels, gain, full well and read noise.

    Args:
        sheet: Receives the keys.
        entry: The camera.
        wish: ISO, channel and full well.
        frame: The sensor's pixels.
        catalogue: Names of the data bases.

    Raises:
        BadData: No noise setting is usable.
        OutOfRange: The ISO is outside the data.
    """
    a, b, of, base = _noise(sheet, entry, wish, frame, catalogue)
    bits, white, black, of_levels = _levels(entry, wish, b, catalogue)
    profile = NoiseProfile(a, b, black, white)
    fields = profile.fields
    sheet.add("sensor", of_levels, bits=bits, black_level_dn=black)
    start = GUESS if of.startswith(GUESS) else ""
    words = of.removeprefix(GUESS)
    sheet.add(
        "sensor",
        f"{start}1 / a electrons at white, a = {a:.5g} of {words}",
        full_well_e=fields["full_well"],
    )
    sheet.add(
        "sensor",
        f"{start}a times the {white - black:g} DN from black to white",
        gain_dn_per_e=profile.gain,
    )
    if b <= 0:
        source = f"b = {b:.4g} <= 0, less than no noise: read noise 0, {words}"
    elif profile.read == 0:
        source = f"b = {b:.4g} is below the rounding of the converter: read noise 0, {words}"
    else:
        source = f"sqrt(b - rounding) / a, b = {b:.5g} of {words}"
    sheet.add("noise", start + source, read_e=profile.read)
    density = 1 / base / (frame.own_pitch * 1e6) ** 2
    if density > CROWDED * DENSITY and wish.full_well is None:
        usual = DENSITY * (frame.own_pitch * 1e6) ** 2
        sheet.notes.append(
            f"Noise: white is {1 / base:.3g} electrons at the lowest ISO, {density:.3g} a square micrometre, where "
            f"pixels have 1500 .. 3500. The data base's slope is of data that were smoothed before, not of one pixel: "
            f"give full_well, such as {usual:.2g} (--full-well), to scale all its noise."
        )


def _noise(sheet, entry, wish, frame, catalogue):
    """Return a and b, their source, and a of the lowest ISO."""
    iso = wish.iso
    if entry.noise is not None:
        own = entry.noise.usable(wish.channel)
        at = "RGB".index(wish.channel)
        iso = own[0].iso if iso is None else float(iso)
        a, b, is_entry = entry.noise.at(iso, wish.channel)
        base = min(one.a[at] for one in own)
        of = f"{catalogue.places['darktable'].label}: {entry.noise.maker} {entry.noise.model}, ISO {iso:g}, "
        of += f"channel {wish.channel}" + ("" if is_entry else ", interpolated")
        if iso == own[0].iso and wish.iso is None:
            of += " (the lowest)"
    elif entry.tuning is not None and entry.tuning.noise is not None:
        base, b = entry.tuning.slopes()
        iso = 100.0 if iso is None else float(iso)
        if iso < 100:
            raise OutOfRange("iso", f"{iso:g}", "100 or more: 100 is gain 1 of the tuning file")
        a, b = base * iso / 100, b * (iso / 100) ** 2
        of = f"{catalogue.places['libcamera'].label}: {entry.tuning.name}, rpi.noise at gain {iso / 100:g}"
        sheet.notes.append("Read noise: libcamera's noise has only a slope (its constant is 0).")
    else:
        base = 1 / (DENSITY * (frame.own_pitch * 1e6) ** 2)
        iso = 100.0 if iso is None else float(iso)
        a, b = base * iso / 100, (READ * base) ** 2 * iso / 100
        return (
            a,
            b,
            f"{GUESS}no noise data of this camera: {DENSITY:g} e- a square micrometre at ISO 100",
            base,
        )
    if wish.full_well is not None:
        factor = 1 / (wish.full_well * base)
        a, b, base = a * factor, b * factor, base * factor
        of += f", scaled to {wish.full_well:g} e- at the lowest ISO (given)"
    return a, b, of, base


def _levels(entry, wish, b, catalogue) -> tuple[int, float, int, str]:
    """Return bits, white and black level [DN] and their source."""
    constants, tuning = entry.constants, entry.tuning
    iso = wish.iso or 100
    bits, white = BITS, None
    if tuning is not None:
        bits = SENSORS.get(tuning.name.split("_")[0], (0, 0, 0, 10))[3]
        white = 2.0**bits - 1
        black = round(tuning.black * 2**bits)
        source = f"{catalogue.places['libcamera'].label}: {tuning.name}, rpi.black_level; bits of the data sheet"
        return bits, white, black, source
    source = "14 bits and their highest value as white"
    label = catalogue.places["camconst"].label if constants else ""
    if constants and (level := constants.white_at(iso)) and 255 <= level <= 65535:
        white, bits = level, max(1, math.ceil(math.log2(level + 1)))
        source = f"white {level:g} of {label}: {constants.names[0]}"
    white = white or 2.0**bits - 1
    if constants and constants.is_absolute and (black := constants.black_at(iso)) is not None:
        if black < white:
            return bits, white, round(black), f"{source}; black of the same"
    noise = CLEARANCE * math.sqrt(max(b, 0)) * white
    black = max(2**bits // 32, math.ceil(noise))
    black = min(black, int(white // 2))
    return bits, white, black, f"{GUESS}black level; {source}"
