"""Time and memory of a loop of new resident scenes to raw: VGA to 8K, 3 to 301 bands, 1 to all cores.

Each row is measured in a process of its own: wall time of a frame; planning of a scene of this kind
with everything loaded; the device memory that the plan predicted, and its peak, including one scene;
the peak memory of the process, including two scenes. A chart's reflectances are interpolated to the
bands, 400 to 700 nm. A size that does not fit has a row that says so.

A process on fewer cores keeps to the first ones by its affinity. PoCL ignores that, and starts as
many threads as POCL_MAX_PTHREAD_COUNT says before version 5, and POCL_CPU_MAX_CU_COUNT afterwards.
`busy` shows whether this worked. The speed-up is valid only on cores without other work.
"""

from collections.abc import Iterator
from typing import Any

from gpusim.backends import open_device
from gpusim.bench.loops import time_in_process
from gpusim.domain.cores import count_cores
from gpusim.domain.errors import OutOfRange
from gpusim.domain.progress import announced

SIZES = (
    (640, 480),
    (1280, 720),
    (1920, 1080),
    (2560, 1440),
    (3840, 2160),
    (7680, 4320),
)  # of 31 bands
BANDS = (3, 10, 31, 61, 101, 301)  # at 1080p
HD, USUAL = (1920, 1080), 31
LIMITS = "POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT"


def list_cases() -> dict[str, dict[str, Any]]:
    """Return the cases by name: size and bands."""
    pairs = [(size, USUAL) for size in SIZES] + [(HD, bands) for bands in BANDS if bands != USUAL]
    return {
        f"{cols}x{rows}, {bands} bands": {"size": (cols, rows), "bands": bands}
        for (cols, rows), bands in pairs
    }


def list_threads(device: str, size: tuple[int, int] = HD) -> dict[str, dict[str, Any]]:
    """Return the cases of one frame on 1, 2, 4 ... and all cores, by name.

    Args:
        device: Name of an OpenCL device of the processor.
        size: Columns and rows.

    Raises:
        OutOfRange: It is another device.
    """
    opened, most = open_device(device), count_cores()
    if not (opened.kind == "opencl" and opened.on_host):
        raise OutOfRange(
            "device",
            opened.name,
            "an OpenCL device of the processor for --threads, such as opencl:0",
        )
    counts = [*(2**power for power in range(most.bit_length()) if 2**power < most), most]
    return {
        f"{number} of {most} cores": {"size": size, "bands": USUAL, "threads": number}
        for number in counts
    }


def measure_scaling(cases: dict[str, dict[str, Any]], **settings: Any) -> Iterator[dict[str, Any]]:
    """Yield the row of each case, see `gpusim.bench.loops.time_loop`.

    Args:
        cases: Cases by name.
        settings: device, tolerance, camera, repeat and content of all of them.

    Yields:
        Rows with name; with "failed", the reason, if a case does not fit.
    """
    for number, (name, case) in enumerate(cases.items(), 1):
        threads = case.get("threads")
        limits = dict.fromkeys(LIMITS, str(threads)) if threads else {}
        with announced(f"{name}, {number} of {len(cases)}"):
            row = time_in_process({**settings, **case}, limits)
        yield {**row, "name": name, **({"threads": threads} if threads else {})}


def describe_row(row: dict[str, Any]) -> str:
    """Return a row as a line.

    Args:
        row: A row of `measure_scaling`.
    """
    if "failed" in row:
        return f"{row['name']:24s} {row['failed']}"
    peak = "-" if row["bytes_peak"] is None else f"{row['bytes_peak'] / 2**20:.0f}"
    return (
        f"{row['name']:24s} {row['ms_p50']:9.3f} ms ({row['ms_p25']:.3f} .. {row['ms_p75']:.3f})  "
        f"{row['ms_p50'] / row['megapixels']:8.3f} ms/Mpixel  planning {row['planning_ms']:.0f} ms  memory "
        f"{row['bytes_predicted'] / 2**20:.0f} MiB predicted, {peak} taken, process {row['rss'] / 2**20:.0f}  "
        f"{row['busy']:.2f} cores busy"
    )
