"""The folder kernels/ of a checkout as a package; an installed gpusim has the kernels here."""

from pathlib import Path

__path__ = [str(Path(__file__).resolve().parents[2] / "kernels")]
