"""Raw frames as arrays: .npy, .npz with settings, and TIFF planes."""

import difflib

import numpy as np

from gpusim.domain.errors import BadFile, OutOfRange
from gpusim.domain.memory import require_memory
from gpusim.io.archive import open_archive
from gpusim.io.files import open_file, reading
from gpusim.io.raw.raw_frame import RawFrame

ARRAYS = (".npy", ".npz", ".tif", ".tiff")
VALUES = ("dn", "raw", "values")  # keys of an .npz
NUMBERS = {  # keys of an .npz: field and factor to its unit
    "iso": ("iso", 1.0),
    "exposure_time_s": ("exposure_time", 1.0),
    "white_level": ("white_level", 1.0),
    "temperature_deg_c": ("temperature", 1.0),
    "f_number": ("f_number", 1.0),
    "focal_length_mm": ("focal_length", 1e-3),
    "photons": ("photons", 1.0),
}
KEYS = (*VALUES, *NUMBERS, "cfa", "black_level", "camera")
ALIKE = 0.62  # ratio of difflib: "black" for "black_level" has 0.625, other arrays such as "mean" 0.6 at most


def read_array(path, frame: int) -> RawFrame:
    """Read a frame of an array's file.

    Args:
        path: .npy, .npz or TIFF file.
        frame: Index of the frame of a stack.

    Returns:
        The frame, with the settings that an .npz has.

    Raises:
        BadFile: The file cannot be read, or holds no frames.
        OutOfRange: There is no such frame.
    """
    suffix, settings = path.suffix.lower(), {}
    if suffix == ".npz":
        values, settings = _read_npz(path)
    elif suffix == ".npy":
        values = _map_npy(path)
    else:
        values = _read_tiff(path, frame)
        frame = 0
    if values.ndim == 3:
        if not 0 <= frame < len(values):
            raise OutOfRange(f"frame of {path.name}", frame, f"0 .. {len(values) - 1}")
        name = f"{path.name}[{frame}]" if len(values) > 1 else path.name
        values = values[frame]
    else:
        name = path.name
    if values.ndim == 2:
        require_memory(f"{path}: a frame", 4 * values.size)
    return RawFrame(np.array(values), name=name, **settings)


def count_array_frames(path) -> int:
    """Return the number of frames of an array's file. Raises BadFile."""
    suffix = path.suffix.lower()
    if suffix == ".npy":
        shape = _map_npy(path).shape
    elif suffix == ".npz":
        with open_archive(path) as stored:
            shape = stored.shape(_key(path, stored))
    else:
        import tifffile

        with open_file(path) as file, reading(path, "a TIFF"), tifffile.TiffFile(file) as tiff:
            is_raw = tiff.pages.first.tags.get(50706) is not None  # DNGVersion: others are previews
            return 1 if is_raw else len(tiff.pages)
    return shape[0] if len(shape) == 3 else 1


def _key(path, stored):
    key = next((key for key in VALUES if key in stored), None)
    if key is None:
        raise BadFile(path, f"no raw values: wanted an array {' or '.join(VALUES)}")
    return key


def _read_npz(path):
    """Return values and settings of an .npz; other arrays are left, but for keys that are written wrongly."""
    with open_archive(path) as stored:
        for key in set(stored) - set(KEYS):
            if near := difflib.get_close_matches(key[:100], KEYS, 1, ALIKE):
                raise BadFile(path, f"{key}: no key of raw frames, the nearest is {near[0]}")
        values = stored[_key(path, stored)]
        settings = {}
        for key, (field, factor) in NUMBERS.items():
            if key in stored:
                number = np.asarray(stored[key], np.float64)
                if number.size != 1 or not np.isfinite(number).all():
                    raise BadFile(path, f"{key}: wanted one number")
                settings[field] = float(number.ravel()[0]) * factor
        if "cfa" in stored:
            settings["cfa"] = tuple(map(str, np.atleast_1d(stored["cfa"])))
        if "black_level" in stored:
            settings["black_level"] = np.atleast_2d(np.asarray(stored["black_level"], np.float64))
        if "camera" in stored:
            settings["camera"] = str(np.asarray(stored["camera"]).ravel()[0])
    return values, settings


def _map_npy(path):
    with open_file(path), reading(path, "a NumPy array (.npy)"):
        return np.load(path, mmap_mode="r", allow_pickle=False)


def _read_tiff(path, frame):
    import tifffile

    with open_file(path) as file, reading(path, "a TIFF"), tifffile.TiffFile(file) as tiff:
        count = len(tiff.pages)
        if not 0 <= frame < count:
            raise OutOfRange(f"frame of {path.name}", frame, f"0 .. {count - 1}")
        return np.squeeze(tiff.pages[frame].asarray())
