"""What is shipped is what is in the tree, and imports point one way."""

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# who may import whom; every package may import itself and the packages in its set
ALLOWED = {
    "gpusim.domain": set(),
    "gpusim.io.atomic": {"gpusim.domain"},  # how files are opened and replaced, whatever is in them
    "gpusim.io.files": {"gpusim.domain"},
    "gpusim.io.archive": {"gpusim.domain", "gpusim.io.files"},
    "gpusim.data": {"gpusim.domain", "gpusim.io.archive", "gpusim.io.atomic", "gpusim.io.files"},
    "gpusim.io": {"gpusim.domain", "gpusim.data"},
    "gpusim.optics": {"gpusim.domain"},
    "gpusim.backends": {"gpusim.domain", "gpusim.kernels"},  # by path alone: it loads kernels by file name
    # data: built-in filter tables
    "gpusim.kernels": {"gpusim.domain", "gpusim.optics", "gpusim.backends", "gpusim.data"},
    "gpusim.measure": {"gpusim.domain", "gpusim.data", "gpusim.planner"},
    "gpusim.planner": {"gpusim.domain", "gpusim.data", "gpusim.optics"},
    "gpusim.report": {"gpusim.domain"},
    "gpusim.verify": {"gpusim.backends", "gpusim.kernels"},
    "gpusim.bench": {"gpusim.domain", "gpusim.backends", "gpusim.kernels", "gpusim.verify"},
    "gpusim.readout": {"gpusim.domain", "gpusim.backends", "gpusim.kernels", "gpusim.planner", "gpusim.program.kept"},
    "gpusim.developer": {"gpusim.domain", "gpusim.backends", "gpusim.kernels", "gpusim.planner"},
    "gpusim.program.kept": {"gpusim.backends"},
    "gpusim.frame": {"gpusim.domain", "gpusim.io", "gpusim.backends", "gpusim.planner", "gpusim.report"},
    "gpusim.program": {"gpusim.domain", "gpusim.backends", "gpusim.developer", "gpusim.frame", "gpusim.kernels",
                       "gpusim.optics", "gpusim.planner", "gpusim.report", "gpusim.truth", "gpusim.truth_field"},
    "gpusim.simulator": {"gpusim.domain", "gpusim.backends", "gpusim.frame", "gpusim.planner", "gpusim.program",
                         "gpusim.readout", "gpusim.report", "gpusim.truth"},
    "gpusim.l3": {"gpusim.domain", "gpusim.data", "gpusim.io", "gpusim.backends", "gpusim.developer", "gpusim.kernels",
                  "gpusim.measure", "gpusim.planner", "gpusim.program", "gpusim.simulator", "gpusim.frame"},
    "gpusim.captures": {"gpusim.domain", "gpusim.kernels", "gpusim.measure", "gpusim.planner", "gpusim.developer",
                        "gpusim.frame", "gpusim.program", "gpusim.report", "gpusim.simulator"},
    "gpusim.hard": {"gpusim.domain", "gpusim.data", "gpusim.optics", "gpusim.backends", "gpusim.kernels",
                    "gpusim.planner", "gpusim.readout", "gpusim.report", "gpusim.simulator"},
    "gpusim.truth": {"gpusim.domain", "gpusim.optics", "gpusim.planner", "gpusim.report", "gpusim.truth_blur",
                     "gpusim.truth_field", "gpusim.truth_light"},
    "gpusim.truth_blur": {"gpusim.domain", "gpusim.optics", "gpusim.planner", "gpusim.truth_light"},
    "gpusim.truth_field": {"gpusim.domain", "gpusim.optics", "gpusim.planner", "gpusim.truth_blur",
                           "gpusim.truth_light"},
    "gpusim.truth_light": {"gpusim.domain", "gpusim.optics", "gpusim.planner"},
    "gpusim.work": {"gpusim.kernels", "gpusim.optics", "gpusim.planner"},
    "gpusim.speeds": {"gpusim.backends", "gpusim.developer", "gpusim.kernels", "gpusim.work"},
    "gpusim.forecast": {"gpusim.domain", "gpusim.planner", "gpusim.simulator", "gpusim.speeds"},
    "gpusim.pareto": {"gpusim.domain", "gpusim.backends", "gpusim.report", "gpusim.simulator", "gpusim.speeds",
                      "gpusim.truth"},
    "gpusim.pairs": {"gpusim.backends", "gpusim.domain", "gpusim.data", "gpusim.io", "gpusim.options",
                     "gpusim.planner", "gpusim.simulator", "gpusim.video"},
    "gpusim.video": {"gpusim.backends", "gpusim.captures", "gpusim.domain", "gpusim.data", "gpusim.io",
                     "gpusim.options", "gpusim.planner", "gpusim.simulator"},
    "gpusim.preview": {"gpusim.backends", "gpusim.domain", "gpusim.data", "gpusim.frame", "gpusim.io", "gpusim.measure",
                       "gpusim.options", "gpusim.planner", "gpusim.program", "gpusim.report", "gpusim.simulator",
                       "gpusim.truth", "gpusim.video"},
    "gpusim.plot": {"gpusim.domain", "gpusim.data", "gpusim.forecast", "gpusim.frame", "gpusim.io", "gpusim.measure",
                    "gpusim.optics", "gpusim.planner", "gpusim.readout", "gpusim.report", "gpusim.simulator",
                    "gpusim.truth"},
    "gpusim.look": {"gpusim.data", "gpusim.domain", "gpusim.forecast", "gpusim.io", "gpusim.options", "gpusim.plot",
                    "gpusim.simulator"},
    "gpusim.options": {"gpusim.domain", "gpusim.io", "gpusim.planner"},
    "gpusim.batches": {"gpusim.domain", "gpusim.data", "gpusim.io", "gpusim.planner", "gpusim.program",
                       "gpusim.simulator"},
    "gpusim.ray": {"gpusim.batches", "gpusim.domain"},
    "gpusim.replicator": {"gpusim.batches", "gpusim.domain"},
    "gpusim.torch": {"gpusim.batches", "gpusim.domain", "gpusim.io", "gpusim.pairs", "gpusim.planner",
                     "gpusim.simulator"},
}
# from above to below: none may reach one before it, by whatever way
CHAIN = ("gpusim.captures", "gpusim.simulator", "gpusim.program", "gpusim.planner", "gpusim.optics", "gpusim.domain")


