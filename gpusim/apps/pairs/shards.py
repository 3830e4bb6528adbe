"""Samples in tar files for WebDataset: the files of a sample are adjacent and start with its key.

A file is complete or does not exist. It holds no time and no owner, so every run writes the same
bytes.
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
    """Return an array as the bytes of a .npy file."""
    file = io.BytesIO()
    np.save(file, np.ascontiguousarray(array), allow_pickle=False)
    return file.getvalue()
