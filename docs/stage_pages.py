"""Generates a page for each area of stages: contract, formula, figure, errors and speed."""

import importlib
import inspect
import json
from pathlib import Path

import prose
import stage_figures

from gpusim.kernels.stage import AREAS, public_function, stage_module, stage_names

ROOT = Path(__file__).parents[1]
TITLES = {
    "spectral": "Light: from spectra to planes",
    "optics": "Optics: the lens",
    "sensor": "Sensor: from light to digital numbers",
    "processor": "Image processor: from raw to colors",
    "display": "Display: from colors to codes",
}
METRICS = {
    "peak": "of the largest value",
    "local": "of each value",
    "exact": "absolute; 0 is bit for bit",
}


def write(folder, keep):
    """Write the pages and their figures; `keep(path, text)` writes a page."""
    figures = folder / "figures"
    figures.mkdir(exist_ok=True)
    speeds = load_results()
    for area in AREAS:
        lines = [TITLES[area], "=" * len(TITLES[area]), ""]
        for name in stage_names():
            if name.startswith(f"{area}."):
                lines += [*page(name, speeds, stage_figures.draw(name, figures)), ""]
        keep(folder / f"stages-{area}.rst", "\n".join(lines) + "\n")


def load_results() -> list[dict]:
    """Return the stored results of `gpusim bench run`, processors first."""
    found = [
        json.loads(path.read_text())
        for path in sorted((ROOT / "bench" / "results").glob("suite-*.json"))
    ]
    return sorted(found, key=lambda result: "NVIDIA" in result["machine"]["device"])


def page(name, speeds, figure):
    """Yield the lines of a stage."""
    module, reference = stage_module(name), importlib.import_module(f"gpusim.kernels.{name}_ref")
    function, leaf = public_function(name), name.rpartition(".")[2]
    yield from (f".. _{name}:", "", name, "-" * len(name), "")
    if figure:
        yield from (f".. image:: figures/{figure.name}", f"   :alt: {name}", "")
    yield from prose.rst(module.__doc__)
    yield from (
        ".. code-block:: python",
        "",
        f"   gpusim.kernels.{name}.{leaf}{signature(function)}",
        "",
    )
    yield from prose.rst(function.__doc__, list(inspect.signature(function).parameters))
    yield from (
        "**Reference** (float64): " + " ".join(prose.rst(reference.__doc__)).strip()
        if "::" not in prose.rst(reference.__doc__)
        else "**Reference** (float64):",
        "",
    )
    yield from fold(f"kernels/{name.replace('.', '/')}_ref.py", source(reference, leaf))
    yield from errors(module)
    yield from speed(name, speeds)


def signature(function):
    """Return a function's signature without types."""
    found = inspect.signature(function)
    return found.replace(
        parameters=[
            each.replace(annotation=inspect.Parameter.empty) for each in found.parameters.values()
        ]
    )


def source(reference, leaf):
    """Return the reference's source; if the function is imported, only the function's."""
    function = getattr(reference, leaf)
    own = inspect.getsource(reference)
    return own if f"def {leaf}(" in own else inspect.getsource(function)


def fold(summary, text):
    """Yield code that a click opens."""
    yield from (
        ".. raw:: html",
        "",
        f"   <details><summary>{summary}</summary>",
        "",
        ".. code-block:: python",
        "",
    )
    yield from ("   " + line for line in text.rstrip().split("\n"))
    yield from ("", ".. raw:: html", "", "   </details>", "")


def errors(module):
    """Yield the tolerances of a stage on all devices, with their reasons."""
    cases = dict.fromkeys((case.tolerance, case.metric, case.why) for case in module.cases())
    yield from ("**Required of every device** by ``gpusim verify``:", "")
    for tolerance, metric, why in sorted(cases, key=lambda one: -one[0])[:3]:
        yield f"* {tolerance:.2g} ({METRICS[metric]}): {prose.escaped(why)}"
    yield ""


def speed(name, speeds):
    """Yield the measured speeds and errors, device by device."""
    rows = [
        (result, row)
        for result in speeds
        for row in result["rows"]
        if row["name"] == f"{name} {row['size']}" and row["verified"]
    ]
    if not rows:
        return
    yield from (
        ".. list-table::",
        "   :header-rows: 1",
        "",
        *cells("device", "frame", "ms", "GB/s", "attained", "rms error", "largest error"),
    )
    for result, row in rows:
        device = result["machine"]["device"] + (
            f", ``{result['device']}``" if result["device"] else ""
        )
        yield from cells(
            device,
            row["size"],
            f"{row['ms_p50']:.3g}",
            f"{row['bytes'] / row['ms_p50'] / 1e6:.3g}",
            "" if row["attained"] is None else f"{row['attained']:.2f}",
            f"{row['rel_rms_error']:.1e}",
            f"{row['max_error']:.1e}",
        )
    yield ""


def cells(*texts):
    """Return a row of a list-table."""
    return [f"   {'*' if number == 0 else ' '} - {text}" for number, text in enumerate(texts)]
