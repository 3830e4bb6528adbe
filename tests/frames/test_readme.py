"""The README's Python runs as it is written."""

from pathlib import Path


def test_the_ten_lines_run(capsys):
    text = (Path(__file__).parents[2] / "README.md").read_text()
    code = (
        text.partition("## Python in ten lines")[2].partition("```python\n")[2].partition("```")[0]
    )
    names: dict = {}
    for scene in (
        'open_scene("colorchecker"',
        'chart("deadleaves"',
    ):  # small ones: the words are what is tested
        assert scene in code
        code = code.replace(scene, f"{scene}, size=(96, 64)")
    exec(code, names)
    assert names["frame"].report.meets_tolerance and names["camera"].optics.f_number == 2
    assert names["raws"].shape == (16, 64, 96)
    assert capsys.readouterr().out.count("(64, 96, 3)") == 9
    assert len([line for line in code.split("\n") if line and not line.startswith("import")]) <= 10
