"""The same loop of new scenes to raw on 1, 2, 4 ... all cores, each in a process of its own.

    python bench/threads.py --device opencl:0 --size 1920x1080 --json bench/results/threads-NAME.json

The process keeps to the first cores by its affinity, and PoCL starts as many threads: POCL_MAX_PTHREAD_COUNT before
version 5, POCL_CPU_MAX_CU_COUNT from then on; PoCL alone does not look at the affinity. `busy` is the processor time of
all threads over the wall time, which shows that it worked. Only cores that no other work takes give a true speed-up.
"""

import os

from results import add_size, cores, finish, in_process, parser, ready, require_cpu, start
from scaling import options, settings, shown

BANDS = 31
LIMITS = "POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT"


def counts(most: int) -> list[int]:
    """1, 2, 4 ... and all."""
    return [*(2**power for power in range(most.bit_length()) if 2**power < most), most]


def main():
    """Print the rows, and write them where asked."""
    made = parser(__doc__, "opencl")
    add_size(made)
    options(made)
    arguments = made.parse_args()
    device, old = ready(arguments, "threads")
    require_cpu(device, "threads are those of the processor")
    given, rows = settings(arguments, device), []
    for number in counts(cores()):
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
