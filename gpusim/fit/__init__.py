"""Cameras from their own raw files: `gpusim fit`, and `gs.fit(files)`.

The package is callable, because an import of one of its modules sets `gpusim.fit` to the package.
"""

import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from types import ModuleType
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from gpusim.fit.fitting import Fit


class _Function(ModuleType):
    """A package that can be called."""

    def __call__(
        self,
        files: str | os.PathLike | Iterable[str | os.PathLike] = (),
        *,
        darks: str | os.PathLike | Iterable[str | os.PathLike] = (),
        flats: str | os.PathLike | Iterable[str | os.PathLike] = (),
        pairs: str | os.PathLike | Iterable[str | os.PathLike] = (),
        chart: str | os.PathLike | Iterable[str | os.PathLike] = (),
        edges: str | os.PathLike | Iterable[str | os.PathLike] = (),
        grid: str | os.PathLike | Iterable[str | os.PathLike] = (),
        shading: str | os.PathLike | Iterable[str | os.PathLike] = (),
        ramp: str | os.PathLike | Iterable[str | os.PathLike] = (),
        base: str | os.PathLike | None = None,
        cfa: str | Sequence[str] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> "Fit":
        """Fit a camera to its own raw files.

        The shots decide which parts are fitted; `Fit.unknown` names the rest. Every estimate has an
        interval of 95 % confidence; `Fit.unexplained` lists findings outside the model. A part whose
        frames cannot be used does not end the fit, if there are others: `Fit.failed` says why.

        Args:
            files: Raw files or folders. A folder's name (darks, flats, pairs, chart, edges, grid,
                shading, ramp) or its own name (grid_03.dng) says what its frames show; of other
                files the content does: dark, even light, or a static scene, twice or more.
            darks: Frames without light, at one or more exposure times and temperatures.
            flats: Pairs, or more frames, of even light without a lens, from dark to beyond saturation.
            pairs: Two frames or more of any static scene at each exposure time, in place of flats, or
                of darks if the files state the black level.
            chart: Frames of a ColorChecker.
            edges: Frames of slanted edges.
            grid: Frames of a checkerboard.
            shading: Frames of even light through the lens.
            ramp: Frames of steps of light, also as JPEGs.
            base: Camera whose values stand for unknown ones, a name or a file; None: "mono" for one
                channel, otherwise "phone".
            cfa: Mosaic of files that do not state it: a name, or rows of letters.
            options: Options of the parts by name, such as the light of a chart.

        Returns:
            The fit.

        Raises:
            BadData: Frames are mixed; or no part can be fitted, as frames are missing, clipped or moved.
            BadFile: A file cannot be read, or is no raw file.
            UnknownName: There is no such base or mosaic.
        """
        from gpusim.fit.fitting import fit_camera

        more = {
            "dark": darks,
            "flat": flats,
            "pairs": pairs,
            "chart": chart,
            "edges": edges,
            "grid": grid,
            "shading": shading,
            "ramp": ramp,
        }
        return fit_camera(files, more, base, cfa, options)


sys.modules[__name__].__class__ = _Function
fit = cast(_Function, sys.modules[__name__])
