"""A page with a slider of refocused pictures, in one file that needs no network."""

import base64
import io
import json
from collections.abc import Sequence
from html import escape

import numpy as np

from gpusim.backends import Device
from gpusim.captures.refocus import focus_each, slopes_between, view_planes
from gpusim.domain.display import DISPLAYS
from gpusim.domain.view_images import ViewImages

MOST_PICTURES = 41
MOST_BYTES = 4_000_000  # of the page
LONGEST = 1024  # [pixel] of a picture's side
QUALITIES = (88, 75, 60, 40)  # of JPEGs; the first that fits is taken
STYLE = """
:root { color-scheme: light dark; font: 16px/1.5 system-ui, sans-serif; }
body { margin: 0 auto; padding: 1rem; max-width: 66rem; }
h1 { font-size: 1.25rem; margin: 0 0 .75rem; overflow-wrap: anywhere; }
img { display: block; width: 100%; max-height: 75vh; object-fit: contain;
  image-rendering: auto; }
.bar { display: grid; grid-template-columns: auto 1fr minmax(8rem, auto); gap: .25rem 1rem;
  align-items: center; margin-top: .75rem; }
input { width: 100%; min-width: 0; height: 2rem; margin: 0; accent-color: #2563eb; }
output { font-variant-numeric: tabular-nums; text-align: right; }
p { color: #666; margin: .5rem 0 0; }
@media (prefers-color-scheme: dark) { p { color: #aaa; } }
@media (max-width: 40rem) { .bar { grid-template-columns: 1fr auto; }
  .bar input { grid-column: 1 / -1; grid-row: 2; } }
"""
SCRIPT = """
const data = JSON.parse(document.getElementById("pictures").textContent);
const slider = document.getElementById("focus"), words = document.getElementById("distance");
const picture = document.getElementById("picture");
const images = data.pictures.map(one => { const made = new Image();
  made.src = "data:image/jpeg;base64," + one; return made; });
function show() {
  const k = Number(slider.value), text = data.words[k];
  picture.src = images[k].src; picture.alt = data.name + ", focused at " + text;
  words.textContent = text; slider.setAttribute("aria-valuetext", text);
}
slider.addEventListener("input", show);
show();
"""


def refocus_page(
    views: ViewImages,
    *,
    white: float,
    distances: Sequence[float] | None = None,
    aperture: float | np.ndarray | None = None,
    device: Device | str = "auto",
) -> str:
    """Return an HTML page with pictures of the views focused from near to far.

    Args:
        views: The views, of one or three channels.
        white: Value that is white.
        distances: Nearest and farthest distance [m], as for `depth_from_views`.
        aperture: As for `refocus`.
        device: As for `refocus`.

    Returns:
        The text of the page, at most MOST_BYTES if its pictures can be made so small.

    Raises:
        BadData: As for `refocus`.
        OutOfRange: As for `depth_from_views`.
        DoesNotFit: The views do not fit into memory.
    """
    slopes = slopes_between(views, distances)[1:-1]
    if len(slopes) > MOST_PICTURES:
        slopes = np.linspace(slopes[0], slopes[-1], MOST_PICTURES)
    if views.slope_per_diopter < 0:  # the nearest first
        slopes = slopes[::-1]
    pictures = [
        codes_of(np.moveaxis(found, 0, -1), white)
        for found in focus_each(views, view_planes(views.values), slopes, aperture, device)
    ]
    pictures = [_shrink(one, -(-max(one.shape[:2]) // LONGEST)) for one in pictures]
    while True:
        for quality in QUALITIES:
            found = [_jpeg(one, quality) for one in pictures]
            if sum(map(len, found)) <= MOST_BYTES - 2**14:
                return _page(views, slopes, found)
        if min(pictures[0].shape[:2]) < 2:
            return _page(views, slopes, found)
        pictures = [_shrink(one, 2) for one in pictures]


def codes_of(picture: np.ndarray, white: float, bits: int = 8) -> np.ndarray:
    """Return the display codes of a linear picture, as sRGB.

    Args:
        picture: Shape (rows, cols, 1 or 3).
        white: Value that is white.
        bits: Bits of a code, 8 or 16.

    Returns:
        Codes, uint8 or uint16, shape (rows, cols, 3).
    """
    rgb = np.broadcast_to(picture / white, (*picture.shape[:2], 3))
    codes = DISPLAYS["srgb"].encode(np.clip(rgb, 0, 1))
    return np.rint((2**bits - 1) * codes).astype(np.uint16 if bits == 16 else np.uint8)


def _shrink(codes, factor):
    """Return codes with means of squares of `factor` pixels."""
    rows, cols = (n // factor for n in codes.shape[:2])
    if factor == 1 or not rows or not cols:
        return codes
    blocks = codes[: rows * factor, : cols * factor].reshape(rows, factor, cols, factor, 3)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def _jpeg(codes, quality):
    """Return a JPEG of codes, in base64."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(codes)).save(file, format="JPEG", quality=quality)
    return base64.b64encode(file.getvalue()).decode()


def describe_distance(distance: float) -> str:
    """Return a distance in words."""
    return "infinity" if np.isinf(distance) else f"{distance:.3g} m"


def _page(views, slopes, pictures):
    """Return the page. pictures: JPEGs in base64."""
    words = [describe_distance(float(views.distance_at(slope))) for slope in slopes]
    data = json.dumps({"name": views.name, "words": words, "pictures": pictures})
    data = data.replace("<", "\\u003c")  # a name cannot end the element
    start = int(np.abs(slopes).argmin())
    title = escape(f"{views.name}, refocused")
    rows, cols = views.shape
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title><style>{STYLE}</style></head><body><main>
<h1>{title}</h1>
<img id="picture" alt="">
<div class="bar"><label for="focus">Distance in focus</label>
<input id="focus" type="range" min="0" max="{len(slopes) - 1}" step="1" value="{start}">
<output id="distance" for="focus"></output></div>
<p>{len(slopes)} pictures from {rows} x {cols} views, from {escape(words[0])} to {escape(words[-1])}.</p>
</main><script id="pictures" type="application/json">{data}</script>
<script>{SCRIPT}</script></body></html>
"""
