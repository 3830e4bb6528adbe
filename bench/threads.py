"""The same loop of new scenes to raw on 1, 2, 4 ... all cores, each in a separate process.

    python bench/threads.py --device opencl:0 --size 1920x1080 --json bench/results/threads-NAME.json

The process keeps to the first cores by its affinity, and PoCL starts the same number of threads,
set by POCL_MAX_PTHREAD_COUNT before version 5 and by POCL_CPU_MAX_CU_COUNT afterwards, since PoCL
ignores the affinity. `busy` is the processor time of all threads over the wall time. It shows
whether this worked. The speed-up is valid only on cores without other work.
"""

import os

from results import add_size, finish, in_process, parser, ready, require_cpu, start
from scaling import options, settings, shown

from gpusim.bench.machine import count_cores

BANDS = 31
LIMITS = "POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT"


def counts(most: int) -> list[int]:
    """Return 1, 2, 4 ... and the number of cores."""
    return [*(2**power for power in range(most.bit_length()) if 2**power < most), most]


def main():
    """Print the rows, and write them if requested."""
    made = parser(__doc__, "opencl")
    add_size(made)
    options(made)
    arguments = made.parse_args()
    device, old = ready(arguments, "threads")
    require_cpu(device, "it counts processor threads")
    given, rows = settings(arguments, device), []
    for number in counts(count_cores()):
        row = in_process(
            "frames",
            {**given, "size": arguments.size, "bands": BANDS, "threads": number},
            dict.fromkeys(LIMITS, str(number)),
        )
        rows.append({**row, "name": f"{number} of {os.cpu_count()} cores", "threads": number})
        print(shown(rows[-1]["name"], row), flush=True)
    del given["device"]
    finish(arguments, "threads", device, rows, old, size=arguments.size, bands=BANDS, **given)


if __name__ == "__main__":
    start(main)
