"""The README, and the pages that are made of the code, say what the code does."""

import ast
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from gpusim.cli import main as cli
from gpusim.domain.camera_keys import SECTIONS
from gpusim.kernels.stage import stage_names

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
PAGES = [ROOT / "README.md", ROOT / "bench" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BUILT = ("generated/", "gallery/")  # pages that are made when the documentation is built


@pytest.fixture(autouse=True)
def docs_are_found(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs")
    monkeypatch.syspath_prepend(ROOT / "tests" / "frames")


def commands(text):
    """Command lines in blocks and in quotes, continued lines joined."""
    blocks = re.findall(r"```\n(.*?)```", text, re.S)
    lines = [line for block in blocks for line in block.split("\n")] + re.findall(
        r"`(gpusim [^`]+)`", text
    )
    known = re.compile(r"(pip .* && )?(gpusim (simulate|plan|look|video|pairs) .*)")
    return [found[2] for line in lines if (found := known.fullmatch(line))]


def test_gallery_has_the_commands_that_made_it():
    pictures = (ROOT / "docs" / "pictures.py").read_text()
    shown = README.partition("<!-- gallery -->")[2].partition("<!-- end of gallery -->")[0]
    found = commands(shown)
    assert len(found) == 9 and shown.count("docs/pictures/") == 10  # one is of Python
    made = ast.parse(pictures)
    texts = {node.value for node in ast.walk(made) if isinstance(node, ast.Constant)}
    assert {*found} <= texts
    for picture in re.findall(r"docs/pictures/[\w-]+\.png", shown):
        assert (ROOT / picture).is_file()


def test_landing_page_has_four_cards_and_their_pages():
    """Each card leads to a page with a command, a picture and a time."""
    page = (ROOT / "docs" / "index.md").read_text()
    cards = re.findall(r":::\{container\} card\n\*\*\[[\w ]+\]\((\w+\.md)\)\*\*", page)
    assert cards == ["design.md", "train.md", "render.md", "kernels.md"]
    for name in cards:
        text = (ROOT / "docs" / name).read_text()
        assert re.search(r"^gpusim .*$", text, re.M) and "![" in text and "processor time" in text
    for picture in re.findall(r"\]\((pictures/[\w-]+\.png)\)", page):
        assert (ROOT / "docs" / picture).is_file()


def test_the_stage_of_the_kernels_page_is_the_one_that_is_tested():
    """tests/frames/test_trial_stage.py adds this stage and runs it."""
    from test_trial_stage import FILES, LINES, TRUTH

    page = (ROOT / "docs" / "kernels.md").read_text()
    blocks = [
        block.strip("\n") for block in re.findall(r"```\{code-block\} \w+\n(.*?)```", page, re.S)
    ]
    lines = [text for _, text in LINES.values() if text] + [TRUTH[1].split("    return found")[0]]
    assert blocks == [text.strip("\n") for text in (*FILES.values(), *lines)]


def test_pictures_of_plots_have_their_commands_and_all_panels():
    from gpusim.cli.look import PANELS

    pictures, page = ((ROOT / "docs" / name).read_text() for name in ("pictures.py", "plots.md"))
    found = [command for command in commands(page) if " -o " in command]
    assert len(found) == page.count("](pictures/") == 2
    for command in found:
        assert (
            f'"{command}"' in pictures
            and (ROOT / "docs" / "pictures" / shlex.split(command)[-1]).is_file()
        )
    assert {*re.findall(r"^\| `(\w+)` \|", page, re.M)} == {*PANELS}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_are_understood(page):
    parser = cli._parser()
    for command in commands(page.read_text()):
        if "--camera" in command:  # whole, not an option that a text speaks of
            assert parser.parse_args(shlex.split(command)[1:]).run


@pytest.mark.parametrize("page", PAGES, ids=lambda page: f"{page.parent.name}-{page.name}")
def test_links_lead_somewhere(page):
    from links import broken

    wrong = [line for line in broken([page]) if not any(f": {folder}" in line for folder in BUILT)]
    assert not wrong


def test_broken_links_are_found(tmp_path):
    from links import broken

    (tmp_path / "a.md").write_text(
        "# Head\n\n[good](#head) [bad](#no) [gone](b.md) [far](https://example.org)\n"
    )
    assert [line.rpartition(": ")[2] for line in broken([tmp_path / "a.md"])] == [
        "no such place",
        "no such file",
    ]


def test_every_key_and_stage_has_a_place():
    code = (
        "import generate, stage_pages; print('\\n'.join(generate.keys())); "
        "print('\\n'.join(generate.commands())); print('\\n'.join(generate.names()))"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT / "docs", capture_output=True, text=True, check=True
    )
    for keys in SECTIONS.values():
        for key in keys:
            assert f"``{key}``" in said.stdout, key
    import gpusim

    for name in gpusim.__all__:
        assert f"gpusim.{name}\n" in said.stdout, name
    tables = (ROOT / "docs" / "index.md").read_text()
    for area in {name.partition(".")[0] for name in stage_names()}:
        assert f"generated/stages-{area}" in tables


def test_defaults_are_in_the_units_of_the_file():
    """Against values known from the domain: 550 nm, 25 degrees, no aberration."""
    from generate import keys

    text = "\n".join(keys())
    for key, cells in (
        ("reference_nm", ("nm", "``550``")),
        ("temperature_c", ("°C", "``25``")),
        ("exposure_time_ms", ("ms", '``"auto"``')),
        ("pixel_pitch_um", ("µm",)),
    ):
        row = text.partition(f"* - ``{key}``\n")[2].partition("* - ")[0]
        assert all(f"- {cell}\n" in row for cell in cells), (key, row)


def test_docstrings_become_lists():
    from prose import rst

    said = rst(
        "Blur it.\n\nplanes: of light, shape (n,). mix_: `weights`\n    of each. Returns shape (m,). Raises "
        "BadData.\n\n"
        "    e = mc^2\n\nDone.",
        ["planes", "mix_"],
    )
    assert [line for line in said if line] == [
        "Blur it.",
        "* ``planes``: of light, shape (n,).",
        "* ``mix_``: ``weights`` of each.",
        "Returns shape (m,). Raises BadData.",
        "::",
        "    e = mc^2",
        "Done.",
    ]


def test_sections_become_lists():
    """Google style: Args, Raises and Source, and entries of several lines."""
    from prose import parameter_texts, rst

    docstring = """Blur it.

    Args:
        planes: Light, shape (n,)
            in W.
        mix, other: `weights` of each.

    Returns:
        Shape (m,).

    Raises:
        BadData: If a plane is missing.
    """
    assert [line for line in rst(docstring, ["planes", "mix", "other"]) if line] == [
        "Blur it.",
        "* ``planes``: Light, shape (n,) in W.",
        "* ``mix``, ``other``: ``weights`` of each.",
        "**Returns:**",
        "Shape (m,).",
        "**Raises:**",
        "* ``BadData``: If a plane is missing.",
    ]
    assert parameter_texts(docstring, ["planes", "mix", "other"]) == {
        "planes": ("Light, shape (n,) in W.", ("planes",)),
        "mix": ("`weights` of each.", ("mix", "other")),
        "other": ("`weights` of each.", ("mix", "other")),
    }
