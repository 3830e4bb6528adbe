"""Sphinx's settings. `python -m sphinx -W -b html docs docs/_build` builds the pages, the gallery's examples included.

    pip install -e '.[docs]'

GPUSIM_EXAMPLES in the environment, a regular expression of paths, says which examples run; all do where it is not set.
"""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import generate  # noqa: E402  beside this file
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
suppress_warnings = ["config.cache"]  # the gallery's settings hold functions

myst_enable_extensions = ["colon_fence", "dollarmath", "deflist"]
myst_heading_anchors = 3
# unpicklable classes of the domain show their fields' values; tables of numbers would fill pages
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"

html_theme = "furo"
html_title = "gpusim"
html_static_path = ["_static"]
html_css_files = ["gpusim.css"]
html_copy_source = False


def whole_figures(gallery, path):
    """Save figures as notebooks show them: with all of their titles."""
    matplotlib.rcParams["savefig.bbox"] = "tight"


class InTurn:
    """Sorts examples as the gallery shows them; what has no place here comes last."""

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
        "figure_12",
        "figure_14",
        "emva1288",
        "your_own_parts",
    )

    def __init__(self, folder):
        pass

    def __call__(self, name):
        """Place of a file."""
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
    "min_reported_time": 30,  # [s] an example that takes longer is named: none should
    "within_subsection_order": InTurn,
    "capture_repr": (),  # what is printed, not the last line's value
    "matplotlib_animations": False,
    "reset_modules": ("matplotlib", whole_figures),
    "plot_gallery": "True",
}


def setup(app):
    """Write what is generated before anything is read; docstrings become what Sphinx reads."""
    app.connect("builder-inited", lambda app: generate.write(HERE / "generated"), priority=100)
    app.connect("autodoc-process-docstring", generate.readable)
