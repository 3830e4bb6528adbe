"""Judge stages in a separate process, which `gpusim.judge.verify` starts.

`python -m gpusim.judge.verify_child DEVICE STAGE ...` writes one JSON object a line: `device` when
it is open, or `refused` if it cannot be opened; then for each stage `begins`, a `row` per case, and
`ends`.
"""

import json
import os
import sys

from gpusim.backends import open_device
from gpusim.domain.errors import DeviceError
from gpusim.judge.verify import verify


def _open_channel():
    """Return a function that sends messages to the standard output.

    Other code no longer writes there.
    """
    channel = os.dup(1)
    os.dup2(2, 1)  # drivers and kernels now print to the standard error

    def send(**message):
        os.write(channel, json.dumps(message).encode() + b"\n")

    return send


def main(name: str, stages: list[str]) -> None:
    """Judge the stages and send the messages.

    Args:
        name: Name of the device.
        stages: Names of the stages, in the order to judge them.
    """
    send = _open_channel()
    try:
        device = open_device(name)
    except DeviceError as error:
        send(refused=error.details)
        return
    send(device=device.name)
    for stage in stages:
        send(begins=stage)
        for row in verify(device, [stage]):
            send(row=row)
        send(ends=stage)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
