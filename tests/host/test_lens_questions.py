"""Only few files ask which kind a lens is: everything else calls the methods of `gpusim.optics.lens.Lens`."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
ASKING = {
    "gpusim/domain/optics.py",  # checks the settings
    "gpusim/domain/pupil.py",  # the geometry of pupils
    "gpusim/optics/lens.py",  # the classes
    "gpusim/judge/truth_lens.py",  # the truth asks for itself
}
SETTINGS = {"varies", "is_ideal", "is_symmetric", "has_mirror", "blades"}
CLASSES = {"PupilLens", "MeasuredLens", "PointLens"}


def asks(node):
    """Whether a node of the syntax tree is a question about a lens's kind."""
    if isinstance(node, ast.Attribute):
        owner = getattr(node.value, "attr", getattr(node.value, "id", ""))
        return node.attr in SETTINGS or (owner == "optics" and node.attr in ("psf", "model"))
    return isinstance(node, ast.Name) and node.id in CLASSES


def test_few_files_ask_about_a_lens():
    files = [*(ROOT / "gpusim").rglob("*.py"), *(ROOT / "kernels").rglob("*.py")]
    found = {
        str(path.relative_to(ROOT))
        for path in files
        if any(asks(node) for node in ast.walk(ast.parse(path.read_text())))
    }
    assert found == ASKING
