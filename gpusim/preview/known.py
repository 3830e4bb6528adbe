"""What is known of a picture, in lines: for the page and for notebooks."""


def of_exposure(facts: dict) -> str:
    """Exposure, gain and predicted error of a Picture's facts, in a line."""
    verdict = {None: "", True: " (met)", False: " (NOT met)"}[facts["verdict"]]
    return (f"exposure {1e3 * facts['exposure']:.4g} ms  gain {facts['gain']:.3g}  "
            + ("draft: its error is not predicted" if facts["draft"] else
               f"predicted error {facts['error']:.2g} rms{verdict}"))


def of_plan(facts: dict) -> str:
    """What was left out, in a line."""
    return f"left out: {'; '.join(facts['left out']) or 'nothing'}"
