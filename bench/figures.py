"""Figures of stored results: stages by error and time and under the roofline, scaling of loops."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import NullFormatter
from tables import largest


def draw(result: dict, path):
    """Write the figure of a result as PNG."""
    figure = {"suite": _suite, "scaling": _scaling}[result["bench"]](result)
    figure.suptitle(
        f"{result['device']}: {result['machine']['device']}, {result['machine']['driver']}",
        fontsize=9,
    )
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _suite(result):
    """Draw time against the RMS error, and operations per second against those per byte."""
    rows = [row for row in largest(result["rows"]) if row["verified"] and row["kind"] == "stage"]
    figure, (left, right) = plt.subplots(1, 2, figsize=(13, 5.5), layout="constrained")
    for row in rows:
        error = max(row["rel_rms_error"] or 0.0, 1e-9)  # bit-exact stages are at the left edge
        _point(left, error, row["ms_p50"], _short(row))
    left.set(
        xscale="log",
        yscale="log",
        xlabel="relative RMS error, against float64",
        ylabel="median time [ms]",
    )
    counted = [row for row in rows if row["operations"]]
    dense = [row["operations"] / row["bytes"] for row in counted]
    for row, x in zip(counted, dense, strict=True):
        _point(right, x, row["operations"] / row["ms_p50"] / 1e6, _short(row))
    copied, fma = result["limits"]["copy_gbps"], result["limits"]["fma_gflops"]
    if copied and counted:
        x = np.geomspace(min(dense) / 2, 2 * max(*dense, fma / copied), 50)
        label = f"{copied:.3g} GB/s copied, {fma:.3g} GFLOP/s"
        right.plot(x, np.minimum(x * copied, fma), color="tab:gray", label=label)
        right.legend(fontsize=8)
    right.set(
        xscale="log",
        yscale="log",
        xlabel="operations per byte read and written once",
        ylabel="GFLOP/s",
    )
    for axes in (left, right):
        axes.margins(x=0.15)
        axes.xaxis.set_minor_formatter(NullFormatter())
    return figure


def _short(row):
    return row["name"].rpartition(" ")[0]


def _scaling(result):
    """Draw time per megapixel against frame size, and time per frame against bands."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    rows = [row for row in result["rows"] if "failed" not in row]
    for axes, kept, x, label, scale in (
        (
            left,
            [row for row in rows if row["bands"] == 31],
            "megapixels",
            "megapixels, 31 bands",
            "megapixels",
        ),
        (
            right,
            [row for row in rows if row["name"].startswith("1920x1080")],
            "bands",
            "bands, 1080p",
            None,
        ),
    ):
        kept = sorted(kept, key=lambda row: row[x])
        over = np.array([row[scale] if scale else 1.0 for row in kept])
        middle, low, high = (
            np.array([row[f"ms_{part}"] for row in kept]) / over for part in ("p50", "p25", "p75")
        )
        axes.errorbar(
            [row[x] for row in kept], middle, (middle - low, high - middle), fmt="o-", capsize=3
        )
        axes.set(xscale="log", xlabel=label, ylabel="ms a megapixel" if scale else "ms a frame")
        axes.set_xticks([row[x] for row in kept], [f"{row[x]:.3g}" for row in kept])
        axes.minorticks_off()
        axes.set_ylim(bottom=0)
        axes.grid(True, alpha=0.3)
    return figure


def _point(axes, x, y, name):
    axes.plot(x, y, "o", color="tab:blue")
    axes.annotate(name, (x, y), textcoords="offset points", xytext=(5, 3), fontsize=7)
    axes.grid(True, which="major", alpha=0.3)
