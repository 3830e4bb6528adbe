"""Point spreads as NumPy archives: wavelengths_nm (L,), psf (L, rows, cols), spacing_um; integrated (optional).

Over the field: heights (H,) with psf (H, L, rows, cols), or grid_y (Y,), grid_x (X,) with psf (Y, X, L, rows, cols).
"""

import zipfile
import zlib
from pathlib import Path

import numpy as np

from gpusim.domain.errors import BadData, BadFile, OutOfRange
from gpusim.domain.psf import PointSpread


def read_psf(path) -> PointSpread:
    """Read a stack of point spreads, one per wavelength. Raises BadFile, naming the file and what is wrong with it."""
    try:
        with np.load(Path(path), allow_pickle=False) as archive:
            missing = [key for key in ("wavelengths_nm", "psf", "spacing_um") if key not in archive]
            if missing:
                raise BadFile(path, f"lacks {', '.join(missing)}; it has {', '.join(archive.files) or 'nothing'}")
            spacing = archive["spacing_um"].astype(np.float64)
            if spacing.ndim:
                raise BadFile(path, f"spacing_um: wanted one number, got shape {spacing.shape}")
            integrated = bool(archive["integrated"]) if "integrated" in archive else False
            heights = archive["heights"] if "heights" in archive else None
            axes = [key for key in ("grid_y", "grid_x") if key in archive]
            if len(axes) == 1:
                raise BadFile(path, f"has {axes[0]} alone; wanted grid_y and grid_x")
            return PointSpread(archive["wavelengths_nm"], archive["psf"], float(spacing) / 1e6, integrated, heights,
                               tuple(archive[key] for key in axes) or None)
    except OSError as error:
        raise BadFile(path, error.strerror or str(error)) from None
    except (ValueError, TypeError, AttributeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise BadFile(path, f"not a NumPy archive of point spreads: {error}") from None
    except (BadData, OutOfRange) as error:
        raise BadFile(path, str(error)) from None
