"""What is known of a picture, as lines of text and as a histogram: for the page and for notebooks."""

COLOURS = {"R": "#e05050", "G": "#40b050", "B": "#5070e0"}


def of_exposure(facts: dict) -> str:
    """Exposure, gain and predicted error of a Picture's facts, in a line."""
    verdict = {None: "", True: " (met)", False: " (NOT met)"}[facts["verdict"]]
    return (f"exposure {1e3 * facts['exposure']:.4g} ms  gain {facts['gain']:.3g}  "
            + ("draft: its error is not predicted" if facts["draft"] else
               f"predicted error {facts['error']:.2g} rms{verdict}"))


def of_plan(facts: dict) -> str:
    """What was left out, in lines; "" where nothing was."""
    return "\n".join(["left out:", *facts["left out"]] if facts["left out"] else [])


def histogram(found: dict) -> str:
    """Counts of the electrons of each channel, from 0 to full well, as an SVG. found: of `Producer.statistics`."""
    counts = {letter: [count**0.5 for count in bins] for letter, bins in found["counts"].items()}
    most = max((max(bins) for bins in counts.values()), default=0.0) or 1.0
    lines = []
    for letter, bins in counts.items():
        step = 400 / len(bins)
        points = " ".join(f"{step * (k + 0.5):.1f},{80 - 76 * count / most:.1f}" for k, count in enumerate(bins))
        lines.append(f'<polyline points="{points}" fill="none" stroke="{COLOURS.get(letter, "#ccc")}"/>')
    text = (f'<text x="2" y="94" fill="#aaa" font-size="10">0 e-</text><text x="398" y="94" fill="#aaa" font-size="10" '
            f'text-anchor="end">full well {found["full well"]:.4g} e-</text><text x="200" y="94" fill="#aaa" '
            f'font-size="10" text-anchor="middle">black level {found["black level"]:.4g} DN</text>')
    return (f'<svg viewBox="0 0 400 98" style="width:100%;background:#171717">{"".join(lines)}{text}'
            '<line x1="0" y1="80" x2="400" y2="80" stroke="#555"/></svg>')
