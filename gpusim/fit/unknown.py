"""Numbers of a camera's noise that its shots do not give, and shots that would."""

from collections.abc import Iterator, Mapping, Sequence

from gpusim.fit.estimate import Estimate
from gpusim.fit.findings import ALARM
from gpusim.fit.noise import SHOOT_DARKS, IsoFit
from gpusim.fit.sorting import Summary


def known_white(fit: IsoFit, summaries: Sequence[Summary]) -> float | None:
    """Return the largest value [DN] that was reached or is stated, or None.

    Args:
        fit: The fit of an ISO speed.
        summaries: The shots.
    """
    return fit.transfer.white or summaries[0].frame.white_level


def unknown_lines(
    fits: Sequence[IsoFit], estimates: Mapping[str, Estimate], summaries: Sequence[Summary]
) -> Iterator[str]:
    """Yield lines about numbers that the shots do not give.

    Args:
        fits: Fits of all ISO speeds, the lowest first.
        estimates: Estimates by camera key.
        summaries: The shots.
    """
    fit = fits[0]
    if fit.is_whole and known_white(fit, summaries) is None:
        yield (
            "bits: no value is clipped and the files state no white level, the next usual number is taken; shoot a "
            "pair of flats that is overexposed in all channels"
        )
    if not any(key.startswith("sensor.full_well_e") for key in estimates):
        if fit.transfer.white is not None:
            yield (
                f"full well: the converter is full first, at {fit.transfer.white:g} DN; it is at least what "
                "reaches that, which the camera file has"
            )
        else:
            yield (
                "full well: no flat is saturated, the camera file has what fills the converter; shoot a pair of flats "
                "that is overexposed in all channels"
            )
    if fit.black_source == "bounds":
        yield (
            "black level and read noise: the files do not state a black level, there are bounds only; shoot two "
            "or more frames with the lens capped, or give .npz with black_level"
        )
    if fit.black_source == "hidden":
        yield (
            "black level and read noise: nearly all values of dark frames are 0, there are bounds only; raw files "
            "whose black level is above 0 would tell"
        )
    if fit.offsets is None:
        yield f"DSNU, fixed rows and columns, dark current, defects, tails: no dark frames; {SHOOT_DARKS}"
    elif fit.black_source == "clipped" and fit.dark_line.chance < ALARM:
        yield (
            "dark current: dark frames are clipped at 0, and their level is no line over exposure time; raw files "
            "whose black level is above 0 would tell"
        )
    elif not any(key.startswith("noise.dark_current") for key in estimates):
        yield (
            "dark current: dark frames of one exposure time, or of an unknown one; shoot darks of two "
            "times that differ tenfold or more"
        )
    if "noise.doubling_k" not in estimates:
        yield (
            "doubling of the dark current: needs darks at two temperatures that the files state; "
            "the camera file has the base's"
        )
    if "noise.adc_dn" not in estimates:
        yield "converter noise: is part of the read noise; shoot darks and flats at two ISO speeds to separate it"
    if fit.linearity is None:
        yield "linearity: needs flats of four or more exposure times in one constant light"
    if fit.response is None:
        yield "PRNU: no unclipped pairs of flats in all channels"
    if fit.drift is None and fit.darks:
        yield f"drift of the black level: {SHOOT_DARKS}"
    if any(level.count < 2 for level in fit.flats):
        yield "single flats are not used: their temporal noise needs pairs"
