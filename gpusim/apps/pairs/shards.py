"""Samples in tar files as WebDataset reads them: the files of a sample follow one another, and have its key.

A file is complete or not there, and the same bytes whoever makes it: it holds no time and no owner.
"""

import io
import tarfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from gpusim.io.atomic import atomic_path


def write_shard(path: Path, samples: Iterable[tuple[str, dict[str, bytes]]]):
    """Write samples, each a key and bytes by suffix, to a tar file. Raises BadFile."""
    with (
        atomic_path(path) as temporary,
        tarfile.open(temporary, "w", format=tarfile.USTAR_FORMAT) as file,
    ):
        for key, parts in samples:
            for suffix, data in parts.items():
                member = tarfile.TarInfo(f"{key}.{suffix}")
                member.size = len(data)
                file.addfile(member, io.BytesIO(data))


def npy(array) -> bytes:
    """An array as a .npy file."""
    file = io.BytesIO()
    np.save(file, np.ascontiguousarray(array), allow_pickle=False)
    return file.getvalue()