def packages(folder, name):
    return {".".join((name, *path.parent.relative_to(folder).parts)) for path in folder.rglob("__init__.py")}


def test_every_package_is_listed():
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    assert listed == packages(ROOT / "gpusim", "gpusim") | packages(ROOT / "kernels", "gpusim.kernels")


def test_kernels_cannot_be_imported_by_another_name():
    result = subprocess.run([sys.executable, "-c", "import kernels"], cwd=ROOT, capture_output=True, text=True)
    assert "import this package as gpusim.kernels" in result.stderr


def modules():
    for folder, name in ((ROOT / "gpusim", "gpusim"), (ROOT / "kernels", "gpusim.kernels")):
        for path in sorted(folder.rglob("*.py")):
            yield ".".join((name, *path.relative_to(folder).with_suffix("").parts)).removesuffix(".__init__"), path


def layer(module):
    return max((name for name in ALLOWED if module == name or module.startswith(f"{name}.")), key=len, default=None)


@pytest.mark.parametrize(("module", "path"), list(modules()))
def test_imports_point_one_way(module, path):
    own = layer(module)
    if own is None:
        assert module in ("gpusim", "gpusim.__main__", "gpusim.cli")  # the top may import everything
        return
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        for name in names:
            target = layer(name)
            if name.startswith("gpusim"):
                allowed = target is None or any(target == one or target.startswith(f"{one}.")
                                                for one in (own, *ALLOWED[own]))
                assert allowed, f"{module} imports upward: {name}"


