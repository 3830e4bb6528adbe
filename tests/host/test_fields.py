"""The account of what a reader did not use."""

import pytest

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
