"""Files that were cut off: MATLAB's and Zemax's listings by every number of bytes."""

import instrument_files
import mat_mutations
import numpy as np
import pytest
from refusals import refused

from gpusim.domain.errors import BadFile
from gpusim.io.camera.zemax import read_zemax_psf
from gpusim.io.scene.scenes import open_scene

LAST = 64  # [byte] of which a file is cut by every number


def cuts_read(path, data, read, cuts=range(1, LAST + 1)):
    """How many bytes were cut off, of those files that are not refused in one line, and what was read."""
    found = {}
    for cut in cuts:
        path.write_bytes(data[:-cut])
        try:
            found[cut] = read(path)
        except BadFile as error:
            assert str(error).startswith(str(path)) and "\n" not in str(error)
    return found


@pytest.mark.parametrize("packed", [False, True])
def test_truncated_files_of_matlab_are_refused(tmp_path, packed):
    """All but those cut off between two variables, which nothing in a file of version 5 shows."""
    for variables in mat_mutations.GOOD:
        data, ends, at = mat_mutations.saved_5(variables, packed), [], 128  # the header's length
        while at < len(data):
            ends.append(at)
            at += 8 + int.from_bytes(data[at + 4 : at + 8], "little")
        cuts = {cut for cut in range(1, LAST + 1) if len(data) - cut in ends[1:]}
        assert at == len(data) and set(cuts_read(tmp_path / "a.mat", data, open_scene)) <= cuts
    (tmp_path / "a.mat").write_bytes(data[:128])
    with refused("a.mat", "holds no variables; is it truncated?", error=BadFile):
        open_scene(tmp_path / "a.mat")


@pytest.mark.parametrize("superblock", ["earliest", "latest"])
def test_truncated_files_of_matlab_7_3_are_refused(tmp_path, superblock):
    import h5py

    data = mat_mutations.saved_73(mat_mutations.GOOD[0])
    if superblock == "latest":  # copied by HDF5's own library into the newest structures
        (tmp_path / "b.mat").write_bytes(data)
        with (
            h5py.File(tmp_path / "b.mat") as old,
            h5py.File(tmp_path / "c.mat", "w", libver="latest") as new,
        ):
            for name in old:
                old.copy(name, new)
        data = (tmp_path / "c.mat").read_bytes()
    cuts = [*range(1, LAST + 1), *range(LAST + 1, len(data), 97)]
    assert cuts_read(tmp_path / "a.mat", data, open_scene, cuts) == {}
    (tmp_path / "a.mat").write_bytes(data + bytes(9))  # HDF5 allows files that are longer
    assert open_scene(tmp_path / "a.mat").shape == (6, 5)
    with h5py.File(tmp_path / "d.mat", "w"):
        pass
    with refused("d.mat", "holds no variables", error=BadFile):
        open_scene(tmp_path / "d.mat")


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("form", [".3E", ".6E", "g"])
@pytest.mark.parametrize("end", ["\n", "\r\n", ""])
def test_truncated_listings_of_zemax_are_refused(tmp_path, encoding, form, end):
    """Or give the same: without the last line's end nothing is lost if all numbers have one length."""
    values = np.random.default_rng(3).random((7, 9))
    text = instrument_files.LISTING.format(
        kind="Huygens",
        um=0.55,
        field="0 deg",
        centre="Center coordinates",
        x=0,
        y=0,
        middle="4, 5",
        values="relative intensity",
    ).replace("8 by 7", "7 by 9")
    lines = (end or "\n").join("\t".join(format(value, form) for value in line) for line in values)
    data = (text + lines + end).encode(encoding)
    (tmp_path / "a.txt").write_bytes(data)
    if form == "g" and not end:
        with refused("a.txt", "no line ends after the last value", "truncated", error=BadFile):
            read_zemax_psf(tmp_path / "a.txt")
        return
    whole = read_zemax_psf(tmp_path / "a.txt").values
    cut = cuts_read(tmp_path / "a.txt", data, lambda path: read_zemax_psf(path).values)
    assert all(np.array_equal(one, whole) for one in cut.values())
    assert max(cut, default=0) <= len(end) * (2 if encoding == "utf-16" else 1)
