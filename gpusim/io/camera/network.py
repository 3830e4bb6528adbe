"""Files of the demosaicking network's weights, and the built-in weights.

A file is a NumPy archive: `version`, `provenance`, and `weight_K`, `bias_K` of layer K.
"""

import functools
from importlib import resources
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadFile
from gpusim.domain.network import VERSION, Network
from gpusim.io.archive import TEXT, WHOLE, open_archive, write_archive
from gpusim.io.files import name_in_errors

COPIES = 2.0  # of the numbers: in their final types, and whether each is finite
MOST_LAYERS = 64


@functools.cache
def built_in_network() -> Network:
    """Return the built-in network for mosaics of red, green and blue; see its `provenance`."""
    return read_network(Path(str(resources.files("gpusim.data")), "learned", "network.npz"))


def write_network(path, network: Network) -> None:
    """Write weights for `read_network`, as float16: they are small numbers. The path ends in .npz.

    Args:
        path: The file.
        network: The weights.

    Raises:
        BadFile: It cannot be written.
    """
    arrays = {"version": np.array(VERSION), "provenance": np.array(network.provenance)}
    for number, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        arrays[f"weight_{number}"] = weight.astype(np.float16)
        arrays[f"bias_{number}"] = bias.astype(np.float32)
    write_archive(path, arrays)


def read_network(path) -> Network:
    """Read weights.

    Args:
        path: A file that `write_network` or `gpusim train-network` wrote.

    Returns:
        The network.

    Raises:
        BadFile: The file is damaged, or no file of weights, or of another version.
        DoesNotFit: It needs more memory than there is.
    """
    with open_archive(path) as stored, name_in_errors(path):
        count = sum(name.startswith("weight_") for name in stored)
        names = [f"{kind}_{number}" for number in range(count) for kind in ("weight", "bias")]
        stored.require(("version", "provenance", *(names or ("weight_0",))))
        stored.shape("version", WHOLE, wanted=())
        stored.shape("provenance", TEXT, wanted=())
        for name in names:
            stored.shape(name)
        stored.require_memory(COPIES)
        version = int(stored["version"])
        if version != VERSION:
            raise BadFile(
                path, f"weights of version {version}; wanted version {VERSION}: train them again"
            )
        weights, biases = (
            tuple(np.asarray(stored[name], np.float32) for name in names[which::2])
            for which in (0, 1)
        )
        return Network(weights, biases, str(stored["provenance"]))
