"""Where measured scenes are looked for, which cannot be shipped."""

from pathlib import Path

SHARED_DATA = Path(__file__).parents[1].parent / "shared" / "data"
