"""What is known of a picture, in lines: for the page and for notebooks."""

from gpusim.domain.account import SHOWN


def of_exposure(facts: dict) -> str:
    """Exposure, gain and predicted error of a Picture's facts, in a line."""
    verdict = "" if facts["verdict"] is None else f" ({SHOWN[facts['verdict']]})"
    return f"exposure {1e3 * facts['exposure']:.4g} ms  gain {facts['gain']:.3g}  " + (
        "draft: its error is not predicted"
        if facts["draft"]
        else f"predicted error {facts['error']:.2g} rms{verdict}"
        + "".join(f"; not known: {cause}" for cause in facts["unknown"])
    )


def of_plan(facts: dict) -> str:
    """What was left out, in a line."""
    return f"left out: {'; '.join(facts['left out']) or 'nothing'}"
