"""What is shipped is what is in the tree, and imports point one way."""

import ast
import os
import subprocess
import sys
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# a package imports only packages before it
LAYERS = (
    "domain",
    "data",
    "optics",
    "backends",
    "io",
    "planner",
    "color",
    "kernels",
    "measure",
    "pipeline",
    "judge",
    "captures",
    "plot",
    "fit",
    "apps",
    "bench",
    "cli",
)


def packages(folder, name):
    return {
        ".".join((name, *path.parent.relative_to(folder).parts))
        for path in folder.rglob("__init__.py")
    }


def test_every_package_is_listed():
    listed = set(
        tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    )
    assert listed == packages(ROOT / "gpusim", "gpusim") | packages(
        ROOT / "kernels", "gpusim.kernels"
    )


def test_kernels_cannot_be_imported_by_another_name():
    result = subprocess.run(
        [sys.executable, "-c", "import kernels"], cwd=ROOT, capture_output=True, text=True
    )
    assert "import this package as gpusim.kernels" in result.stderr


def modules():
    for folder, name in ((ROOT / "gpusim", "gpusim"), (ROOT / "kernels", "gpusim.kernels")):
        for path in sorted(folder.rglob("*.py")):
            yield (
                ".".join((name, *path.relative_to(folder).with_suffix("").parts)).removesuffix(
                    ".__init__"
                ),
                path,
            )


def layer(module):
    """Package of a module, "" of the top, which may import everything."""
    return module.split(".")[1] if module.count(".") and module != "gpusim.__main__" else ""


class WithoutTypes(ast.NodeTransformer):
    """Takes out the imports that only type checkers see."""

    def visit_If(self, node):
        return None if ast.unparse(node.test) == "TYPE_CHECKING" else self.generic_visit(node)


def imports(path, with_types=True):
    """Modules that a file imports anywhere. with_types: also those that only type checkers see."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree if with_types else WithoutTypes().visit(tree)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_every_package_has_a_layer():
    assert {layer(module) for module, _ in modules()} - {""} == set(LAYERS)


def test_imports_point_one_way():
    above = {}
    for module, path in modules():
        for name in imports(path) if layer(module) else ():
            if (
                name.startswith("gpusim.")
                and layer(name) in LAYERS[LAYERS.index(layer(module)) + 1 :]
            ):
                above.setdefault((layer(module), layer(name)), []).append(
                    f"{module} imports {name}"
                )
    assert not above


def test_no_files_import_one_another_in_a_circle():
    """Imports inside functions count, too, those for type checkers only do not.

    The face, `gpusim`, hands in what stands above a package.
    """
    known = dict(modules())
    graph = {}
    for module, path in known.items():
        names = {
            name if name in known else name.rpartition(".")[0]
            for name in imports(path, with_types=False)
        }
        graph[module] = (names & known.keys()) - {module, "gpusim"}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the files


def test_there_are_few_rooms():
    """Files and folders directly in the installed package: at most 20."""
    assert len({f"{module}.face".split(".")[1] for module, _ in modules()}) <= 20


def test_import_is_light():
    """No slow library is loaded by `import gpusim` (design: under 0.3 s; a list is steadier than a clock)."""
    code = "import gpusim, sys; print(sorted({'warp', 'pyopencl', 'colour', 'scipy', 'PIL'} & set(sys.modules)))"
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip()
        == "[]"
    )


def test_devices_are_found_from_any_folder(tmp_path):
    """A folder with another `gpusim` in it, as the source tree is for an installed package, does not stop the probe."""
    (tmp_path / "gpusim").mkdir()
    (tmp_path / "gpusim" / "__init__.py").write_text("raise ImportError('the wrong gpusim')\n")
    code = "from gpusim.backends.probe import _names; print(_names())"
    result = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert "warp:cpu" in result.stdout and result.stdout.strip().endswith("'')"), (
        result.stdout + result.stderr
    )


def test_public_names_exist():
    import gpusim

    for name in gpusim.__all__:
        assert getattr(gpusim, name) is not None


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_closed_streams_are_no_mistake(closed):
    """What is wrong with the arguments is status 2 whatever is closed; with standard error it is said there."""
    command = f"{sys.executable} -m gpusim bench --help {closed}; echo status $? >&9"
    done = subprocess.run(
        ["bash", "-c", f"exec 9>&1; {command}"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.stdout.splitlines()[-1] == "status 0" and "Traceback" not in done.stderr, done


def test_a_checkout_has_its_kernels_without_an_editable_install():
    """As after `pip install .`: Python in the checkout imports ./gpusim, whose kernels lie beside it."""
    code = (
        "import sys; sys.meta_path = [one for one in sys.meta_path if 'editable' not in repr(one)]; "
        "import gpusim.kernels.stage as one; print(one.__file__)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert Path(done.stdout.strip()) == ROOT / "kernels" / "stage.py", done.stderr


def test_devices_are_listed_in_a_checkout_without_an_editable_install(tmp_path):
    """`python -m gpusim devices` in the checkout, and the processes in which it tries devices, find this package."""
    (tmp_path / "sitecustomize.py").write_text(
        "import sys\nclass Removed(list):\n    def append(self, one):\n"
        "        if 'editable' not in repr(one):\n            super().append(one)\n"
        "sys.meta_path = Removed(one for one in sys.meta_path if 'editable' not in repr(one))\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "gpusim", "devices"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    assert done.returncode == 0 and done.stdout.startswith("numpy"), done
    assert (
        "Traceback" not in done.stderr
        and "No module named 'gpusim" not in done.stdout + done.stderr
    ), done


def test_an_installed_package_has_the_kernels_own_init():
    """A wheel takes gpusim.kernels from kernels/, and not the file that finds them in a checkout."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert settings["package-dir"] == {"gpusim.kernels": "kernels"}
    assert "__path__" in (ROOT / "gpusim" / "kernels" / "__init__.py").read_text()
    assert "__path__" not in (ROOT / "kernels" / "__init__.py").read_text()
    assert [path.name for path in (ROOT / "gpusim" / "kernels").glob("*.*")] == ["__init__.py"]
