"""Lines of text about a picture, for the page and for notebooks."""

from gpusim.domain.account import SHOWN


def describe_exposure(facts: dict) -> str:
    """Return a line with exposure, gain and predicted error of a Picture's facts."""
    verdict = "" if facts["verdict"] is None else f" ({SHOWN[facts['verdict']]})"
    size = " of half the resolution" if facts.get("is half") else ""
    return f"exposure {1e3 * facts['exposure']:.4g} ms  gain {facts['gain']:.3g}  " + (
        f"draft{size}: its error is not predicted"
        if facts["draft"]
        else f"predicted error {facts['error']:.2g} rms{verdict}"
        + "".join(f"; not known: {cause}" for cause in facts["unknown"])
    )


def describe_plan(facts: dict) -> str:
    """Return a line with the effects that the plan leaves out."""
    return f"left out: {'; '.join(facts['left out']) or 'nothing'}"
