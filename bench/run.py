"""Speed against error of every stage: runs the tests first, then `gpusim bench`, and draws its rows.

    python bench/run.py --device opencl --out speed        writes speed.json, speed.md and speed.png

Needs `pip install -e '.[test,bench]'`. Nothing is timed on red tests.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt

from gpusim.backends import open_device
from gpusim.bench import bench

ROOT = Path(__file__).parents[1]
COLUMNS = ("ms_p20", "ms_p50", "ms_p80", "gbps", "ratio_to_floor", "build_ms", "rel_rms_error", "max_error")


def table(rows):
    """Rows as a Markdown table."""
    lines = [f"| stage | {' | '.join(COLUMNS)} |", "|---" * (len(COLUMNS) + 1) + "|"]
    lines += [f"| {row['stage']} | {' | '.join(f'{row[key]:.3g}' for key in COLUMNS)} |" for row in rows]
    return "\n".join(lines) + "\n"


def plot(rows, path):
    """Median time against largest error, one point per stage."""
    figure, axes = plt.subplots(figsize=(7, 5), layout="constrained")
    for row in rows:
        error = max(row["max_error"], 1e-9)  # bit-exact stages stand at the left edge
        axes.loglog(error, row["ms_p50"], "o", color="tab:blue")
        axes.annotate(row["stage"], (error, row["ms_p50"]), textcoords="offset points", xytext=(5, 3), fontsize=8)
    axes.set(xlabel="largest error over the peak, against float64", ylabel="median time [ms]",
             title=f"{rows[0]['device']}, {rows[0]['size']}")
    axes.grid(True, which="major", alpha=0.3)
    figure.savefig(path, dpi=120)


def main():
    """Run tests, bench, table and plot; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--out", default="speed", help="stem of the files written")
    arguments = parser.parse_args()
    if subprocess.run([sys.executable, "-m", "pytest", "-q", str(ROOT / "tests" / "test_stages.py")]).returncode:
        print("no speed is measured on red tests", file=sys.stderr)
        return 1
    rows = list(bench(open_device(arguments.device)))
    if any("failed" in row for row in rows):
        print("a stage failed its verification", file=sys.stderr)
        return 1
    Path(f"{arguments.out}.json").write_text(json.dumps(rows, indent=2) + "\n")
    Path(f"{arguments.out}.md").write_text(table(rows))
    plot(rows, f"{arguments.out}.png")
    print(table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
