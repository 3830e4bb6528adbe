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

PIECE = (
    2**20
)  # [byte] that small files fill before they are written; larger ones are written at once


def write_shard(path: Path, samples: Iterable[tuple[str, dict[str, bytes]]]):
    """Write samples, each a key and bytes by suffix, to a tar file. Raises BadFile."""
    with atomic_path(path) as temporary, open(temporary, "wb", PIECE) as file:
        size = 0
        for key, parts in samples:
            for suffix, data in parts.items():
                member = tarfile.TarInfo(f"{key}.{suffix}")
                member.size = len(data)
                for part in (
                    member.tobuf(tarfile.USTAR_FORMAT),
                    data,
                    bytes(-len(data) % tarfile.BLOCKSIZE),
                ):
                    size += file.write(part)
        # two blocks of zeros end an archive, whose size is one of whole records
        end = 2 * tarfile.BLOCKSIZE
        file.write(bytes(end + -(size + end) % tarfile.RECORDSIZE))


def npy(array) -> bytes:
    """Return an array as the bytes of a .npy file."""
    array = np.ascontiguousarray(array)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, np.lib.format.header_data_from_array_1_0(array))
    return b"".join((header.getvalue(), array.reshape(-1).view(np.uint8)))
