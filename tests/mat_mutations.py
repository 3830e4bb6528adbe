"""Damaged files of MATLAB: ISETCam's variables, elements of version 5 and the HDF5 of version 7.3."""

import copy
import io
import re
import struct
import tempfile
import zlib
from pathlib import Path

import numpy as np
from mutations import WORDS, damaged, pick

RANDOM = np.random.default_rng(7)
WAVES, CUBE = np.array([400.0, 500.0, 650.0]), RANDOM.uniform(1, 2, (6, 5, 3))
LAMP = {
    "type": "illuminant",
    "name": "lamp",
    "data": {"photons": np.ones(3)},
    "spectrum": {"wave": WAVES},
}
SCENE = {
    "type": "scene",
    "name": "wall",
    "data": {"photons": CUBE.astype(np.float32)},
    "spectrum": {"wave": WAVES},
    "illuminant": LAMP,
    "wAngular": 10.0,
    "depthMap": CUBE[..., 0],
}
CODES = {"photons": (CUBE * 9999).astype(np.uint16), "dmin": 1.0, "dmax": 2.0, "bitDepth": 16.0}
GOOD = [
    {"scene": SCENE},
    {"x": 1.0, "mine": SCENE | {"data": CODES, "illuminant": LAMP | {"data": {"photons": CUBE}}}},
    {
        "oi": {
            "type": "opticalimage",
            "data": {"photons": CUBE},
            "spectrum": {"wave": WAVES},
            "optics": {"fNumber": 4.0},
        }
    },
    {
        "mcCOEF": CUBE,
        "basis": {"basis": np.eye(3), "wave": WAVES},
        "imgMean": np.ones(3),
        "comment": "text",
        "illuminant": {"data": np.ones(3), "wavelength": WAVES},
        "fov": 9.0,
    },
    {"photons": CUBE, "wave": WAVES, "illuminant": LAMP, "name": "a"},
    {"rad": CUBE, "bands": WAVES, "rgb": CUBE[..., :2], "norm_factor": 2.0, "text": "a"},
    {"hs": {"data": CUBE.astype(np.float32), "wl": WAVES / 1e3}, "mask": CUBE[..., 0] > 1.5},
]
VALUES = (
    0.0,
    -1.0,
    1e300,
    np.nan,
    np.inf,
    "",
    "x",
    "sensor",
    "y" * 5000,
    "窓\n",
    np.zeros((0, 0)),
    np.zeros((0, 3, 2)),
    np.ones((2, 2, 2, 2)),
    1j,
    np.ones((3, 1)),
    np.arange(9),
    np.full((6, 5, 3), 1e39),
    True,
    np.float32(3),
    {},
    {"photons": 1.0},
    {"data": CUBE},
    np.zeros((6, 5, 3), np.int8),
    WAVES[::-1],
    np.full((6, 5, 3), 7, np.uint32),
    np.array([400.0, 400.0, 500.0]),
    np.ones((6, 5)),
    -CUBE,
    np.zeros((6, 5, 3)),
    np.zeros((99, 99, 3)),
)
HDF5 = b"\x89HDF|TREE|SNOD|HEAP|GCOL|OHDR|OCHK|FRHP|BTHD|FADB|deflate"


def changed(variables, random):
    """Variables of which one, or a field at any depth, is another value, is missing or has another name."""
    variables = copy.deepcopy(variables)
    place = variables
    while True:
        name = pick(random, list(place))
        if not isinstance(place[name], dict) or not place[name] or random.random() < 0.2:
            break
        place = place[name]
    kind = int(random.integers(5))
    value = place[name]
    if kind == 0 and len(place) > 1:
        del place[name]
    elif kind == 1:
        place[pick(random, ("wave", "data", "basis", "photons", "min", "scene", "a" * 31))] = (
            place.pop(name)
        )
    elif kind == 2 and isinstance(value, np.ndarray):
        value = value.copy()
        with np.errstate(all="ignore"):
            value.reshape(-1)[int(random.integers(value.size))] = np.array(
                pick(random, (0, -1, 1e9, 1e38, 1e300, np.nan, np.inf, 1e-300))
            ).astype(value.dtype)
        place[name] = value
    elif kind == 3 and isinstance(value, np.ndarray):
        place[name] = np.resize(value, tuple(random.integers(0, 7, int(random.integers(2, 4)))))
    else:
        place[name] = pick(random, VALUES)
    return variables


# ---- version 5


def version_5(data: bytes, random) -> bytes:
    """A file of version 5 of which variables, or elements, say something else; sizes of packed ones are right."""
    if random.random() < 0.4:
        data = saved_5(changed(pick(random, GOOD), random), packed=random.random() < 0.3)
    variables = list(_variables(data))
    for _ in range(int(random.integers(0, 4))):
        number = int(random.integers(len(variables)))
        variables[number] = _reworded(variables[number], random)
    if random.random() < 0.1:
        variables.append(variables[0])
    whole = data[:128]
    for variable in variables:
        if random.random() < 0.4:
            more = bytes(int(10 ** random.uniform(3, 7))) if random.random() < 0.1 else b""
            packed = zlib.compress(variable + more)
            packed = packed if random.random() < 0.9 else damaged(packed, b"", random)
            whole += struct.pack("<II", 15, len(packed)) + packed
        else:
            whole += variable
    return whole


def saved_5(variables, packed=False):
    import scipy.io

    buffer = io.BytesIO()
    scipy.io.savemat(buffer, variables, do_compression=packed)
    return buffer.getvalue()


def _variables(data):
    """Variables of a whole file, each with its tag, not packed."""
    at = 128
    while at + 8 <= len(data):
        kind, length = struct.unpack_from("<II", data, at)
        yield (
            zlib.decompress(data[at + 8 : at + 8 + length])
            if kind == 15
            else data[at : at + 8 + length]
        )
        at += 8 + length


