"""A stage's OpenCL and Warp kernels take the same arguments, so that one launch serves both: read from their texts."""

import ast
import re
from pathlib import Path

import pytest

import gpusim.kernels

ROOT = Path(gpusim.kernels.__path__[0])
# names that Python or Warp's module keeps for something else
RENAMED = {
    ("common/copy", "copy"): {"in": "data"},
    ("optics/sample", "rows"): {"rows": "height"},
    ("processor/flash", "flash"): {"flash": "flash_"},
}
# kernels of another form for OpenCL's vectors: a run of pixels per work-item, strips of rows in local memory
OTHER_FORM = {"processor/merge": {"merge"}, "processor/best": {"differences", "greens", "colors"}}


def opencl_kernels(path):
    """Names of arguments by kernel."""
    text = re.sub(r"//[^\n]*", "", path.read_text())
    found = re.finditer(
        r"__kernel\s+(?:__attribute__\(\(.*?\)\)\)\s*)?void\s+(\w+)\s*\(([^{]*)\)\s*\{", text
    )
    return {
        match[1]: [re.search(r"(\w+)\s*$", argument)[1] for argument in match[2].split(",")]
        for match in found
    }


def warp_kernels(path):
    """The same; of functions with the decorator `wp.kernel`, and their overloads for other types."""
    tree = ast.parse(path.read_text())
    found = {
        node.name: [argument.arg for argument in node.args.args]
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and any(ast.unparse(decorator).startswith("wp.kernel") for decorator in node.decorator_list)
    }
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("wp.overload("):
            found[node.targets[0].id] = found[node.value.args[0].id]
    return found


def kernels():
    """(stage, kernel, OpenCL's arguments, Warp's); Warp modules made of the OpenCL text itself have no kernels."""
    for path in sorted(ROOT.rglob("*.cl")):
        warp = path.with_name(f"{path.stem}_warp.py")
        if warp.exists():
            stage, others = path.relative_to(ROOT).with_suffix("").as_posix(), warp_kernels(warp)
            for name, arguments in opencl_kernels(path).items():
                if name in others and name not in OTHER_FORM.get(stage, ()):
                    yield stage, name, arguments, others[name]


KERNELS = list(kernels())


def test_kernels_are_found():
    assert len(KERNELS) > 50
    assert ("processor/linear", "linear") in {(stage, name) for stage, name, *_ in KERNELS}


@pytest.mark.parametrize(
    ("stage", "name", "opencl", "warp"), KERNELS, ids=[f"{k[0]}-{k[1]}" for k in KERNELS]
)
def test_arguments_agree(stage, name, opencl, warp):
    """Warp may take more, sizes that OpenCL has as compile-time constants, but what both take is in one order."""
    wanted = [RENAMED.get((stage, name), {}).get(argument, argument) for argument in opencl]
    assert [argument for argument in warp if argument in wanted] == wanted