def reached(name):
    """All that a package may import, and what that may import."""
    found, open_ends = set(), [name]
    while open_ends:
        for other in ALLOWED[open_ends.pop()] - found:
            found.add(other)
            open_ends.append(other)
    return found


@pytest.mark.parametrize("upper", CHAIN)
def test_packages_are_a_chain(upper):
    below = CHAIN[CHAIN.index(upper) + 1:]
    assert below[:1] == () or below[0] in reached(upper)
    assert not [lower for lower in below if upper in reached(lower)]


def test_import_is_light():
    """No slow library is loaded by `import gpusim` (design: under 0.3 s; a list is steadier than a clock)."""
    code = "import gpusim, sys; print(sorted({'warp', 'pyopencl', 'colour', 'scipy', 'PIL'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_devices_are_found_from_any_folder(tmp_path):
    """A folder with another `gpusim` in it, as the source tree is for an installed package, does not stop the probe."""
    (tmp_path / "gpusim").mkdir()
    (tmp_path / "gpusim" / "__init__.py").write_text("raise ImportError('the wrong gpusim')\n")
    code = "from gpusim.backends.probe import _names; print(_names())"
    result = subprocess.run([sys.executable, "-P", "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert "warp:cpu" in result.stdout and result.stdout.strip().endswith("'')"), result.stdout + result.stderr


def test_public_names_exist():
    import gpusim

    for name in gpusim.__all__:
        assert getattr(gpusim, name) is not None


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_closed_streams_are_no_mistake(closed):
    """What is wrong with the arguments is status 2 whatever is closed; with standard error it is said there."""
    command = f"{sys.executable} -m gpusim bench --help {closed}; echo status $? >&9"
    done = subprocess.run(["bash", "-c", f"exec 9>&1; {command}"], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "status 0" and "Traceback" not in done.stderr, done


def test_a_checkout_has_its_kernels_without_an_editable_install():
    """As after `pip install .`: Python in the checkout imports ./gpusim, whose kernels lie beside it."""
    code = ("import sys; sys.meta_path = [one for one in sys.meta_path if 'editable' not in repr(one)]; "
            "import gpusim.kernels.stage as one; print(one.__file__)")
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert Path(done.stdout.strip()) == ROOT / "kernels" / "stage.py", done.stderr


def test_devices_are_listed_in_a_checkout_without_an_editable_install(tmp_path):
    """`python -m gpusim devices` in the checkout, and the processes in which it tries devices, find this package."""
    (tmp_path / "sitecustomize.py").write_text(
        "import sys\nclass Removed(list):\n    def append(self, one):\n"
        "        if 'editable' not in repr(one):\n            super().append(one)\n"
        "sys.meta_path = Removed(one for one in sys.meta_path if 'editable' not in repr(one))\n")
    done = subprocess.run([sys.executable, "-m", "gpusim", "devices"], cwd=ROOT, capture_output=True,
                          text=True, env={**os.environ, "PYTHONPATH": str(tmp_path)})
    assert done.returncode == 0 and done.stdout.startswith("numpy"), done
    assert "Traceback" not in done.stderr and "No module named 'gpusim" not in done.stdout + done.stderr, done


def test_an_installed_package_has_the_kernels_own_init():
    """A wheel takes gpusim.kernels from kernels/, and not the file that finds them in a checkout."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    assert settings["package-dir"] == {"gpusim.kernels": "kernels"}
    assert "__path__" in (ROOT / "gpusim" / "kernels" / "__init__.py").read_text()
    assert "__path__" not in (ROOT / "kernels" / "__init__.py").read_text()
    assert [path.name for path in (ROOT / "gpusim" / "kernels").glob("*.*")] == ["__init__.py"]
