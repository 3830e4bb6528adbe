"""The account of what a reader did not use."""

import numpy as np
import pytest

import gpusim as gs
from gpusim.io.account import LONGEST_NOTE, Fields, note_of


def test_fields_that_are_neither_taken_nor_ignored_are_named_in_the_order_of_the_file():
    fields = Fields({"width": 4, "owner": "me", "exposure": 0.1, "comment 1": "", "comment 2": ""})
    assert fields.notes() == ("not used: width, owner, exposure, comment 1, comment 2",)
    assert fields.take("width") == 4
    assert fields.take("height", 3) == 3  # a default, which is no field
    fields.ignore("comment *", "software")
    assert fields.unused == ("owner", "exposure")
    assert "owner" in fields and "height" not in fields
    assert fields.notes() == ("not used: owner, exposure",)  # asking used nothing
    fields.ignore("*")
    assert fields.notes() == ()


def test_names_only():
    channels = Fields(["R", "N.X", "N.Y"], "channels without a use")
    assert channels.take("R") == "R" and channels.take("G") is None
    assert channels.notes() == ("channels without a use: N.X, N.Y",)


@pytest.mark.parametrize("count", [3, 20, 5000])
def test_a_note_is_one_line_of_limited_length(count):
    names = [f"name\n{number}" + "x" * number for number in range(count)]
    (note,) = note_of("not used", names)
    assert note.isprintable() and note.startswith("not used: name 0, name 1x, name 2xx")
    assert len(note) < LONGEST_NOTE + 40
    more = int(note.split(", ")[-1].split()[0]) if note.endswith(" more") else 0
    assert len(note.split(": ", 1)[1].split(", ")) + more - bool(more) == count


def test_a_name_that_is_empty_is_seen():
    assert note_of("not used", [""]) == ("not used: (no name)",)


def test_archives_account_for_their_keys(tmp_path):
    """Of a scene and of a lens; a camera repeats the lens's."""
    keys = {"wavelengths_nm": np.array([450.0, 550.0, 650.0]), "kind": "reflectance"}
    np.savez(tmp_path / "scene.npz", **keys, cube=np.ones((3, 4, 4)), exposure=3.0, foo=np.ones(4))
    assert gs.open_scene(tmp_path / "scene.npz").notes == ("keys not used: exposure, foo",)
    gs.save_scene(gs.open_scene(tmp_path / "scene.npz"), tmp_path / "own.npz")
    assert gs.open_scene(tmp_path / "own.npz").notes == ()
    lens = {
        "wavelengths_nm": np.array([360.0, 780.0]),
        "psf": np.ones((2, 3, 3)),
        "spacing_um": 0.2,
    }
    np.savez(tmp_path / "lens.npz", **lens, serial="12")
    (tmp_path / "a.toml").write_text(
        'base = "phone"\n[optics]\nmodel = "measured"\npsf = "lens.npz"\n'
    )
    assert gs.open_camera(tmp_path / "a.toml").notes == ("keys not used: serial",)
