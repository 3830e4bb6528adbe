"""Curves next to the picture, as SVG, of the values of `gpusim.apps.preview.measures`."""

COLOURS = {"R": "#e05050", "G": "#40b050", "B": "#5070e0"}


def histogram(found: dict) -> str:
    """Return a picture of the histogram of electrons by channel, from 0 to full well."""
    counts = {letter: [count**0.5 for count in bins] for letter, bins in found["counts"].items()}
    most = max((max(bins) for bins in counts.values()), default=0.0) or 1.0
    lines = []
    for letter, bins in counts.items():
        step = 400 / len(bins)
        points = " ".join(
            f"{step * (k + 0.5):.1f},{80 - 76 * count / most:.1f}" for k, count in enumerate(bins)
        )
        lines.append(
            f'<polyline points="{points}" fill="none" stroke="{COLOURS.get(letter, "#ccc")}"/>'
        )
    text = (
        f'<text x="2" y="94" fill="#aaa" font-size="10">0 e-</text><text x="398" y="94" fill="#aaa" font-size="10" '
        f'text-anchor="end">full well {found["full well"]:.4g} e-</text><text x="200" y="94" fill="#aaa" '
        f'font-size="10" text-anchor="middle">black level {found["black level"]:.4g} DN</text>'
    )
    return (
        f'<svg viewBox="0 0 400 98" style="width:100%;background:#171717">{"".join(lines)}{text}'
        '<line x1="0" y1="80" x2="400" y2="80" stroke="#555"/></svg>'
    )


def response(found: dict) -> str:
    """Return a picture of the frequency response of an edge, from 0 to 1 cycle/pixel."""
    most = max(1.0, *found["response"])
    points = " ".join(
        f"{400 * f:.1f},{80 - 76 * r / most:.1f}"
        for f, r in zip(found["frequencies"], found["response"], strict=True)
    )
    at = 400 * found["mtf50"]
    return (
        f'<svg viewBox="0 0 400 98" style="width:100%;background:#171717"><polyline points="{points}" fill="none" '
        f'stroke="#ffd54f"/><line x1="{at:.1f}" y1="0" x2="{at:.1f}" y2="80" stroke="#888"/><line x1="0" y1="80" '
        'x2="400" y2="80" stroke="#555"/><g fill="#aaa" font-size="10"><text x="2" y="94">0</text>'
        '<text x="200" y="94" text-anchor="middle">0.5 cycle/pixel</text>'
        '<text x="398" y="94" text-anchor="end">1</text></g></svg>'
    )