def _places(data, at, end):
    """Where elements begin, and those inside of them."""
    while at + 8 <= end:
        kind, length = struct.unpack_from("<II", data, at)
        yield at
        if kind >> 16:
            at += 8
            continue
        if kind == 14:
            yield from _places(data, at + 8, min(at + 8 + length, end))
        at += 8 + length + -length % 8


def _reworded(variable, random):
    """A variable with the type, the length or the first words of an element changed."""
    data = bytearray(variable)
    at = pick(random, list(_places(data, 0, len(data))))
    if random.random() < 0.2:
        at += 4 * int(random.integers(5))
    at, wide = at + int(random.integers(4)) * 4, pick(random, (1, 2, 4, 4, 4))
    number = pick(random, (*WORDS, *range(2, 18), 24, 32, 64, int(random.integers(10**6))))
    data[at : at + wide] = (number % 256**wide).to_bytes(wide, "little")
    return bytes(data)


# ---- version 7.3


def version_7_3(data: bytes, random, others: bool = True) -> bytes:
    """A file of version 7.3 with other variables, or words of its structures changed."""
    if others and random.random() < 0.3:
        data = saved_73(changed(pick(random, GOOD), random), pick(random, ("gzip", None)))
        if random.random() < 0.5:
            return data
    data = bytearray(data)
    places = [match.start() for match in re.finditer(HDF5, bytes(data))] or [0]
    for _ in range(int(random.integers(1, 6))):
        kind = int(random.integers(4))
        if kind <= 1:  # near a signature
            at = pick(random, places) + int(random.integers(0, 96))
        elif kind == 2:  # anywhere that is not empty: the messages of headers have no signature
            at = int(random.integers(len(data)))
            while at + 1 < len(data) and not data[at]:
                at += 1
        else:  # a number of 8 bytes that is an address or a size
            at = 8 * int(random.integers(64, max(len(data) // 8, 65)))
        wide = pick(random, (1, 1, 2, 4, 8))
        number = pick(
            random,
            (
                *WORDS,
                2,
                3,
                4,
                5,
                6,
                8,
                9,
                11,
                12,
                16,
                17,
                24,
                512,
                int(random.integers(len(data))),
                int(random.integers(10**6)),
            ),
        )
        if (
            random.random() < 0.3
        ):  # an address, counted from the user block on; of something else, or of itself
            number, wide = max(pick(random, places) - 512, 0), 8
        if random.random() < 0.3 and at < len(data):
            number, wide = data[at] ^ (1 << int(random.integers(8))), 1
        data[at : at + wide] = (number % 256**wide).to_bytes(wide, "little")
    return bytes(data)


def saved_73(variables, compression="gzip"):
    from matlab import save73

    with tempfile.TemporaryDirectory() as folder:
        save73(Path(folder) / "a.mat", variables, compression)
        return (Path(folder) / "a.mat").read_bytes()


def good(reader):
    """Bytes of files that the reader takes."""
    if reader == "mat":
        return [saved_5(variables, packed) for variables in GOOD for packed in (False, True)]
    return [
        saved_73(variables, compression) for variables in GOOD for compression in ("gzip", None)
    ]


# ---- HDF5 of other programs


def saved_hdf5(cube=CUBE, waves=WAVES, own=(), more=(), packing=None, latest=False):
    """Bytes of a file with a cube and its wavelengths. own: attributes of the cube."""
    import h5py

    file = io.BytesIO()
    with h5py.File(file, "w", libver="latest" if latest else None) as held:
        if packing and np.ndim(cube):
            held.create_dataset("scene/cube", data=cube, compression=packing, shuffle=True)
        else:
            held["scene/cube"] = cube
        held["scene/cube"].attrs.update(dict(own))
        held["scene/wavelength"] = waves
        held["scene/wavelength"].attrs["units"] = "nm"
        for name, value in dict(more).items():
            held[name] = value
    return file.getvalue()


ATTRIBUTES = (
    "scale_factor",
    "add_offset",
    "_FillValue",
    "Scale_Factor",
    "units",
    "wavelengths",
    "gain",
)
SMALL = {
    "scale_factor": 0.5,
    "add_offset": 0.01,
    "_FillValue": -1.0,
    "units": "1",
    "long_name": "a",
}


def good_hdf5():
    """Bytes of files that the reader takes."""
    return [
        saved_hdf5(),
        saved_hdf5(own=SMALL, packing="gzip", more={"other/mask": CUBE[..., 0]}),
        saved_hdf5((CUBE * 99).astype(np.int16), own={"Scale_Factor": 200.0}, packing="lzf"),
        saved_hdf5(own=SMALL, more={"a/b/c": 1.0}, latest=True),
    ]


def hdf5(data: bytes, random) -> bytes:
    """A file of HDF5 with other values and attributes, or words of its structures changed."""
    if random.random() < 0.4:
        own = {
            pick(random, ATTRIBUTES): pick(
                random, (0.0, -1.0, 1e300, np.nan, "x", "y" * 999, WAVES)
            )
            for _ in range(int(random.integers(3)))
        }
        found = changed({"cube": CUBE, "waves": WAVES, "more": {"a": CUBE}}, random)
        try:
            data = saved_hdf5(
                found.get("cube", 1.0), found.get("waves", 1.0), own, found.get("more") or {},
                pick(random, ("gzip", "lzf", None)), random.random() < 0.3,
            )  # fmt: skip
        except (TypeError, ValueError, AttributeError, OSError):  # values that HDF5 does not hold
            return damaged(data, data, random)
        if random.random() < 0.6:
            return data
    return version_7_3(bytes(512) + data, random, others=False)[512:]
