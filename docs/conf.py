"""Sphinx's settings. `python -m sphinx -W -b html docs docs/_build` builds pages and gallery.

    pip install -e '.[docs]'

The environment variable GPUSIM_EXAMPLES, a regular expression, selects the examples to run (default: all).
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import generate  # noqa: E402  in this folder
import matplotlib  # noqa: E402

import gpusim  # noqa: E402

project, author, release = "gpusim", "the authors of gpusim", gpusim.__version__
copyright = "the authors of gpusim"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_gallery.gen_gallery"]
exclude_patterns = [
    "_build",
    "examples",
    "README.md",
    "gallery/*.ipynb",
    "gallery/*.py",
    "gallery/*.json",
    "gallery/*.zip",
]
suppress_warnings = ["config.cache"]  # the gallery's settings contain functions

myst_enable_extensions = ["colon_fence", "dollarmath", "deflist"]
myst_heading_anchors = 3
# show defaults as written, since tables of numbers would fill pages
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"

html_theme = "furo"
html_title = "gpusim"
html_static_path = ["_static"]
html_css_files = ["gpusim.css"]
html_copy_source = False


def whole_figures(gallery, path):
    """Save figures with all their titles, as notebooks show them."""
    matplotlib.rcParams["savefig.bbox"] = "tight"


class InTurn:
    """Order of the examples in the gallery; files that are not listed come last."""

    names = (
        "start",
        "own_camera",
        "low_light",
        "render_to_raw",
        "training_pairs",
        "pixel_sizes",
        "measured_psf",
        "hdr_burst",
        "figure_8",
        "tolerances",
        "figure_12",
        "figure_14",
        "emva1288",
        "your_own_parts",
    )

    def __init__(self, folder):
        pass

    def __call__(self, name):
        """Return the position of a file."""
        stem = Path(name).stem
        return self.names.index(stem) if stem in self.names else len(self.names)


sphinx_gallery_conf = {
    "examples_dirs": str(HERE / "examples"),
    "gallery_dirs": str(HERE / "gallery"),
    "filename_pattern": os.environ.get("GPUSIM_EXAMPLES", r"\.py$"),
    "abort_on_example_error": True,
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 30,  # [s] slower examples are listed; none should be
    "within_subsection_order": InTurn,
    "capture_repr": (),  # only printed output, not the last value
    "matplotlib_animations": False,
    "reset_modules": ("matplotlib", whole_figures),
    "plot_gallery": "True",
}


def setup(app):
    """Connect the generator (before any page is read) and the conversion of docstrings."""
    app.connect("builder-inited", lambda app: generate.write(HERE / "generated"), priority=100)
    app.connect("autodoc-process-docstring", generate.readable)
